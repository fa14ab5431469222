"""Memory that was freed and is taken again."""

import platform
import resource

import numpy as np
import pytest

from tiltcal.logs.streams import keep_freed_memory


def faults_of_a_block() -> int:
    """Fill 30 MB in arrays of the size of a column, free them, and return how many pages had to be taken."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    arrays = [np.ones(1 << 16) for _ in range(60)]
    del arrays
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc returns freed memory and can be told not to")
def test_pages_of_a_block_are_taken_once():
    keep_freed_memory()
    faults_of_a_block()
    assert faults_of_a_block() < 30 * 256 / 10  # pages of 4 kB

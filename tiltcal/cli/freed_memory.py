"""The memory that a process frees, and takes again for the next rows of a long log."""

from __future__ import annotations

import sys
from contextlib import suppress

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of mallopt(3)
_KEPT = 64 << 20
_ARRAY = 16 << 20


def keep_freed_memory() -> None:
    """Let this process keep up to 64 MB that it has freed, where its C library is glibc.

    Left to itself, glibc returns the arrays of each block of rows to the system. To take their pages again costs as
    much time as the arithmetic of uncertainties.
    """
    if sys.platform != "linux":
        return
    import ctypes

    with suppress(AttributeError, OSError):  # another C library has no such function
        library = ctypes.CDLL(None)
        library.mallopt(_MMAP_THRESHOLD, _ARRAY)
        library.mallopt(_TRIM_THRESHOLD, _KEPT)

"""Four accelerometers on a stage behind a pseudo-terminal: the lines of an independent disk, for the tests alone.

Nothing is lost on the way: a line is printed when there is room for it, so the disk waits while nobody reads.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from itertools import chain, repeat

from support.pty_device import printing

LINES_A_SECOND = 1500


def on_a_pty(lines: Sequence[bytes]) -> AbstractContextManager[str]:
    """Print the lines on a pseudo-terminal, the last one again and again; its path."""
    following = chain(lines, repeat(lines[-1]))
    return printing(lambda: next(following), LINES_A_SECOND, waits=True)

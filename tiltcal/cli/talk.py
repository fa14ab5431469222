"""Messages on standard error: where its reader has ended or its disk is full, a command goes on without them."""

from __future__ import annotations

import sys
from contextlib import suppress

from tiltcal.printable import printable


def talk(text: str) -> None:
    """Print a text as it is."""
    if sys.stderr is not None:
        with suppress(OSError):
            print(text, file=sys.stderr, flush=True)


def remark(text: str) -> None:
    """Print a remark on what a command does, broken at the width of a terminal."""
    shown = printable(text)
    talk(wrapped(shown) if sys.stderr is not None and sys.stderr.isatty() else shown)


def wrapped(text: str) -> str:
    """Return text whose lines break between words at the width of the terminal; a broken line goes on indented."""
    from shutil import get_terminal_size
    from textwrap import fill

    width = get_terminal_size().columns
    return "\n".join(
        fill(line, width, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False)
        if len(line) > width
        else line
        for line in text.split("\n")
    )

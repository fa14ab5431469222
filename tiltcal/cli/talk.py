"""Messages and progress on standard error: where its reader has ended or its disk is full, a command goes on."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from tiltcal.printable import printable

if TYPE_CHECKING:
    from tiltcal.logs.log import Progress


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


@contextmanager
def progress_bar(what: str) -> Iterator[Progress | None]:
    """Show a progress bar on a terminal, for a log with a known size."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress as Bar

    with Bar(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=None, visible=False)
        yield lambda done, size: bar.update(task, completed=done, total=size, visible=size is not None)

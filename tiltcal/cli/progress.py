"""The progress bar of a command that reads a log."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tiltcal.logs.log import Progress


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

"""What the commands that read a log share: where its bytes come from, where they go, how far it is."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from tempfile import SpooledTemporaryFile
from typing import BinaryIO, cast

from tiltcal.errors import UsageError

STANDARD = "-"

_SPOOL = 64 << 20  # bytes of a result for standard output that stay in memory


def require_csv(*names: str) -> None:
    """Refuse what is not CSV, where nothing else is read.

    Raises
    ------
    UsageError
        One of the names is that of another format.
    """
    from tiltcal.logs.formats import is_csv

    for name in names:
        if not is_csv(name):
            raise UsageError(f"{name}: logs are CSV for now; convert it to CSV first")


@contextmanager
def log_source(log: str) -> Iterator[tuple[BinaryIO, str, int | None]]:
    """The log's bytes, what to call it in messages, and its size where it has one.

    Parameters
    ----------
    log : str
        A file, or ``-`` for standard input.
    """
    if log == STANDARD:
        yield sys.stdin.buffer, "standard input", None
        return
    try:
        stream = open(log, "rb")  # noqa: SIM115 (only what opening raises is about opening)
    except OSError as failure:
        raise UsageError(f"cannot read {log}: {failure.strerror}") from failure
    with stream:
        yield stream, log, os.fstat(stream.fileno()).st_size or None


@contextmanager
def log_sink(output: str) -> Iterator[BinaryIO]:
    """Where the rows go, all of them or none."""
    if output != STANDARD:
        from tiltcal.files.whole import whole_file

        with whole_file(output) as stream:
            yield stream
        return
    with SpooledTemporaryFile(_SPOOL) as spool:
        yield cast("BinaryIO", spool)
        spool.seek(0)
        stdout = sys.stdout.buffer
        shutil.copyfileobj(spool, stdout)
        stdout.flush()


@contextmanager
def progress_bar(what: str, size: int | None) -> Iterator[Callable[[int], None] | None]:
    """A bar for a person who watches; nothing for a program."""
    if size is None or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=size)
        yield lambda done: bar.update(task, completed=done)

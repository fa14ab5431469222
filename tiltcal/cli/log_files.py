"""What the commands that read a log share: where its bytes come from, where they go, how far it is."""

from __future__ import annotations

import os
import shutil
import stat
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from select import select
from tempfile import SpooledTemporaryFile
from typing import BinaryIO, cast

from tiltcal.errors import UsageError

STANDARD = "-"

_ARRIVES = 1 << 16  # bytes that a pipe holds
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


class PipeReader:
    """What arrives from a pipe, a device or a terminal; Ctrl-C ends the wait for it.

    The engine that parses rows has its own word on signals, and lets a read go on after one.

    Parameters
    ----------
    stream : BinaryIO
        Of which nothing was read: what stands in its buffer would not be seen.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._descriptor = stream.fileno()

    def fileno(self) -> int:
        """Of the stream."""
        return self._descriptor

    def read1(self, size: int = -1) -> bytes:
        """What has arrived, once something has; nothing at the end."""
        if os.name == "posix":
            select([self._descriptor], [], [])
        return os.read(self._descriptor, size if size >= 0 else _ARRIVES)

    def read(self, size: int = -1) -> bytes:
        """So many bytes, or all that come until the end."""
        parts, left = [], size
        while left and (part := self.read1(left)):
            parts.append(part)
            left -= len(part) if size >= 0 else 0
        return b"".join(parts)


def has_no_end(stream: BinaryIO) -> bool:
    """Whether nothing but Ctrl-C, or the other side, will end a stream; a file has its own end."""
    try:
        return not stat.S_ISREG(os.fstat(stream.fileno()).st_mode)
    except OSError:  # memory
        return False


@contextmanager
def log_source(log: str) -> Iterator[tuple[BinaryIO, str, int | None]]:
    """The log's bytes, what to call it in messages, and its size where it has one.

    Parameters
    ----------
    log : str
        A file, or ``-`` for standard input.
    """
    if log == STANDARD:
        yield _read_as_it_comes(sys.stdin.buffer), "standard input", None
        return
    try:
        stream = open(log, "rb")  # noqa: SIM115 (only what opening raises is about opening)
    except OSError as failure:
        raise UsageError(f"cannot read {log}: {failure.strerror}") from failure
    with stream:
        yield _read_as_it_comes(stream), log, os.fstat(stream.fileno()).st_size or None


def _read_as_it_comes(stream: BinaryIO) -> BinaryIO:
    return cast("BinaryIO", PipeReader(stream)) if has_no_end(stream) else stream


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

"""Where the bytes of a log come from and where they go: files, pipes, devices, standard input and output."""

from __future__ import annotations

import io
import os
import re
import select
import signal
import stat
import sys
import threading
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext, suppress
from hashlib import file_digest
from pathlib import Path
from types import FrameType
from typing import BinaryIO, TypeVar, cast

from tiltcal.errors import InputError, TiltcalError, UsageError

T = TypeVar("T")
STANDARD = "-"  # the name of standard input and standard output
_LOOK = 0.2  # seconds until a wait for bytes looks whether Ctrl-C came
_OF_THE_SYSTEM = re.compile(r"\(os error (\d+)\)$|errno = (\d+)")  # in what libraries say where the system refuses
_SPOOL = 64 << 20  # bytes of a result for standard output that stay in memory
_WRITEBACK = 32 << 20  # bytes of a result that go to the disk together


@contextmanager
def log_source(log: str, *, live: bool = False) -> Iterator[tuple[BinaryIO, int | None]]:
    """Open a log, a file or ``-`` for standard input: its bytes, and its size where it has one.

    Where ``live``, Ctrl-C ends a stream that has no end of its own. A UsageError if the file cannot be opened.
    """
    if log == STANDARD and sys.stdin is None:
        raise UsageError("standard input is closed: name a file instead of -")
    try:
        stream = sys.stdin.buffer if log == STANDARD else open(log, "rb")  # noqa: SIM115
    except OSError as failure:
        raise UsageError(f"cannot read {log}: {failure.strerror}") from failure
    with nullcontext() if log == STANDARD else stream:
        try:
            state = os.fstat(stream.fileno())
        except OSError:  # memory
            yield stream, None
            return
        size = None if log == STANDARD else state.st_size or None
        if stat.S_ISREG(state.st_mode):
            yield stream, size
            return
        pipe = PipeReader(stream)
        with pipe.ended_by_ctrl_c() if live else nullcontext():
            yield cast("BinaryIO", pipe), size


@contextmanager
def log_sink(output: str) -> Iterator[BinaryIO]:
    """Open where the rows go, a file or ``-`` for standard output: all of them or none appear there."""
    if output != STANDARD:
        from tiltcal.files.atomic import whole_file

        with whole_file(output) as stream:
            yield stream
        return
    if sys.stdout is None:
        raise UsageError("standard output is closed: name a file instead of -")
    import shutil
    from tempfile import SpooledTemporaryFile

    with SpooledTemporaryFile(_SPOOL) as spool:
        yield cast("BinaryIO", spool)
        spool.seek(0)
        stdout = sys.stdout.buffer
        shutil.copyfileobj(spool, stdout)
        stdout.flush()


def with_writeback(sink: BinaryIO, items: Iterable[T]) -> Iterator[T]:
    """Yield items that are written to a sink, and let the system bring to the disk what it has meanwhile.

    Without it the command waits in the end until all is there: 0.4 s for a result of 1.2 GB.
    """
    begun, advise = 0, getattr(os, "posix_fadvise", None)
    for item in items:
        yield item
        if advise is None or not isinstance(sink, io.BufferedIOBase):  # what goes to standard output is no file yet
            continue
        if (size := os.fstat(sink.fileno()).st_size) - begun >= _WRITEBACK:
            with suppress(OSError):
                advise(sink.fileno(), begun, size - begun, os.POSIX_FADV_DONTNEED)
            begun = size


def keep_freed_memory() -> None:
    """Let the C library keep up to 64 MB of freed arrays of each thread for the next ones, where it is glibc.

    It returns to the system what lies free beyond twice the largest block that it has seen freed, and the arrays of
    each block of rows would have to take it back, page by page: that took as long as the compensation.
    """
    import numpy as np

    np.empty(31 << 20, np.uint8)  # 32 MB is the most that counts


@contextmanager
def refusing(what: str, file: str) -> Iterator[None]:
    """Raise an InputError that says ``what`` for whatever a library raises about a file, damaged ones raise anything.

    What the system refuses, such as on a full disk, becomes an OSError with its number, which the libraries only quote.
    """
    import polars as pl

    try:
        yield
    except (TiltcalError, MemoryError):
        raise
    except (Exception, pl.exceptions.PanicException) as failure:
        if (quoted := _OF_THE_SYSTEM.search(str(failure))) is not None:
            code = int(quoted[1] or quoted[2])
            raise OSError(code, os.strerror(code)) from failure
        raise InputError(f"{what}: {failure or type(failure).__name__}", file=file) from failure


def read_ahead(items: Iterator[T], count: int = 2) -> Iterator[T]:
    """Yield the items of an iterator, which runs in a thread of its own and is up to ``count`` items ahead.

    What the iterator raises is raised here. Its thread ends with the iterator, or when this one is closed.
    """
    with ThreadPoolExecutor(max_workers=1, thread_name_prefix="read-ahead") as thread:
        expected = deque(thread.submit(next, items, None) for _ in range(count))
        try:
            while (item := expected.popleft().result()) is not None:
                expected.append(thread.submit(next, items, None))
                yield item
        finally:
            for future in expected:
                future.cancel()


def sha256_of(path: str | Path) -> str:
    """Return the SHA-256 of a whole file, hexadecimal."""
    if os.path.exists(path) and not os.path.isfile(path):
        raise InputError("this is no file that can be read twice, and its checksum is needed: name a file", file=path)
    with open(path, "rb") as stream:
        return file_digest(stream, "sha256").hexdigest()


class PipeReader:
    """What arrives from a pipe, a device or a terminal, of which nothing was read yet; Ctrl-C ends the wait for it.

    The engine that parses rows handles signals in its own way, and lets a read go on after one.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._descriptor = stream.fileno()
        self.interrupted = False

    def read(self, size: int) -> bytes:
        """Return so many bytes, or all that come until the end."""
        parts, missing = [], size
        while missing and not self.interrupted:
            # A signal that comes just before the wait, or to another thread, does not end it. On Windows select takes
            # sockets alone, and has no poll beside it.
            if hasattr(select, "poll") and not select.select([self._descriptor], [], [], _LOOK)[0]:
                continue
            if not (part := os.read(self._descriptor, missing)):
                break
            parts.append(part)
            missing -= len(part)
        return b"".join(parts)

    @contextmanager
    def ended_by_ctrl_c(self) -> Iterator[None]:
        """Let Ctrl-C end the stream, and leave what was read of it."""
        before = signal.getsignal(signal.SIGINT)
        if not callable(before) or threading.current_thread() is not threading.main_thread():
            yield
            return

        def end(_signal: int, _frame: FrameType | None) -> None:
            self.interrupted = True

        signal.signal(signal.SIGINT, end)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)

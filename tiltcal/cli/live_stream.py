"""A stream that has no end of its own: read as it arrives, ended by Ctrl-C."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, cast

from tiltcal.cli.log_files import has_no_end, log_source

if TYPE_CHECKING:
    import io


class LiveStream:
    """The whole lines of a log, handed on as they arrive and not when a block is full.

    Parameters
    ----------
    stream : io.BufferedReader
        Standard input, a pipe, a serial device, or a file.

    Attributes
    ----------
    endless : bool
        Whether nothing but Ctrl-C, or the other side, will end it; a file has its own end.
    interrupted : bool
        Whether Ctrl-C has ended it.
    """

    def __init__(self, stream: io.BufferedReader) -> None:
        self._stream = stream
        self.endless = has_no_end(stream)
        self.interrupted = False
        self._waiting = False
        self._begun = b""

    def read(self, size: int = -1) -> bytes:
        """What has arrived, up to the end of its last line; nothing at the end, where a line may lack its own."""
        while not self.interrupted:
            try:
                self._waiting = True
                arrived = self._stream.read1(size)
            except KeyboardInterrupt:
                break
            finally:
                self._waiting = False
            if not arrived:
                rest, self._begun = self._begun, b""
                return rest
            lines, end, begun = arrived.rpartition(b"\n")
            if end:
                whole, self._begun = self._begun + lines + end, begun
                return whole
            self._begun += arrived
        return b""

    @contextmanager
    def ended_by_ctrl_c(self) -> Iterator[None]:
        """While this lasts Ctrl-C ends the stream and leaves what was read of it; a file it stops as it stops all."""
        before = signal.getsignal(signal.SIGINT)
        if not self.endless or before is not signal.default_int_handler:
            yield
            return

        def end(_signal: int, _frame: FrameType | None) -> None:
            self.interrupted = True
            if self._waiting:
                raise KeyboardInterrupt

        signal.signal(signal.SIGINT, end)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)


@contextmanager
def live_source(log: str) -> Iterator[tuple[LiveStream, str, int | None]]:
    """A log as a live stream, what to call it in messages, and its size where it has one."""
    with log_source(log) as (source, name, size):
        stream = LiveStream(cast("io.BufferedReader", source))
        with stream.ended_by_ctrl_c():
            yield stream, name, size

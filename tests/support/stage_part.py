"""Four accelerometers on a stage behind a pseudo-terminal: the lines of an independent disk, for the tests alone.

Nothing is lost on the way: a line is printed when there is room for it, so the disk waits while nobody reads.
"""

from __future__ import annotations

import os
import threading
import tty
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from support import accelerometer_disk as disk

LINES_A_SECOND = 1500


def printed(taken: disk.Record) -> list[bytes]:
    """A record as lines: ``time,theta,a1,a2,a3,a4``."""
    return [
        ",".join(f"{value:.10g}" for value in (time, theta, *row)).encode() + b"\r\n"
        for time, theta, row in zip(taken.time, taken.theta, taken.readings.tolist(), strict=True)
    ]


@contextmanager
def on_a_pty(lines: Sequence[bytes]) -> Iterator[str]:
    """Print the lines on a pseudo-terminal, the last one again and again; its path."""
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    ended = threading.Event()

    def talk() -> None:
        number, rest = 0, b""
        while not ended.wait(1 / LINES_A_SECOND):
            if not rest:
                rest = lines[min(number, len(lines) - 1)]
                number += 1
            try:
                rest = rest[os.write(master, rest) :]
            except BlockingIOError:
                continue

    talker = threading.Thread(target=talk)
    talker.start()
    try:
        yield os.ttyname(slave)
    finally:
        ended.set()
        talker.join()
        os.close(master)
        os.close(slave)

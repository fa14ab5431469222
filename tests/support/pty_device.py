"""A device that prints on a pseudo-terminal, in a thread of the test."""

import os
import select
import threading
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def printing(next_bytes: Callable[[], bytes], per_second: float, *, waits: bool) -> Iterator[str]:
    """Print what a function returns, so often a second; the path of the pseudo-terminal.

    While nobody reads, a device that ``waits`` keeps its bytes for later. Those of another are lost, as a UART's are.
    """
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    ended = threading.Event()

    def print_on() -> None:
        rest = b""
        while not ended.wait(1 / per_second):
            rest = rest or next_bytes()
            try:
                written = os.write(master, rest)
            except BlockingIOError:
                written = 0
            rest = rest[written:] if waits else b""

    printer = threading.Thread(target=print_on)
    printer.start()
    try:
        yield os.ttyname(slave)
    finally:
        ended.set()
        printer.join()
        os.close(master)
        os.close(slave)


@contextmanager
def answering(answer: Callable[[bytes], bytes], ends: bytes = b"\r") -> Iterator[str]:
    """Answer each question, which ends so, with what a function returns; the path of the pseudo-terminal."""
    master, slave = os.openpty()
    tty.setraw(slave)
    stop, stopped = os.pipe()

    def serve() -> None:
        asked = b""
        while stop not in (ready := select.select([master, stop], [], [])[0]):
            asked += os.read(ready[0], 4096)
            *questions, asked = asked.split(ends)
            for question in questions:
                os.write(master, answer(question + ends))

    server = threading.Thread(target=serve)
    server.start()
    try:
        yield os.ttyname(slave)
    finally:
        os.write(stopped, b"stop")
        server.join()
        for descriptor in (master, slave, stop, stopped):
            os.close(descriptor)

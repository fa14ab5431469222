"""Processes of the tiltcal command without the second that a start of Python takes.

A server imports what a session needs, once, and forks a process for every command: a real process, with a number,
standard streams, a folder and an environment of its own, that a signal ends as it ends any other. Run as a script this
module is the server.
"""

import gc
import json
import os
import selectors
import shutil
import signal
import socket
import subprocess
import sys
import time
from array import array
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from select import select
from tempfile import TemporaryDirectory
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

from support.warm_program import STREAMS, fork, line_of

POLL = 0.0005
"""Seconds between two looks at a file."""


class Victim:
    """A running command."""

    def __init__(self, server: socket.socket, number: int) -> None:
        self._server = server
        self._number = number

    def kill_at(self, file: Path, size: int) -> int:
        """Kill it when a file of its has grown to a size, in bytes, and return its wait status."""
        with self._server:
            while not select([self._server], [], [], POLL)[0]:
                if file.exists() and file.stat().st_size >= size:
                    with suppress(ProcessLookupError):
                        os.kill(self._number, signal.SIGKILL)
                    break
            return int(line_of(self._server))


def wait_until_grown(process: subprocess.Popen[Any], file: Path, size: int) -> None:
    """Wait until a file that a process writes has grown to a size, in bytes, or the process has ended."""
    while process.poll() is None and not (file.exists() and file.stat().st_size >= size):
        time.sleep(POLL)


class WarmStart:
    """A running server; ``program`` is what stands for ``python -m tiltcal`` in a command line."""

    def __init__(self, path: Path) -> None:
        self._path = str(path)
        self.program = [sys.executable, "-I", "-S", str(Path(__file__).with_name("warm_program.py")), self._path]

    def start(self, arguments: Sequence[str], folder: Path) -> Victim:
        """Start a command in a folder, with nothing to read and nobody who reads."""
        with open(os.devnull, "r+b") as nothing:
            return Victim(*fork(self._path, arguments, str(folder), [nothing.fileno()] * STREAMS))


@contextmanager
def warm_start() -> Iterator[WarmStart]:
    """Yield a running server; what it forks can use emulated device nodes, where these can be made."""
    wrapper = shutil.which("umockdev-wrapper")
    with TemporaryDirectory() as folder:
        path = Path(folder) / "socket"
        command = [*([wrapper] if wrapper else []), sys.executable, __file__, str(path)]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as server:
            if server.stdout is None or server.stdout.readline() != "ready\n":
                raise RuntimeError("the server does not start")
            yield WarmStart(path)
            server.communicate()  # the end of its input ends it


def serve(path: str) -> None:
    """Fork a process for each connection that asks for one, tell its number and how it ended; until the input ends."""
    from support.command import measure

    for library in ("smbus2", "spidev"):
        with suppress(ImportError):
            import_module(library)
    with TemporaryDirectory() as folder:  # a session imports more than its modules name at their heads
        measure("--samples", "2", "--settle", "0.1", cwd=Path(folder))
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 50)
    with socket.socket(socket.AF_UNIX) as listening, selectors.DefaultSelector() as events:
        listening.bind(path)
        listening.listen()
        events.register(listening, selectors.EVENT_READ)
        events.register(sys.stdin, selectors.EVENT_READ)
        print("ready", flush=True)
        while True:
            for key, _ in events.select():
                if key.fileobj is sys.stdin:
                    return
                if key.fileobj is listening:
                    connection, number = forked(listening)
                    process = os.pidfd_open(number)
                    for source in (process, connection):
                        events.register(source, selectors.EVENT_READ, (connection, number, process))
                    continue
                connection, number, process = key.data
                if key.fileobj is connection:  # who asked for the process has ended
                    os.kill(number, signal.SIGKILL)
                status = os.waitpid(number, 0)[1]
                for source in (process, connection):
                    events.unregister(source)
                os.close(process)
                with connection, suppress(BrokenPipeError):
                    connection.sendall(b"%d\n" % status)
                break  # both may be ready


def forked(listening: socket.socket) -> tuple[socket.socket, int]:
    """Fork the process that the next connection asks for, tell its number, and return both."""
    connection = listening.accept()[0]
    request, streams = b"", array("i")
    while not request.endswith(b"\n"):
        data, messages, _, _ = connection.recvmsg(65536, socket.CMSG_SPACE(STREAMS * streams.itemsize))
        request += data
        for _, _, passed in messages:
            streams.frombytes(passed)
    number = os.fork()
    if number == 0:
        for stream, passed in enumerate(streams):
            os.dup2(passed, stream)
        os.closerange(STREAMS, os.sysconf("SC_OPEN_MAX"))
        become(*json.loads(request))
    for passed in streams:
        os.close(passed)
    connection.sendall(b"%d\n" % number)
    return connection, number


def become(*arguments: str) -> None:
    """Run the command, with a folder and an environment behind its arguments, to the end of this process."""
    from tiltcal.__main__ import main

    *words, folder, environment = arguments
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    sys.stdin = os.fdopen(0, encoding="utf-8")
    sys.stdout = os.fdopen(1, "w", encoding="utf-8")
    sys.stderr = os.fdopen(2, "w", encoding="utf-8", buffering=1)
    sys.argv = ["tiltcal", *words]
    try:
        main()
    except BaseException:
        sys.excepthook(*sys.exc_info())
    finally:
        os._exit(1)  # main ends the process itself


if __name__ == "__main__":
    serve(sys.argv[1])

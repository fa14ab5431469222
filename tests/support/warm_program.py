"""A program that stands for ``python -m tiltcal``: a server of :mod:`support.warm_start` forks the process that it is.

    python -I -S warm_program.py SOCKET ARGUMENT...

It hands on its standard streams, folder, environment and signals, and ends as that process ends.
"""

import json
import os
import signal
import socket
import sys
from array import array
from collections.abc import Sequence
from contextlib import suppress

STREAMS = 3
WAIT = 0.1  # seconds of one wait: a signal that came just before it is handled behind it


def fork(path: str, arguments: Sequence[str], folder: str, streams: Sequence[int]) -> tuple[socket.socket, int]:
    """Have the server fork a process; return the connection, which tells its end, and its number."""
    server = socket.socket(socket.AF_UNIX)
    server.connect(path)
    request = json.dumps([*arguments, folder, dict(os.environ)])
    server.sendmsg([request.encode() + b"\n"], [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array("i", streams))])
    return server, int(line_of(server))


def line_of(connection: socket.socket) -> bytes:
    """Return the next line; the other side sends one at a time."""
    line, more = b"", b"-"
    connection.settimeout(WAIT)
    while more and not line.endswith(b"\n"):
        with suppress(TimeoutError):
            line += (more := connection.recv(65536))
    return line


def main(path: str, *arguments: str) -> None:
    server, number = fork(path, arguments, os.getcwd(), range(STREAMS))
    for name in (signal.SIGINT, signal.SIGTERM):
        signal.signal(name, lambda told, _: os.kill(number, told))
    code = os.waitstatus_to_exitcode(int(line_of(server)))
    if code < 0:
        signal.signal(-code, signal.SIG_DFL)
        os.kill(os.getpid(), -code)
    os._exit(code)


if __name__ == "__main__":
    main(*sys.argv[1:])

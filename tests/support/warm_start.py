"""Processes that can be killed, without the second that a start of Python takes.

A server imports what a session needs, once, and forks a process for every command: a real process, with a number, that
a signal ends as it ends any other. Run as a script this module is the server.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).parents[1]))

Start = Callable[[Sequence[str], Path], "Victim"]


class Victim:
    """A running command."""

    def __init__(self, number: int, ended: Callable[[], int]) -> None:
        self._number = number
        self._ended = ended

    def kill_at(self, file: Path, size: int) -> int:
        """Kill it when a file of its has grown to a size, in bytes, and return its wait status."""
        while self._runs():
            if file.exists() and file.stat().st_size >= size:
                os.kill(self._number, signal.SIGKILL)
                break
            time.sleep(0.0005)
        return self._ended()

    def _runs(self) -> bool:
        """Whether it has not ended; an ended one is a zombie until the server is asked for its status."""
        state = Path(f"/proc/{self._number}/stat").read_text().rpartition(")")[2].split()[0]
        return state != "Z"


@contextmanager
def warm_start() -> Iterator[Start]:
    """Yield a function that starts a command in a folder; one at a time."""
    with subprocess.Popen(
        [sys.executable, __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as server:
        asked, told = server.stdin, server.stdout
        if asked is None or told is None:
            raise RuntimeError("no pipes")

        def start(arguments: Sequence[str], folder: Path) -> Victim:
            asked.write(json.dumps([list(arguments), str(folder)]) + "\n")
            asked.flush()
            return Victim(int(told.readline()), ended)

        def ended() -> int:
            asked.write("\n")
            asked.flush()
            return int(told.readline())

        yield start


def serve() -> None:
    """Fork a process for each line that asks for one, and tell its number; at an empty line tell how it ended."""
    from support.command import measure
    from tiltcal.cli.main import run

    with TemporaryDirectory() as folder:  # a session imports more than its modules name at their heads
        measure("--samples", "2", "--settle", "0.1", cwd=Path(folder))
    number = 0
    for line in sys.stdin:
        if line.strip():
            arguments, folder = json.loads(line)
            number = os.fork()
            if number == 0:
                os.chdir(folder)
                nothing = os.open(os.devnull, os.O_RDWR)
                for stream in range(3):
                    os.dup2(nothing, stream)
                os._exit(run(arguments))
            print(number, flush=True)
        else:
            print(os.waitpid(number, 0)[1], flush=True)


if __name__ == "__main__":
    serve()

"""A test's hand on a program that runs against an emulated device node.

::

    with run_on([sys.executable, "-m", "tiltcal", "measure", ..., "--operator", "json"]) as bench:
        events = bench.lead()       # takes every position that is asked for, answers "ready"
    assert bench.exit_code == 0

The program uses the real bus library (python-spidev, smbus2) on a real device node; umockdev hands its ioctls to an
SCA100T that was written apart from the drivers, or to a virtual part, which other hands judge elsewhere.
"""

import json
import os
import shutil
import socket
import subprocess
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from functools import cache
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any, NamedTuple

import pytest

from tiltcal.drivers.virtual import Truth

HERE = Path(__file__).parent
SYSTEM_PYTHON = "/usr/bin/python3"
DEVICE = "/dev/spidev0.0"
I2C_BUS = "/dev/i2c-1"


def truth(noise: float, *rows: tuple[float, ...], **more: Any) -> Truth:
    """The truth of a part: of each channel its offset (count at 24 °C), then its sensitivities (count/g) to x, y, z."""
    named = dict(zip("xyz", rows, strict=False))
    return Truth(
        tuple(named),
        {channel: row[0] for channel, row in named.items()},
        {channel: dict(zip("xyz", row[1:], strict=True)) for channel, row in named.items()},
        **{"reference": 24.0, "noise": dict.fromkeys(named, noise), "jig": 0.01, "seed": 1, **more},
    )


SCA100T = truth(0.6, (1026.3, 817.4, 11.2, -3.5), (1020.8, -7.9, 821.6, 5.1), drift={"x": (0.21,), "y": (-0.05,)})
SCA3000 = truth(1.5, (31.4, 1341.2, 9.6, -14.3), (-18.7, -7.1, 1322.5, 11.8), (44.2, 5.9, -12.4, 1338.7))


def coefficients(part: Truth) -> tuple[list[float], list[list[float]]]:
    """Offsets and sensitivities, a row for each channel."""
    return list(part.offset.values()), [list(row.values()) for row in part.sensitivity.values()]


class Message(NamedTuple):
    """One SPI message or I2C transaction as the kernel's side saw it: times on the monotonic clock, ns."""

    start_ns: int
    end_ns: int
    out: bytes
    answer: bytes


READY = '{"answer": "ready"}'


class Bench:
    """The running program, with text pipes for standard input and output, and the part it talks to."""

    def __init__(self, process: subprocess.Popen[str], control: socket.socket, errors: IO[str]) -> None:
        self.process = process
        self._errors = errors
        self._control = control.makefile("rw", encoding="utf-8")

    @property
    def exit_code(self) -> int:
        """Of the program, once it has ended; 128 + n where signal n ended it."""
        return self.process.wait()

    def errors(self) -> str:
        """What the program has written to standard error so far."""
        self._errors.seek(0)
        return self._errors.read()

    def pose(self, gravity: Sequence[float], temperature: float | None = None) -> None:
        """Lay the part so that ``gravity`` (unit vector) points up, at a temperature in °C; in force on return."""
        self._order(pose=list(gravity), temperature=temperature)

    def fail(self, number: int) -> None:
        """Let every message fail with this errno from now on; 0 lets them pass again."""
        self._order(fault=number)

    def break_part(self) -> None:
        """Let the part send its fault signal."""
        self._order(broken=True)

    def kill(self, signal: int) -> None:
        """Send a signal to the program."""
        self._order(kill=int(signal))

    def messages(self) -> list[Message]:
        """Every SPI message or I2C transaction that was answered so far."""
        rows = self._order(messages=True)["messages"]
        return [Message(start, end, bytes.fromhex(out), bytes.fromhex(answer)) for start, end, out, answer in rows]

    def settings(self) -> dict[str, int]:
        """Mode, bits per word and speed in Hz that the program has set on SPI."""
        settings: dict[str, int] = self._order(messages=True)["settings"]
        return settings

    def ask(self, line: str) -> dict[str, Any]:
        """Send the program a line and take its answer, one line of JSON."""
        self.say(line)
        return self.read()

    def read(self) -> dict[str, Any]:
        """Take the next line of the program, one object of JSON."""
        line = self.process.stdout.readline()  # type: ignore[union-attr]
        assert line, self.errors()
        found: dict[str, Any] = json.loads(line)
        return found

    def take(self, asked: Mapping[str, Any] | None = None, gravity: Sequence[float] | None = None) -> None:
        """Take the position of an ask, of the next one where none is given, or a wrong ``gravity``; say ready."""
        asked = asked or self.read()
        self.pose(gravity or asked["gravity"], asked.get("temperature"))
        self.say(READY)

    def say(self, line: str) -> None:
        """Send the program a line on its standard input."""
        self.process.stdin.write(line + "\n")  # type: ignore[union-attr]
        self.process.stdin.flush()  # type: ignore[union-attr]

    def lead(self) -> list[dict[str, Any]]:
        """Take each position that ``--operator json`` asks for, until the program ends; return every line of it."""
        said = []
        for line in self.process.stdout:  # type: ignore[union-attr]
            said.append(json.loads(line))
            if "ask" in said[-1]:
                self.take(said[-1])
        return said

    def _order(self, **order: object) -> dict[str, Any]:
        self._control.write(json.dumps(order) + "\n")
        self._control.flush()
        answer: dict[str, Any] = json.loads(self._control.readline())
        return answer


@contextmanager
def run_on(
    program: Sequence[str | os.PathLike[str]],
    part: Truth = SCA100T,
    model: str = "data-sheet",
    address: int | None = None,
) -> Iterator[Bench]:
    """Start a program on a machine with one device node, and wait for its end on leaving.

    The node leads to an SCA100T by its data sheet, or to a part of a model: ``/dev/spidev0.0``, or ``/dev/i2c-1`` where
    the part has a 7-bit address. A program that runs longer than two minutes is killed.
    """
    if why := missing():
        pytest.skip(why)
    ours, theirs = socket.socketpair()
    command = [
        *("umockdev-wrapper", SYSTEM_PYTHON, str(HERE / "host.py"), str(theirs.fileno()), json.dumps(address)),
        *(model, json.dumps(asdict(part)), *map(str, program)),
    ]
    with (
        ours,
        # A pipe that nobody reads would stop a talkative program.
        TemporaryFile("w+", encoding="utf-8") as errors,
        subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, text=True, pass_fds=[theirs.fileno()]
        ) as process,
    ):
        theirs.close()
        bench = Bench(process, ours, errors)
        # The host ends the program when the control socket closes.
        watchdog = threading.Timer(120.0, ours.shutdown, [socket.SHUT_RDWR])
        watchdog.start()
        try:
            yield bench
            if process.stdin is not None:
                process.stdin.close()
            process.wait()
        finally:
            watchdog.cancel()
            if process.poll() is None:
                ours.shutdown(socket.SHUT_RDWR)


@cache
def missing() -> str | None:
    """Why no device node can be emulated here, if so."""
    advice = "(Debian: apt install umockdev gir1.2-umockdev-1.0 python3-gi)"
    if shutil.which("umockdev-wrapper") is None:
        return f"umockdev is not installed {advice}"
    binding = "import gi; gi.require_version('UMockdev', '1.0'); from gi.repository import UMockdev"
    if (
        not Path(SYSTEM_PYTHON).exists()
        or subprocess.run([SYSTEM_PYTHON, "-c", binding], capture_output=True).returncode
    ):
        return f"the system's Python lacks umockdev's bindings {advice}"
    return None

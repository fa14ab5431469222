"""A test's hand on a program that runs against an emulated device node.

::

    with run_on_spi([sys.executable, "-m", "tiltcal", "measure", ..., "--operator", "json"]) as bench:
        events = bench.lead()       # takes every position that is asked for, answers "ready"
    assert bench.exit_code == 0

The program uses the real bus library (python-spidev, smbus2) on a real device node; umockdev hands its ioctls to a part
that was written apart from the drivers: see :mod:`support.sca100t_part` and :mod:`support.sca3000_part` for what they
model.
"""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any, ClassVar, NamedTuple, Protocol

import pytest

HERE = Path(__file__).parent
SYSTEM_PYTHON = "/usr/bin/python3"
DEVICE = "/dev/spidev0.0"
I2C_BUS = "/dev/i2c-1"


class PartFacts(Protocol):
    """A frozen dataclass of what a part of :mod:`support.emulated.host` is made with."""

    kind: ClassVar[str]
    __dataclass_fields__: ClassVar[dict[str, Any]]


@dataclass(frozen=True)
class Part:
    """The truth of the independent SCA100T: see :class:`support.sca100t_part.Sca100tPart`."""

    kind: ClassVar[str] = "sca100t"

    offset: tuple[float, float] = (1026.3, 1020.8)
    sensitivity: tuple[tuple[float, float, float], tuple[float, float, float]] = (
        (817.4, 11.2, -3.5),
        (-7.9, 821.6, 5.1),
    )
    drift: tuple[float, float] = (0.21, -0.05)
    noise: float = 0.6
    jig: float = 0.01
    seed: int = 1


@dataclass(frozen=True)
class Sca3000:
    """The truth of the independent SCA3000: see :class:`support.sca3000_part.Sca3000Part`."""

    kind: ClassVar[str] = "sca3000"

    offset: tuple[float, float, float] = (31.4, -18.7, 44.2)
    sensitivity: tuple[tuple[float, float, float], ...] = (
        (1341.2, 9.6, -14.3),
        (-7.1, 1322.5, 11.8),
        (5.9, -12.4, 1338.7),
    )
    noise: float = 1.5
    jig: float = 0.01
    seed: int = 1
    rate: float = 250.0
    thermometer: bool = True


class Message(NamedTuple):
    """One SPI message or I2C transaction as the kernel's side saw it: times on the monotonic clock, ns."""

    start_ns: int
    end_ns: int
    out: bytes
    answer: bytes


READY = '{"answer": "ready"}'


class Bench:
    """The running program, and the part it talks to.

    Attributes
    ----------
    process : Popen
        The program with text pipes for standard input and output.
    """

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

    def break_part(self, broken: bool = True) -> None:
        """Let the part send its fault signal, words below 102."""
        self._order(broken=broken)

    def kill(self, signal: int) -> None:
        """Send a signal to the program."""
        self._order(kill=int(signal))

    def messages(self) -> list[Message]:
        """Every SPI message or I2C transaction that was answered so far."""
        rows = self._order(messages=True)["messages"]
        return [Message(start, end, bytes.fromhex(out), bytes.fromhex(answer)) for start, end, out, answer in rows]

    def settings(self) -> dict[str, int]:
        """SPI: mode, bits per word and speed in Hz that the program has set. I2C: the address last spoken to."""
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

    def lead(self, answer: Mapping[str, object] | None = None) -> list[dict[str, Any]]:
        """Be the tilt table of ``--operator json``: take each position that is asked for, until the program ends.

        Parameters
        ----------
        answer : mapping, optional
            Said once a position is taken; ``{"answer": "ready"}`` where it is left out.

        Returns
        -------
        list of dict
            Every line the program said.
        """
        said = []
        for line in self.process.stdout:  # type: ignore[union-attr]
            said.append(json.loads(line))
            if "ask" in said[-1]:
                self.pose(said[-1]["gravity"], said[-1].get("temperature"))
                self.say(json.dumps(answer) if answer else READY)
        return said

    def _order(self, **order: object) -> dict[str, Any]:
        self._control.write(json.dumps(order) + "\n")
        self._control.flush()
        answer: dict[str, Any] = json.loads(self._control.readline())
        return answer


def run_on_spi(
    program: Sequence[str | os.PathLike[str]], part: PartFacts | None = None, *, seconds: float = 120.0, **popen: Any
) -> AbstractContextManager[Bench]:
    """Start a program on a machine whose ``/dev/spidev0.0`` leads to a part, an SCA100T unless another is named.

    The other parameters are those of :func:`run_on`.
    """
    return run_on({"kind": "spidev"}, program, part or Part(), seconds=seconds, **popen)


def run_on_i2c(
    program: Sequence[str | os.PathLike[str]], part: PartFacts, address: int, *, seconds: float = 120.0, **popen: Any
) -> AbstractContextManager[Bench]:
    """Start a program on a machine whose ``/dev/i2c-1`` has a part at a 7-bit address.

    The other parameters are those of :func:`run_on`.
    """
    return run_on({"kind": "i2c", "address": address}, program, part, seconds=seconds, **popen)


@contextmanager
def run_on(
    node: Mapping[str, object],
    program: Sequence[str | os.PathLike[str]],
    part: PartFacts,
    *,
    seconds: float = 120.0,
    **popen: Any,
) -> Iterator[Bench]:
    """Start a program on a machine that has one emulated device node.

    Parameters
    ----------
    node : mapping
        Its kind and what else it is made with: see :mod:`support.emulated.host`.
    program : sequence of str
        Program and arguments.
    part : PartFacts
        What is behind the node.
    seconds : float
        The program is killed when it runs longer than this.
    **popen
        For :class:`subprocess.Popen`, such as ``cwd`` or ``env``.

    Yields
    ------
    Bench
        On leaving, standard input is closed and the program is waited for.
    """
    if why := missing():
        pytest.skip(why)
    ours, theirs = socket.socketpair()
    command = [
        *("umockdev-wrapper", SYSTEM_PYTHON, str(HERE / "host.py"), str(theirs.fileno())),
        *(json.dumps(node), json.dumps({"kind": part.kind, **asdict(part)}), *map(str, program)),
    ]
    with (
        ours,
        # A pipe that nobody reads would stop a talkative program.
        TemporaryFile("w+", encoding="utf-8") as errors,
        subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
            pass_fds=[theirs.fileno()],
            **popen,
        ) as process,
    ):
        theirs.close()
        bench = Bench(process, ours, errors)
        # The host ends the program when the control socket closes.
        watchdog = threading.Timer(seconds, ours.shutdown, [socket.SHUT_RDWR])
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

"""A virtual tilt table and a virtual chamber with the faults of real ones, and sessions that they carry out.

They know nothing of the code that drives them: the table takes lines as a controller of steppers does, and each keeps
the truth beside what it tells.
"""

from __future__ import annotations

import asyncio
import re
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path

import numpy as np

from tiltcal.bench.drives import open_drive
from tiltcal.bench.machines import Machines, Mover
from tiltcal.bench.measure import run_session
from tiltcal.bench.operators import VirtualJig
from tiltcal.bench.session import Session
from tiltcal.bench.setup import SessionFiles, Setup
from tiltcal.drivers.bus.address import Address
from tiltcal.drivers.bus.clock import Clock
from tiltcal.errors import BusError, Stopped
from tiltcal.files.bench import BenchFile, BenchSensor
from tiltcal.files.journal import read_journal
from tiltcal.files.machine import Machine
from tiltcal.files.procedure import find_procedure

PLAY = 0.3
"""Degrees by which the axis may be beside the motor."""

AMBIENT = 23.0

TABLE = {
    "kind": "text", "address": "serial:loop://", "limits": {"x": (-95, 95), "y": (-95, 95)}, "tolerance": 0.05,
    "approach": 2.0, "timeout": 30.0, "start": ("$H",), "set": ("G0 X{x:.3f} Y{y:.3f}",), "accepted": "^ok",
    "failed": "error|ALARM", "read": "?", "read_alone": True, "done": "<Idle", "stop": "!",
    "pattern": r"MPos:(?P<x>[-0-9.]+),(?P<y>[-0-9.]+)",
}  # fmt: skip

CHAMBER = {
    "kind": "text", "address": "serial:loop://", "limits": {"temperature": (-40, 90)}, "tolerance": 0.5,
    "timeout": 7200.0, "set": ("SP {temperature:.1f}",), "read": "PV", "pattern": "PV=(?P<temperature>[-0-9.]+)",
}  # fmt: skip


class VirtualTable:
    """Two axes on steppers with play, zero where the play is taken up from below, and an encoder at each axis.

    ``elapsed`` gives the seconds since it was called before. ``draws`` gives the fault of each move: none, ``lost``
    steps, a ``stall``, an end ``switch``, a ``slip`` some seconds later, a ``silent`` line.
    """

    SPEED = 30.0

    def __init__(self, elapsed: Callable[[], float], draws: Callable[[], str], rng: np.random.Generator) -> None:
        self._elapsed, self._draws, self._rng = elapsed, draws, rng
        self.motor, self.axis = np.zeros(2), np.zeros(2)
        self._target, self._short = np.zeros(2), np.zeros(2)
        self._state, self._fault, self._left, self._silent = "Idle", "", 0.0, 0

    def repair(self) -> None:
        """Switch it off and on again, with the axes anywhere."""
        self.motor = self._target = self._rng.uniform(-60.0, 60.0, 2)
        self.axis = self.motor + self._rng.uniform(0.0, PLAY, 2)
        self._state, self._fault, self._silent, self._draws = "Alarm", "", 0, lambda: ""

    def line(self, text: str) -> str:
        """Answer one line."""
        self._advance()
        if self._silent:
            self._silent -= 1
            raise BusError("silent")
        if text == "?":
            return f"<{self._state}|MPos:{self.axis[0]:.3f},{self.axis[1]:.3f}>\r\n"
        if text == "$H":
            self.motor, self._target, self._short = np.zeros(2), np.zeros(2), np.zeros(2)
            self.axis, self._state, self._fault = np.zeros(2), "Idle", ""
        elif text == "!":
            self._target = self.motor.copy()
        elif self._state == "Alarm":
            return "error:9\r\n"
        else:
            self._begin(np.array([float(number) for number in re.findall(r"[XY]([-0-9.]+)", text)]))
        return "ok\r\n"

    def _begin(self, target: np.ndarray) -> None:
        self._fault = self._draws()
        if self._fault == "lost":  # for good: the next moves are short as well, until the table is homed
            self._short = self._short + self._rng.choice([-1, 1]) * self._rng.uniform(0.2, 3.0, 2)
        self._silent = 3 if self._fault == "silent" else 0
        self._target = target - self._short
        self._left = self._rng.uniform(0.0, 3.0)
        self._state = "Run" if np.any(self._target != self.motor) else "Idle"

    def _advance(self) -> None:
        seconds = self._elapsed()
        self._left -= seconds
        if self._fault == "stall" and self._left < 0.0:
            return
        if self._fault == "switch" and self._left < 0.0:
            self._state = "Alarm"
            return
        way = self._target - self.motor
        self.motor = self.motor + np.clip(way, -self.SPEED * seconds, self.SPEED * seconds)
        self.axis = np.clip(self.axis, self.motor, self.motor + PLAY)
        if self._state == "Run" and np.array_equal(self.motor, self._target):
            self._state = "Idle"
        if self._fault == "slip" and self._left < 0.0:
            self.motor = self.motor - self._rng.uniform(0.2, 5.0, 2)
            self.axis, self._target, self._fault = self.motor.copy(), self.motor.copy(), ""


class VirtualChamber:
    """A chamber that goes 2 °C a minute and swings in; ``draws`` gives the fault of each new temperature.

    None, a ``door`` that is opened some time later, an ``overshoot`` of 4 °C, a ``silent`` line.
    """

    PACE = 2.0 / 60.0

    def __init__(self, elapsed: Callable[[], float], draws: Callable[[], str], rng: np.random.Generator) -> None:
        self._elapsed, self._draws, self._rng = elapsed, draws, rng
        self.temperature = self._target = AMBIENT
        self._fault, self._left, self._silent = "", 0.0, 0

    def repair(self) -> None:
        """Close the door, and let it stand."""
        self.temperature = self._target = AMBIENT
        self._fault, self._silent, self._draws = "", 0, lambda: ""

    def line(self, text: str) -> str:
        """Answer one line."""
        self._advance()
        if self._silent:
            self._silent -= 1
            raise BusError("silent")
        if text == "PV":
            return f"PV={self.temperature:.2f}\n"
        self._set(float(text.split()[1]))
        return ""

    def _set(self, target: float) -> None:
        self._target, self._fault = target, self._draws()
        self._left = self._rng.uniform(0.0, 2400.0)
        self._silent = 3 if self._fault == "silent" else 0

    def _advance(self) -> None:
        seconds = self._elapsed()
        self._left -= seconds
        goal = self._target
        if self._fault == "overshoot" and self._left > 0.0:
            goal += 4.0 * np.sign(goal - AMBIENT)
        if self._fault == "door" and self._left < 0.0:
            goal = AMBIENT
        self.temperature += float(np.clip(goal - self.temperature, -self.PACE * seconds, self.PACE * seconds))


class LineLink:
    """A link to a virtual machine: whole lines, and single characters such as ``?``."""

    letter = "r"

    def __init__(self, answer: Callable[[str], str]) -> None:
        self._answer = answer
        self._waiting = b""

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        for line in out.decode().splitlines():
            self._waiting += self._answer(line).encode()
        if not count:
            return b""
        arrived, self._waiting = self._waiting[:count], b""
        if not arrived:
            raise BusError("silent")
        return arrived

    def close(self) -> None:
        self._waiting = b""


def by_clock(clock: Clock) -> Callable[[], float]:
    """Return what gives the seconds on a clock since it was called before."""
    before = [clock.now_ns()]

    def elapsed() -> float:
        seconds, before[0] = (clock.now_ns() - before[0]) / 1e9, clock.now_ns()
        return seconds

    return elapsed


class FaultySession:
    """A session of one virtual sensor whose machines fail by chance, until it is complete.

    ``wrong`` has what was accepted and was not so, ``stops`` counts how often it stopped and was resumed.
    """

    def __init__(self, folder: Path, procedure: str, seed: int, rate: float) -> None:
        self._rng = np.random.default_rng(seed)
        self._rate, self._folder, self._seed = rate, folder, seed
        self.wrong: list[str] = []
        self.refused: list[str] = []
        self.stops = 0
        table, chamber = Machine(**TABLE), Machine(**CHAMBER)  # type: ignore[arg-type]
        steps = find_procedure(procedure)
        if all(position.temperature is None for position in steps.positions):
            chamber = None  # type: ignore[assignment]
        sensor = BenchSensor(f"S-{seed}", "sca100t-d02", f"sim:?seed={seed}")
        bench = BenchFile((sensor,), jig=0.05, table=table, chamber=chamber)
        self.output = folder / f"S-{seed}.yaml"
        journal = folder / f"S-{seed}.journal.jsonl"
        setup = Setup.begin(steps, bench, [self.output], journal, operator="sim", samples=5, settle=0.5)
        self._session = Session(setup, SessionFiles(setup, journal))
        self._table = VirtualTable(lambda: 0.0, partial(self._drawn, "lost stall switch slip silent"), self._rng)
        self._chamber = VirtualChamber(lambda: 0.0, partial(self._drawn, "door overshoot silent"), self._rng)
        self.watches, self.most_attempts = False, 10
        self._answer: dict = {}
        self._asked: dict = {}

    def _drawn(self, faults: str) -> str:
        return str(self._rng.choice(faults.split())) if self._rng.random() < self._rate else ""

    def run(self) -> None:
        """Carry it out; where it stops, repair the machines and resume it from its journal."""
        while True:
            session = self._session
            self._table._elapsed = by_clock(session.clock)
            self._chamber._elapsed = by_clock(session.clock)
            machines = {"table": self._table.line, "chamber": self._chamber.line}
            movers = [
                Mover(name, one, session.clock, partial(open_drive, one, session.clock, self._opener(machines[name])))
                for name, one in session.setup.machines.items()
                if one is not None
            ]
            self._machines = Machines(VirtualJig(), movers, session.setup.steps, session.clock, thermometer=True)
            try:
                self.result = run_session(session, self)
            except Stopped as stopped:
                self.stops += 1
                self.why = str(stopped)
                self._table.repair()
                self._chamber.repair()
                journal = read_journal(session.files.journal)
                setup = Setup.of(journal)
                self._session = Session(setup, SessionFiles(setup, session.files.journal), journal)
            else:
                return

    def _opener(self, answer: Callable[[str], str]) -> Callable[[Address, object], LineLink]:
        return lambda address, device: LineLink(answer)

    def ask(self, question: dict) -> object:
        """Pass on, and keep what was answered."""
        said = self._machines.ask(question)
        if question["ask"] == "position":
            self._asked, self._answer = question, dict(said)  # type: ignore[call-overload]
        elif question["ask"] == "review":
            self._compare(question["position"])
        return said

    def tell(self, event: dict) -> None:
        if event["event"] == "refused":
            self.refused.append(event["why"])
        self._machines.tell(event)

    def _compare(self, position: str) -> None:
        """Compare what is about to count with where the machines really are."""
        if position != self._asked["position"]:
            return  # they were tipped meanwhile
        told = np.array([self._answer["tilt"]["x"], self._answer["tilt"]["y"]])
        x, y = np.radians(self._table.axis)
        real = np.degrees(np.arcsin([np.sin(x), np.cos(x) * np.sin(y)]))
        if np.max(np.abs(told - real)) > TABLE["tolerance"]:  # type: ignore[operator]
            self.wrong.append(f"{position}: {told} was told, and it is at {real}")
        asked = self._asked["temperature"]
        if asked is not None and abs(asked - self._chamber.temperature) > CHAMBER["tolerance"]:  # type: ignore[operator]
            self.wrong.append(f"{position}: {asked} °C was asked, and it has {self._chamber.temperature} °C")


@contextmanager
def serving(answer: Callable[[str], str]) -> Iterator[str]:
    """Serve the lines of a machine on a socket, and yield its address."""
    with ExitStack() as stack:
        listening = stack.enter_context(socket.create_server(("127.0.0.1", 0)))

        def serve() -> None:
            while True:
                try:
                    connection, _ = listening.accept()
                except OSError:
                    return
                with connection:
                    while arrived := connection.recv(4096):
                        for line in re.findall(r"[?!]|[^?!\n]+", arrived.decode()):
                            connection.sendall(answer(line).encode())

        thread = threading.Thread(target=serve)
        thread.start()
        stack.callback(thread.join)
        stack.callback(listening.shutdown, socket.SHUT_RDWR)
        yield f"serial:socket://127.0.0.1:{listening.getsockname()[1]}"


@contextmanager
def serving_registers(read: Callable[[], float], set_to: Callable[[float], None]) -> Iterator[str]:
    """Serve a chamber with pymodbus, its temperature in register 200 and what is set in 100, in 0.1 °C."""
    from pymodbus.server import ModbusTcpServer
    from pymodbus.simulator import DataType, SimData, SimDevice

    async def act(
        function: int, start: int, address: int, count: int, registers: list[int], words: list[int] | None
    ) -> None:
        if words is None:
            registers[200 - start] = round(10 * read()) & 0xFFFF
        else:
            set_to(((words[0] + 0x8000) % 0x10000 - 0x8000) / 10)

    data = SimData(100, values=[0] * 101, datatype=DataType.REGISTERS)
    loop = asyncio.new_event_loop()
    servers: list[ModbusTcpServer] = []

    async def serve() -> int:
        servers.append(ModbusTcpServer(SimDevice(1, [data], action=act), address=("127.0.0.1", 0)))
        await servers[0].serve_forever(background=True)
        return int(servers[0].transport.sockets[0].getsockname()[1])

    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    try:
        port = asyncio.run_coroutine_threadsafe(serve(), loop).result(10)
        yield f"modbus:tcp://127.0.0.1:{port}?unit=1&timeout=2"
    finally:
        asyncio.run_coroutine_threadsafe(servers[0].shutdown(), loop).result(10)
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()

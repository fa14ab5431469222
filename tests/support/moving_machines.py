"""A virtual tilt table and a virtual chamber, and links to them.

They know nothing of the code that drives them: each answers lines, and keeps the truth beside what it tells.
"""

import asyncio
import re
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial

import numpy as np

from tiltcal.bench.drives import Drive, open_drive
from tiltcal.bench.machines import Mover
from tiltcal.drivers.bus.clock import Clock
from tiltcal.files.machine import Machine

PLAY = 0.3
"""Degrees by which an axis may be beside its motor."""
AMBIENT = 23.0

TABLE = Machine(
    kind="text", address="serial:loop://", limits={"x": (-95, 95), "y": (-95, 95)}, tolerance=0.05, approach=2.0,
    timeout=30.0, start=("$H",), set=("G0 X{x:.3f} Y{y:.3f}",), accepted="^ok", failed="error|ALARM", read="?",
    read_alone=True, done="<Idle", stop="!", pattern=r"MPos:(?P<x>[-0-9.]+),(?P<y>[-0-9.]+)",
)  # fmt: skip
CHAMBER = Machine(
    kind="text", address="serial:loop://", limits={"temperature": (-40, 90)}, tolerance=0.5, timeout=7200.0,
    set=("SP {temperature:.1f}",), read="PV", pattern="PV=(?P<temperature>[-0-9.]+)",
)  # fmt: skip


class VirtualMachine:
    """A machine that moves while time goes on; ``elapsed`` gives the seconds since it was called before."""

    def __init__(self, rng: np.random.Generator, elapsed: Callable[[], float]) -> None:
        self.elapsed, self.rng = elapsed, rng

    def line(self, text: str) -> str:
        """Answer one line."""
        self.advance(self.elapsed())
        return self.answer(text)


class VirtualTable(VirtualMachine):
    """Two axes on steppers with play, zero where the play is taken up from below, and an encoder at each axis."""

    speed = 30.0

    def __init__(self, rng: np.random.Generator, elapsed: Callable[[], float]) -> None:
        super().__init__(rng, elapsed)
        self.home()

    def home(self) -> None:
        self.motor = self.axis = self.target = np.zeros(2)
        self.state = "Idle"

    def switch_on(self) -> None:
        """Stand anywhere, and refuse to move until it is homed."""
        self.motor = self.target = self.rng.uniform(-60.0, 60.0, 2)
        self.axis, self.state = self.motor + self.rng.uniform(0.0, PLAY, 2), "Alarm"

    def answer(self, text: str) -> str:
        if text == "?":
            return f"<{self.state}|MPos:{self.axis[0]:.3f},{self.axis[1]:.3f}>\r\n"
        if text == "$H":
            self.home()
        elif text == "!":
            self.target = self.motor
        elif self.state == "Alarm":
            return "error:9\r\n"
        else:
            self.go(np.array([float(one) for one in re.findall(r"[XY]([-0-9.]+)", text)]))
        return "ok\r\n"

    def go(self, target: np.ndarray) -> None:
        """Begin to move."""
        self.target = target
        self.state = "Run" if np.any(self.target != self.motor) else "Idle"

    def advance(self, seconds: float) -> None:
        """Move for so long."""
        way = self.target - self.motor
        self.motor = self.motor + np.clip(way, -self.speed * seconds, self.speed * seconds)
        self.axis = np.clip(self.axis, self.motor, self.motor + PLAY)
        if self.state == "Run" and np.array_equal(self.motor, self.target):
            self.state = "Idle"


class VirtualChamber(VirtualMachine):
    """A chamber that goes 2 °C a minute."""

    temperature = target = AMBIENT

    def answer(self, text: str) -> str:
        if text == "PV":
            return f"PV={self.temperature:.2f}\n"
        self.go(float(text.split()[1]))
        return ""

    def go(self, target: float) -> None:
        """Begin to change."""
        self.target = target

    def advance(self, seconds: float) -> None:
        """Change for so long."""
        self.temperature += float(np.clip(self.target - self.temperature, -seconds / 30.0, seconds / 30.0))


class LineLink:
    """A link to a virtual machine."""

    letter = "r"

    def __init__(self, answer: Callable[[str], str]) -> None:
        self._answer = answer

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        return "".join(self._answer(line) for line in out.decode().splitlines()).encode()

    def close(self) -> None:
        """Do nothing."""


def by_clock(clock: Clock) -> Callable[[], float]:
    """Return what gives the seconds on a clock since it was called before."""
    before = [clock.now_ns()]

    def elapsed() -> float:
        seconds, before[0] = (clock.now_ns() - before[0]) / 1e9, clock.now_ns()
        return seconds

    return elapsed


def movers_of(machines: dict[str, tuple[Machine, VirtualMachine]], clock: Clock) -> list[Mover]:
    """Return what moves virtual machines, each with what a bench file states of it."""

    def opened(stated: Machine, machine: VirtualMachine) -> Drive:
        return open_drive(stated, clock, lambda address, device: LineLink(machine.line))

    return [Mover(name, one, clock, partial(opened, one, machine)) for name, (one, machine) in machines.items()]


@contextmanager
def serving(answer: Callable[[str], str]) -> Iterator[str]:
    """Serve the lines of a machine on a socket, and yield its address."""
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def serve() -> None:
            with suppress(OSError):
                while True:
                    connection, _ = listening.accept()
                    with connection:
                        while arrived := connection.recv(4096):
                            for line in re.findall(r"[?!]|[^?!\n]+", arrived.decode()):
                                connection.sendall(answer(line).encode())

        thread = threading.Thread(target=serve)
        thread.start()
        yield f"serial:socket://127.0.0.1:{listening.getsockname()[1]}"
        listening.shutdown(socket.SHUT_RDWR)
    thread.join(10.0)


@contextmanager
def serving_registers(answer: Callable[[str], str]) -> Iterator[str]:
    """Serve a chamber with pymodbus, its temperature in register 200 and what is set in 100, in 0.1 °C."""
    from pymodbus.server import ModbusTcpServer
    from pymodbus.simulator import DataType, SimData, SimDevice

    async def act(
        function: int, start: int, address: int, count: int, registers: list[int], words: list[int] | None
    ) -> None:
        if words is None:
            registers[200 - start] = round(10 * float(answer("PV").removeprefix("PV="))) & 0xFFFF
        else:
            answer(f"SP {((words[0] + 0x8000) % 0x10000 - 0x8000) / 10}")

    device = SimDevice(1, [SimData(100, values=[0] * 101, datatype=DataType.REGISTERS)], action=act)
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever)
    thread.start()

    async def serve() -> ModbusTcpServer:
        server = ModbusTcpServer(device, address=("127.0.0.1", 0))
        await server.serve_forever(background=True)
        return server

    server = asyncio.run_coroutine_threadsafe(serve(), loop).result(10)
    try:
        yield f"modbus:tcp://127.0.0.1:{server.transport.sockets[0].getsockname()[1]}?unit=1&timeout=2"
    finally:
        asyncio.run_coroutine_threadsafe(server.shutdown(), loop).result(10)
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()

"""A virtual device with numbers in Modbus registers."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from tiltcal.drivers.bus.modbus import FAILED
from tiltcal.drivers.columns import TEMPERATURE
from tiltcal.drivers.modbus import RegisterColumn, RegisterLayout
from tiltcal.drivers.twin.link import TwinLink
from tiltcal.errors import BusError

if TYPE_CHECKING:
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.twin.fixture import HeldPose
    from tiltcal.drivers.twin.truth import Truth

ANSWER_SECONDS = 0.020
"""Time from a request to the end of its answer, s."""
RATE = 100.0
"""New numbers per second."""
TIMEOUT = 1.0
NO_SUCH_FUNCTION, NO_SUCH_REGISTER = 1, 2


class ModbusTwin(TwinLink):
    """A device with the columns of an address in its registers."""

    letter = "m"

    def __init__(self, layout: RegisterLayout, truth: Truth, fixture: HeldPose, clock: Clock) -> None:
        super().__init__(clock)
        self._layout = layout
        self._truth = truth
        self._fixture = fixture

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Answer one request; see :class:`~tiltcal.drivers.bus.modbus.ModbusLink`."""
        if self._truth.fault_on_link(self._clock.now_ns()).kind == "silent":
            self._clock.sleep(TIMEOUT)
            raise BusError("the virtual device does not answer: a fault that its twin file names")
        self._clock.sleep(ANSWER_SECONDS)
        function, first, number = struct.unpack(">BHH", out)
        if function != self._layout.function:
            return bytes([function | FAILED, NO_SUCH_FUNCTION])
        held = self._registers()
        if any(register not in held for register in range(first, first + number)):
            return bytes([function | FAILED, NO_SUCH_REGISTER])
        data = b"".join(held[register] for register in range(first, first + number))
        return bytes([function, len(data)]) + data

    def _registers(self) -> dict[int, bytes]:
        held = {}
        for column in self._layout.columns:
            data = self._layout.arranged(self._packed(column))
            held.update({column.first + place: data[2 * place : 2 * place + 2] for place in range(column.length)})
        return held

    def _packed(self, column: RegisterColumn) -> bytes:
        number = self._number(column.name) / column.scale
        if column.code in "fd":
            return struct.pack(f">{column.code}", number)
        bits = 16 * column.length
        low, high = (0, 2**bits - 1) if column.code.isupper() else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
        return struct.pack(f">{column.code}", min(max(round(number), low), high))

    def _number(self, name: str) -> float:
        if name == TEMPERATURE:
            return self._fixture.temperature() + self._truth.thermometer_error
        now_ns, temperature = self._clock.now_ns(), self._fixture.temperature(self._truth.lag)
        return self._truth.sample(name, self._fixture.gravity, temperature, now_ns, int(now_ns / 1e9 * RATE))

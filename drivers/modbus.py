"""Any device with numbers in Modbus registers: ``modbus-columns``.

The address says which registers hold which number::

    modbus:///dev/ttyUSB0?unit=1&columns=x@0:int16*0.001,y@1:int16*0.001,temperature@4:int16*0.1

A column is a name, the first register (counted from 0, as it is sent), a type (``int16`` where none is named) and a
factor. ``order`` says how the bytes of a number lie in its registers, written as a number of four bytes A to D:
``abcd`` as the protocol has it, ``cdab`` with the lower register first, ``badc`` and ``dcba`` with the bytes of each
register swapped.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from math import isfinite

from tiltcal.column_names import TEMPERATURE, TIME
from tiltcal.drivers.bus import Link
from tiltcal.drivers.bus.address import Address, parse_address
from tiltcal.drivers.bus.clock import SECOND, Clock
from tiltcal.drivers.bus.modbus import FAILED, HOLDING, INPUT, WRITE, WRITE_ONE
from tiltcal.drivers.columns import channels_of, model_of_numbers, require_name, scale_at
from tiltcal.drivers.model import Model, Reading, Sensor
from tiltcal.drivers.virtual import HeldPose, Truth, VirtualPart
from tiltcal.errors import BusError, DeviceFault

TYPES = {"int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "float32": "f", "int64": "q", "float64": "d"}
"""Encoding of a number, by its name in the address."""

ORDERS = {"abcd": (False, False), "cdab": (True, False), "badc": (False, True), "dcba": (True, True)}
"""Whether the lowest register comes first, and whether the bytes of each register are swapped."""

TABLES = {"holding": HOLDING, "input": INPUT}
UNIT = "measured_in"  # the option for the unit of the numbers, because `unit` is the device on the line
LONGEST = 125  # registers of one request (MODBUS Application Protocol V1.1b3, 6.3)
RATE = 10.0  # samples per second if the address states no rate
BUSY = (5, 6)  # exception codes of a unit that carries out something else first: the request is to be sent again
BUSY_REQUESTS, BUSY_SECONDS = 20, 0.25
"""How often a busy unit is asked, and the time from its answer to the next request, s."""

EXCEPTIONS = {
    1: "it does not have this function: try table=input, or table=holding",
    2: "it has no such register: check the register numbers, which count from 0",
    3: "it refuses the number of registers",
    4: "it has failed",
    5: "it needs more time",
    6: "it is busy",
    10: "the gateway has no path to it: check the unit's number",
    11: "the gateway got no answer from it: check the unit's number and its supply",
}
"""Meaning of the exception codes."""

_COLUMN = re.compile(
    r"([^@:*]+)@(0[xX][0-9a-fA-F]{1,8}|[0-9]{1,9})(?::([a-z0-9]+))?(?:\*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,3})?))?",
    re.ASCII,
)


@dataclass(frozen=True)
class RegisterColumn:
    """One number in registers: the first register, counted from 0, and its code in :mod:`struct`."""

    name: str
    first: int
    code: str
    scale: float

    @property
    def length(self) -> int:
        """Number of its registers."""
        return struct.calcsize(f">{self.code}") // 2


@dataclass(frozen=True)
class RegisterLayout:
    """The numbers and their registers, the function code that reads them, and an order of :data:`ORDERS`."""

    columns: tuple[RegisterColumn, ...]
    function: int
    order: tuple[bool, bool]

    @property
    def channels(self) -> tuple[str, ...]:
        """The readings: see :func:`~tiltcal.drivers.columns.channels_of`."""
        return channels_of([column.name for column in self.columns])

    @property
    def step(self) -> float:
        """The finest step of the readings, in their unit; 0 where one is a float."""
        readings = [column for column in self.columns if column.name != TEMPERATURE]
        return min(0.0 if column.code in "fd" else abs(column.scale) for column in readings)

    @property
    def requests(self) -> tuple[bytes, ...]:
        """The requests that read all columns: one per range of registers without a gap."""
        runs: list[list[int]] = []
        for column in sorted(self.columns, key=lambda column: column.first):
            end = column.first + column.length
            if runs and column.first <= runs[-1][1] and end - runs[-1][0] <= LONGEST:
                runs[-1][1] = max(runs[-1][1], end)
            else:
                runs.append([column.first, end])
        return tuple(struct.pack(">BHH", self.function, first, end - first) for first, end in runs)

    def arranged(self, data: bytes) -> bytes:
        """Convert the bytes of a number between the order of the device and that of the protocol."""
        words = [data[at : at + 2] for at in range(0, len(data), 2)]
        lowest_first, swapped = self.order
        return b"".join(word[::-1] if swapped else word for word in (words[::-1] if lowest_first else words))

    def numbers(self, registers: Mapping[int, bytes]) -> Iterator[tuple[str, float]]:
        """Iterate over every column's number, scaled, from the two bytes of each register."""
        for column in self.columns:
            data = b"".join(registers[column.first + place] for place in range(column.length))
            (number,) = struct.unpack(f">{column.code}", self.arranged(data))
            yield column.name, number * column.scale


class ModbusColumns(Sensor):
    """The driver of a device with numbers in Modbus registers."""

    def __init__(self, layout: RegisterLayout, link: Link, clock: Clock) -> None:
        self._layout, self.channels = layout, layout.channels
        self._link = link
        self._clock = clock

    def read(self) -> Reading:
        """Read every number; the errors are those of :meth:`numbers`."""
        numbers = self.numbers()
        values = tuple(numbers[channel] for channel in self._layout.channels)
        return Reading(values, numbers.get(TEMPERATURE), self._layout.step)

    def numbers(self) -> dict[str, float]:
        """Read every number; a device that refuses, or sends a number that is not finite, is a DeviceFault."""
        registers: dict[int, bytes] = {}
        for request in self._layout.requests:
            registers.update(self._registers(request))
        numbers = dict(self._layout.numbers(registers))
        for name, number in numbers.items():
            if not isfinite(number):
                raise DeviceFault(
                    f"{name} is {number}: the device has no reading, or order= and the type are not its own"
                )
        return numbers

    def write(self, name: str, number: float) -> None:
        """Write a number to the registers of its column; a DeviceFault where the device refuses or it does not fit."""
        column = next(column for column in self._layout.columns if column.name == name)
        scaled = number / column.scale
        try:
            data = struct.pack(f">{column.code}", scaled if column.code in "fd" else round(scaled))
        except (struct.error, OverflowError):
            raise DeviceFault(f"{name} = {number:g} does not fit the type of register {column.first}") from None
        function = WRITE_ONE if column.length == 1 else WRITE
        answer = self._link.exchange(struct.pack(">BH", function, column.first) + self._layout.arranged(data))
        if answer != bytes([function]):
            why = EXCEPTIONS.get(answer[-1], f"exception {answer[-1]}")
            raise DeviceFault(f"the device refuses to write {name} to register {column.first}: {why}")

    def _registers(self, request: bytes) -> dict[int, bytes]:
        function, first, number = struct.unpack(">BHH", request)
        refused, head = bytes([function | FAILED]), bytes([function, 2 * number])
        answer = self._link.exchange(request)
        for _ in range(BUSY_REQUESTS - 1):
            if answer not in [refused + bytes([code]) for code in BUSY]:
                break
            self._clock.sleep(BUSY_SECONDS)
            answer = self._link.exchange(request)
        if len(answer) == 2 and answer[:1] == refused:
            why = EXCEPTIONS.get(answer[1], f"exception {answer[1]}")
            raise DeviceFault(f"the device refuses to read {number} registers from {first}: {why}")
        if answer[:2] != head or len(answer) != len(head) + 2 * number:
            raise BusError(
                f"{number} registers from {first} were answered with {answer[:2].hex(' ')} and {len(answer[2:])} bytes "
                f"of data, not with {head.hex(' ')} and {2 * number}: the gateway is at fault"
            )
        return {first + place: answer[2 + 2 * place : 4 + 2 * place] for place in range(number)}


ANSWER_SECONDS = 0.020  # time from a request to the end of its answer, s
NUMBERS_PER_SECOND = 100.0  # how often a virtual device has new ones
VIRTUAL_TIMEOUT = 1.0


class VirtualModbus(VirtualPart):
    """A device with the columns of an address in its registers."""

    letter, silence = "m", VIRTUAL_TIMEOUT

    def __init__(self, layout: RegisterLayout, truth: Truth, fixture: HeldPose, clock: Clock) -> None:
        super().__init__(truth, fixture, clock)
        self._layout = layout

    def _answered(self, out: bytes, count: int) -> bytes:
        """Answer one request; see :class:`~tiltcal.drivers.bus.modbus.ModbusLink`."""
        self._clock.sleep(ANSWER_SECONDS)
        function, first, number = struct.unpack(">BHH", out)
        held: dict[int, bytes] = {}
        for column in self._layout.columns:
            data = self._layout.arranged(struct.pack(f">{column.code}", self._number(column)))
            held.update({column.first + place: data[2 * place : 2 * place + 2] for place in range(column.length)})
        data = b"".join(held[register] for register in range(first, first + number))
        return bytes([function, len(data)]) + data

    def _number(self, column: RegisterColumn) -> float:
        """Return what the registers of a column hold now, rounded and clipped to its type."""
        number, place = self._celsius(), int(self._clock.now_ns() / SECOND * NUMBERS_PER_SECOND)
        if column.name != TEMPERATURE:
            number = self._truth.sample(column.name, self._fixture, self._clock, place)
        number /= column.scale
        if column.code in "fd":
            return number
        half: int = 1 << 16 * column.length - 1
        low, high = (0, 2 * half - 1) if column.code.isupper() else (-half, half - 1)
        return min(max(round(number), low), high)


def layout_of(address: Address, default: str | None = None) -> RegisterLayout:
    """Return the registers of an address, which without a default has to name the columns."""
    named = [column_of(address, text.strip()) for text in address.text("columns", default).split(",")]
    columns = [column for column in named if column.name != "-"]
    names = [column.name for column in columns]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice:
        address.refuse(f"columns names {twice!r} twice")
    layout = RegisterLayout(
        tuple(columns), address.choice("table", TABLES, HOLDING), address.choice("order", ORDERS, ORDERS["abcd"])
    )
    if not layout.channels:
        address.refuse("columns names no reading: x, y, z, or another name than temperature")
    return layout


def column_of(address: Address, text: str) -> RegisterColumn:
    """Return a column from its text in an address, such as ``x@0:int16*0.001``."""
    matched = _COLUMN.fullmatch(text)
    if not matched:
        address.refuse(f"column {text!r} is not of the form name@register:type*factor (such as x@0:int16*0.001)")
    name, first, word, factor = matched.groups()
    require_name(address, name)
    if name == TIME:
        address.refuse("a column 'time' is of no use: leave it out")
    word = word or "int16"
    if word not in TYPES:
        address.refuse(f"type {word!r} of column {name} is not one of {', '.join(TYPES)}")
    scale = float(factor or 1.0)
    if not isfinite(scale) or scale == 0.0:
        address.refuse(f"factor {factor!r} of column {name} is no number other than 0")
    column = RegisterColumn(name, int(first, 16 if "x" in first.lower() else 10), TYPES[word], scale)
    if column.first + column.length > 0x10000:
        address.refuse(f"register {first} of column {name} is beyond 65535")
    return column


SIMULATED = "x@0:float32,y@2:float32,temperature@4:float32"  # default columns of a virtual device


def modbus_columns_at(address: Address) -> Model:
    """Return the device with the registers of an address."""
    layout = layout_of(address, SIMULATED if address.simulated else None)
    return model_of_numbers(
        scale_at(address, layout.channels, UNIT),
        layout.channels,
        any(column.name == TEMPERATURE for column in layout.columns),
        name="modbus-columns",
        title="any device with numbers in Modbus registers, RTU or TCP",
        addresses=(
            "modbus:///dev/ttyUSB0?unit=1&columns=x@0:int16*0.001,y@1:int16*0.001",
            "modbus:tcp://192.168.1.7:502?unit=1&columns=x@0:float32,y@2:float32,temperature@4:float32",
        ),
        interval=1.0 / address.number("rate", RATE, low=0.001, high=1000.0),
        driver=partial(ModbusColumns, layout),
        twin=partial(VirtualModbus, layout),
        not_modelled=("how often a real device renews its registers, and whether it does so between two of them",),
        options=("columns", "table", "order", "rate", UNIT, "angles", "offset", "sensitivity", "low", "high"),
        configure=modbus_columns_at,
    )


MODELS = {"modbus-columns": modbus_columns_at(parse_address("sim:"))}

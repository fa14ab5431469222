"""Any device that prints numbers on a line: ``serial-columns``.

``columns=`` of the address names them in the order they are printed: x, y, z, temperature (°C), and ``-`` or nothing
for one that is skipped; ``time``, the clock of the device, is skipped too. Any other name of letters and digits is a
reading that is not a tilt. With ``sensitivity`` (unit/g) and ``offset`` (unit at 0 g), which the units g, mg and m/s2
imply, a wrong position and a movement are detected; with a sensitivity alone positions are compared with each other,
and without one the device is calibrated without these checks, as the session says.
"""

from __future__ import annotations

import json
import re
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import cached_property, partial
from math import isfinite
from typing import Any, NamedTuple

from tiltcal.column_names import AXES, TEMPERATURE, TIME, meaning
from tiltcal.dialect import flattened, labels_of, printed, without_clock
from tiltcal.drivers.bus import Link
from tiltcal.drivers.bus.address import Address, parse_address
from tiltcal.drivers.bus.clock import SECOND, Clock
from tiltcal.drivers.model import OF_G, OF_TILT, SLOPES, Model, Reading, Sensor
from tiltcal.drivers.virtual import HeldPose, StreamingPart, Tolerances, Truth
from tiltcal.errors import BusError
from tiltcal.units import CONVENTIONS

CHUNK = 4096  # the largest number of bytes to take at once
LONGEST = 1024  # longest line; a longer one means a wrong baud rate, or a device that sends no text
PATIENCE = 10.0  # seconds from its first byte in which a line must be complete; a slower one is given up
SILENCE = 0.1  # seconds without a byte after which a line begins; a line that is being sent has shorter pauses
UNUSABLE = 50  # unusable lines in a row before a driver raises an error
_LINE_END = re.compile(rb"[\r\n]+")

SKIPPED = ("", "-")

SEPARATORS = {
    "comma": rb",",
    "semicolon": rb";",
    "tab": rb"\t",
    "space": rb"[ \t]+",
    "bar": rb"[ \t]*\|[ \t]*",
    "any": rb"[ \t]*[,;|][ \t]*|[ \t]+",
}
"""By name, because some of the characters have a meaning in an address."""

UNSTATED = "unit"  # unit if the address states none
UNKNOWN = 1e6  # stands for an unknown sensitivity, unit/g: large, so that no change of a reading looks like a movement
OFFSET_SPREAD, ANYWHERE = 0.1, 1e4
"""Standard deviation of the offset between devices, g, with and without a known nominal offset."""

SCALE_OPTIONS = ("offset", "sensitivity", "low", "high")
RAIL = 1e12  # rails if the address states none: no printed number reaches them
_WORD = re.compile(r"[^\W\d]\w*(?:\^?-?\d)?")  # a label or unit
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9]*")
_NUMBER = re.compile(r"[+-]?(?:[0-9]+(?:\.([0-9]*))?|\.([0-9]+))(?:[eE]([+-]?[0-9]{1,3}))?")


class LineBuffer:
    """Splits the bytes of a device into lines.

    The first piece after the start, or after :meth:`discard`, may be the tail of a line; it is a whole one where the
    device was silent before it.
    """

    def __init__(self, link: Link, clock: Clock) -> None:
        self._link = link
        self._clock = clock
        self._ready: deque[bytes] = deque()
        self._rest = b""
        self._begun = self._emptied = False

    def next(self) -> tuple[bytes, bool]:
        """Return the next line that is not empty, without its end, and whether its beginning is there."""
        for _ in range(UNUSABLE):
            began_ns: int | None = None
            while not self._ready:
                self._listen()
                now_ns = self._clock.now_ns()
                began_ns = now_ns if began_ns is None else began_ns
                if not self._ready and now_ns - began_ns > PATIENCE * SECOND:
                    raise self._given_up(
                        f"no whole line came in {PATIENCE:g} s, only {shown(self._rest)}: does the device end its "
                        "lines, and is this its baud rate?"
                    )
            line, whole = self._ready.popleft(), self._begun
            self._begun = True
            if line:
                return line, whole
        raise BusError(f"{UNUSABLE} lines arrived and all were empty: does the device send text?")

    def discard(self) -> None:
        """Discard what has arrived."""
        self._restart()
        self._link.exchange(b"", 0)
        self._emptied = True

    def _restart(self) -> None:
        self._ready.clear()
        self._rest = b""
        self._begun = self._emptied = False

    def _given_up(self, why: str) -> BusError:
        self._restart()
        return BusError(why)

    def _listen(self) -> None:
        asked_ns = self._clock.now_ns()
        try:
            arrived = self._link.exchange(b"", CHUNK)
        except BusError:
            # Data after a reconnection do not continue the partial line from before.
            self._restart()
            raise
        if self._emptied:
            # Nothing was waiting in the port, so a long wait for the first byte was silence on the line.
            self._begun = self._clock.now_ns() - asked_ns > SILENCE * SECOND
            self._emptied = False
        pieces = _LINE_END.split(self._rest + arrived)
        self._rest = pieces.pop()
        self._ready.extend(pieces)
        if not pieces and len(self._rest) > LONGEST:
            raise self._given_up(
                f"{len(self._rest)} bytes came without a line end, beginning with {shown(self._rest)}: is the baud "
                "rate right, and does the device send text?"
            )


def shown(line: bytes) -> str:
    """Return the first characters of a line for a message, quoted and escaped."""
    return repr(line[:60])[1:]


@dataclass(frozen=True)
class ColumnLayout:
    """The meaning of the numbers of a line: their names, ``-`` for a skipped one, and the separator, a pattern."""

    names: tuple[str, ...]
    separator: bytes

    @cached_property
    def channels(self) -> tuple[str, ...]:
        """The readings: see :func:`channels_of`."""
        return channels_of(self.names)

    @cached_property
    def _between(self) -> bytes:
        return next(mark for mark in (b",", b";", b"\t", b" ") if re.fullmatch(self.separator, mark))

    def reading(self, line: bytes) -> Reading | None:
        """Return the reading of a line; None where it has other columns, a cell is no number, or a label is another."""
        cells = self._cells(line)
        if len(cells) != len(self.names) or self._contradicting(cells):
            return None
        numbers, places = {}, []
        for name, (_, text) in zip(self.names, cells, strict=True):
            if name in ("-", TIME):
                continue
            written = _NUMBER.fullmatch(text)
            if not written or not isfinite(float(text)):
                return None
            numbers[name] = float(text)
            if name != TEMPERATURE:
                whole, part, exponent = written.groups()
                places.append(int(exponent or 0) - len(whole or part or ""))
        values = tuple(numbers[channel] for channel in self.channels)
        return Reading(values, numbers.get(TEMPERATURE), float(f"1e{min(places)}"))

    def mislabelled(self, line: bytes) -> str:
        """Return the label of a line that contradicts the column at its place; empty where none does."""
        return self._contradicting(self._cells(line))

    def _contradicting(self, cells: Sequence[tuple[str, str]]) -> str:
        pairs, named = zip(cells, self.names, strict=False), (*AXES, TEMPERATURE)
        return next((label for (label, _), name in pairs if name in named and meaning(label) not in (name, "")), "")

    def _cells(self, line: bytes) -> list[tuple[str, str]]:
        """Return the cells of a line as it is printed, each with its label, empty without one."""
        whole = line.decode(errors="replace").strip()
        if "\ufffd" in whole or not whole.replace("\t", "").isprintable():
            return []  # noise
        text = without_clock(whole)[1].strip()
        if text.startswith("{"):
            try:
                return [(key, cell.strip()) for key, cell in flattened(json.loads(text)).items()]
            except (ValueError, RecursionError):
                return []
        texts, numbers = printed(text) if any(map(str.isalpha, text)) else ([], [])
        if any(character.isalpha() for around in texts for character in around):  # labels or units
            # A number with something stuck to it is none.
            sound = not any(character.isdigit() for around in texts for character in _WORD.sub("", around))
            if sound and len(numbers) == len(self.names):
                return list(zip(labels_of(texts), numbers, strict=True))
        # A column that is skipped may hold words, or the clock.
        cells = re.split(self.separator.decode(), text)
        if len(cells) < len(self.names):
            cells = re.split(self.separator.decode(), whole)
        return [("", cell.strip()) for cell in cells]

    def line(self, numbers: Mapping[str, float]) -> bytes:
        """Return the line that shows these numbers, by the names of their columns; a column without one shows 0."""
        return self._between.join(f"{numbers.get(name, 0.0):.9g}".encode() for name in self.names) + b"\r\n"


class ColumnsSensor(Sensor):
    """The driver of a device that prints numbers on a serial line."""

    def __init__(self, columns: ColumnLayout, link: Link, clock: Clock) -> None:
        self._columns, self.channels = columns, columns.channels
        self._lines = LineBuffer(link, clock)
        self._used = self._damaged = 0

    def read(self) -> Reading:
        """Return the next line of numbers; none with the right number of columns is a BusError."""
        for _ in range(UNUSABLE):
            line, whole = self._lines.next()
            # The tail of a line may have as many numbers as a line, with the first one cut.
            if not whole:
                continue
            reading = self._columns.reading(line)
            if reading is not None:
                self._used += 1
                return reading
            self._damaged += 1
        wanted = ",".join(self._columns.names)
        if label := self._columns.mislabelled(line):
            raise BusError(f"the label {label!r} of {shown(line)} contradicts columns={wanted}: name them as they come")
        raise BusError(
            f"{UNUSABLE} lines arrived and none had the numbers {wanted}; the last was {shown(line)}: does columns= "
            "name every number of a line, and is the separator right?"
        )

    def discard(self) -> None:
        """Discard queued data."""
        self._lines.discard()

    def link_statistics(self) -> Mapping[str, int]:
        """Return the counts of used lines, and of lines that do not match the columns of the address."""
        return {"lines": self._used, "damaged": self._damaged}


def listened(link: Link, clock: Clock, seconds: float = 2.0) -> tuple[list[bytes], float]:
    """Return the whole lines that a device prints in some seconds, and how many come in one."""
    buffer, began_ns, lines = LineBuffer(link, clock), clock.now_ns(), list[bytes]()
    while not lines or clock.now_ns() - began_ns < seconds * SECOND:
        line, whole = buffer.next()
        lines += [line] * whole
    return lines, SECOND * len(lines) / max(clock.now_ns() - began_ns, 1)


def columns_of(address: Address, default: str | None = None) -> ColumnLayout:
    """Return the column layout of an address, which without a default has to name the columns."""
    written = address.text("columns", default)
    names = tuple("-" if name.strip() in SKIPPED else name.strip() for name in written.split(","))
    for name in names:
        require_name(address, name)
        if name != "-" and names.count(name) > 1:
            address.refuse(f"columns names {name!r} twice")
    columns = ColumnLayout(names, address.choice("separator", SEPARATORS, SEPARATORS["any"]))
    if not columns.channels:
        address.refuse("columns names no reading: x, y, z, or another name that is neither time nor temperature")
    return columns


def channels_of(names: Sequence[str]) -> tuple[str, ...]:
    """Return the readings among the names of columns: x, y and z in this order, then the others in theirs."""
    others = (name for name in names if name not in (*AXES, TEMPERATURE, TIME, "-"))
    return (*(axis for axis in AXES if axis in names), *others)


def require_name(address: Address, name: str) -> None:
    """Refuse a column whose name is none, or is nearly ``temperature``."""
    if name != "-" and not _NAME.fullmatch(name):
        address.refuse(f"column {name!r} is neither a name of letters and digits nor - (for one that is skipped)")
    if name != TEMPERATURE and get_close_matches(name.lower(), [TEMPERATURE], cutoff=0.8):
        address.refuse(f"column {name!r}: did you mean {TEMPERATURE!r}?")


def virtual_columns(columns: ColumnLayout, truth: Truth, fixture: HeldPose, clock: Clock) -> StreamingPart:
    """Return a device that prints the columns of an address 100 times a second; a skipped column is 0."""

    def line(number: int) -> bytes:
        numbers = {n: truth.sample(n, fixture, clock, number) for n in columns.channels}
        return columns.line({**numbers, TEMPERATURE: fixture.temperature() + truth.thermometer_error})

    return StreamingPart(truth, fixture, clock, line)


LIMITS = Tolerances(offset=0.05, sensitivity=0.03, cross=0.02, drift=0.001)
OF_ANGLES = replace(LIMITS, cross=0.008)  # of a virtual device; they are ours


class Scale(NamedTuple):
    """What a device's numbers are: unit, nominal offset (unit at 0 g) and sensitivity (unit/g), and their rails."""

    unit: str
    offset: float | None = None
    sensitivity: float | None = None
    low: float = -RAIL
    high: float = RAIL
    angles: str | None = None  # the convention of its angles, where that is stated

    def objection(self) -> str:
        """Return what cannot be; empty where all can."""
        if self.sensitivity == 0.0:
            return "sensitivity=0 is impossible: the device would not respond to tilt"
        return "" if self.low < self.high else f"low={self.low:g} is not below high={self.high:g}"


def scale_at(address: Address, channels: tuple[str, ...], unit_option: str = "unit") -> Scale:
    """Return the scale that the options of an address state; a virtual device has no readings but of tilt."""
    if address.simulated and not set(channels) <= set(AXES):
        address.refuse(
            "the virtual device has x, y, z and temperature alone; a virtual stage with four accelerometers is the "
            "model gradiometer"
        )
    stated = {name: address.number(name) for name in SCALE_OPTIONS if name in address.options}
    unit = address.text(unit_option, "g" if address.simulated else UNSTATED)
    scale = Scale(unit, **stated, angles=address.text("angles", "") or None)
    if scale.angles is not None and scale.angles not in CONVENTIONS:
        address.refuse(f"option angles is {' or '.join(CONVENTIONS)}, not {scale.angles}")
    if why := scale.objection():
        address.refuse(f"option {why}")
    return scale


def model_of_numbers(
    scale: Scale, channels: tuple[str, ...], thermometer: bool, twin: Callable[..., Link], **facts: Any
) -> Model:
    """Return the model of a device that sends numbers; ``twin`` is as in :class:`Model`, of a truth in their unit."""
    printed = {"angles": scale.angles or CONVENTIONS[0], "slope": SLOPES.get(scale.unit, 0.0)}
    default = OF_G.get(scale.unit)
    sensitivity = scale.sensitivity or default or OF_TILT.get(scale.unit)
    offset = scale.offset or 0.0
    return Model(
        channels=channels,
        unit=scale.unit,
        angles=scale.angles,
        offset=offset,
        sensitivity=sensitivity or UNKNOWN,
        offset_spread=OFFSET_SPREAD if scale.offset is not None or default is not None else ANYWHERE,
        sensitivity_spread=0.1,
        scaled=sensitivity is not None,
        rails=(scale.low, scale.high),
        thermometer=thermometer,
        default_truth=lambda seed: (OF_ANGLES if scale.unit in OF_TILT else LIMITS).draw(
            channels, sensitivity or UNKNOWN, abs(sensitivity or UNKNOWN) * 0.001, seed, offset
        ),
        twin=lambda truth, *held: twin(replace(truth, **printed) if scale.unit in OF_TILT else truth, *held),
        **facts,
    )


def serial_columns_at(address: Address) -> Model:
    """Return the device that prints the numbers of an address."""
    columns = columns_of(address, "x,y,temperature" if address.simulated else None)
    scale = scale_at(address, columns.channels)
    return model_of_numbers(
        scale,
        columns.channels,
        TEMPERATURE in columns.names,
        name="serial-columns",
        title="any device that prints numbers on a line",
        addresses=("serial:///dev/ttyUSB0?columns=x,y,temperature",),
        driver=partial(ColumnsSensor, columns),
        twin=partial(virtual_columns, columns),
        options=("columns", "separator", "unit", "angles", *SCALE_OPTIONS),
        configure=serial_columns_at,
    )


MODELS = {"serial-columns": serial_columns_at(parse_address("sim:"))}

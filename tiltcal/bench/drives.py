"""What moves a machine of the bench file: lines of text, Modbus registers, or Python objects.

A drive takes angles, degrees, or a temperature, °C, by the machine's axes, and tells where these are. Whatever fails is
a HardwareError; who uses a drive opens it anew after one.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

from tiltcal.drivers.bus import Device, Link, open_link
from tiltcal.drivers.bus.address import Address, parse_address
from tiltcal.drivers.bus.attributes import made_by
from tiltcal.drivers.bus.clock import Clock
from tiltcal.drivers.bus.modbus import HOLDING
from tiltcal.drivers.modbus import ORDERS, TABLES, ModbusColumns, RegisterLayout, column_of
from tiltcal.drivers.text_device import LINE_ENDS, number_of
from tiltcal.errors import BusError, HardwareError
from tiltcal.files.machine import Machine

CHUNK = 1 << 16
MOST_LINES = 1000  # without the one that is waited for, after which a device only talks

Angles = Mapping[str, float]
"""Numbers by the axes of a machine: degrees, or °C."""


DEVICES = {
    kind: Device(name=f"a machine of kind {kind}", addresses=(example,), options=options)
    for kind, example, options in (
        ("text", "serial:///dev/ttyUSB0?baudrate=115200", ()),
        ("modbus", "modbus:tcp://192.168.1.7:502?unit=1", ("table", "order")),
        ("object", "python:rig:table_x", ()),
    )
}


class Drive:
    """One machine, opened, and the link behind it where there is one."""

    link: Link | None = None

    def set(self, targets: Angles) -> None:
        """Send where to go, and return at once."""
        raise NotImplementedError

    def read(self) -> tuple[dict[str, float], bool]:
        """Return where it is, and False where it says that it still moves."""
        raise NotImplementedError

    def stop(self) -> None:
        """Stop it, where it can be stopped."""

    def close(self) -> None:
        """Release it."""
        if self.link is not None:
            self.link.close()


def open_drive(machine: Machine, clock: Clock, open_: Callable[..., Link] = open_link) -> Drive:
    """Open a machine; ``open_`` opens the link of an address. A HardwareError where it cannot be opened."""
    if machine.kind == "object":
        return ObjectDrive(machine)
    address = parse_address(machine.address or "")
    link = open_(address, DEVICES[machine.kind])
    try:
        return TextDrive(machine, link) if machine.kind == "text" else ModbusDrive(machine, address, link, clock)
    except HardwareError:
        link.close()
        raise


def check_addresses(machine: Machine) -> None:
    """Refuse an address that its kind of machine cannot have, with a UsageError."""
    device = DEVICES[machine.kind]
    for text in [one.address for one in machine.objects.values()] or [machine.address or ""]:
        if (address := parse_address(text)).scheme not in device.schemes:
            address.refuse(f"{device.name} has an address such as {device.addresses[0]}")
        for key in ("set", "read"):
            _layout(machine, address, key)


class TextDrive(Drive):
    """A machine that takes lines of text and answers with such."""

    def __init__(self, machine: Machine, link: Link) -> None:
        self._machine, self.link, self._exchange = machine, link, link.exchange
        self._end, self._rest = LINE_ENDS[machine.line_end], ""
        if machine.greeting is not None:
            self._heard(b"", machine.greeting)
        for line in machine.start:
            self._command(line)

    def set(self, targets: Angles) -> None:
        for line in self._machine.set:
            self._command(line.format(**targets))

    def _command(self, line: str) -> None:
        out = (line + self._end).encode()
        if self._machine.accepted is None:
            self._exchange(out)
        else:
            self._heard(out, self._machine.accepted)

    def read(self) -> tuple[dict[str, float], bool]:
        machine = self._machine
        asked = (machine.read or "") + ("" if machine.read_alone else self._end)
        answer = self._heard(asked.encode(), machine.pattern or "")
        try:
            at = {axis: number_of(axis, answer[axis])[0] for axis in machine.limits}
        except ValueError as error:
            raise HardwareError(f"{error}, in {answer.string!r}") from None
        return at, machine.done is None or re.search(machine.done, answer.string) is not None

    def stop(self) -> None:
        if self._machine.stop is not None:
            self._exchange((self._machine.stop + self._end).encode())

    def _heard(self, out: bytes, wanted: str) -> re.Match[str]:
        """Send, and wait for a whole line with a pattern; of several that have arrived the last one counts."""
        lines = 0
        if out:
            self._rest = ""  # the link drops what arrived before a question
        while lines < MOST_LINES:
            arrived = self._rest + self._exchange(out, CHUNK).decode(errors="replace")
            *whole, self._rest = re.split(r"[\r\n]+", arrived)
            out, lines, match = b"", lines + max(len(whole), 1), None
            for line in whole:
                if self._machine.failed is not None and re.search(self._machine.failed, line):
                    raise HardwareError(f"it answers {line!r}")
                match = re.search(wanted, line) or match
            if match is not None:
                return match
        raise BusError(f"{MOST_LINES} lines have arrived, and none of them has {wanted!r}")


class ModbusDrive(Drive):
    """A machine with what is set, and where it is, in Modbus registers."""

    def __init__(self, machine: Machine, address: Address, link: Link, clock: Clock) -> None:
        self.link = link
        self._to_set, self._to_read = (
            ModbusColumns(_layout(machine, address, key), link, clock) for key in ("set", "read")
        )

    def set(self, targets: Angles) -> None:
        for axis, number in targets.items():
            self._to_set.write(axis, number)

    def read(self) -> tuple[dict[str, float], bool]:
        return self._to_read.numbers(), True


def _layout(machine: Machine, address: Address, key: str) -> RegisterLayout:
    """Return the registers that are set, or read; what is set stands in the holding registers."""
    columns = tuple(column_of(address, f"{axis}@{getattr(one, key)}") for axis, one in machine.registers.items())
    order, table = address.choice("order", ORDERS, ORDERS["abcd"]), address.choice("table", TABLES, HOLDING)
    return RegisterLayout(columns, table, order)


class ObjectDrive(Drive):
    """A machine of Python objects, one an axis, with bluesky's ``set(value) -> status`` and ``read() -> readings``."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self._objects = {axis: made_by(parse_address(one.address))[1] for axis, one in machine.objects.items()}
        self._moving: dict[str, Any] = {}

    def set(self, targets: Angles) -> None:
        self._moving = {axis: self._tried(axis, "set", number) for axis, number in targets.items()}

    def read(self) -> tuple[dict[str, float], bool]:
        at = {axis: self._number(axis, self._tried(axis, "read")) for axis in self._objects}
        done = {axis: status for axis, status in self._moving.items() if getattr(status, "done", True)}
        for axis, status in done.items():
            if not getattr(status, "success", True):
                raise HardwareError(f"{axis} has not got there: {status}")
        return at, len(done) == len(self._moving)

    def stop(self) -> None:
        for axis in self._objects:
            if hasattr(self._objects[axis], "stop"):
                self._tried(axis, "stop")

    def _tried(self, axis: str, method: str, *numbers: float) -> Any:
        try:
            return getattr(self._objects[axis], method)(*numbers)
        except Exception as cause:  # a foreign object may raise anything
            raise HardwareError(f"{method} of {axis} failed ({type(cause).__name__}: {cause})") from cause

    def _number(self, axis: str, readings: Any) -> float:
        """Return the reading that the machine names, else the one of the object's name, else the only one."""
        named = self._machine.objects[axis].reading or getattr(self._objects[axis], "name", None)
        try:
            name = named if len(readings) > 1 or named in readings else next(iter(readings))
            return float(readings[name]["value"])
        except (TypeError, ValueError, LookupError, StopIteration):
            raise HardwareError(f"{axis} reads {readings!r}: no value of {named!r}; say reading: NAME") from None

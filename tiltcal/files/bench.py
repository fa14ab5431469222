"""The bench file: the sensors on one fixture, the thermometer beside them, and the operator's name.

::

    tiltcal: 1
    kind: bench
    operator: A. Technician
    jig: 0.1                                   # standard uncertainty of a set angle, degrees
    thermometer: {model: thermistor, address: "ads1115+i2c:///dev/i2c-1?address=0x48&channel=3&...", uncertainty: 0.1}
    sensors:
      - {serial: A-1005, model: adxl202, address: "serial:///dev/ttyUSB0"}
      - {serial: A-1006, model: adxl202, address: "serial:///dev/ttyUSB1", axes: [-y, x]}
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from tiltcal.core.orientation import STRAIGHT, Orientation, orientation
from tiltcal.files.declaration import Context, Converted, ListOf, Section, entry
from tiltcal.files.node import Node
from tiltcal.files.scalars import FROM_ZERO, Text

_SERIAL = re.compile(r"[\w.+-][\w.+ -]*")
_SIGNED_AXES = {"items": {"type": "string", "pattern": "^[+-]?[xyz]$"}, "minItems": 2, "maxItems": 3}


def _file_name(serial: str, node: Node, context: Context) -> str:
    if not _SERIAL.fullmatch(serial):
        raise node.error(f"the serial number {serial!r} names a file: letters, digits, '-', '_', '.', '+'")
    return serial


@dataclass(frozen=True)
class BenchSensor:
    """One sensor of a bench."""

    serial: str = entry(
        Converted(Text(), _file_name, more={"pattern": f"^{_SERIAL.pattern}$"}),
        "unique; the calibration file is named for it",
    )
    model: str = entry(Text(), "as `--sensor`")
    address: str = entry(Text(), "as `--address`")
    orientation: Orientation = entry(
        Converted(ListOf(Text()), lambda names, node, _: node.converted(orientation, names), more=_SIGNED_AXES),
        "which axis of the fixture each sensor axis points along, such as `[-y, x]` or three of them; a third one that "
        "is left out completes a right-handed frame",
        default=STRAIGHT,
        key="axes",
        usual="`[x, y, z]`",
    )


@dataclass(frozen=True)
class BenchThermometer:
    """The thermometer of a bench: any device that reports a temperature."""

    model: str = entry(Text(), "any device that reports a temperature, which stands for that of every sensor")
    address: str = entry(Text(), "its address")
    uncertainty: float | None = entry(FROM_ZERO, "standard uncertainty of a temperature, °C", default=None)


def _unique(sensors: tuple[BenchSensor, ...], node: Node, context: Context) -> tuple[BenchSensor, ...]:
    serials = [sensor.serial for sensor in sensors]
    for number, item in enumerate(node.items()):
        if serials[number] in serials[:number]:
            raise item.error(f"the serial number {serials[number]!r} is there twice")
    return sensors


@dataclass(frozen=True)
class BenchFile:
    """The content of a bench file."""

    sensors: tuple[BenchSensor, ...] = entry(
        Converted(ListOf(Section(BenchSensor), 1, says="a bench has at least one sensor"), _unique),
        "a list, at least one",
    )
    thermometer: BenchThermometer | None = entry(
        Section(BenchThermometer), "the thermometer beside the sensors", default=None
    )
    operator: str | None = entry(Text(), "the name of who stands there, for the files", default=None)
    jig: float | None = entry(
        FROM_ZERO,
        "standard uncertainty of a set angle, degrees; `--jig` takes its place",
        default=None,
    )
    table: float | None = entry(
        FROM_ZERO,
        "standard uncertainty of the table's lean, which all positions share, degrees; `--table-lean` takes its place",
        default=None,
    )
    heading: float | None = entry(
        FROM_ZERO,
        "standard uncertainty of a heading, degrees; `--heading-uncertainty` takes its place",
        default=None,
    )


BENCH = Section(BenchFile, kind="bench")
"""The bench file."""

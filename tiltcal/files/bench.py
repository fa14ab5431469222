"""The bench file: the sensors on one fixture, the thermometer beside them, and who stands there.

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
from pathlib import Path

from tiltcal.core.orientation import STRAIGHT, Orientation, orientation
from tiltcal.errors import InputError
from tiltcal.files.document import read_tiltcal_file
from tiltcal.files.node import Node

_SERIAL = re.compile(r"[\w.+-][\w.+ -]*")


@dataclass(frozen=True)
class BenchSensor:
    """One sensor of a bench.

    Attributes
    ----------
    serial, model, address : str
    orientation : Orientation
        How it sits on the fixture.
    """

    serial: str
    model: str
    address: str
    orientation: Orientation = STRAIGHT


@dataclass(frozen=True)
class BenchThermometer:
    """The thermometer of a bench: any device that reports a temperature.

    Attributes
    ----------
    model, address : str
    uncertainty : float or None
        Standard uncertainty of a temperature, °C; None where it is not stated.
    """

    model: str
    address: str
    uncertainty: float | None = None


@dataclass(frozen=True)
class BenchFile:
    """The content of a bench file.

    Attributes
    ----------
    sensors : tuple of BenchSensor
    thermometer : BenchThermometer or None
    operator : str or None
        The person's name.
    jig : float or None
        Standard uncertainty of a set angle, degrees.
    """

    sensors: tuple[BenchSensor, ...]
    thermometer: BenchThermometer | None = None
    operator: str | None = None
    jig: float | None = None


def read_bench(path: str | Path) -> BenchFile:
    """Read and check a bench file.

    Raises
    ------
    InputError
        Anything in it is wrong; the message names file, line and key.
    """
    top = read_tiltcal_file(path, "bench").mapping(
        required=("tiltcal", "kind", "sensors"), optional=("operator", "jig", "thermometer")
    )
    sensors = tuple(_read_sensor(node) for node in top["sensors"].items())
    if not sensors:
        raise top["sensors"].error("a bench has at least one sensor")
    serials = [sensor.serial for sensor in sensors]
    for number, node in enumerate(top["sensors"].items()):
        if serials[number] in serials[:number]:
            raise node.error(f"the serial number {serials[number]!r} is there twice")
    return BenchFile(
        sensors=sensors,
        thermometer=_read_thermometer(top["thermometer"]) if "thermometer" in top else None,
        operator=top["operator"].text() if "operator" in top else None,
        jig=top["jig"].number(minimum=0.0) if "jig" in top else None,
    )


def _read_sensor(node: Node) -> BenchSensor:
    section = node.mapping(required=("serial", "model", "address"), optional=("axes",))
    serial = section["serial"].text()
    if not _SERIAL.fullmatch(serial):
        raise section["serial"].error(f"the serial number {serial!r} names a file: letters, digits, '-', '_', '.', '+'")
    return BenchSensor(
        serial=serial,
        model=section["model"].text(),
        address=section["address"].text(),
        orientation=_read_axes(section["axes"]) if "axes" in section else STRAIGHT,
    )


def _read_axes(node: Node) -> Orientation:
    try:
        return orientation([item.text() for item in node.items()])
    except InputError as error:
        if error.file is not None:
            raise
        raise node.error(error.message) from None


def _read_thermometer(node: Node) -> BenchThermometer:
    section = node.mapping(required=("model", "address"), optional=("uncertainty",))
    uncertainty = section["uncertainty"].number(minimum=0.0) if "uncertainty" in section else None
    return BenchThermometer(section["model"].text(), section["address"].text(), uncertainty)

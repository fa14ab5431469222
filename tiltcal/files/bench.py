"""The bench file: the sensors on one fixture, the thermometer beside them, and the operator's name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from msgspec import Meta

from tiltcal.core.attitude import STRAIGHT, Orientation, orientation
from tiltcal.files.document import Document
from tiltcal.files.record import FromZero, Record, Text, about
from tiltcal.files.results import Reference, Standard

NAMES_A_FILE = {"says": "a serial number that names a file: letters, digits, '-', '_', '.', '+'"}
Serial = Annotated[str, Meta(pattern=r"^[\w.+-][\w.+ -]*$", extra=NAMES_A_FILE)]
SignedAxis = Annotated[str, Meta(pattern="^[+-]?[xyz]$", extra={"says": "an axis x, y or z with its sign, such as -y"})]


class BenchSensor(Record):
    """One sensor of a bench."""

    serial: Annotated[Serial, about("unique; the calibration file is named for it")]
    model: Annotated[Text, about("as `--sensor`")]
    address: Annotated[Text, about("as `--address`")]
    axes: Annotated[
        tuple[SignedAxis, ...],
        Meta(min_length=2, max_length=3),
        about("the fixture's axis along each sensor axis, such as `[-y, x]` or three of them", usual="`[x, y, z]`"),
    ] = STRAIGHT.names

    @property
    def orientation(self) -> Orientation:
        """How the sensor sits on the fixture."""
        return orientation(self.axes)


class BenchThermometer(Record):
    """The thermometer of a bench: any device that reports a temperature."""

    model: Annotated[Text, about("any device that reports a temperature, which stands for that of every sensor")]
    address: Annotated[Text, about("its address")]
    uncertainty: Annotated[FromZero | None, about("standard uncertainty of a temperature, °C")] = None


class BenchFile(Record):
    """The content of a bench file."""

    sensors: Annotated[tuple[BenchSensor, ...], Meta(min_length=1), about("a list, at least one")]
    thermometer: Annotated[BenchThermometer | None, about("the thermometer beside the sensors")] = None
    operator: Annotated[Text | None, about("the name of who stands there, for the files")] = None
    jig: Annotated[FromZero | None, about("standard uncertainty of a set angle, degrees; or `--jig`")] = None
    table: Annotated[FromZero | None, about("of the table's lean in all positions, degrees; or `--table-lean`")] = None
    heading: Annotated[FromZero | None, about("of a heading, degrees; or `--heading-uncertainty`")] = None
    references: Annotated[Mapping[Standard, Reference], about("the standards, by what they are")] = {}


def bench_of(document: Document) -> BenchFile:
    """Return the content of a bench file, checked; an InputError names file, line and key."""
    body = document.body("bench")
    bench = body.read(BenchFile)
    serials = [sensor.serial for sensor in bench.sensors]
    for number, sensor in enumerate(bench.sensors):
        with body.locating("sensors", number, "axes"):
            orientation(sensor.axes)
        if serials[number] in serials[:number]:
            raise body.error(f"the serial number {serials[number]!r} is there twice", "sensors", number)
    for name, reference in bench.references.items():
        body.at("references", name).require_moments(reference, "due")
    return bench

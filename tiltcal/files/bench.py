"""The bench file: the sensors on one fixture, the thermometer beside them, and the operator's name."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Annotated, TypeVar

from msgspec import Meta

from tiltcal.core.attitude import STRAIGHT, Orientation, orientation
from tiltcal.drivers import find_model
from tiltcal.drivers.bus import link_letter
from tiltcal.drivers.bus.address import Address, parse_address
from tiltcal.drivers.model import Model
from tiltcal.files.device import DeviceFile, device_named
from tiltcal.files.document import Document
from tiltcal.files.machine import CHAMBER_AXES, TABLE_AXES, Machine, check_machine
from tiltcal.files.record import AboveZero, FromZero, Record, Text, about
from tiltcal.files.results import Reference, Standard

NAMES_A_FILE = {"says": "a serial number that names a file: letters, digits, '-', '_', '.', '+'"}
Serial = Annotated[str, Meta(pattern=r"^[\w.+-][\w.+ -]*$", extra=NAMES_A_FILE)]
SignedAxis = Annotated[str, Meta(pattern="^[+-]?[xyz]$", extra={"says": "an axis x, y or z with its sign, such as -y"})]


class BenchSensor(Record):
    """One sensor of a bench."""

    serial: Annotated[Serial, about("unique; the calibration file is named for it")]
    model: Annotated[Text, about("as `--sensor`; a device file is named from the folder of this file")]
    address: Annotated[Text, about("as `--address`")]
    axes: Annotated[
        tuple[SignedAxis, ...],
        Meta(min_length=2, max_length=3),
        about("the fixture's axis along each sensor axis, such as `[-y, x]` or three of them", usual="`[x, y, z]`"),
    ] = STRAIGHT.names
    device: Annotated[DeviceFile | None, about("of a text device what its file says, in place of the file")] = None

    @property
    def orientation(self) -> Orientation:
        """How the sensor sits on the fixture."""
        return orientation(self.axes)

    @property
    def parsed_address(self) -> Address:
        """The address, parsed."""
        return _connected(self.model, self.address, self.device)[0]

    @property
    def wired(self) -> Model:
        """The model as it is wired at the address."""
        return _connected(self.model, self.address, self.device)[1]

    @property
    def simulated(self) -> bool:
        """Whether it is a virtual twin."""
        return self.parsed_address.simulated

    @property
    def letter(self) -> str:
        """Its bus in a journal."""
        return link_letter(self.parsed_address, self.wired)


@lru_cache
def _connected(model: str, address: str, device: DeviceFile | None) -> tuple[Address, Model]:
    """Parse an address and find its model, once for all sensors of a session and of its journal."""
    place = parse_address(address)
    return place, (find_model(model) if device is None else device.model).at(place)


class BenchThermometer(Record):
    """The thermometer of a bench: any device that reports a temperature."""

    model: Annotated[Text, about("any device that reports a temperature, which stands for that of every sensor")]
    address: Annotated[Text, about("its address")]
    uncertainty: Annotated[FromZero | None, about("standard uncertainty of a temperature, °C")] = None
    device: Annotated[DeviceFile | None, about("as of a sensor")] = None


class BenchReference(Record, kw_only=True):
    """A reference instrument on the plate, which is read and never moved: its reading is the angle that was set."""

    model: Annotated[Text, about("as of a sensor; it reads tilts, in degrees, mrad, mm/m or g")]
    address: Annotated[Text, about("its address")]
    axes: Annotated[tuple[SignedAxis, ...], Meta(min_length=2, max_length=3), about("as of a sensor")] = STRAIGHT.names
    device: Annotated[DeviceFile | None, about("as of a sensor")] = None
    zero: Annotated[FromZero | None, about("standard uncertainty of its zero, degrees, in all positions alike")] = None
    scale: Annotated[FromZero | None, about("of its scale, as a share, likewise")] = None
    repeatability: Annotated[FromZero, about("standard uncertainty of each of its tilts beside, degrees")]
    alignment: Annotated[FromZero, about("of its turn about the vertical of the plate, degrees")] = 1.0
    uncertainty: Annotated[
        FromZero | None,
        about("of its certificate, expanded (95 %), degrees: counts as `zero`, and as `scale` at `range`"),
    ] = None
    range: Annotated[AboveZero | None, about("its full range to one side, degrees")] = None

    def errors(self) -> tuple[float, float]:
        """Return the standard uncertainties of zero, degrees, and scale, a share; a ValueError if one is not stated."""
        zero, scale = self.zero, self.scale
        if self.uncertainty is not None:
            if self.range is None:
                raise ValueError("an uncertainty needs the key 'range': it counts as that of the scale there")
            u = self.uncertainty / 2.0
            zero, scale = u if zero is None else zero, u / self.range if scale is None else scale
        if zero is None or scale is None:
            raise ValueError("state 'zero' and 'scale', or the 'uncertainty' of the certificate and the 'range'")
        return zero, scale


class BenchFile(Record):
    """The content of a bench file."""

    sensors: Annotated[tuple[BenchSensor, ...], Meta(min_length=1), about("a list, at least one")]
    thermometer: Annotated[BenchThermometer | None, about("the thermometer beside the sensors")] = None
    reference: Annotated[BenchReference | None, about("a reference instrument on the same plate")] = None
    operator: Annotated[Text | None, about("the name of who stands there, for the files")] = None
    jig: Annotated[FromZero | None, about("standard uncertainty of a set angle, degrees; or `--jig`")] = None
    table_lean: Annotated[
        FromZero | None, about("of the table's lean in all positions, degrees; or `--table-lean`")
    ] = None
    table: Annotated[Machine | None, about("a table that moves by itself")] = None
    chamber: Annotated[Machine | None, about("a chamber that moves by itself; its keys are those of `table`")] = None
    heading: Annotated[FromZero | None, about("of a heading, degrees; or `--heading-uncertainty`")] = None
    references: Annotated[Mapping[Standard, Reference], about("the standards, by what they are")] = {}

    def with_stated(self, **uncertainties: float | None) -> BenchFile:
        """Return the bench with other uncertainties where they are stated, degrees: jig, table_lean, heading."""
        return self.replaced(**{name: u for name, u in uncertainties.items() if u is not None})


S = TypeVar("S", BenchSensor, BenchThermometer, BenchReference)


def with_device_file(sensor: S, beside: str | None = None) -> S:
    """Return a sensor or thermometer with the content of the device file that it names, and the name in it.

    ``beside`` is the file from whose folder a path counts.
    """
    device = sensor.device or device_named(sensor.model, beside)
    return sensor if device is None else sensor.replaced(model=device.name, device=device)


def bench_of(document: Document) -> BenchFile:
    """Return the content of a bench file, checked; an InputError names file, line and key."""
    body = document.body("bench")
    bench = body.read(BenchFile)
    bench = bench.replaced(
        sensors=tuple(with_device_file(sensor, document.file) for sensor in bench.sensors),
        thermometer=None if bench.thermometer is None else with_device_file(bench.thermometer, document.file),
        reference=None if bench.reference is None else with_device_file(bench.reference, document.file),
    )
    if bench.reference is not None:
        try:
            bench.reference.errors()
        except ValueError as error:
            raise body.error(str(error), "reference") from None
    serials = [sensor.serial for sensor in bench.sensors]
    for number, sensor in enumerate(bench.sensors):
        with body.locating("sensors", number, "axes"):
            orientation(sensor.axes)
        if serials[number] in serials[:number]:
            raise body.error(f"the serial number {serials[number]!r} is there twice", "sensors", number)
    for key, machine, axes in (("table", bench.table, TABLE_AXES), ("chamber", bench.chamber, CHAMBER_AXES)):
        if machine is not None:
            check_machine(machine, body.at(key), axes)
    for name, reference in bench.references.items():
        body.at("references", name).require_moments(reference, "due")
    return bench

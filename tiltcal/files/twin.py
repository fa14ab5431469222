"""The twin file, ``kind: twin``: the true coefficients of a virtual sensor, or the truth of a stage that turns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from math import inf, radians
from pathlib import Path
from typing import Annotated

from msgspec import Meta
from msgspec.structs import asdict

from tiltcal.core.detection import TEMPERATURES
from tiltcal.core.model import AXES
from tiltcal.drivers.stage import CHANNELS, FASTEST, Accelerometer, Disk, StageTruth
from tiltcal.drivers.virtual import Fault, Truth
from tiltcal.files.coefficients import MountingSection, Polynomials, require_equal_columns
from tiltcal.files.document import Document, read_document
from tiltcal.files.record import ByAxis, Count, FromZero, Number, Record, Text, about, one_of

FAULTS = ("parity", "stuck", "silent", "unplugged")

LARGEST = 1e12  # no sensor reads more, in any unit
SLOWEST = 1e-3  # lines a second of a virtual line, at least
LEAST_OWN = 1e-6  # least sensitivity of a channel to its own axis, over its largest: its nonlinearity is along it


class FaultSection(Record):
    """One of ``faults`` as it stands in a file."""

    kind: Annotated[str, one_of(*FAULTS), about("`parity` of a memory, `stuck` reading, `silent` line, `unplugged`")]
    start: Annotated[FromZero, about("seconds after the session began")]
    end: Annotated[Number, about("seconds after the session began")]


class ThermalTruth(Record):
    """``truth.temperature`` as it stands in a file."""

    reference: Annotated[Number, about("reference temperature, °C")]
    offset: Annotated[Polynomials, about("as in a calibration file")] = {}
    sensitivity: Annotated[Polynomials, about("as in a calibration file")] = {}


class TruthSection(Record):
    """The section ``truth`` of a tilt sensor as it stands in a file."""

    offset: Annotated[ByAxis[Number], about("as in a calibration file")]
    sensitivity: Annotated[ByAxis[ByAxis[Number]], about("as in a calibration file")]
    temperature: Annotated[ThermalTruth | None, about("as in a calibration file")] = None
    mounting: Annotated[MountingSection, about("how it sits on the fixture, degrees")] = MountingSection()
    supply: Annotated[FromZero, about("of an analog sensor or a thermistor, V")] = Truth.supply
    nonlinearity: Annotated[Polynomials, about("per channel the coefficients of a², a³, … of the signal a in g")] = {}
    noise: Annotated[ByAxis[FromZero], about("per channel, standard deviation of a sample, unit", usual="0")] = {}
    thermometer_error: Annotated[Number, about("of the sensor's thermometer, °C")] = Truth.thermometer_error
    lag: Annotated[FromZero, about("of the sensing element behind chamber and thermometer, s")] = Truth.lag
    jig: Annotated[FromZero, about("standard deviation of a set angle, degrees; the first sensor's")] = Truth.jig
    ambient: Annotated[Number, about("temperature at the start, °C")] = Truth.ambient
    time_constant: Annotated[FromZero, about("of the chamber, seconds")] = Truth.time_constant
    faults: Annotated[tuple[FaultSection, ...], about("a list of `{kind, start, end}`")] = ()


class Gradient(Record):
    """``disk.gradient`` as it stands in a file."""

    differential: Annotated[Number, about("R (Γxx − Γyy), g")]
    cross: Annotated[Number, about("R Γxy, g")]


class AccelerometerSection(Record):
    """One of ``disk.accelerometers`` as it stands in a file."""

    scale: Annotated[Number, about("unit/g")]
    misalignment: Annotated[Number, about("degrees")] = 0.0
    phase_error: Annotated[Number, about("degrees")] = 0.0
    offset: Annotated[Number, about("unit")] = 0.0


ByChannel = Annotated[
    Mapping[Annotated[str, one_of(*CHANNELS)], AccelerometerSection],
    Meta(extra_json_schema={"required": list(CHANNELS)}),
]


class DiskSection(Record):
    """``truth.disk`` as it stands in a file."""

    inclination: Annotated[Number | None, about("of the spin axis, degrees", usual="0.086")] = None
    spin: Annotated[Number, about("turns a second")] = Disk.spin
    rate: Annotated[Annotated[float, Meta(ge=SLOWEST, le=FASTEST)], about("lines a second")] = Disk.rate
    gradient: Annotated[Gradient | None, about("`{differential, cross}`, g", usual="0")] = None
    noise: Annotated[FromZero, about("one-sided amplitude density, g/√Hz")] = Disk.noise
    encoder_noise: Annotated[FromZero, about("standard deviation of the angle, degrees")] = Disk.encoder_noise
    accelerometers: Annotated[ByChannel | None, about("`a1` to `a4`", usual="the source's")] = None


class StageSection(Record):
    """The section ``truth`` of a ``gradiometer`` as it stands in a file."""

    disk: Annotated[DiskSection, about("of a `gradiometer`, in place of all that a tilt sensor has")]
    faults: Annotated[tuple[FaultSection, ...], about("a list of `{kind, start, end}`")] = ()


class TwinFile(Record, kw_only=True):
    """The content of a twin file."""

    model: Annotated[Text | None, about("the sensor model it is for; any where it is absent")] = None
    seed: Annotated[Count, about("of all noise; `seed=` in the address takes its place")] = Truth.seed
    truth: Annotated[TruthSection, about("what the virtual sensor really is")]


class StageFile(TwinFile, kw_only=True):
    """The content of a twin file of a stage."""

    truth: Annotated[StageSection, about("what the virtual stage really is")]  # type: ignore[assignment]


def read_twin(path: str | Path, seed: int | None = None) -> tuple[str | None, Truth]:
    """Read and check a twin file; an InputError names file, line and key."""
    return twin_of(read_document(path), seed)


def twin_of(document: Document, seed: int | None = None) -> tuple[str | None, Truth]:
    """Return the sensor model that a twin file is for, None where it fits any, and the truth with another seed."""
    body = document.body("twin")
    section, place = body.data.get("truth"), body.at("truth")
    file = body.read(StageFile if isinstance(section, dict) and "disk" in section else TwinFile)
    truth = _stage_of(file.truth, place) if isinstance(file.truth, StageSection) else _truth_of(file.truth, place)
    for number, fault in enumerate(file.truth.faults):
        if fault.end <= fault.start:
            why = f"the fault ends at {fault.end:g} s, not after its start at {fault.start:g} s"
            raise place.error(why, "faults", number, "end")
    faults = tuple(Fault(fault.kind, fault.start, fault.end) for fault in file.truth.faults)
    return file.model, replace(truth, faults=faults, seed=file.seed if seed is None else seed)


def _truth_of(section: TruthSection, place: Document) -> Truth:
    if not section.offset:
        raise place.error("no channel; give an offset for one to three of x, y, z", "offset")
    channels = tuple(axis for axis in AXES if axis in section.offset)
    place.require_keys(section.sensitivity, channels, "sensitivity", complete=True)
    require_equal_columns(section.sensitivity, place)
    for channel, row in section.sensitivity.items():
        if abs(row.get(channel, 0.0)) <= LEAST_OWN * max(map(abs, row.values()), default=0.0):
            why = f"the channel does not sense its own axis; give a {channel} of more than {LEAST_OWN:g} of the largest"
            raise place.error(why, "sensitivity", channel)
    thermal, mounting = section.temperature or ThermalTruth(reference=Truth.reference), section.mounting
    for key in ("offset", "sensitivity"):
        place.require_keys(getattr(thermal, key), channels, "temperature", key)
    for key in ("nonlinearity", "noise"):
        place.require_keys(getattr(section, key), channels, key)
    names = [name for name in section.__struct_fields__ if name not in ("temperature", "mounting", "faults")]
    truth = Truth(
        channels=channels,
        mounting=(mounting.roll, mounting.pitch, mounting.yaw),
        reference=thermal.reference,
        drift=thermal.offset,
        gain=thermal.sensitivity,
        **{name: getattr(section, name) for name in names},
    )
    for channel, temperature in product(channels, (*TEMPERATURES, truth.ambient)):
        up = (float(channel == "x"), float(channel == "y"), float(channel == "z"))
        try:
            reading = truth.reading(channel, up, temperature)
        except OverflowError:
            reading = inf
        if not abs(reading) <= LARGEST:
            raise place.error(
                f"{channel} would read more than {LARGEST:g} at {temperature:g} °C: look at its coefficients, at the "
                "reference temperature and at ambient"
            )
    return truth


def _stage_of(section: StageSection, place: Document) -> Truth:
    disk, parts = section.disk, section.disk.accelerometers
    stated = {name: one for name, one in asdict(disk).items() if one is not None}
    if disk.inclination is not None:
        stated["inclination"] = radians(disk.inclination)
    if disk.gradient is not None:
        stated["gradient"] = (disk.gradient.differential, disk.gradient.cross)
    if parts is not None:
        place.require_keys(parts, CHANNELS, "disk", "accelerometers", complete=True)
        stated["accelerometers"] = tuple(_accelerometer(parts[name]) for name in CHANNELS)
    return StageTruth.of(Disk(**stated), Truth.seed)


def _accelerometer(section: AccelerometerSection) -> Accelerometer:
    angles = {name: radians(getattr(section, name)) for name in ("misalignment", "phase_error")}
    return Accelerometer(**asdict(section) | angles)

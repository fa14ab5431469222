"""The twin file, ``kind: twin``: the true coefficients of a virtual sensor.

::

    tiltcal: 1
    kind: twin
    model: sca100t-d02
    seed: 7
    truth:
      offset: {x: 1024.6, y: 1021.9}          # offset, sensitivity and temperature as in a calibration file
      sensitivity:
        x: {x: 818.2, y: 9.1, z: 2.0}
        y: {x: -6.4, y: 820.7, z: -1.5}
      temperature: {reference: 24.0, offset: {x: [0.21], y: [-0.05]}}
      nonlinearity: {x: [0.002, -0.004]}      # coefficients of a², a³, ... where a is the signal in g
      noise: {x: 0.6, y: 0.6}                 # standard deviation of one sample, unit
      thermometer_error: 0.5                  # °C
      supply: 4.9                             # of an analog sensor, V
      jig: 0.01                               # standard deviation of a set angle, degrees
      ambient: 24.0                           # °C
      time_constant: 300                      # of the chamber, seconds
      mounting: {roll: 90, pitch: 0, yaw: 0}  # how it sits on the fixture, degrees
      faults:
        - {kind: parity, start: 12.0, end: 12.5}   # seconds after the session began

Of a ``gradiometer`` the truth is a disk instead::

    truth:
      disk:
        inclination: 0.086                    # of the spin axis, degrees
        spin: 0.125                           # Hz
        rate: 50                              # lines a second
        wander: 0.01                          # of the common acceleration, relative
        gradient: {differential: 0, cross: 0} # R (Γxx - Γyy) and R Γxy, g
        noise: 1.5e-7                         # one-sided amplitude density, g/√Hz
        corner: 0.05                          # where 1/f noise is as large, Hz
        encoder_noise: 0.002                  # standard deviation, degrees
        accelerometers:
          a1: {scale: 3.383, misalignment: -1.27, phase_error: 0, offset: 0, drift: 0, second_order: 0}
          a2: {scale: 3.415}                  # unit/g; degrees; degrees; unit; unit/s; 1/g
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from math import radians
from pathlib import Path
from typing import Any

from tiltcal.core.detection import TEMPERATURES
from tiltcal.core.model import AXES
from tiltcal.drivers.twin.gradiometer import CHANNELS, FASTEST, Accelerometer, Disk, StageTruth
from tiltcal.drivers.twin.truth import Fault, Polynomial, Truth
from tiltcal.files.coefficients import ROWS, MountingSection, polynomials
from tiltcal.files.declaration import ByChannel, ByKey, Context, Converted, Either, ListOf, Section, entry
from tiltcal.files.document import read_document
from tiltcal.files.node import Node
from tiltcal.files.scalars import FROM_ZERO, Choice, Integer, Number, Text

FAULTS = ("parity", "stuck", "silent", "unplugged")


def _fault_of(found: FaultSection, node: Node, context: Context) -> Fault:
    if found.end <= found.start:
        raise node.entries()["end"].error(
            f"the fault ends at {found.end:g} s, not after its start at {found.start:g} s"
        )
    return Fault(found.kind, found.start, found.end)


@dataclass(frozen=True, kw_only=True)
class FaultSection:
    """One of ``faults`` as it stands in a file."""

    kind: str = entry(
        Choice(FAULTS),
        "`parity` (memory error), `stuck` (the reading holds), `silent` (the data line floats) or `unplugged`; of a "
        "`gradiometer` not `parity`, and `stuck` is one line again and again: the stage stands",
    )
    start: float = entry(FROM_ZERO, "seconds after the session began")
    end: float = entry(Number(), "seconds after the session began")


_FAULTS = ListOf(Converted(Section(FaultSection), _fault_of))


LARGEST = 1e12
"""No sensor reads more, in any unit."""

SLOWEST = 1e-3
"""Lines a second of a virtual line, at least."""

LEAST_OWN = 1e-6
"""Least sensitivity of a channel to its own axis, over its largest one: its nonlinearity is counted along it."""


def _some(offset: Mapping[str, float], node: Node, context: Context) -> Mapping[str, float]:
    if not offset:
        raise node.error("no channel; give an offset for one to three of x, y, z")
    return offset


def _own_axis(
    rows: Mapping[str, Mapping[str, float]], node: Node, context: Context
) -> Mapping[str, Mapping[str, float]]:
    for channel, row in rows.items():
        if abs(row.get(channel, 0.0)) <= LEAST_OWN * max(map(abs, row.values()), default=0.0):
            raise node.entries()[channel].error(
                f"the channel does not sense its own axis; give a {channel} of more than {LEAST_OWN:g} of the largest"
            )
    return rows


@dataclass(frozen=True, kw_only=True)
class ThermalTruth:
    """``truth.temperature`` as it stands in a file."""

    reference: float = entry(Number(), "reference temperature, °C")
    offset: Mapping[str, Polynomial] = entry(polynomials(), "as in a calibration file", default={})
    sensitivity: Mapping[str, Polynomial] = entry(polynomials(), "as in a calibration file", default={})


@dataclass(frozen=True, kw_only=True)
class TruthSection:
    """The section ``truth`` of a tilt sensor as it stands in a file."""

    offset: Mapping[str, float] = entry(Converted(ByChannel(Number()), _some), "as in a calibration file")
    sensitivity: Mapping[str, Mapping[str, float]] = entry(Converted(ROWS, _own_axis), "as in a calibration file")
    temperature: ThermalTruth | None = entry(
        Section(ThermalTruth), "`reference`, `offset`, `sensitivity`, as in a calibration file", default=None
    )
    mounting: MountingSection = entry(
        Section(MountingSection), "how it sits on the fixture, degrees", default=MountingSection()
    )
    supply: float = entry(FROM_ZERO, "of an analog sensor or a thermistor, V", default=Truth.supply)
    nonlinearity: Mapping[str, Polynomial] = entry(
        polynomials(), "per channel the coefficients of a², a³, … in g, where a is the signal in g", default={}
    )
    noise: Mapping[str, float] = entry(
        ByChannel(FROM_ZERO, of="channels"),
        "per channel, standard deviation of one sample, unit",
        default={},
        usual="0",
    )
    thermometer_error: float = entry(
        Number(), "what the sensor's thermometer reads too high, °C", default=Truth.thermometer_error
    )
    lag: float = entry(
        FROM_ZERO, "by how much the sensing element is later than chamber and thermometer, s", default=Truth.lag
    )
    jig: float = entry(
        FROM_ZERO,
        "standard deviation of each set angle, degrees; jig and chamber are those of the bench's first virtual sensor",
        default=Truth.jig,
    )
    ambient: float = entry(Number(), "temperature at the start, °C", default=Truth.ambient)
    time_constant: float = entry(FROM_ZERO, "of the chamber, seconds", default=Truth.time_constant)
    faults: tuple[Fault, ...] = entry(_FAULTS, "a list of `{kind, start, end}`", default=())


def _truth_of(found: TruthSection, node: Node, context: Context) -> Truth:
    thermal, mounting = found.temperature or ThermalTruth(reference=Truth.reference), found.mounting
    own = {name: value for name, value in vars(found).items() if name not in ("temperature", "mounting")}
    truth = Truth(
        channels=tuple(axis for axis in AXES if axis in found.offset),
        mounting=(mounting.roll, mounting.pitch, mounting.yaw),
        reference=thermal.reference,
        drift=thermal.offset,
        gain=thermal.sensitivity,
        **own,
    )
    for channel, temperature in product(truth.channels, (*TEMPERATURES, truth.ambient)):
        up = (float(channel == "x"), float(channel == "y"), float(channel == "z"))
        if not _reads(truth, channel, up, temperature):
            raise node.error(
                f"{channel} would read more than {LARGEST:g} at {temperature:g} °C: look at its coefficients, at the "
                "reference temperature and at ambient"
            )
    return truth


def _reads(truth: Truth, channel: str, up: tuple[float, float, float], temperature: float) -> bool:
    """Return whether a reading is one that a sensor could give."""
    try:
        return abs(truth.reading(channel, up, temperature)) <= LARGEST
    except OverflowError:
        return False


def _channels(key: str, found: Mapping[str, Any], context: Context) -> Context:
    """Return the context with the channels that have an offset, in the order x, y, z."""
    return Context(channels=[axis for axis in AXES if axis in found["offset"]])


_ANGLE = Converted(Number(), lambda degrees, node, context: radians(degrees))


@dataclass(frozen=True, kw_only=True)
class Gradient:
    """``disk.gradient`` as it stands in a file."""

    differential: float = entry(Number(), "R (Γxx − Γyy), g")
    cross: float = entry(Number(), "R Γxy, g")


@dataclass(frozen=True, kw_only=True)
class AccelerometerSection:
    """One of ``disk.accelerometers`` as it stands in a file."""

    scale: float = entry(Number(), "unit/g")
    misalignment: float = entry(_ANGLE, "degrees", default=0.0)
    phase_error: float = entry(_ANGLE, "degrees", default=0.0)
    offset: float = entry(Number(), "unit", default=0.0)
    drift: float = entry(Number(), "of the offset, unit/s", default=0.0)
    second_order: float = entry(Number(), "1/g", default=0.0)


@dataclass(frozen=True, kw_only=True)
class DiskSection:
    """``truth.disk`` as it stands in a file."""

    inclination: float | None = entry(
        _ANGLE, "of the spin axis, degrees; its sine is the common acceleration in g", default=None, usual="0.086"
    )
    spin: float = entry(Number(), "turns a second", default=Disk.spin)
    rate: float = entry(
        Number(SLOWEST, maximum=FASTEST, says=f"more than {FASTEST:g} lines a second do not fit on the virtual line"),
        "lines a second",
        default=Disk.rate,
    )
    wander: float = entry(FROM_ZERO, "of the common acceleration, its largest excursion, relative", default=Disk.wander)
    gradient: Gradient | None = entry(
        Section(Gradient), "`{differential, cross}`: R (Γxx − Γyy) and R Γxy, g", default=None, usual="0"
    )
    noise: float = entry(FROM_ZERO, "one-sided amplitude density, g/√Hz", default=Disk.noise)
    corner: float = entry(FROM_ZERO, "where 1/f noise is as large, Hz", default=Disk.corner)
    encoder_noise: float = entry(FROM_ZERO, "standard deviation of the angle, degrees", default=Disk.encoder_noise)
    accelerometers: Mapping[str, AccelerometerSection] | None = entry(
        ByKey(Section(AccelerometerSection), CHANNELS, complete=True),
        "`a1` to `a4`, each with `scale` (unit/g) and, 0 where left out, `misalignment` and `phase_error` (degrees), "
        "`offset` (unit), `drift` (unit/s), `second_order` (1/g)",
        default=None,
        usual="the source's",
    )


def _disk_of(found: DiskSection, node: Node, context: Context) -> Disk:
    given = {name: value for name, value in vars(found).items() if value is not None}
    if found.gradient is not None:
        given["gradient"] = (found.gradient.differential, found.gradient.cross)
    if found.accelerometers is not None:
        given["accelerometers"] = tuple(Accelerometer(**vars(found.accelerometers[name])) for name in CHANNELS)
    return Disk(**given)


@dataclass(frozen=True, kw_only=True)
class StageSection:
    """The section ``truth`` of a ``gradiometer`` as it stands in a file."""

    disk: Disk = entry(
        Converted(Section(DiskSection), _disk_of),
        "of a `gradiometer`, in place of `offset`, `sensitivity` and what belongs to them",
    )
    faults: tuple[Fault, ...] = entry(_FAULTS, "a list of `{kind, start, end}`", default=())


def _stage_of(found: StageSection, node: Node, context: Context) -> Truth:
    return replace(StageTruth.of(found.disk, Truth.seed), faults=found.faults)


@dataclass(frozen=True, kw_only=True)
class TwinFile:
    """The content of a twin file."""

    model: str | None = entry(Text(), "the sensor model it is for; any where it is absent", default=None)
    seed: int = entry(Integer(minimum=0), "of all noise; `seed=` in the address takes its place", default=Truth.seed)
    truth: Truth = entry(
        Either(
            "disk",
            Converted(Section(TruthSection, follow=_channels), _truth_of),
            Converted(Section(StageSection), _stage_of),
        ),
        "what the virtual sensor really is",
    )


TWIN = Section(TwinFile, kind="twin")
"""The twin file."""


def read_twin(path: str | Path, seed: int | None = None) -> tuple[str | None, Truth]:
    """Read and check a twin file; an InputError names file, line and key.

    Return the sensor model that it is for, None where it fits any, and the truth; ``seed`` replaces the file's.
    """
    found = TWIN.read(read_document(path))
    return found.model, replace(found.truth, seed=found.seed if seed is None else seed)

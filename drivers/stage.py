"""Four accelerometers on a rotary stage: a device prints their readings and the stage angle on a line.

This is :mod:`tiltcal.drivers.columns` with the columns of a gravity gradient instrument, and with a virtual stage for
``sim:``. The address may name other columns::

    serial:///dev/ttyUSB0?columns=theta,a1,a2,-,a4&separator=semicolon

Each virtual accelerometer measures, along its tangent at θ + φ,

    a (sin + δP cos) + R (Γxx - Γyy) / 2 sin 2(θ + φ) + R Γxy cos 2(θ + φ) + noise

and reads scale * that + offset. The common acceleration a results from the inclination of the stage. Every number is a
function of the seed and the sample's number, so a stream can start anywhere.

Source: Misalignment Angle Compensation during Scale Factor Matching (2018), figure 1 and eq. 1, 3 and 4.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from math import cos, pi, radians, sin, sqrt
from typing import NamedTuple

from tiltcal.drivers.bus.address import Address, parse_address
from tiltcal.drivers.bus.clock import Clock
from tiltcal.drivers.columns import UNKNOWN, UNSTATED, ColumnLayout, ColumnsSensor, columns_of, serial_columns_at
from tiltcal.drivers.model import Model
from tiltcal.drivers.virtual import HeldPose, StreamingPart, Truth, normal, part_errors

PHASES = (0.0, 180.0, 90.0, 270.0)  # where a1, a2, a3 and a4 sit, degrees
CHANNELS = ("a1", "a2", "a3", "a4")
TIME, THETA = "time", "theta"

BAUDRATE = 921_600
FASTEST = 400.0  # largest number of lines per second at the baud rate


@dataclass(frozen=True)
class Accelerometer:
    """One of the four: unit/g, δP and the error of its place on the disk (radians), and unit."""

    scale: float
    misalignment: float = 0.0
    phase_error: float = 0.0
    offset: float = 0.0


@dataclass(frozen=True)
class Disk:
    """The stage with its accelerometers; the defaults are the magnitudes of the source.

    accelerometers: four, a1 to a4.
    inclination: of the spin axis, radians; its sine is the common acceleration in g.
    spin: Hz; negative for a stage that turns backwards.
    rate: samples per second.
    gradient: R (Γxx - Γyy) and R Γxy, g.
    noise: white, one-sided amplitude density, g/√Hz.
    encoder_noise: standard deviation of the stage angle, degrees.
    """

    accelerometers: tuple[Accelerometer, ...] = (
        Accelerometer(3.383, -0.0221),
        Accelerometer(3.415, -0.0217),
        Accelerometer(3.402, 0.0120),
        Accelerometer(3.390, 0.0124),
    )
    inclination: float = 1.5e-3
    spin: float = 0.125
    rate: float = 50.0
    gradient: tuple[float, float] = (0.0, 0.0)
    noise: float = 1.5e-7
    encoder_noise: float = 0.0


class DiskSample(NamedTuple):
    """One row: seconds, the stage angle of the encoder in degrees (0 to 360), and the four readings."""

    time: float
    theta: float
    readings: tuple[float, ...]


def disk_sample(disk: Disk, seed: int, number: int) -> DiskSample:
    """Return the sample with this number, counted from 0."""
    time = number / disk.rate
    turned = disk.spin * time % 1.0
    common, (differential, cross) = sin(disk.inclination), disk.gradient
    noise = disk.noise * sqrt(disk.rate / 2.0)
    readings = []
    for name, phase, part in zip(CHANNELS, PHASES, disk.accelerometers, strict=True):
        angle = 2.0 * pi * turned + radians(phase) + part.phase_error
        signal = common * (sin(angle) + part.misalignment * cos(angle))
        signal += 0.5 * differential * sin(2.0 * angle) + cross * cos(2.0 * angle)
        signal += noise * normal(seed, name, number) if noise else 0.0
        readings.append(part.offset + part.scale * signal)
    theta = 360.0 * turned + (disk.encoder_noise * normal(seed, "encoder", number) if disk.encoder_noise else 0.0)
    return DiskSample(time, theta % 360.0, tuple(readings))


@dataclass(frozen=True)
class StageTruth(Truth):
    """The true state of a virtual stage: a disk in place of the coefficients of a tilt sensor."""

    disk: Disk = field(default_factory=Disk)

    @classmethod
    def of(cls, disk: Disk, seed: int) -> StageTruth:
        return cls((TIME, THETA, *CHANNELS), {}, {}, seed=seed, disk=disk)


def virtual_stage(columns: ColumnLayout, truth: Truth, fixture: HeldPose, clock: Clock) -> StreamingPart:
    """Return a stage that prints the columns of an address, a skipped one as 0; stuck it repeats the first line."""
    disk = truth.disk if isinstance(truth, StageTruth) else Disk()

    def line(number: int) -> bytes:
        fault = truth.fault(number / disk.rate)
        sample = disk_sample(disk, truth.seed, round(fault.start * disk.rate) if fault.kind == "stuck" else number)
        readings = dict(zip(CHANNELS, sample.readings, strict=True))
        return columns.line({TIME: number / disk.rate, THETA: sample.theta, **readings})

    return StreamingPart(truth, fixture, clock, line, period=1.0 / disk.rate, baudrate=BAUDRATE)


def draw_truth(seed: int) -> StageTruth:
    """Return accelerometers near those of the source; the tolerances are ours."""
    within = part_errors(seed)

    parts = tuple(
        Accelerometer(
            scale=3.4 * (1.0 + within(0.01, f"scale {name}")),
            misalignment=within(0.02, f"misalignment {name}"),
            phase_error=radians(within(0.1, f"place {name}")),
            offset=within(0.002, f"offset {name}"),
        )
        for name in CHANNELS
    )
    return StageTruth.of(replace(Disk(), accelerometers=parts, encoder_noise=0.002), seed)


PRINTED = "time,theta,a1,a2,a3,a4"  # default columns: seconds, the stage angle in degrees, the four readings


def gradiometer_at(address: Address) -> Model:
    """Return the stage with the columns and the unit of an address."""
    columns = columns_of(address, PRINTED)
    return replace(
        serial_columns_at(parse_address("sim:")),
        name="gradiometer",
        title="four accelerometers on a rotary stage, as numbers on a line",
        channels=columns.channels,
        unit=address.text("unit", "mA" if address.simulated else UNSTATED),
        addresses=(f"serial:///dev/ttyUSB0?columns={PRINTED}",),
        # Matching a pair does not need the value of 1 g.
        sensitivity=UNKNOWN,
        scaled=False,
        thermometer=False,
        driver=partial(ColumnsSensor, columns),
        twin=partial(virtual_stage, columns),
        not_modelled=(
            "a stage that starts, stops or changes its speed; its bearing, vibration and angular acceleration",
            "output and pendulous axes: only the misalignment in the plane of the disk couples",
            "bandwidth and delay of the accelerometers and of the encoder; temperature",
        ),
        default_truth=draw_truth,
        options=("columns", "separator", "unit"),
        configure=gradiometer_at,
    )


MODELS = {"gradiometer": gradiometer_at(parse_address("sim:"))}

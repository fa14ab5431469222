"""The virtual rotary stage: prints the lines of four accelerometers in real time."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import radians
from typing import TYPE_CHECKING

from tiltcal.drivers.twin.gradiometer import CHANNELS, Accelerometer, Disk, Gradiometer
from tiltcal.drivers.twin.streaming import StreamingTwin
from tiltcal.drivers.twin.tolerances import part_errors
from tiltcal.drivers.twin.truth import Truth

if TYPE_CHECKING:
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.columns import ColumnLayout
    from tiltcal.drivers.twin.fixture import HeldPose

TIME, THETA = "time", "theta"

BAUDRATE = 921_600

FASTEST = 400.0
"""Largest number of lines per second at the baud rate."""


@dataclass(frozen=True)
class StageTruth(Truth):
    """The true state of a virtual stage: a disk in place of the coefficients of a tilt sensor."""

    disk: Disk = field(default_factory=Disk)

    @classmethod
    def of(cls, disk: Disk, seed: int) -> StageTruth:
        """Return the truth of a disk, with all channels that it can print."""
        return cls((TIME, THETA, *CHANNELS), {}, {}, seed=seed, disk=disk)


def stage_twin(columns: ColumnLayout, truth: Truth, fixture: HeldPose, clock: Clock) -> StreamingTwin:
    """Return a stage that prints the columns of an address; a skipped or unknown column is 0.

    Parameters
    ----------
    truth : StageTruth
        During its fault ``stuck``, it repeats the first line of the fault.
    """
    disk = truth.disk if isinstance(truth, StageTruth) else Disk()
    gradiometer = Gradiometer(disk, truth.seed)

    def line(number: int) -> bytes:
        fault = truth.fault(number / disk.rate)
        sample = gradiometer.sample(round(fault.start * disk.rate) if fault.kind == "stuck" else number)
        readings = dict(zip(CHANNELS, sample.readings, strict=True))
        return columns.line({TIME: number / disk.rate, THETA: sample.theta, **readings})

    return StreamingTwin(truth, clock, line, period=1.0 / disk.rate, baudrate=BAUDRATE)


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

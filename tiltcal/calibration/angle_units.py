"""Sensors that print angles or slopes: their readings in degrees, their convention, and what cannot be fitted.

The unit decides it here; all that follows asks the coefficients (:mod:`tiltcal.core.angle_readings`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from math import cos, inf, radians, sin

import numpy as np

from tiltcal.calibration.measurement import BenchUncertainty, MeasuredSensor
from tiltcal.core.angle_readings import CONVENTION_SHOWS, USABLE, AngleReadings, reads_steep
from tiltcal.core.model import AXES
from tiltcal.core.samples import SampleSummary
from tiltcal.drivers.model import OF_TILT
from tiltcal.errors import EstimateError, UsageError
from tiltcal.files.calibration import ANGLE, EULER, INCLINATION, CalibrationRecord, SensorIdentity
from tiltcal.files.procedure import PositionProcedure

STEEP = radians(60.0)  # one axis beyond shows the convention of a device that is turned about the vertical, radians
CLEARLY = 4.0  # a convention is the one whose residuals are smaller by this factor
FEWER = "no position nearer than 5° to ±90° of a channel is fitted where readings are angles"


def identified(
    sensor: SensorIdentity, procedure: PositionProcedure | None = None, angles: str | None = None
) -> SensorIdentity:
    """Return the identity of a sensor with what its unit says of its readings, and a convention that is stated."""
    if sensor.unit in OF_TILT:
        return sensor.replaced(reads=ANGLE, angles=angles or sensor.angles)
    askew = procedure is not None and not procedure.renews and procedure.alignment
    for option, stated in (("angles", angles), ("alignment", askew)):
        if stated:
            why = f"is of readings that are angles, and {sensor.serial or sensor.model} reads {sensor.unit}"
            raise UsageError(option=option, why=why, advice="leave it out")
    return sensor.replaced(angles=None)


def read_in_degrees(sensor: MeasuredSensor, procedure: PositionProcedure, angles: str | None) -> MeasuredSensor:
    """Return a sensor whose readings are angles with these, and without the positions that are too steep to be fitted.

    EstimateError: a procedure of free positions, which needs components of gravity.
    """
    identity = identified(sensor.sensor, procedure, angles)
    readings = identity.angle_readings
    if readings is None:
        return sensor
    if procedure.free:
        why = f"{procedure.name} needs components of gravity, and {sensor.sensor.serial} prints {sensor.sensor.unit}"
        raise EstimateError(f"{why}: set its positions, such as with multi-angle")
    kept = [one for one in sensor.measurements if not too_steep(one.gravity, identity.channels, readings)]
    if sensor.measurements and not kept:
        raise EstimateError(f"{procedure.name} leaves no position to {sensor.sensor.serial}: {FEWER}")
    measured = [
        replace(one, summaries={c: _in_degrees(summary, readings) for c, summary in one.summaries.items()})
        for one in kept
    ]
    base = sensor.base
    if base is not None and readings.slope:  # which is compensated in degrees, too
        flat = replace(base.coefficients, angles=replace(readings, slope=0.0))
        base = replace(base, coefficients=flat)
    return replace(sensor, sensor=identity, measurements=measured, base=base)


def too_steep(gravity: Sequence[float], channels: Sequence[str], readings: AngleReadings | None) -> bool:
    """Return whether a position is too near ±90° of a channel that prints angles, or beyond that of a roll."""
    rolled = readings is not None and readings.euler is not False and gravity[2] < cos(USABLE)
    return rolled or any(reads_steep(readings, gravity[AXES.index(channel)]) for channel in channels)


def _in_degrees(summary: SampleSummary, readings: AngleReadings) -> SampleSummary:
    if not readings.slope:
        return summary
    mean = np.array(summary.mean)
    steep = float(readings.steepness(mean))
    sizes = {name: getattr(summary, name) * steep for name in ("std", "u", "quantisation", "resolution")}
    return replace(summary, mean=float(readings.angle(mean)), **sizes)


def shows_convention(attitudes: Sequence[Sequence[float]]) -> bool:
    """Return whether a position tilts both axes, or one of them, so far that inclinations and Euler angles differ."""
    far, alone = sin(CONVENTION_SHOWS), sin(STEEP)
    tilts = [sorted(map(abs, up[:2])) for up in attitudes]
    return any(low >= far or high >= alone for low, high in tilts)


def with_convention(sensor: MeasuredSensor, procedure: PositionProcedure, bench: BenchUncertainty) -> MeasuredSensor:
    """Return a sensor with the convention of its angles that the positions show, where none is stated."""
    from tiltcal.calibration.fit import observed_sensor
    from tiltcal.core.estimation.estimate import estimate_jointly

    attitudes = [one.gravity for one in sensor.measurements]
    if not (_undecided(sensor.sensor) and procedure.axes and shows_convention(attitudes)):
        return sensor

    def misfit(tried: MeasuredSensor) -> float:
        try:
            (found,) = estimate_jointly([observed_sensor(tried, procedure, bench)])
        except EstimateError:
            return inf
        return float(np.sum(found.residuals**2))

    either = [replace(sensor, sensor=sensor.sensor.replaced(angles=name)) for name in (INCLINATION, EULER)]
    best, worst = sorted((misfit(tried), k) for k, tried in enumerate(either))
    return sensor if best[0] * CLEARLY > worst[0] else either[best[1]]


def _undecided(sensor: SensorIdentity) -> bool:
    """Return whether it counts, and is not stated, whether the readings are inclinations or Euler angles."""
    readings = sensor.angle_readings
    return readings is not None and readings.euler is None and {"x", "y"} <= set(sensor.channels)


def remarks(before: MeasuredSensor, sensor: MeasuredSensor) -> Iterator[str]:
    """Yield what is said of a sensor that prints angles: what was left out, and the convention."""
    kept = {one.position for one in sensor.measurements}
    if out := [one.position for one in before.measurements if one.position not in kept]:
        yield f"{', '.join(out)} left out: {FEWER}"
    if _undecided(sensor.sensor):
        yield (
            "inclinations or Euler angles is not stated (--angles), and no position shows it: rows in which both axes "
            "exceed 5° are suspect"
        )


def finished(record: CalibrationRecord, said: Iterable[str]) -> CalibrationRecord:
    """Return a record as its file is read again, with what is said of it."""
    coefficients = replace(record.coefficients, angles=record.sensor.angle_readings)
    return replace(record, coefficients=coefficients, fit=record.fit.replaced(notes=(*record.fit.notes, *said)))

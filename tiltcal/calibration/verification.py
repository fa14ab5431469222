"""Verification: positions that a calibration was not fitted to, as the calibration reads them, and the verdict.

The decision rule is that of ISO 14253-1: an error is within the limit where it is so with its expanded uncertainty
added, and beyond it where it is so with that taken off. Between the two it is not decided. The uncertainty is that of
the verification, from the jig and the noise: what the calibration is uncertain by is what the errors show.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from math import asin, cos, degrees, hypot, inf, isnan, radians
from typing import Any

import numpy as np

from tiltcal.calibration.measurement import BenchUncertainty, Measurement
from tiltcal.calibration.record import compensation_of
from tiltcal.core.attitude import normalised
from tiltcal.core.model import AXES
from tiltcal.core.rounding import plus_minus
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity

PASSED, FAILED, UNDECIDED = "passed", "failed", "not decided"
LOUD = {FAILED: "FAILED"}

LIMIT = 0.5  # the largest tilt error that passes where none is stated, degrees
EXACT = BenchUncertainty()  # positions count as exact where nothing is stated of the bench
STEEP = cos(radians(89.0))  # the slope of an arcsine is followed up to this far from level
ANGLE, DIRECTION = 1.959964, 2.447747  # 95 % coverage factors of an error in one angle and in two (root of chi-square)


@dataclass(frozen=True)
class VerifiedPosition:
    """One position as set, and as the calibration reads it."""

    position: str
    expected: dict[str, float]  # the tilt of each axis, degrees
    measured: dict[str, float]  # degrees; NaN where the arcsine has no angle
    error: float  # the largest, of three axes that of the direction, degrees; infinite where there is no angle
    expanded: float  # the uncertainty (95 %) of the error from the jig and the noise, degrees
    flag: int  # that of ``apply``

    def verdict(self, limit: float) -> str:
        """Return ``passed``, ``failed`` or ``not decided`` by a limit in degrees."""
        if self.error + self.expanded <= limit:
            return PASSED
        return FAILED if self.error - self.expanded > limit else UNDECIDED


@dataclass(frozen=True)
class Verification:
    """How a calibration reads positions that it was not fitted to, judged by the largest error that passes."""

    sensor: SensorIdentity
    positions: tuple[VerifiedPosition, ...]
    limit: float  # degrees
    jig: float | None  # standard uncertainty of a set angle, degrees; not stated, the positions count as exact

    @property
    def verdict(self) -> str:
        """``failed`` where any position is; ``passed`` where all are."""
        return min((one.verdict(self.limit) for one in self.positions), key=(FAILED, UNDECIDED, PASSED).index)

    @property
    def worst(self) -> VerifiedPosition:
        """The position with the largest error."""
        return max(self.positions, key=lambda position: position.error)

    def as_data(self) -> dict[str, Any]:
        """Return the verification as plain data; an error that has no number is infinite."""
        verdicts = [(one, one.verdict(self.limit)) for one in self.positions]
        positions = [asdict(one) | {"verdict": said, "passed": said == PASSED} for one, said in verdicts]
        return {
            "sensor": self.sensor.serial,
            "limit": self.limit,
            "jig": self.jig,
            "verdict": self.verdict,
            "passed": self.verdict == PASSED,
            "worst": {"position": self.worst.position, "error": self.worst.error},
            "positions": positions,
        }

    def __str__(self) -> str:
        lines = [f"{self.sensor.model} {self.sensor.serial}, limit {self.limit:g}°"]
        for one in self.positions:
            angles = (f"{axis} {set_:+8.3f}° read {one.measured[axis]:+8.3f}°" for axis, set_ in one.expected.items())
            off = f"off by {plus_minus(one.error, one.expanded)}°   {LOUD.get(said := one.verdict(self.limit), said)}"
            lines.append(f"  {one.position:<12} {'  '.join(angles)}   {off}")
        worst = f"worst {plus_minus(self.worst.error, self.worst.expanded)}° at {self.worst.position}"
        return "\n".join([*lines, f"{LOUD.get(self.verdict, self.verdict)}: {worst}"])


def verify(
    calibration: CalibrationRecord,
    measurements: Sequence[Measurement],
    limit: float = LIMIT,
    bench: BenchUncertainty = EXACT,
) -> Verification:
    """Judge how a calibration reads the positions of its sensor, set with the jig or the reference of a bench."""
    coefficients = calibration.coefficients
    # What is judged is the sensor's own frame, in which positions are set; the mounting is the application's.
    compensation = compensation_of(replace(calibration, coefficients=replace(coefficients, mounting=None)))
    axes, whole = compensation.axes, len(compensation.axes) == 3
    found = []
    attitudes = np.array([measurement.gravity for measurement in measurements])
    errors_of_reference = np.zeros((*attitudes.shape, 1))
    if bench.instrument is not None:
        errors_of_reference = bench.instrument.moves(attitudes, np.arange(len(attitudes)))
    for measurement, moves in zip(measurements, np.linalg.norm(errors_of_reference, axis=2), strict=True):
        readings = np.array([[measurement.summaries[channel].mean for channel in coefficients.channels]])
        result = compensation(readings, np.array([measurement.temperature], dtype=float))
        up = normalised(measurement.gravity)
        tilts = {axis: degrees(asin(component)) for axis, component in zip(AXES, up, strict=True)}
        slopes = {axis: max(cos(radians(tilt)), STEEP) for axis, tilt in tilts.items()}
        expected, measured = {axis: tilts[axis] for axis in axes}, dict(zip(axes, result.tilt[0].tolist(), strict=True))
        errors = [abs(measured[axis] - angle) for axis, angle in expected.items()]
        if whole:
            # The direction is judged, whose error does not grow where one axis nears the vertical.
            apart = np.linalg.norm(np.cross(up, result.gravity[0]))
            errors = [degrees(float(np.arctan2(apart, np.dot(up, result.gravity[0]))))]
        noise = list[float]()
        for channel in set(coefficients.channels) & set(coefficients.axes):
            angles = coefficients.angles
            slope = 1.0 if whole or angles else slopes[channel]
            summary = measurement.summaries[channel]
            u = summary.u if angles is None else summary.u * float(angles.steepness(np.array(summary.mean)))
            noise.append(degrees(u / abs(coefficients.own_sensitivity(channel)) / slope))
        error = inf if any(map(isnan, errors)) else max(errors)
        along = [float(moves[AXES.index(axis)]) / slopes[axis] for axis in axes]
        shared = degrees(hypot(*moves) if whole else max(along))
        expanded = (DIRECTION if whole else ANGLE) * hypot(bench.jig or 0.0, shared, max(noise))
        flag = int(result.flag[0])
        found.append(VerifiedPosition(measurement.position, expected, measured, error, expanded, flag))
    return Verification(calibration.sensor, tuple(found), limit, bench.jig)

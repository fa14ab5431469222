"""Verification: positions that a calibration was not fitted to, as the calibration reads them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import acos, degrees, hypot, inf, isnan

import numpy as np

from tiltcal.bench.positions import PositionResult
from tiltcal.core.compensation import Compensation
from tiltcal.core.frames import Vector, tilt_from_gravity
from tiltcal.files.calibration import CalibrationRecord


@dataclass(frozen=True)
class VerifiedPosition:
    """One position as set, and as the calibration reads it.

    Attributes
    ----------
    position : str
    expected, measured : dict of str to float
        Tilt per axis, degrees; NaN where the arcsine has no angle.
    direction : float or None
        Angle between the direction as set and as read, degrees; None of a sensor that has no three axes.
    flag : int
        As ``tiltcal apply`` would flag the mean reading.
    """

    position: str
    expected: dict[str, float]
    measured: dict[str, float]
    direction: float | None
    flag: int

    @property
    def error(self) -> float:
        """The largest error of the position, degrees; infinite where there is no angle."""
        if self.direction is not None:
            return self.direction
        errors = [abs(self.measured[axis] - angle) for axis, angle in self.expected.items()]
        return inf if any(isnan(error) for error in errors) else max(errors)


def verify_positions(
    calibration: CalibrationRecord, serial: str, accepted: Sequence[PositionResult]
) -> list[VerifiedPosition]:
    """Return every position of a sensor, as its calibration reads it."""
    coefficients = calibration.coefficients
    # What is judged is the sensor's own frame, in which positions are set; the mounting is the application's.
    compensation = Compensation(replace(coefficients, mounting=None), calibration.limits)
    found = []
    for one in (result.measurements[serial] for result in accepted):
        readings = np.array([[one.summaries[channel].mean for channel in coefficients.channels]])
        result = compensation(readings, None if one.temperature is None else np.array([one.temperature]))
        expected = _tilt(one.gravity)
        found.append(
            VerifiedPosition(
                one.position,
                {axis: expected[axis] for axis in compensation.axes},
                dict(zip(compensation.axes, result.tilt[0].tolist(), strict=True)),
                _between(one.gravity, result.gravity[0].tolist()) if len(compensation.axes) == 3 else None,
                int(result.flag[0]),
            )
        )
    return found


def _tilt(gravity: Vector) -> dict[str, float]:
    return {**tilt_from_gravity(gravity), "z": 90.0 - degrees(acos(max(-1.0, min(1.0, gravity[2]))))}


def _between(a: Sequence[float], b: Sequence[float]) -> float:
    """Angle between two directions, degrees."""
    cross = np.cross(a, b)
    return degrees(float(np.arctan2(hypot(*cross), np.dot(a, b))))

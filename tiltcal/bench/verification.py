"""Verification: what a calibration makes of positions that it was not fitted to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import acos, degrees, hypot, inf, isnan

import numpy as np

from tiltcal.bench.position_runner import PositionResult
from tiltcal.bench.sensor_set import ConnectedSensor
from tiltcal.core.compensation import Compensation
from tiltcal.core.frames import Vector, tilt_from_gravity
from tiltcal.core.model import Coefficients
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


def checks(
    calibration: CalibrationRecord, bay: ConnectedSensor, taken: Sequence[PositionResult]
) -> list[VerifiedPosition]:
    """Every position of a sensor, as its calibration reads it.

    Parameters
    ----------
    calibration : CalibrationRecord
    bay : ConnectedSensor
    taken : sequence of PositionResult
    """
    coefficients = calibration.coefficients
    # What is judged is the sensor's own frame, in which positions are set; the mounting is the application's.
    compensation = Compensation(_without_mounting(coefficients), calibration.limits)
    found = []
    for one in taken:
        summaries: Mapping[str, float] = {
            channel: summary.mean for channel, summary in one.summaries[bay.serial].items()
        }
        readings = np.array([[summaries[channel] for channel in coefficients.channels]])
        temperature = one.temperatures[bay.serial]
        result = compensation(readings, None if temperature is None else np.array([temperature]))
        gravity = bay.orientation.seen(one.position.gravity)
        expected = _tilt(gravity)
        found.append(
            VerifiedPosition(
                one.position.name,
                {axis: expected[axis] for axis in compensation.axes},
                dict(zip(compensation.axes, result.tilt[0].tolist(), strict=True)),
                _between(gravity, result.gravity[0].tolist()) if len(compensation.axes) == 3 else None,
                int(result.flag[0]),
            )
        )
    return found


def _without_mounting(coefficients: Coefficients) -> Coefficients:
    return replace(coefficients, mounting=None)


def _tilt(gravity: Vector) -> dict[str, float]:
    return {**tilt_from_gravity(gravity), "z": 90.0 - degrees(acos(max(-1.0, min(1.0, gravity[2]))))}


def _between(a: Sequence[float], b: Sequence[float]) -> float:
    """Angle between two directions, degrees."""
    cross = np.cross(a, b)
    return degrees(float(np.arctan2(hypot(*cross), np.dot(a, b))))

"""Calibration in positions that nobody set: that gravity is 1 g in each is all that is known of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from tiltcal.calibration.measurement import MeasuredSensor, Measurement
from tiltcal.core.estimation.ellipsoid import UNKNOWNS, count_distinct, fit_ellipsoid, misfits
from tiltcal.core.model import AXES, Array
from tiltcal.core.rounding import significant
from tiltcal.core.statistics import SampleSummary
from tiltcal.errors import EstimateError, UsageError
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.procedure import Procedure

UNDETERMINED = (
    "undetermined: gravity alone does not tell how the sensor sits. The sensitivity is given in the frame whose z axis "
    "is the direction that channel z senses, and whose y axis lies in the plane of those of channels y and z"
)


def require_no_jig(procedure: Procedure, jig: float | None) -> None:
    """Refuse a stated jig where no position is set by one.

    Raises
    ------
    UsageError
    """
    if procedure.determines.free and jig is not None:
        raise UsageError("free positions trust no jig: leave --jig out, or name a procedure whose positions are set")


def directed(sensors: Sequence[MeasuredSensor]) -> list[MeasuredSensor]:
    """The sensors of a fixture with every position where the readings say that it was, for the estimator to refine.

    Parameters
    ----------
    sensors : sequence of MeasuredSensor
        One of three channels among them: the ellipsoid of its readings gives the directions for all.

    Raises
    ------
    EstimateError
        No sensor has three channels, or the readings lie on no ellipsoid.
    """
    leader = next((one for one in sensors if set(AXES) <= set(one.sensor.channels)), None)
    if leader is None:
        raise EstimateError("free positions need a sensor of three channels: unit gravity says too little of fewer")
    seen = directions([one.summaries for one in leader.measurements]) @ np.array(leader.orientation)
    return [replace(one, measurements=_turned(one, seen)) for one in sensors]


def directions(positions: Sequence[Mapping[str, SampleSummary]]) -> Array:
    """A first guess at where gravity pointed in each position.

    Parameters
    ----------
    positions : sequence of mapping of str to SampleSummary
        What x, y and z read in each.

    Returns
    -------
    ndarray, shape (positions, 3)
        Unit vectors, in the frame in which the sensitivity matrix is upper triangular.

    Raises
    ------
    EstimateError
        The readings are fewer than nine, or lie on no ellipsoid.
    """
    means = np.array([[summaries[channel].mean for channel in AXES] for summaries in positions])
    return fit_ellipsoid(means, np.zeros_like(means)).attitudes


def with_verdict(calibration: CalibrationRecord, measurements: Sequence[Measurement]) -> CalibrationRecord:
    """Say how well the length of gravity is met, what judges it, and what is undetermined.

    Parameters
    ----------
    calibration : CalibrationRecord
        From unit gravity alone.
    measurements : sequence of Measurement
        Its positions, in the directions that were found.
    """
    coefficients = calibration.coefficients
    distinct = count_distinct(np.array([one.gravity for one in measurements]))
    fit = replace(calibration.fit, distinct_attitudes=distinct)
    if len(coefficients.channels) == len(coefficients.axes) == len(AXES):
        mean = np.array([[one.summaries[channel].mean for channel in coefficients.channels] for one in measurements])
        misfit = misfits(mean, coefficients.offset, coefficients.sensitivity)
        fit = replace(fit, misfit_rms_mg=significant(1e3 * float(np.sqrt(np.mean(misfit**2))), 3))
    if distinct <= UNKNOWNS:
        warning = (
            f"{distinct} different attitudes for {UNKNOWNS} unknowns: zero degrees of freedom are left to tell whether "
            "the result is right; add attitudes, 12 to 18 or more"
        )
        fit = replace(fit, warning=warning)
    return replace(calibration, derived=replace(calibration.derived, mounting=UNDETERMINED), fit=fit)


def _turned(sensor: MeasuredSensor, directions: Array) -> list[Measurement]:
    """A sensor's positions in directions of the fixture's frame."""
    own = directions @ np.array(sensor.orientation).T
    return [
        replace(one, gravity=(x, y, z), tilt=None)
        for one, (x, y, z) in zip(sensor.measurements, own.tolist(), strict=True)
    ]

"""What a temperature sweep warrants: the order of the drift by cross-validation, and the hysteresis that is left.

A polynomial of too high an order follows the noise; one of too low an order leaves the curve. Each order is judged by
how well it foretells a position that was left out, and a higher one must be better by more than chance would make it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from tiltcal.calibration.calibrate import MeasuredSensor, Measurement, calibrate_jointly, design_of, observations_of
from tiltcal.core.estimation.design import SensorObservations
from tiltcal.core.estimation.estimate import estimate_jointly
from tiltcal.core.model import Array
from tiltcal.core.rounding import significant
from tiltcal.errors import EstimateError
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.procedure import Procedure

ALIKE = 1.5
"""Temperatures that are no further apart are one temperature met twice, °C."""


@dataclass(frozen=True)
class OrderChoice:
    """The order that was chosen, and why.

    Attributes
    ----------
    order : int
    errors : mapping of int to float
        Mean square error of foretelling a position that was left out, over its variance, by order.
    """

    order: int
    errors: Mapping[int, float]


def calibrate(
    subjects: Sequence[MeasuredSensor],
    procedure: Procedure,
    *,
    jig: float | None = None,
    thermometer: float | None = None,
    settings: Mapping[str, Any] | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> list[CalibrationRecord]:
    """Calibrate all sensors of a fixture with the order of the drift that the procedure states, or has chosen.

    The arguments are those of :func:`tiltcal.calibration.calibrate.calibrate_jointly`.

    Raises
    ------
    EstimateError
        The positions cannot determine the coefficients, or are too few to choose an order by.
    """
    choice = None
    if procedure.determines.cross_validated:
        choice = choose_order(subjects, procedure, jig=jig, thermometer=thermometer)
        procedure = with_order(procedure, choice.order)
    found = calibrate_jointly(
        subjects, procedure, jig=jig, thermometer=thermometer, settings=settings, provenance=provenance
    )
    if choice is None:
        return found
    return [swept(one, subject.measurements, choice) for one, subject in zip(found, subjects, strict=True)]


def choose_order(
    subjects: Sequence[MeasuredSensor],
    procedure: Procedure,
    *,
    jig: float | None = None,
    thermometer: float | None = None,
) -> OrderChoice:
    """The order of the drift that foretells left-out positions best.

    Parameters
    ----------
    subjects : sequence of MeasuredSensor
        All of them have the same order.
    procedure : Procedure
        Its ``drift`` is the highest order that is tried.
    jig, thermometer : float, optional
        As stated.

    Returns
    -------
    OrderChoice

    Notes
    -----
    Of the orders whose mean error is within one standard error of the best one's, the lowest is taken.
    """
    squares: dict[int, Array] = {}
    for order in range(1, procedure.determines.drift + 1):
        try:
            squares[order] = _left_out(subjects, with_order(procedure, order), jig, thermometer)
        except EstimateError:
            break
    if not squares:
        raise EstimateError("the sweep has too few temperatures to leave one out: add some between and beyond them")
    errors = {order: float(np.mean(square)) for order, square in squares.items()}
    best = min(errors, key=lambda order: errors[order])
    slack = float(np.std(squares[best], ddof=1)) / np.sqrt(len(squares[best]))
    order = next(order for order in errors if errors[order] <= errors[best] + slack)
    return OrderChoice(order, errors)


def with_order(procedure: Procedure, order: int) -> Procedure:
    """The procedure with one order of the drift."""
    return replace(procedure, determines=replace(procedure.determines, drift=order, cross_validated=False))


def swept(
    calibration: CalibrationRecord, measurements: Sequence[Measurement], choice: OrderChoice
) -> CalibrationRecord:
    """A calibration that tells how its order was chosen, and how far the way up differs from the way down."""
    record: dict[str, Any] = {
        "cross_validation": {
            "order": choice.order,
            "error_by_order": {str(order): significant(error, 4) for order, error in choice.errors.items()},
        }
    }
    loops = _hysteresis(calibration, measurements)
    if loops:
        record["hysteresis"] = loops
    return replace(calibration, fit={**calibration.fit, **record})


def _left_out(
    subjects: Sequence[MeasuredSensor], procedure: Procedure, jig: float | None, thermometer: float | None
) -> Array:
    """Squared error of foretelling each position from the others, over its variance; over 1 where none is known."""
    found = []
    noise = [_uncertainties(subject, design_of(subject, procedure, jig, thermometer).channels) for subject in subjects]
    for number in range(len(subjects[0].measurements)):
        rest = [
            replace(subject, measurements=[m for k, m in enumerate(subject.measurements) if k != number])
            for subject in subjects
        ]
        sensors = []
        for subject in rest:
            design = design_of(subject, procedure, jig, thermometer)
            sensors.append(
                SensorObservations(design, observations_of(subject.measurements, design.channels), subject.orientation)
            )
        for subject, u, estimate in zip(subjects, noise, estimate_jointly(sensors), strict=True):
            out = subject.measurements[number]
            gravity, temperature = np.array([out.gravity]), np.array([out.temperature], dtype=float)
            predicted = estimate.coefficients.predict(gravity, temperature)[0]
            mean = [out.summaries[channel].mean for channel in estimate.coefficients.channels]
            found.extend((((np.array(mean) - predicted) / u[number]) ** 2).tolist())
    return np.array(found)


def _uncertainties(subject: MeasuredSensor, channels: Sequence[str]) -> Array:
    """Of every position's mean readings, shape (positions, channels)."""
    u = np.array([observation.u for observation in observations_of(subject.measurements, channels)])
    return np.where(u > 0.0, u, 1.0)


def _hysteresis(calibration: CalibrationRecord, measurements: Sequence[Measurement]) -> dict[str, Any]:
    """The largest difference of residuals at one temperature that was met twice, per channel, unit."""
    residuals: Mapping[str, Mapping[str, float]] = calibration.fit["residuals"]
    met_twice = [
        (one.position, other.position)
        for one, other in combinations(measurements, 2)
        if one.gravity == other.gravity
        and one.temperature is not None
        and other.temperature is not None
        and abs(one.temperature - other.temperature) <= ALIKE
    ]
    loops: dict[str, Any] = {}
    for channel in calibration.coefficients.channels:
        differences = {pair: residuals[pair[1]][channel] - residuals[pair[0]][channel] for pair in met_twice}
        if differences:
            pair = max(differences, key=lambda pair: abs(differences[pair]))
            loops[channel] = {"difference": significant(differences[pair], 4), "between": list(pair)}
    return loops

"""An outlook in words."""

from __future__ import annotations

from collections.abc import Iterator

from tiltcal.calibration.labels import unit_of
from tiltcal.calibration.prediction import PredictedUncertainty
from tiltcal.core.estimation.design import Design

SHOWN = 3
"""Correlations and positions that are named."""


def outlook_text(outlook: PredictedUncertainty) -> str:
    """Every coefficient with its predicted standard uncertainty, and what the plan is weak in."""
    return "\n".join(_lines(outlook))


def _lines(outlook: PredictedUncertainty) -> Iterator[str]:
    prediction, design = outlook.prediction, outlook.design
    noise = f"{outlook.noise:.2g} {outlook.unit} of noise a sample"
    yield f"predicted standard uncertainty, with {noise} and {_jig(design)}:"
    for name, u in prediction.uncertainty().items():
        # What unit gravity leaves open is the choice of a frame, in which these are 0.
        if u > 0.0 or not design.free:
            yield f"  {name:<28} {u:.2g} {unit_of(name, outlook.unit)}"
    yield f"  degrees of freedom {prediction.dof}" + (
        "" if prediction.dof else ": nothing is left to check the result by"
    )
    for first, second, correlation in prediction.correlations[:SHOWN]:
        yield f"  {first} and {second} are hardly told apart (correlation {correlation:+.2f})"
    for name, coefficient, share in prediction.worth_adding[:SHOWN]:
        yield f"  adding {name} would bring {coefficient} to {100 * share:.0f} % of its uncertainty"


def _jig(design: Design) -> str:
    if design.free:
        return "positions that nobody sets"
    return "a perfect jig (none is stated)" if design.jig is None else f"a jig of {design.jig:g}°"

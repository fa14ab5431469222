"""From measured positions to the mounting of a sensor that is calibrated already."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import degrees, radians
from typing import Any

import numpy as np

from tiltcal.calibrate import Measurement
from tiltcal.core.compensate import Compensation
from tiltcal.core.model import Array, Coefficients, Mounting
from tiltcal.core.rounding import round_to, significant
from tiltcal.core.wahba import MountingEstimate, solve_mounting
from tiltcal.errors import EstimateError
from tiltcal.files.calibration import Calibration


def mount(
    base: Calibration,
    measurements: Sequence[Measurement],
    *,
    jig: float | None = None,
    settings: Mapping[str, Any] | None = None,
) -> Calibration:
    """A calibration with the mounting that the positions show; all else is the base's.

    Parameters
    ----------
    base : Calibration
        Of the same sensor, in its own frame.
    measurements : sequence of Measurement
        In positions whose gravity is given in the application's frame.
    jig : float, optional
        Standard uncertainty of a set angle, degrees.
    settings : mapping, optional
        Records for the file.

    Returns
    -------
    Calibration

    Raises
    ------
    EstimateError
        One direction of gravity alone, or a sensor without x and y.
    """
    known = np.array([measurement.gravity for measurement in measurements])
    found = _best(base.coefficients, measurements, known, jig)
    mounting, u = _rounded(found)
    return replace(
        base,
        coefficients=replace(base.coefficients, mounting=mounting),
        uncertainty={**base.uncertainty, **({} if u is None else {"mounting": u})},
        derived={**base.derived, "gimbal_lock": True} if found.gimbal_lock else base.derived,
        fit={**base.fit, "mounting": _record(found, measurements, jig)},
        procedure={**base.procedure, "mounting": {**(settings or {}), "positions": [m.position for m in measurements]}},
        positions=[*base.positions, *(_position(measurement) for measurement in measurements)],
    )


def _best(
    coefficients: Coefficients, measurements: Sequence[Measurement], known: Array, jig: float | None
) -> MountingEstimate:
    """The mounting; of a sensor of two axes it may hang upside down, and the better of the two is taken."""
    sigma = None if jig is None else np.full(len(known), max(radians(jig), 1e-6))
    read = _directions(coefficients, measurements)
    candidates = [read] if len(coefficients.channels) == 3 else [read, read * [1.0, 1.0, -1.0]]
    found = [solve_mounting(directions, known, sigma) for directions in candidates]
    return min(found, key=lambda estimate: float(np.sum(estimate.residuals**2)))


def _directions(coefficients: Coefficients, measurements: Sequence[Measurement]) -> Array:
    """Up in the sensor's frame in every position, as its calibration reads it."""
    if not {"x", "y"} <= set(coefficients.channels):
        raise EstimateError("the mounting is found from the x and y channels at least, and this sensor lacks one")
    compensation = Compensation(replace(coefficients, mounting=None))
    readings = np.array([[m.summaries[c].mean for c in coefficients.channels] for m in measurements])
    temperatures = np.array([np.nan if m.temperature is None else m.temperature for m in measurements])
    gravity = compensation(readings, temperatures).gravity
    if gravity.shape[1] == 3:
        return gravity
    rest = np.sqrt(np.maximum(1.0 - np.sum(gravity**2, axis=1), 0.0))
    return np.column_stack([gravity, rest])


def _rounded(found: MountingEstimate) -> tuple[Mounting, dict[str, float] | None]:
    """The angles with the digits that their uncertainty warrants, radians; and that, degrees."""
    if found.u is None:
        return found.mounting, None
    u = {name: degrees(getattr(found.u, name)) for name in ("roll", "pitch", "yaw")}
    angles = {name: radians(round_to(degrees(getattr(found.mounting, name)), u[name])) for name in u}
    return Mounting(**angles), {name: significant(value, 4) for name, value in u.items()}


def _record(found: MountingEstimate, measurements: Sequence[Measurement], jig: float | None) -> dict[str, Any]:
    record: dict[str, Any] = {
        "residuals_degrees": {
            m.position: round(degrees(float(r)), 4) for m, r in zip(measurements, found.residuals, strict=True)
        },
        "degrees_of_freedom": found.dof,
        "uncertainty_from": "stated jig" if found.stated else "residuals",
    }
    if found.stated and jig:
        record["chi_square"] = significant(float(np.sum(found.residuals**2)) / radians(jig) ** 2, 4)
    return record


def _position(measurement: Measurement) -> dict[str, Any]:
    return {
        "position": measurement.position,
        "mean": {c: round_to(s.mean, s.u) for c, s in measurement.summaries.items()},
        "std": {c: significant(s.std, 4) for c, s in measurement.summaries.items()},
        "n": next(iter(measurement.summaries.values())).n,
        **({"temperature": round(measurement.temperature, 3)} if measurement.temperature is not None else {}),
        **measurement.when,
    }

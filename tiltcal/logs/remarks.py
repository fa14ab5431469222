"""What a fit of recorded data has to add to the records of a calibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from tiltcal.calibration.calibrate import Measurement
from tiltcal.core.rounding import round_to
from tiltcal.errors import EstimateError
from tiltcal.files.calibration import CalibrationRecord

ACCELERATION = ("m/s2", "m/s^2", "m/s²")


def of_local_gravity(calibration: CalibrationRecord, gravity: float) -> CalibrationRecord:
    """Say the main sensitivities per m/s² and, for readings in m/s², by how much they are off.

    Parameters
    ----------
    calibration : CalibrationRecord
        Its sensitivities are per g, 1 g being gravity where it was made.
    gravity : float
        There, m/s².
    """
    coefficients = calibration.coefficients
    own = {
        channel: float(coefficients.sensitivity[row, coefficients.axes.index(channel)]) / gravity
        for row, channel in enumerate(coefficients.channels)
        if channel in coefficients.axes
    }
    u = {channel: calibration.uncertainty["sensitivity"][channel][channel] / gravity for channel in own}
    said: dict[str, Any] = {
        "gravity_m_s2": gravity,
        "sensitivity_per_m_s2": {c: round_to(value, u[c]) for c, value in own.items()},
    }
    if calibration.sensor.unit in ACCELERATION:
        said["scale_error_percent"] = {c: round_to(100.0 * (value - 1.0), 100.0 * u[c]) for c, value in own.items()}
    return replace(calibration, derived={**calibration.derived, **said})


def of_table(calibration: CalibrationRecord, measurements: Sequence[Measurement]) -> CalibrationRecord:
    """Keep in the record of positions what the table said, and nothing else.

    Parameters
    ----------
    calibration : CalibrationRecord
    measurements : sequence of Measurement
        Its positions.

    Raises
    ------
    EstimateError
        The table states no uncertainty, and no position is left over that would show it.
    """
    stated = any(summary.u > 0 for one in measurements for summary in one.summaries.values())
    if not stated and not calibration.fit.get("degrees_of_freedom"):
        raise EstimateError(
            "the table states no uncertainties (ux, uy, uz) and has no position more than there are unknowns: nothing "
            "says how good the result is; add either"
        )
    unsaid = {"std"} if stated else {"std", "u"}
    kept = [{name: value for name, value in one.items() if name not in unsaid} for one in calibration.positions]
    return replace(calibration, positions=kept)

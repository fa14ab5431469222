"""The errors that a calibration file states, as the uncertain quantities that angles and comparisons follow from."""

from __future__ import annotations

from collections.abc import Mapping
from math import radians

import numpy as np

from tiltcal.core.angle_uncertainty import length_half_width
from tiltcal.core.attitude import mounting_matrix
from tiltcal.core.compensation import LENGTH_TOLERANCE
from tiltcal.core.model import Coefficients, Limits, Mounting
from tiltcal.core.named_coefficients import values
from tiltcal.core.uncertain import ALIGNMENT, NORMAL_FACTOR, READING, TURN, Uncertain, widened
from tiltcal.errors import EstimateError
from tiltcal.files.coefficients import ANGLES
from tiltcal.files.uncertainty import MOUNTING, TURNS, Uncertainty


def stated_uncertainty(
    uncertainty: Uncertainty, coefficients: Coefficients, *, reading_noise: float | None = None
) -> tuple[Uncertain, tuple[str, ...]]:
    """Return what an angle is uncertain by, and remarks on what is assumed.

    These are the errors of the coefficients, of the mounting's turn, of a reading and its temperature, and of how the
    sensor sits. ``reading_noise`` (unit) replaces that of a reading of the file. Without a covariance the coefficients
    count as uncorrelated; what is not stated counts as exact. An EstimateError refuses a file without any uncertainty.
    """
    known = uncertain_coefficients(uncertainty, coefficients)
    if not known.names:
        raise EstimateError(
            "the file states no uncertainty of any coefficient: calibrate with `tiltcal measure` or `tiltcal fit`, "
            "which write it, or write standard uncertainties (k = 1) under `uncertainty`, in the shape of `calibration`"
        )
    remarks = []
    if uncertainty.covariance is None:
        remarks.append("the file has no covariance: the coefficients count as uncorrelated")
    silent = [name for name in values(coefficients) if name not in uncertainty and name not in known.names]
    if silent:
        remarks.append(f"no uncertainty is stated of {', '.join(silent)}: they count as exact")
    if coefficients.mounting is not None and not known.named(TURNS).names:
        remarks.append("no uncertainty is stated of the mounting: it counts as exact")
    reading = dict(uncertainty.single_reading)
    if reading_noise is not None:
        reading |= dict.fromkeys(coefficients.channels, reading_noise)
    elif not any(channel in reading for channel in coefficients.channels):
        remarks.append(
            "the file has no uncertainty of a reading: only that of the calibration counts (state --reading-noise)"
        )
    u = [*reading.values(), radians(uncertainty.alignment)]
    other = Uncertain.errors((*(READING + name for name in reading), ALIGNMENT), np.diag(np.array(u) ** 2))
    return known.beside(other), tuple(remarks)


def uncertain_coefficients(uncertainty: Uncertainty, coefficients: Coefficients) -> Uncertain:
    """Return the errors of the coefficients and of the mounting's turn; empty where no uncertainty is stated."""
    stated = uncertainty.covariance
    if stated is None:
        own = {
            name: u
            for name, u in uncertainty.items()
            if u > 0.0 and not name.startswith(MOUNTING) and name not in ("temperature.reference", "temperature.lag")
        }
        names, covariance = tuple(own), np.diag(np.array(list(own.values())) ** 2)
    else:
        names, covariance = stated.parameters, stated.as_array()
    factors = np.array([uncertainty.coverage_factor.get(name, NORMAL_FACTOR) for name in names])
    wide = widened(covariance, factors) if stated is None else stated.wide_array(factors)
    scale = np.array([radians(1.0) if name.startswith(TURN) else 1.0 for name in names])
    scales = np.outer(scale, scale)
    found = Uncertain(names, np.zeros(len(names)), covariance * scales, wide * scales)
    angles = {angle: radians(u) for angle in ANGLES if (u := uncertainty.get(f"mounting.{angle}")) is not None}
    if not names or coefficients.mounting is None or not angles or any(name.startswith(TURN) for name in names):
        return found
    return found.beside(_turn(coefficients.mounting, angles))


def length_tolerance(uncertainty: Uncertainty, coefficients: Coefficients, limits: Limits) -> float:
    """Return by how much the length of gravity of three axes may differ from 1 g before a row is suspect."""
    if len(coefficients.channels) < 3 or not uncertain_coefficients(uncertainty, coefficients).names:
        return LENGTH_TOLERANCE
    stated, _ = stated_uncertainty(uncertainty, coefficients)
    return max(LENGTH_TOLERANCE, length_half_width(coefficients, limits, stated))


def _turn(mounting: Mounting, u: Mapping[str, float]) -> Uncertain:
    """Return the mounting's turn about the application's axes, from uncorrelated angles, radians."""
    axes = np.column_stack(
        [
            mounting_matrix(Mounting(0.0, mounting.pitch, mounting.yaw))[:, 0],
            mounting_matrix(Mounting(0.0, 0.0, mounting.yaw))[:, 1],
            [0.0, 0.0, 1.0],
        ]
    )
    angles = np.diag([u.get(angle, 0.0) ** 2 for angle in ANGLES])
    return Uncertain.errors(ANGLES, angles).through(axes, TURNS)

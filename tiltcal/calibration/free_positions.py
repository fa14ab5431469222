"""Calibration in free positions: the attitude of none is set, and gravity is 1 g in each."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations, compress
from math import acos, cos, degrees, radians, sqrt

import numpy as np

from tiltcal.calibration.joint_fit import design_of, record_of
from tiltcal.calibration.measurement import BenchUncertainty, MeasuredSensor, judge_channels
from tiltcal.core.estimation.estimate import NO_FREEDOM, Estimate
from tiltcal.core.estimation.free import UNKNOWNS, FreeFit, fit_free
from tiltcal.core.model import AXES, Coefficients
from tiltcal.core.rounding import significant
from tiltcal.core.samples import noise_of_means
from tiltcal.core.uncertain import NORMAL_FACTOR
from tiltcal.errors import EstimateError
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.procedure import Procedure

UNCERTAIN, WORTHLESS = 10.0, 50.0
"""Expanded uncertainty of a coefficient above which it is warned of, and above which a recording that lacks a
direction is refused, mg."""

WORTHLESS_ANGLE = 500.0
"""The latter of a recording that lacks none, in which only the angle of two axes can be so uncertain."""

SKEW, UNEQUAL = 15.0, 1.5
"""Axes further from square, degrees, or sensitivities further apart, as a ratio, are those of no sensor."""

REACH = 45.0  # a direction is missing where no attitude comes as near, degrees

BELOW_NOISE = "the residuals are smaller than the noise of the readings, by chance: the noise counts"
GAUGE = (
    "unit gravity alone says nothing of the mounting: the frame's z axis is the direction that the z channel senses, "
    "and its y axis lies in the plane of those of y and z"
)
UNDETERMINED = (
    "undetermined: gravity alone does not show how the sensor sits. The sensitivity is given in the frame whose z axis "
    "is the direction that channel z senses, and whose y axis lies in the plane of those of channels y and z"
)


def calibrate_free(sensor: MeasuredSensor, procedure: Procedure, bench: BenchUncertainty) -> CalibrationRecord:
    """Calibrate a sensor of three channels from unit gravity alone; refused where the attitudes do not show it."""
    design = design_of(sensor.sensor, procedure, bench)
    summaries = [[measurement.summaries[axis] for axis in AXES] for measurement in sensor.measurements]
    mean = np.array([[summary.mean for summary in row] for row in summaries])
    # Sway within a hold looks like noise with a memory; it does not change the length of gravity.
    noise = [noise_of_means(channel) for channel in zip(*summaries, strict=True)]
    u = np.sqrt([variance + rounding**2 for variance, _, rounding in noise]).T
    # Motion is what the samples scatter by more than noise explains.
    std = np.array([[summary.std for summary in row] for row in summaries])
    slow = float(np.sum([[summary.n * summary.noise**2 for summary in row] for row in summaries]))
    sway = std * sqrt(max(1.0 - float(np.sum(std**2)) / slow, 0.0)) if slow else 0.0 * std
    seen = fit_free(mean, u, sway)
    names = [measurement.position for measurement in sensor.measurements]
    off = {name: significant(1e3 * float(misfit), 3) for name, misfit in zip(names, seen.misfit, strict=True)}
    if len(seen.disagreeing):
        named = ", ".join(f"{names[k]} ({off[names[k]]:+g} mg)" for k in seen.disagreeing)
        raise EstimateError(
            f"the length of gravity in {named} does not agree with the other attitudes, and these are too few without "
            "them: was the sensor still there? Take them again, or more attitudes"
        )
    placed = [
        replace(measurement, gravity=(x, y, z), tilt=None)
        for measurement, (x, y, z) in zip(sensor.measurements, seen.attitudes.tolist(), strict=True)
    ]
    dof = sum(summary.dof for row in summaries for summary in row)
    found = Estimate(
        coefficients=Coefficients(AXES, AXES, seen.offset, seen.sensitivity),
        uncertain=seen.uncertain(dof),
        positions=tuple(compress(names, seen.kept)),
        residuals=(seen.misfit[:, None] * seen.attitudes)[seen.kept] @ seen.sensitivity.T,
        dof=seen.dof,
        chi_square=None,
        p=None,
        stated=not seen.dof,
    )
    left_out = {name: off[name] for name in compress(names, ~seen.kept)}
    notes = [GAUGE, *([BELOW_NOISE] if seen.below_noise else []), *([] if seen.dof else [NO_FREEDOM])]
    notes += judge_channels(sensor, found)
    if left_out:
        named = ", ".join(f"{name} ({misfit:+g} mg)" for name, misfit in left_out.items())
        notes.append(f"left out, because the length of gravity does not agree with the other attitudes: {named}")
    found = replace(found, notes=tuple(notes))
    record = record_of(found, design, replace(sensor, measurements=list(compress(placed, seen.kept))), procedure)
    return replace(
        record,
        derived=record.derived.replaced(mounting=UNDETERMINED),
        fit=record.fit.replaced(
            distinct_attitudes=seen.distinct,
            left_out_mg=left_out,
            misfit_rms_mg=significant(1e3 * seen.rms, 3),
            warning=_warning(record, seen),
        ),
        positions=tuple(measurement.record(AXES) for measurement in placed),
    )


def _warning(calibration: CalibrationRecord, seen: FreeFit) -> str | None:
    """Return what limits the use of a calibration; what makes it useless is an EstimateError."""
    coefficients, uncertainty = calibration.coefficients, calibration.uncertainty
    length = np.linalg.norm(coefficients.sensitivity, axis=1)
    expanded = {
        name: 1e3 * u * uncertainty.coverage_factor.get(name, NORMAL_FACTOR) / float(np.mean(length))
        for name, u in uncertainty.items()
        if name.startswith(("offset.", "sensitivity."))
    }
    worst = max(expanded, key=lambda name: expanded[name])
    axes = worst.split(".")[1:]
    missing = [
        f"{sign}{axis}"
        for axis, column in zip(AXES, seen.attitudes.T, strict=True)
        for sign, highest in (("+", np.max(column)), ("-", -np.min(column)))
        if highest < cos(radians(REACH))
    ]
    advice = "hold it still for longer in each attitude, or in more of them"
    if missing:
        advice = f"add attitudes in which {', '.join(missing)} points up"
    elif len(set(axes)) > 1:
        advice = f"add attitudes between the axes {' and '.join(axes)}, with both about 45° up or down"
    most, why = WORTHLESS if missing else WORTHLESS_ANGLE, ""
    uncertain = f"{worst} has an expanded uncertainty of {expanded[worst]:.2g} mg"
    if expanded[worst] > most:
        why = f"{uncertain}, more than {most:g} mg"
    unit = coefficients.sensitivity / length[:, None]
    for (first, a), (second, b) in combinations(zip(AXES, unit, strict=True), 2):
        skew = abs(90.0 - degrees(acos(float(np.clip(a @ b, -1.0, 1.0)))))
        why = f"the axes {first} and {second} come out {skew:.0f}° from square" if skew > SKEW else why
    if np.max(length) > UNEQUAL * np.min(length):
        why = f"its sensitivities come out {np.max(length) / np.min(length):.1f} times apart"
    if why:
        raise EstimateError(f"the attitudes do not determine the sensor: {why}; {advice}")
    warnings = [f"{uncertain}: {advice}"] if expanded[worst] > UNCERTAIN else []
    few = (
        f"{seen.distinct} different attitudes for {UNKNOWNS} unknowns: zero degrees of freedom are left to show "
        "whether the result is right; add attitudes, 12 to 18 or more"
    )
    return "; ".join([few] * (seen.distinct <= UNKNOWNS) + warnings) or None

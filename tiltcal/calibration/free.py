"""The calibration of a sensor from attitudes that nobody set: gravity is 1 g in each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import compress
from math import cos, fsum, radians, sqrt

import numpy as np

from tiltcal.calibration.fit import record_of
from tiltcal.calibration.measurement import BenchUncertainty, MeasuredSensor, judge_channels
from tiltcal.calibration.priors import design_of
from tiltcal.core.estimation.estimate import NO_FREEDOM, Estimate
from tiltcal.core.estimation.free import FreeFit, fit_free
from tiltcal.core.model import AXES, Array, Coefficients, Thermal
from tiltcal.core.rounding import significant
from tiltcal.core.samples import SampleSummary, noise_of_means
from tiltcal.core.uncertain import NORMAL_FACTOR
from tiltcal.errors import EstimateError, WrongPositions
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.procedure import PositionProcedure

UNCERTAIN, WORTHLESS = 10.0, 50.0  # expanded u of a coefficient: warned of; refused where a direction is missing, mg
UNEQUAL = 1.5  # the largest sensitivity of a direction over the least, beyond which they are those of no sensor
WARM = 5.0  # a span of temperatures beyond which free attitudes show a drift of the offset, °C
REACH = 45.0  # a direction is missing where no attitude comes as near, degrees

UNDETERMINED = (
    "undetermined: gravity alone does not show how the sensor sits. The sensitivity is given in the frame whose z axis "
    "is the direction that channel z senses, and whose y axis lies in the plane of those of channels y and z"
)


def calibrate_free(sensor: MeasuredSensor, procedure: PositionProcedure, bench: BenchUncertainty) -> CalibrationRecord:
    """Calibrate a sensor of three channels from unit gravity alone; refused where the attitudes do not show it."""
    design = design_of(sensor.sensor, procedure, bench)
    summaries = [[measurement.summaries[axis] for axis in AXES] for measurement in sensor.measurements]
    met = [measurement.temperature for measurement in sensor.measurements]
    known = [one for one in met if one is not None]
    reference, warmth, thermal = 0.0, None, None
    if len(known) == len(met) and max(known) - min(known) > WARM:
        reference = round(fsum(known) / len(known), 3)
        warmth = np.array(known) - reference
    seen = fit_free(*_readings(summaries), warmth)
    if warmth is not None:
        thermal = Thermal(reference, (min(known), max(known)), seen.drift[:, None], np.empty((3, 0)))
    names = [measurement.position for measurement in sensor.measurements]
    off = {name: significant(1e3 * float(misfit), 3) for name, misfit in zip(names, seen.misfit, strict=True)}
    if len(seen.disagreeing):
        named = ", ".join(f"{names[k]} ({off[names[k]]:+g} mg)" for k in seen.disagreeing)
        raise WrongPositions(
            [names[k] for k in seen.disagreeing],
            f"the length of gravity in {named} does not agree with the other attitudes, and these are too few without "
            "them: was the sensor still there? Take them again, or more attitudes",
        )
    placed = [
        replace(measurement, gravity=(x, y, z), tilt=None)
        for measurement, (x, y, z) in zip(sensor.measurements, seen.attitudes.tolist(), strict=True)
    ]
    dof = sum(summary.dof for row in summaries for summary in row)
    found = Estimate(
        coefficients=Coefficients(AXES, AXES, seen.offset, seen.sensitivity, thermal),
        uncertain=seen.uncertain(dof),
        positions=tuple(compress(names, seen.kept)),
        residuals=(seen.misfit[:, None] * seen.attitudes)[seen.kept] @ seen.sensitivity.T,
        dof=seen.dof,
        chi_square=None,
        p=None,
        stated=not seen.dof,
    )
    left_out = {name: off[name] for name in compress(names, ~seen.kept)}
    notes = [*([] if seen.dof else [NO_FREEDOM]), *judge_channels(sensor, found)]
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


def _readings(summaries: Sequence[Sequence[SampleSummary]]) -> tuple[Array, Array, Array]:
    """Return mean readings, their u, and the standard deviation that is sway of the hand, (attitudes, 3) each, unit."""
    mean, std = (np.array([[getattr(one, name) for one in row] for row in summaries]) for name in ("mean", "std"))
    # Sway within a hold looks like noise with a memory; it does not change the length of gravity.
    noise = [noise_of_means(channel) for channel in zip(*summaries, strict=True)]
    u = np.sqrt([variance + rounding**2 for variance, _, rounding in noise]).T
    # Of white noise n u² is the variance of the samples; what is slower, such as sway, makes it larger by its share.
    slow = float(np.sum([[one.n * one.noise**2 for one in row] for row in summaries]))
    return mean, u, std * sqrt(max(1.0 - float(np.sum(std**2)) / slow, 0.0)) if slow else 0.0 * std


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
    uncertain = f"{worst} has an expanded uncertainty of {expanded[worst]:.2g} mg"
    unequal = float(np.linalg.cond(coefficients.sensitivity))
    why = f"{uncertain}, more than {WORTHLESS:g} mg" if missing and expanded[worst] > WORTHLESS else ""
    if unequal > UNEQUAL:
        why = f"its sensitivities to gravity come out {unequal:.1f} times apart, or its axes far from square"
    if why:
        raise EstimateError(f"the attitudes do not determine the sensor: {why}; {advice}")
    warnings = [f"{uncertain}: {advice}"] if expanded[worst] > UNCERTAIN else []
    few = (
        f"{seen.distinct} different attitudes for {seen.unknowns} unknowns: zero degrees of freedom are left to show "
        f"whether the result is right; add attitudes, {seen.unknowns + 3} to {2 * seen.unknowns} or more"
    )
    return "; ".join([few] * (seen.distinct <= seen.unknowns) + warnings) or None

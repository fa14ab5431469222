"""The fit of the sensors of a fixture: in positions that were set, whose attitude they share, and in free ones.

In free positions the attitude of none is set, and gravity is 1 g in each.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import compress, pairwise
from math import asin, cos, degrees, fsum, radians, sqrt

import numpy as np

from tiltcal.calibration.measurement import BenchUncertainty, MeasuredSensor, Measurement, judge_channels, rails_of
from tiltcal.calibration.priors import design_of
from tiltcal.calibration.stated import (
    DIGITS,
    TEMPERATURE_DIGITS,
    derived_record,
    fit_record,
    rounded,
    stated_section,
)
from tiltcal.calibration.wording import LARGEST_AGREEMENT
from tiltcal.core.directions import covered, tilts
from tiltcal.core.estimation.estimate import NO_FREEDOM, Estimate, estimate_jointly, with_hysteresis
from tiltcal.core.estimation.free import FreeFit, fit_free
from tiltcal.core.estimation.positions import Design, Observation, SensorObservations
from tiltcal.core.model import AXES, Coefficients, Limits, Thermal
from tiltcal.core.rounding import outwards, significant
from tiltcal.core.samples import SampleSummary, correlated_noise, noise_of_means
from tiltcal.core.uncertain import NORMAL_FACTOR
from tiltcal.errors import EstimateError, WrongPositions
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.procedure import PositionProcedure
from tiltcal.files.results import ProcedureRecord

OF_BASE = "of the base calibration"  # the origin of a sensitivity that the sensor's own calibration lends
STEEP = 0.99  # gravity along a channel, g, from which on a set angle says little of its reading
DRIFT_NOT_SHOWN = "along gravity only the noise counts; --closing or --jig shows a drift"


def fit_jointly(
    sensors: Sequence[MeasuredSensor], procedure: PositionProcedure, bench: BenchUncertainty
) -> list[CalibrationRecord]:
    """Calibrate all sensors of a fixture together, by the positions of a procedure with its order of the drift."""
    observed = [observed_sensor(sensor, procedure, bench) for sensor in sensors]
    calibrations = []
    for sensor, seen, estimated in zip(sensors, observed, estimate_jointly(observed), strict=True):
        wiring = () if seen.design.assumes_sensitivity else judge_channels(sensor, estimated)
        found = with_hysteresis(estimated, seen)
        notes = (*found.notes, *_remarks(found, sensor, seen.design), *wiring)
        found = replace(found, notes=notes, not_covered=(*found.not_covered, *_assumed_zero(seen.design)))
        calibrations.append(record_of(found, seen.design, sensor, procedure))
    return calibrations


def record_of(
    found: Estimate, design: Design, sensor: MeasuredSensor, procedure: PositionProcedure
) -> CalibrationRecord:
    """Return the calibration of an estimate from a sensor's measurements, rounded to its uncertainty."""
    measurements, assumed = sensor.measurements, ""
    if design.assumes_sensitivity:
        assumed = "nominal of the model" if sensor.base is None else OF_BASE
    coefficients = rounded(found)
    limits = _limits(design, sensor, coefficients)
    if coefficients.thermal is not None:
        coefficients = replace(coefficients, thermal=replace(coefficients.thermal, range=limits.temperature))
    return CalibrationRecord(
        sensor=sensor.sensor.replaced(channels=design.channels),
        coefficients=coefficients,
        uncertainty=replace(
            stated_section(found.uncertain),
            single_reading=_reading(measurements, design, found.estimated_thermometer),
        ),
        limits=limits,
        derived=derived_record(found, assumed, mounted=not design.free),
        fit=fit_record(found, design, max(summary.u for summary in _summaries(measurements, design.channels))),
        procedure=ProcedureRecord(
            name=procedure.name,
            title=procedure.title,
            source=procedure.source or None,
            set={measurement.position: measurement.as_set for measurement in measurements},
        ),
        positions=tuple(measurement.record(design.channels) for measurement in measurements),
    )


def _assumed_zero(design: Design) -> Iterator[str]:
    """Yield the coefficients that neither positions nor a data sheet determine, for ``not_covered``."""
    if not (design.free or design.assumes_sensitivity):
        yield from (f"sensitivity.{axis}" for axis in AXES if len(design.channels) == 2 and axis not in design.axes)
        if not design.nonlinearity:
            yield "nonlinearity"


def _remarks(found: Estimate, sensor: MeasuredSensor, design: Design) -> Iterator[str]:
    """Yield what the uncertainty of an estimate includes and what it leaves out."""
    measurements = sensor.measurements
    if design.jig is None and along_gravity(design.channels, [measurement.gravity for measurement in measurements]):
        yield DRIFT_NOT_SHOWN
    if (found.estimated_jig or 0.0) > LARGEST_AGREEMENT:
        yield "were the positions set by hand, or was something changed between them? State the --jig"
    correlated = correlated_noise(_summaries(measurements, design.channels))
    if correlated is not None and correlated.note:
        yield correlated.note
    for channel in design.channels:
        own = _summaries(measurements, (channel,))
        if len({(summary.mean, summary.std) for summary in own}) == 1 < len(own) and own[0].std == 0.0:
            yield (
                f"{channel} reads {own[0].mean:.6g} in every sample of every position: what differs between them "
                "changes it by less than its step, or the channel is stuck"
            )
    if design.thermal and not design.thermometer:
        shown = found.estimated_thermometer
        counts = f"the residuals show {shown:.2g} °C, which counts" if shown else "temperatures count as exact"
        yield f"the thermometer's uncertainty is not stated (--thermometer): {counts}"
    if found.estimated_noise is not None:
        unstated = "the table states no uncertainties of its means (ux, uy, uz)"
        yield f"{unstated}: the residuals show noise of {found.estimated_noise:.2g} in them, which counts"


def along_gravity(channels: Sequence[str], directions: Sequence[Sequence[float]]) -> bool:
    """Return whether a channel stands along gravity, where an angle hardly counts, and no direction comes twice."""
    steep = any(abs(up[AXES.index(channel)]) > STEEP for up in directions for channel in channels if channel in AXES)
    return steep and len({tuple(np.round(up, 6).tolist()) for up in directions}) == len(directions)


def observed_sensor(
    sensor: MeasuredSensor, procedure: PositionProcedure, bench: BenchUncertainty
) -> SensorObservations:
    """Return a sensor as the estimator takes it; what :func:`design_of` refuses is refused here."""
    design = design_of(sensor.sensor, procedure, bench, nominal=sensor.nominal, base=sensor.base)
    observations = observations_of(sensor.measurements, design.channels)
    if not (procedure.nonlinearity or _sense_own_axes(design, observations)):
        # It is counted along a channel's own axis, which swapped channels hardly sense.
        kept = {name: prior for name, prior in design.priors.items() if not name.startswith("nonlinearity.")}
        design = replace(design, nonlinearity=0, priors=kept)
    return SensorObservations(design, observations, sensor.orientation)


def _sense_own_axes(design: Design, observations: Sequence[Observation]) -> bool:
    """Return whether no channel follows another axis of the design more than its own, by a straight line."""
    axes = [axis for axis in design.axes if f"sensitivity.{design.channels[0]}.{axis}" not in design.priors]
    along = np.array([[1.0, *(seen.gravity[AXES.index(axis)] for axis in axes)] for seen in observations])
    follows = np.abs(np.linalg.lstsq(along, np.array([seen.mean for seen in observations]), rcond=None)[0][1:])
    return all(axes[k] == c for c, k in zip(design.channels, np.argmax(follows, axis=0), strict=True)) if axes else True


def observations_of(measurements: Sequence[Measurement], channels: Sequence[str]) -> list[Observation]:
    """Return the positions for the estimator, each one's noise made better known by that of the others."""
    correlated = correlated_noise(_summaries(measurements, channels))
    noise = [noise_of_means(_summaries(measurements, (channel,)), correlated) for channel in channels]
    taken = sorted(measurements, key=lambda one: str(one.when.get("time", "")))  # a position may be taken again later
    held = {two.position for one, two in pairwise(taken) if (one.gravity, one.heading) == (two.gravity, two.heading)}
    observations = []
    for number, measurement in enumerate(measurements):
        summaries = [measurement.summaries[channel] for channel in channels]
        adc = np.array([rounding[number] for _, _, rounding in noise])
        observations.append(
            Observation(
                measurement.position,
                np.array(measurement.gravity),
                np.array([summary.mean for summary in summaries]),
                np.sqrt(np.array([variance[number] for variance, _, _ in noise]) + adc**2),
                measurement.temperature,
                measurement.heading,
                held=measurement.position in held,
                dof=np.array([dof[number] for _, dof, _ in noise]),
                adc=adc,
                noise_unknown=all(summary.noise_unknown for summary in summaries),
            )
        )
    return observations


def _summaries(measurements: Sequence[Measurement], channels: Sequence[str]) -> list[SampleSummary]:
    return [measurement.summaries[channel] for measurement in measurements for channel in channels]


def _reading(measurements: Sequence[Measurement], design: Design, shown: float | None) -> dict[str, float]:
    """Return the uncertainty of a single reading: the scatter within the positions, and that of rounding."""
    known: dict[str, float] = {}
    for channel in design.channels:
        summaries = _summaries(measurements, (channel,))
        dof = sum(summary.n - 1 for summary in summaries)
        if dof:
            scatter = fsum((summary.n - 1) * summary.std**2 for summary in summaries) / dof
            u = sqrt(scatter + max(summary.quantisation for summary in summaries) ** 2)
            known[channel] = significant(u, DIGITS)
    thermometer = design.thermometer or shown
    if known and thermometer and design.thermal:
        known["temperature"] = significant(thermometer, DIGITS)
    return known


def _limits(design: Design, sensor: MeasuredSensor, coefficients: Coefficients) -> Limits:
    """Return the ranges that were covered: tilts or directions, which are the base's if there is one, °C, and rails."""
    met = [measurement.temperature for measurement in sensor.measurements if measurement.temperature is not None]
    warmth = None
    if coefficients.thermal is not None:
        step = sensor.temperature_step or sqrt(12.0) * (sensor.thermometer or 0.0)
        warmth = outwards(min(met), max(met), TEMPERATURE_DIGITS, step)
    limits = Limits({}, warmth, dict(rails_of(design.channels, sensor.nominal, sensor.base)))
    if sensor.base is not None:
        return replace(limits, tilt=sensor.base.limits.tilt, directions=sensor.base.limits.directions)
    up = [measurement.gravity for measurement in sensor.measurements]
    if len(design.channels) == 3:
        directions = covered(up)
        return replace(limits, tilt=tilts(directions), directions=directions)
    steps = {
        channel: max(summary.resolution for summary in _summaries(sensor.measurements, (channel,)))
        / abs(coefficients.own_sensitivity(channel))
        for channel in design.channels
        if channel in design.axes
    }
    return replace(limits, tilt=covered_tilts(design.channels, up, steps))


def covered_tilts(
    channels: Sequence[str], directions: Sequence[Sequence[float]], steps: Mapping[str, float] | None = None
) -> dict[str, tuple[float, float]]:
    """Return the tilts that positions cover, to either side as far as any of them, radians; none of a level axis.

    ``steps`` are those of the readings, g.
    """
    reach = {axis: max(abs(up[AXES.index(axis)]) for up in directions) for axis in channels}
    tilt = {}
    for axis, g in reach.items():
        if g > 0.0:
            furthest = degrees(asin(min(g + (steps or {}).get(axis, 0.0) / 2.0, 1.0)))
            low, high = outwards(-furthest, furthest, 6)
            tilt[axis] = radians(low), radians(high)
    return tilt


UNCERTAIN, WORTHLESS = 10.0, 50.0
"""Expanded uncertainty of a coefficient above which it is warned of, and above which a recording that lacks a
direction is refused, mg."""

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
    mean = np.array([[summary.mean for summary in row] for row in summaries])
    # Sway within a hold looks like noise with a memory; it does not change the length of gravity.
    noise = [noise_of_means(channel) for channel in zip(*summaries, strict=True)]
    u = np.sqrt([variance + rounding**2 for variance, _, rounding in noise]).T
    # Motion is what the samples scatter by more than noise explains.
    std = np.array([[summary.std for summary in row] for row in summaries])
    slow = float(np.sum([[summary.n * summary.noise**2 for summary in row] for row in summaries]))
    sway = std * sqrt(max(1.0 - float(np.sum(std**2)) / slow, 0.0)) if slow else 0.0 * std
    met = [measurement.temperature for measurement in sensor.measurements]
    known = [one for one in met if one is not None]
    reference, warmth, thermal = 0.0, None, None
    if len(known) == len(met) and max(known) - min(known) > WARM:
        reference = round(fsum(known) / len(known), 3)
        warmth = np.array(known) - reference
    seen = fit_free(mean, u, sway, warmth)
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

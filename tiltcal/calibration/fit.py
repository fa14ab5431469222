"""The fit of the sensors of a fixture in positions that were set, whose attitude they share."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from math import asin, degrees, fsum, radians, sqrt

import numpy as np

from tiltcal.calibration.measurement import BenchUncertainty, MeasuredSensor, Measurement, judge_channels, rails_of
from tiltcal.calibration.priors import design_of
from tiltcal.calibration.stated import DIGITS, TEMPERATURE_DIGITS, derived_record, fit_record, rounded, stated_section
from tiltcal.calibration.wording import LARGEST_AGREEMENT
from tiltcal.core.directions import covered, tilts
from tiltcal.core.estimation.estimate import Estimate, estimate_jointly, with_hysteresis
from tiltcal.core.estimation.positions import Design, Observation, SensorObservations
from tiltcal.core.model import AXES, Coefficients, Limits
from tiltcal.core.rounding import outwards, significant
from tiltcal.core.samples import SampleSummary, correlated_noise, noise_of_means
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
    found: Estimate,
    design: Design,
    sensor: MeasuredSensor,
    procedure: PositionProcedure,
    warmth: tuple[float, float] | None = None,
) -> CalibrationRecord:
    """Return the calibration of an estimate from a sensor's measurements, rounded to its uncertainty.

    ``warmth`` is the range of temperatures of a record, °C; else that of the positions counts.
    """
    measurements, assumed = sensor.measurements, ""
    if design.assumes_sensitivity:
        assumed = "nominal of the model" if sensor.base is None else OF_BASE
    coefficients = rounded(found)
    limits = _limits(design, sensor, coefficients, warmth)
    if coefficients.thermal is not None:
        coefficients = replace(coefficients, thermal=replace(coefficients.thermal, range=limits.temperature))
    return CalibrationRecord(
        sensor=sensor.sensor.replaced(channels=design.channels),
        coefficients=coefficients,
        uncertainty=replace(
            stated_section(found.uncertain), single_reading=_reading(measurements, design, found.estimated_thermometer)
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
    """Return whether each channel changes most with its own axis, by a straight line in the components of gravity."""
    axes = [axis for axis in design.axes if f"sensitivity.{design.channels[0]}.{axis}" not in design.priors]
    along = np.array([[1.0, *(seen.gravity[AXES.index(axis)] for axis in axes)] for seen in observations])
    follows = np.abs(np.linalg.lstsq(along, np.array([seen.mean for seen in observations]), rcond=None)[0][1:])
    return all(axes[k] == c for c, k in zip(design.channels, np.argmax(follows, axis=0), strict=True)) if axes else True


def observations_of(measurements: Sequence[Measurement], channels: Sequence[str]) -> list[Observation]:
    """Return the positions for the estimator, each one's noise made better known by that of the others."""
    correlated = correlated_noise(_summaries(measurements, channels))
    noise = [noise_of_means(_summaries(measurements, (channel,)), correlated) for channel in channels]
    taken = sorted(measurements, key=lambda one: str(one.noted.get("time", "")))  # a position may be taken again later
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


def _limits(
    design: Design, sensor: MeasuredSensor, coefficients: Coefficients, warmth: tuple[float, float] | None
) -> Limits:
    """Return the ranges that were covered: tilts or directions, which are the base's if there is one, °C, and rails."""
    if coefficients.thermal is not None and warmth is None:
        met = [measurement.temperature for measurement in sensor.measurements if measurement.temperature is not None]
        step = sensor.temperature_step or sqrt(12.0) * sensor.thermometer_rounding
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

"""The temperature terms of a calibration: from a sweep, from a ramp, and typical curves of a model.

A polynomial of too high an order follows the noise; one of too low an order leaves the curve. Each order of a sweep is
judged by how well it predicts a position that was left out, with the uncertainty of that prediction. Terms of a higher
order are 0 then, with the uncertainty of the highest order that was tried: what the readings do not show may still be
there. A ramp is a continuous record in one attitude, while the temperature goes up and down.

Where a unit has no temperature run of its own, the mean curves of its model are a starting point: one part differs from
the mean, and the file states by how much. A unit's own run always wins.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import reduce
from math import hypot, inf, radians, sqrt
from operator import add

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from tiltcal.calibration.fit import OF_BASE, fit_jointly, observed_sensor, record_of
from tiltcal.calibration.measurement import BenchUncertainty, MeasuredSensor, Measurement
from tiltcal.calibration.priors import design_of
from tiltcal.calibration.stated import TEMPERATURE_DIGITS, rounded_covariance
from tiltcal.core.attitude import normalised
from tiltcal.core.compensation import Compensated, Compensation
from tiltcal.core.detection import TEMPERATURES
from tiltcal.core.estimation.equations import BASE, HYSTERESIS, JIG, NOISE, PRIOR, TABLE, THERMOMETER
from tiltcal.core.estimation.estimate import Estimate, estimate_jointly, met_twice
from tiltcal.core.estimation.positions import Design
from tiltcal.core.model import Array, Coefficients, Thermal, values, with_vector
from tiltcal.core.ramp.fit import RampFit, fit_ramp
from tiltcal.core.ramp.record import RampRecord, row_noise
from tiltcal.core.rounding import outwards, plus_minus, round_to, significant
from tiltcal.core.samples import SampleSummary
from tiltcal.core.thermal_lag import LOG_SMOOTHING, ThermalLag
from tiltcal.core.uncertain import TURN, Uncertain, selection
from tiltcal.errors import Argument, EstimateError
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.procedure import Positions, Ramp
from tiltcal.files.results import CrossValidation, Hysteresis, RampFitRecord, RampLeg

ROOM = 25.0  # reference temperature where none was measured, °C


def calibrate_sweep(
    sensors: Sequence[MeasuredSensor], procedure: Positions, bench: BenchUncertainty
) -> list[CalibrationRecord]:
    """Calibrate sensors by positions at many temperatures, with one order of the drift that the readings warrant."""
    errors = order_errors(sensors, procedure, bench)
    order, highest = min(errors, key=lambda order: errors[order][1]), max(errors)
    calibrations = fit_jointly(sensors, with_order(procedure, order), bench)
    if highest > order:
        widest = fit_jointly(sensors, with_order(procedure, highest), bench)
        calibrations = [_with_open_order(record, wider) for record, wider in zip(calibrations, widest, strict=True)]
    validation = _validation(order, {tried: error for tried, (error, _) in errors.items()})
    judged = []
    for record, sensor in zip(calibrations, sensors, strict=True):
        loops = _hysteresis(record, sensor.measurements)
        judged.append(replace(record, fit=record.fit.replaced(cross_validation=validation, hysteresis=loops)))
    return judged


def _validation(order: int, errors: Mapping[int, float]) -> CrossValidation:
    return CrossValidation(order=order, error_by_order={str(n): significant(error, 4) for n, error in errors.items()})


def order_errors(
    sensors: Sequence[MeasuredSensor], procedure: Positions, bench: BenchUncertainty
) -> dict[int, tuple[float, float]]:
    """Return by order how well it predicts left-out positions: their mean square error over its variance, and deviance.

    The deviance is minus twice the logarithm of the normal density of what was left out, about its prediction, with the
    variances of both. Where the errors are larger than these, all variances of an order are multiplied by one factor
    that fits. A plain mean of squared errors would refuse a curve because its ends, once left out, are extrapolated.

    Source: A. Gelman, J. Hwang and A. Vehtari, *Understanding predictive information criteria for Bayesian models*,
    Statistics and Computing 24 (2014) 997.
    """
    errors: dict[int, tuple[float, float]] = {}
    for order in range(1, procedure.drift + 1):
        try:
            error, variance = _left_out(sensors, with_order(procedure, order), bench)
        except EstimateError:
            break
        mean = float(np.mean(error**2 / variance))
        factor = max(mean, 1.0)
        errors[order] = mean, float(len(variance) * (np.log(factor) + mean / factor) + np.sum(np.log(variance)))
    if not errors:
        raise EstimateError("the sweep has too few temperatures to leave one out: add some between and beyond them")
    return errors


def with_order(procedure: Positions, order: int) -> Positions:
    """Return the procedure with one order of the drift."""
    return replace(procedure, drift=order, cross_validated=False)


def _with_open_order(calibration: CalibrationRecord, highest: CalibrationRecord) -> CalibrationRecord:
    """Return a calibration with drift terms of 0 up to the order of ``highest``, and the uncertainty of that order."""
    own = dict.fromkeys(values(highest.coefficients), 0.0) | values(calibration.coefficients)
    return replace(
        calibration,
        coefficients=with_vector(highest.coefficients, list(own), np.array(list(own.values()))),
        uncertainty=highest.uncertainty,
        fit=calibration.fit.replaced(budget=highest.fit.budget),
    )


def _left_out(sensors: Sequence[MeasuredSensor], procedure: Positions, bench: BenchUncertainty) -> tuple[Array, Array]:
    """Return the error of predicting each position from the others, and the variance of that error, unit."""
    errors: list[Array] = []
    variances: list[Array] = []
    observed = [observed_sensor(sensor, procedure, bench).observations for sensor in sensors]
    for number in range(len(sensors[0].measurements)):
        rest = [replace(s, measurements=[*s.measurements[:number], *s.measurements[number + 1 :]]) for s in sensors]
        estimates = estimate_jointly([observed_sensor(sensor, procedure, bench) for sensor in rest])
        for observations, fitted in zip(observed, estimates, strict=True):
            seen = observations[number]
            predicted, variance = _prediction(fitted.coefficients, fitted.uncertain, seen.gravity, seen.temperature)
            noise = np.where(seen.u > 0.0, seen.u, fitted.estimated_noise or 1.0)
            errors.append(seen.mean - predicted)
            variances.append(noise**2 + variance)
    return np.concatenate(errors), np.concatenate(variances)


def _prediction(
    coefficients: Coefficients, uncertain: Uncertain, gravity: Array, temperature: float | None = None
) -> tuple[Array, Array]:
    """Return the readings that coefficients predict in a position, unit, and the variances of the prediction."""
    readings = coefficients.read(gravity[None], None if temperature is None else np.array([temperature]))
    slopes = np.stack(
        [
            selection(uncertain.names, model.coefficients) @ reading.by_coefficient[0]
            for model, reading in zip(coefficients.models, readings, strict=True)
        ]
    )
    variances = np.einsum("ik,kl,il->i", slopes, uncertain.covariance, slopes)
    return np.concatenate([reading.value for reading in readings]), variances


def _hysteresis(calibration: CalibrationRecord, measurements: Sequence[Measurement]) -> dict[str, Hysteresis]:
    """Return the largest difference of residuals at one temperature that was met twice, per channel, unit."""
    residuals, names = calibration.fit.residuals, [measurement.position for measurement in measurements]
    pairs = [(names[i], names[j]) for i, j in met_twice(measurements)]
    loops = {}
    for channel in calibration.coefficients.channels:
        differences = {pair: residuals[pair[1]][channel] - residuals[pair[0]][channel] for pair in pairs}
        if differences:
            pair = max(differences, key=lambda pair: abs(differences[pair]))
            loops[channel] = Hysteresis(difference=significant(differences[pair], 4), between=pair)
    return loops


def with_typical_temperature(calibration: CalibrationRecord, sensor: MeasuredSensor) -> CalibrationRecord:
    """Add the mean temperature curves of a sensor's model to its calibration, and record that they are assumed."""
    population = None if sensor.nominal is None else sensor.nominal.population
    if population is None:
        raise EstimateError(f"no source states how a {calibration.sensor.model} behaves over temperature: measure it")
    coefficients = calibration.coefficients
    met = [m.temperature for m in sensor.measurements if m.temperature is not None]
    reference = round(float(np.mean(met)), 3) if met else ROOM
    # The curves are polynomials in T; the file's count from the reference, and a gain from the sensitivity there.
    drift, gain = (
        np.asarray(Polynomial(curve)(Polynomial([reference, 1.0])).coef, dtype=float)
        for curve in (population.drift, population.gain)
    )
    drift, gain = drift[1:], gain[1:] / (1.0 + gain[0])
    channels = coefficients.channels
    thermal = Thermal(
        reference=reference,
        range=None,
        drift=np.tile([round_to(k, population.drift_spread / 1000) for k in drift], (len(channels), 1)),
        gain=np.tile([significant(k, 8) for k in gain], (len(channels), 1)),
    )
    curves = (("offset", population.drift_spread, drift), ("sensitivity", population.gain_spread, gain))
    typical = {
        f"temperature.{name}.{channel}.{power}": significant(spread, 4) if power == 1 else 0.0
        for name, spread, curve in curves
        for channel in channels
        for power in range(1, len(curve) + 1)
    }
    derived, u = calibration.derived, calibration.uncertainty
    spread = Uncertain.errors(tuple(typical), np.diag(np.array(list(typical.values())) ** 2))
    both = calibration.uncertain.beside(spread)
    assumed = (*derived.assumed, f"temperature: {population.source}, not this unit's own")
    return replace(
        calibration,
        coefficients=replace(coefficients, thermal=thermal),
        uncertainty=replace(u, standard={**u.standard, **typical}, covariance=rounded_covariance(both)),
        derived=derived.replaced(assumed=assumed),
    )


GROUPS = 8  # parts of a leg that the file lists as positions
FAR, DEVIATIONS = 2.0, 5.0  # refuse an attitude that the base reads so far off, degrees and standard uncertainties
USUAL_GAIN = 2e-4  # standard uncertainty of the sensitivity's temperature coefficient where nothing states it, 1/°C


def calibrate_ramp(sensor: MeasuredSensor, procedure: Ramp, bench: BenchUncertainty) -> CalibrationRecord:
    """Calibrate the drift of a sensor from its ramp; its first measurement states the attitude."""
    if sensor.ramp is None:
        raise EstimateError(f"{procedure.name} takes a continuous record, and there is none of {sensor.sensor.serial}")
    record, attitude = sensor.ramp, sensor.measurements[0]
    low, high = _range(record.temperature)
    reference = procedure.reference if low <= procedure.reference <= high else round((low + high) / 2.0, 1)
    renews = sensor.base is None or sensor.attitude_stated or bench.jig is not None
    of_base = None if sensor.base is None else sensor.base.temperature
    at = of_base if of_base is not None and low <= of_base <= high else reference  # where the base is compared
    if not renews:
        reference = at
    design = design_of(sensor.sensor, procedure, bench, nominal=sensor.nominal, base=sensor.base)
    _require_sound(record, design.channels)
    fit = fit_ramp(record, reference=reference, highest=procedure.drift)
    # The turns of the temperature are not reached by an element that follows them. The inverse filter amplifies the
    # thermometer's noise, which the means average.
    element = fit.means.temperature(fit.lag) + reference
    element = ThermalLag(fit.lag)(record.time, record.temperature) if fit.lag >= 0.0 else element
    limits = _range(element, record.step or sqrt(12.0) * sensor.thermometer_rounding)
    design = replace(design, drift=fit.order, reference=reference)
    known, notes = None, [record.jumps] if record.jumps else []
    if sensor.base is not None:
        seen = fit.coefficients @ (at - reference) ** np.arange(fit.order + 1)
        if renews:
            _require_attitude(sensor.base, seen, attitude, hypot(bench.jig or 0.0, bench.table_lean or 0.0))
        else:
            known, attitude = sensor.base, _as_base_reads(sensor.base, seen, attitude)
            up = ", ".join(f"{component:.3f}" for component in attitude.gravity)
            notes.append(
                f"no attitude is stated (--segments, --jig): the base keeps its offset, by which up was ({up}) g"
            )
    groups = _groups(fit, record, attitude)
    estimate = _estimate(fit, design, groups, _gain_of(sensor, reference), known)
    estimate = replace(estimate, notes=(*estimate.notes, *notes))
    made = record_of(estimate, design, replace(sensor, measurements=groups), procedure, limits)
    standard, reading = made.uncertainty.standard, made.uncertainty.single_reading
    if fit.uses_lag:
        standard = {**standard, "temperature.lag": significant(fit.u_lag, 4)}
    if u_temperature := _reading_uncertainty(fit, record, bench.thermometer, sensor.thermometer_rounding):
        reading = {**reading, "temperature": significant(u_temperature, 4)}
    assumed = made.derived.assumed if known is None else (*made.derived.assumed, f"offset: {OF_BASE}")
    return replace(
        made,
        derived=made.derived.replaced(assumed=assumed),
        uncertainty=replace(made.uncertainty, standard=standard, single_reading=reading),
        fit=made.fit.replaced(
            cross_validation=_validation(fit.order, fit.error_by_order),
            hysteresis=_largest_loops(fit, design.channels),
            ramp=_ramp_record(fit, design.channels),
        ),
    )


def _require_sound(record: RampRecord, channels: Sequence[str]) -> None:
    """Refuse temperatures that are none in °C, and a channel that is stuck."""
    low, high = _range(record.temperature)
    if low < TEMPERATURES[0] or high > TEMPERATURES[1]:
        raise EstimateError(
            f"the temperature goes from {low:g} to {high:g}, and not within {TEMPERATURES[0]:g} to {TEMPERATURES[1]:g} "
            "°C: convert counts or kelvin to °C first"
        )
    for channel, noise, value in zip(channels, record.noise, record.readings[0], strict=True):
        if noise == 0.0:
            raise EstimateError(
                f"{channel} reads {value:g} in all {record.rows} rows: it is stuck, not without drift; is it connected?"
            )


def _reading_uncertainty(fit: RampFit, record: RampRecord, stated: float | None, own: float) -> float:
    """Return the standard uncertainty of a temperature in a log, °C, with those that are stated or of the step."""
    # The inverse filter amplifies what is random in it.
    random = (not stated and own) or record.step / sqrt(12.0)
    if fit.lag < 0.0:
        noise = row_noise(record.temperature) * sqrt(record.rows / len(record.time))
        random = max(random, noise) * (1.0 + 1.0 / LOG_SMOOTHING)
    pace = max(leg.pace for leg in fit.means.legs) / 60.0
    return hypot(stated or 0.0, random, fit.u_lag * pace if fit.uses_lag else 0.0, fit.u_element)


def _require_attitude(base: CalibrationRecord, reading: Array, attitude: Measurement, jig: float) -> None:
    """Refuse readings, (channels,), in a stated attitude where the base reads another one."""
    own = replace(base.coefficients, mounting=None, thermal=None)
    known = base.uncertain.named([name for name in base.uncertain.names if name in values(own)])
    expected, variance = _prediction(own, known, np.array(attitude.gravity))
    size = np.linalg.norm(own.sensitivity, axis=1)
    off, u = np.degrees(np.abs(reading - expected) / size), np.hypot(np.degrees(np.sqrt(variance) / size), jig)
    for channel, angle, limit in zip(own.channels, off.tolist(), np.maximum(FAR, DEVIATIONS * u), strict=True):
        if angle > limit:
            raise EstimateError(
                f"{channel} reads {angle:.2g}° away from what the base calibration expects in the attitude that is "
                "stated",
                advice=("state the true one with ", Argument("segments"), " (position,start,end,gx,gy,gz)"),
            )


def _as_base_reads(base: CalibrationRecord, reading: Array, attitude: Measurement) -> Measurement:
    """Return the attitude in which the base reads what was read, (channels,)."""
    compensation = Compensation(replace(base.coefficients, mounting=None, thermal=None))
    out = Compensated.empty(1, len(compensation.axes))
    (chunk,) = compensation.chunks(reading[None], None, out)
    x, y, z = normalised(compensation.up(chunk)[:, 0].tolist())
    return replace(attitude, gravity=(x, y, z), tilt=None)


def _gain_of(sensor: MeasuredSensor, reference: float) -> Array | float:
    """Return the size of the temperature coefficient of the sensitivity, which a ramp does not show, 1/°C."""
    population = None if sensor.nominal is None else sensor.nominal.population
    if population is not None:
        mean = Polynomial(population.gain)
        return hypot(float(mean.deriv()(reference) / (1.0 + mean(reference))), population.gain_spread)
    thermal = None if sensor.base is None else sensor.base.coefficients.thermal
    if sensor.base is None or thermal is None or not thermal.gain.any():
        return USUAL_GAIN
    names = [f"temperature.sensitivity.{channel}.1" for channel in sensor.base.coefficients.channels]
    return np.hypot(thermal.gain[:, 0], [sensor.base.uncertainty.get(name, 0.0) for name in names])


def _range(temperatures: Array, step: float = 0.0) -> tuple[float, float]:
    return outwards(float(temperatures.min()), float(temperatures.max()), TEMPERATURE_DIGITS, step)


def _estimate(
    fit: RampFit, design: Design, groups: Sequence[Measurement], gain: Array | float, known: CalibrationRecord | None
) -> Estimate:
    """Return the coefficients that the record shows, and those that stand in, with their covariance.

    ``known`` is the base whose offset stays; ``gain`` the size of the sensitivity's temperature coefficient, 1/°C.
    """
    channels, up = design.channels, np.array(groups[0].gravity)
    coefficients = Coefficients(
        channels,
        design.axes,
        np.zeros(len(channels)),
        np.array([[channel == axis for axis in design.axes] for channel in channels], dtype=float),
        Thermal(
            design.reference,
            None,
            fit.coefficients[:, 1:].copy(),
            np.zeros((len(channels), 0)),
            round_to(fit.lag, fit.u_lag) if fit.uses_lag else 0.0,
        ),
        nonlinearity=np.zeros((len(channels), design.nonlinearity)) if design.nonlinearity else None,
        angles=design.angles,
    )
    stands_in = {name: prior.value for name, prior in design.priors.items()}
    coefficients = with_vector(coefficients, list(stands_in), np.array(list(stands_in.values())))
    offset = fit.coefficients[:, 0] - coefficients.predict(up[None, :]).ravel()
    coefficients = replace(coefficients, offset=offset if known is None else known.coefficients.offset)
    by_model = fit.means.powers(fit.lag, fit.order) @ fit.coefficients.T
    modelled = np.array([by_model[part].mean(axis=0) for _, part in _parts(fit)])
    return Estimate(
        coefficients=coefficients,
        uncertain=reduce(add, _sources(fit, design, coefficients, up, gain, known)),
        positions=tuple(group.position for group in groups),
        residuals=np.array([[group.summaries[c].mean for c in channels] for group in groups]) - modelled,
        dof=max(len(fit.means.leg) - fit.order - 1, 0) * len(channels),
        chi_square=None,
        p=None,
        stated=False,
        notes=_notes(fit),
    )


def _sources(
    fit: RampFit, design: Design, found: Coefficients, up: Array, gain: Array | float, known: CalibrationRecord | None
) -> Iterator[Uncertain]:
    """Yield what each source adds to the uncertainty of the coefficients: the record, and what is stated."""
    names = [name for model in found.models for name in model.coefficients]
    column = dict(zip(names, np.eye(len(names)), strict=True))
    offsets = np.stack([column[f"offset.{channel}"] for channel in design.channels], axis=1)
    terms = ("offset.{}", *(f"temperature.offset.{{}}.{power}" for power in range(1, fit.order + 1)))
    by_record = np.stack([column[term.format(channel)] for channel in design.channels for term in terms], axis=1)

    if known is not None:  # the record shows the drift alone
        by_record[offsets.any(axis=1)] = 0.0

    def errors(source: str, by: Array, covariance: Array) -> Uncertain:
        return Uncertain.errors([""] * len(covariance), covariance, source=source).through(by, names)

    yield errors(NOISE, by_record, fit.covariance)
    if fit.loop_covariance.any():
        yield errors(HYSTERESIS, by_record, fit.loop_covariance)
    readings = found.read(up[None, :])
    slope = np.stack([column[f"temperature.offset.{channel}.1"] for channel in design.channels], axis=1)
    signal = found.predict(up[None, :]).ravel() - found.offset
    yield errors(PRIOR, slope, np.diag((gain * signal) ** 2))
    if known is not None:
        base = known.uncertain.without("temperature.", TURN)
        yield base.through(selection(names, base.names), names, source=BASE)
        return
    # An offset follows a sensitivity that stands in: the reading is what it was.
    followed = {
        name: column[name] - derivative * offset
        for model, reading, offset in zip(found.models, readings, offsets.T, strict=True)
        for name, derivative in zip(model.coefficients, reading.by_coefficient[0].tolist(), strict=True)
    }
    known_to = {name: prior.u for name, prior in design.priors.items() if 0.0 < prior.u < inf}
    stands_in = [known_to[name] * by for name, by in followed.items() if name in known_to]
    if stands_in:
        yield errors(PRIOR, np.stack(stands_in, axis=1), np.eye(len(stands_in)))
    for _, together in design.stated:
        yield errors(PRIOR, np.stack([followed[name] for name in together.names], axis=1), together.covariance)
    across = np.array([np.cross(up, reading.by_gravity[0]) for reading in readings])
    for source, u in ((JIG, design.jig), (TABLE, design.table_lean)):
        if u:
            yield errors(source, offsets @ across, radians(u) ** 2 * np.eye(3))
    if design.thermometer:
        slopes = np.pad(fit.coefficients[:, 1:] * np.arange(1, fit.order + 1), ((0, 0), (0, 1)))
        yield errors(THERMOMETER, by_record @ slopes.reshape(-1, 1), np.eye(1) * design.thermometer**2)


def _parts(fit: RampFit) -> Iterator[tuple[str, NDArray[np.intp]]]:
    """Yield the name and the means of each part of a leg that counts as a position."""
    for number, leg in enumerate(fit.means.legs, start=1):
        rows = np.flatnonzero(fit.means.leg == number - 1)
        for k, part in enumerate(np.array_split(rows, min(GROUPS, len(rows))), start=1):
            yield f"{leg.way}-{number}-{k}", part


def _groups(fit: RampFit, record: RampRecord, attitude: Measurement) -> list[Measurement]:
    """Return parts of the legs as positions: what they read, and at which temperature of the thermometer."""
    means, groups = fit.means, []
    temperatures = means.temperature(0.0) + means.reference
    for name, part in _parts(fit):
        n = round(record.rows / len(means.leg) * len(part))
        summaries = {
            channel: SampleSummary(float(values.mean()), float(noise), n, float(noise) / sqrt(n))
            for channel, values, noise in zip(attitude.summaries, means.readings[part].T, record.noise, strict=True)
        }
        temperature = float(temperatures[part].mean())
        groups.append(replace(attitude, position=name, temperature=temperature, summaries=summaries, noted={}))
    return groups


def _largest_loops(fit: RampFit, channels: Sequence[str]) -> dict[str, Hysteresis]:
    """Return the largest loop that is left, per channel."""
    largest = {}
    for channel, loop in zip(channels, fit.loops.T, strict=True):
        k = int(np.argmax(np.abs(loop)))
        at = f"at {fit.places[k] + fit.means.reference:.1f} °C"
        largest[channel] = Hysteresis(difference=significant(float(loop[k]), 4), between=(f"down {at}", f"up {at}"))
    return largest


def _ramp_record(fit: RampFit, channels: Sequence[str]) -> RampFitRecord:
    def by_channel(values: Array) -> dict[str, float]:
        return {channel: significant(value, 3) for channel, value in zip(channels, values.tolist(), strict=True)}

    legs = [
        RampLeg(
            way=leg.way,
            temperature=(round(leg.low, 2), round(leg.high, 2)),
            seconds=round(leg.seconds, 1),
            pace=significant(leg.pace, 3),
            polynomial=by_channel(polynomial),
            lagged=by_channel(lagged),
        )
        for leg, polynomial, lagged in zip(fit.means.legs, fit.polynomial, fit.lagged, strict=True)
    ]
    return RampFitRecord(
        lag=round_to(fit.found_lag, fit.u_lag),
        u_lag=significant(fit.u_lag, 4),
        used=fit.uses_lag,
        explained_percent=by_channel(100.0 * fit.explained),
        legs=tuple(legs),
    )


def _notes(fit: RampFit) -> tuple[str, ...]:
    why = "not used: the legs do not confirm it, or hysteresis explains the record as well"
    if fit.uses_lag:
        why = "used: it makes the residuals of every leg smaller when it is fitted to the other legs"
    note = f"a thermal lag of {plus_minus(fit.found_lag, fit.u_lag)} s is {why}"
    differ = "the ways up and down differ: the intervals of the drift hold the readings of both"
    return (note, differ) if fit.loop_covariance.any() else (note,)

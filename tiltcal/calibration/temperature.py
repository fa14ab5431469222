"""The temperature terms of a calibration: their order, the hysteresis that is left, and typical curves.

A polynomial of too high an order follows the noise; one of too low an order leaves the curve. Each order is judged by
how well it predicts a position that was left out, with the uncertainty of that prediction. Terms of a higher order are
0 then, with the uncertainty of the highest order that was tried: what the readings do not show may still be there.

Where a unit has no temperature run of its own, the mean curves of its model are a starting point: one part differs from
the mean, and the file states by how much. A unit's own run always wins.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.polynomial import Polynomial

from tiltcal.calibration.joint_fit import fit_jointly, observed_sensor
from tiltcal.calibration.measurement import BenchUncertainty, MeasuredSensor, Measurement
from tiltcal.calibration.stated import rounded_covariance, uncertain_coefficients
from tiltcal.core.estimation.estimate import ALIKE, Estimate, estimate_jointly
from tiltcal.core.estimation.positions import Observation
from tiltcal.core.model import Array, Thermal, vector_of, with_vector
from tiltcal.core.rounding import round_to, significant
from tiltcal.core.uncertain import Uncertain, central_differences
from tiltcal.errors import EstimateError
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.procedure import Procedure
from tiltcal.files.results import CrossValidation, Hysteresis

ROOM = 25.0  # reference temperature where none was measured, °C


def calibrate_sweep(
    sensors: Sequence[MeasuredSensor], procedure: Procedure, bench: BenchUncertainty
) -> list[CalibrationRecord]:
    """Calibrate sensors by positions at many temperatures, with one order of the drift that the readings warrant."""
    errors = order_errors(sensors, procedure, bench)
    order, highest = min(errors, key=lambda order: errors[order][1]), max(errors)
    calibrations = fit_jointly(sensors, with_order(procedure, order), bench)
    if highest > order:
        widest = fit_jointly(sensors, with_order(procedure, highest), bench)
        calibrations = [_with_open_order(record, wider) for record, wider in zip(calibrations, widest, strict=True)]
    by_order = {str(tried): significant(error, 4) for tried, (error, _) in errors.items()}
    validation = CrossValidation(order=order, error_by_order=by_order)
    return [
        replace(
            record,
            fit=record.fit.replaced(cross_validation=validation, hysteresis=_hysteresis(record, sensor.measurements)),
        )
        for record, sensor in zip(calibrations, sensors, strict=True)
    ]


def order_errors(
    sensors: Sequence[MeasuredSensor], procedure: Procedure, bench: BenchUncertainty
) -> dict[int, tuple[float, float]]:
    """Return by order how well it predicts left-out positions: their mean square error over its variance, and deviance.

    Notes
    -----
    The lowest deviance is that of the highest predictive density: minus twice the logarithm of the normal density of
    what was left out, about its prediction, with the variances of both. Where the errors are larger than these, all
    variances of an order are multiplied by one factor that fits. A plain mean of squared errors would refuse the order
    of a curve because its ends, once left out, are extrapolated.

    Source: A. Gelman, J. Hwang and A. Vehtari, *Understanding predictive information criteria for Bayesian models*,
    Statistics and Computing 24 (2014) 997.
    """
    errors: dict[int, tuple[float, float]] = {}
    for order in range(1, procedure.determines.drift + 1):
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


def with_order(procedure: Procedure, order: int) -> Procedure:
    """Return the procedure with one order of the drift."""
    return procedure.replaced(determines=procedure.determines.replaced(drift=order, cross_validated=False))


def _with_open_order(calibration: CalibrationRecord, highest: CalibrationRecord) -> CalibrationRecord:
    """Return a calibration with drift terms of 0 up to the order of ``highest``, and the uncertainty of that order."""
    thermal, wider = calibration.coefficients.thermal, highest.coefficients.thermal
    if thermal is None or wider is None or thermal.drift.shape == wider.drift.shape:
        return calibration
    drift = np.zeros_like(wider.drift)
    drift[:, : thermal.drift.shape[1]] = thermal.drift
    return replace(
        calibration,
        coefficients=replace(calibration.coefficients, thermal=replace(thermal, drift=drift)),
        uncertainty=highest.uncertainty,
        fit=calibration.fit.replaced(budget=highest.fit.budget),
    )


def _left_out(sensors: Sequence[MeasuredSensor], procedure: Procedure, bench: BenchUncertainty) -> tuple[Array, Array]:
    """Return the error of predicting each position from the others, and the variance of that error, unit."""
    errors: list[Array] = []
    variances: list[Array] = []
    observed = [observed_sensor(sensor, procedure, bench).observations for sensor in sensors]
    for number in range(len(sensors[0].measurements)):
        rest = [replace(s, measurements=[*s.measurements[:number], *s.measurements[number + 1 :]]) for s in sensors]
        estimates = estimate_jointly([observed_sensor(sensor, procedure, bench) for sensor in rest])
        for observations, fitted in zip(observed, estimates, strict=True):
            seen = observations[number]
            predicted, variance = _prediction(fitted, seen)
            noise = np.where(seen.u > 0.0, seen.u, fitted.estimated_noise or 1.0)
            errors.append(seen.mean - predicted)
            variances.append(noise**2 + variance)
    return np.concatenate(errors), np.concatenate(variances)


def _prediction(fitted: Estimate, position: Observation) -> tuple[Array, Array]:
    """Return the readings that an estimate predicts in a position, unit, and the variances of the prediction."""
    names, u = fitted.uncertain.names, fitted.uncertain.u
    gravity, temperature = position.gravity[None], np.array([position.temperature], dtype=float)

    def predicted(vector: Array) -> Array:
        return np.asarray(with_vector(fitted.coefficients, names, vector).predict(gravity, temperature)[0])

    at = vector_of(fitted.coefficients, names)
    slopes = central_differences(predicted, at, u)
    return predicted(at), np.einsum("ik,kl,il->i", slopes, fitted.uncertain.covariance, slopes)


def _hysteresis(calibration: CalibrationRecord, measurements: Sequence[Measurement]) -> dict[str, Hysteresis]:
    """Return the largest difference of residuals at one temperature that was met twice, per channel, unit."""
    residuals = calibration.fit.residuals
    met = [measurement for measurement in measurements if measurement.temperature is not None]
    met_twice = [
        (one.position, other.position)
        for one, other in combinations(met, 2)
        if one.gravity == other.gravity and abs((one.temperature or 0.0) - (other.temperature or 0.0)) <= ALIKE
    ]
    loops = {}
    for channel in calibration.coefficients.channels:
        differences = {pair: residuals[pair[1]][channel] - residuals[pair[0]][channel] for pair in met_twice}
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
    if coefficients.thermal is not None:
        raise EstimateError("the unit's own temperature run is in this calibration: leave --typical-temperature out")
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
    both = uncertain_coefficients(u, coefficients).beside(spread)
    assumed = (*derived.assumed, f"temperature: {population.source}, not this unit's own")
    return replace(
        calibration,
        coefficients=replace(coefficients, thermal=thermal),
        uncertainty=replace(u, standard={**u.standard, **typical}, covariance=rounded_covariance(both)),
        derived=derived.replaced(assumed=assumed),
    )

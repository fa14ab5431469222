"""The drift and the lag of a ramp, on records that the differential equation makes."""

from math import sqrt

import numpy as np
import pytest
from numpy.polynomial.polynomial import polyfit, polyval
from scipy.integrate import solve_ivp

from tiltcal.core.ramp.fit import fit_ramp
from tiltcal.core.ramp.record import ramp_record
from tiltcal.core.thermal_lag import ThermalLag
from tiltcal.errors import EstimateError

REFERENCE = 24.0
CURVES = np.array([[1000.0, 0.8, 0.010, -1e-4], [1000.0, -0.5, 0.004, 1e-4]])
"""unit, unit/°C, ..."""

LOW, SPAN = 5.0, 40.0
PLACES = np.linspace(LOW + 2.0, LOW + SPAN - 2.0, 10)


def chamber(seconds, pace):
    """From 5 to 45 °C and back, at a pace in °C/min."""
    return LOW + SPAN * np.abs((seconds / (SPAN / pace * 60.0) + 1.0) % 2.0 - 1.0)


def delayed(seconds, pace, lag):
    def slope(t, e):
        return (chamber(t, pace) - e) / lag

    return solve_ivp(slope, (0.0, seconds[-1]), [LOW], t_eval=seconds, max_step=lag / 2.0, rtol=1e-7).y[0]


def read(element):
    return np.stack([polyval(element - REFERENCE, curve) for curve in CURVES], axis=1)


def fitted(seconds, thermometer, readings):
    return fit_ramp(ramp_record(seconds, thermometer, readings.T), reference=REFERENCE, highest=3)


def made(pace, *, lag=0.0, legs=4, noise=1.0, seed=1, wander=0.0, rows=2400):
    """A record of a row every two seconds or more."""
    draw = np.random.default_rng(seed)
    seconds = np.linspace(0.0, legs * SPAN / pace * 60.0, rows)
    element = thermometer = chamber(seconds, pace)
    if lag > 0.0:
        element = delayed(seconds, pace, lag)
    elif lag < 0.0:
        thermometer = delayed(seconds, pace, -lag)
    readings = read(element) + noise * draw.normal(size=(len(seconds), 2))
    readings += wander * np.cumsum(draw.normal(size=readings.shape), axis=0)
    return ramp_record(seconds, thermometer, readings.T)


def curve_error(coefficients):
    """How far the curves are off, shape (channels, places), unit."""
    powers = [np.vander(PLACES - REFERENCE, n, increasing=True) for n in (coefficients.shape[1], 4)]
    return (powers[0] @ coefficients.T - powers[1] @ CURVES.T).T


def u_of_curve(fit):
    """The standard uncertainty of the curves, shape (channels, places), unit."""
    p, total = fit.order + 1, fit.covariance + fit.loop_covariance
    powers = np.vander(PLACES - REFERENCE, p, increasing=True)
    blocks = [total[start : start + p, start : start + p] for start in (0, p)]
    return np.sqrt([np.einsum("ij,jk,ik->i", powers, block, powers) for block in blocks])


def test_what_a_fit_says_of_legs_orders_and_loops_is_numpys():
    record = made(1.0, noise=0.3, rows=320)
    fit = fit_ramp(record, reference=REFERENCE, highest=3)
    means, draws = fit.means, fit.means.readings
    dt, up = chamber(means.time, 1.0) - REFERENCE, np.isin(means.leg, (0, 2))
    left_out = {
        order: np.array(
            [
                np.mean((draws[own] - polyval(dt[own], polyfit(dt[~own], draws[~own], order)).T) ** 2, axis=0)
                for own in (means.leg == number for number in range(4))
            ]
        )
        for order in (1, 2, 3)
    }
    scale = np.std(draws - polyval(dt, polyfit(dt, draws, 3)).T, axis=0)
    errors = {order: np.mean(left_out[order] / scale**2) for order in left_out}
    assert fit.error_by_order == pytest.approx(errors, rel=0.01)
    assert fit.order == min(errors, key=errors.get) == 3
    np.testing.assert_allclose(fit.polynomial, np.sqrt(left_out[3]), rtol=0.01)
    assert (fit.lag, fit.u_element, means.shift) == (0.0, 0.0, 0.0)
    assert np.abs(fit.found_lag) < 3.0 * fit.u_lag
    assert not fit.loop_covariance.any()
    low, high = max(dt[up].min(), dt[~up].min()), min(dt[up].max(), dt[~up].max())
    np.testing.assert_allclose(fit.places, np.linspace(low, high, 17)[1::2], rtol=1e-9)
    design = np.hstack([np.vander(dt, 4), np.where(up, 1.0, -1.0)[:, None] * np.vander(dt, 3)])
    half = np.linalg.lstsq(design, draws, rcond=None)[0][4:]
    np.testing.assert_allclose(fit.loops, 2.0 * np.vander(fit.places, 3) @ half, atol=1e-4)
    np.testing.assert_allclose(means.white, record.noise / np.sqrt(320 / len(dt)))
    between = np.mean(np.diff(read(chamber(record.time, 1.0)), axis=0) ** 2, axis=0)
    np.testing.assert_allclose(record.noise, np.sqrt(0.3**2 + between / 2.0), rtol=0.05)


def test_the_noise_is_the_mean_over_what_the_restricted_likelihood_allows():
    """Patterson and Thompson (1971), dense: white noise, and some that lasts 1/64 to 1.2 of the record."""
    means = fit_ramp(made(1.0, noise=0.3, wander=0.05, rows=96), reference=REFERENCE, highest=3).means
    x, span = means.powers(0.0, 2), means.time[-1] - means.time[0]
    at, d = x[3:20, 1], x[4, 1] - x[3, 1]  # each is the mean over a steady change by d
    for k, power in enumerate(means.powers(0.0, 3)[3:20].T, start=1):
        assert power == pytest.approx(((at + d / 2.0) ** k - (at - d / 2.0) ** k) / (k * d))
    (n, p), apart = x.shape, np.abs(np.subtract.outer(means.time, means.time)) / span
    for y in means.readings.T:
        left = y - x @ np.linalg.lstsq(x, y, rcond=None)[0]
        second = [left[2 * k :] - 2.0 * left[k:-k] + left[: -2 * k] for k in (1, 2, 4, 8)]
        least, found = min(max(np.mean(d**2) / 6.0 for d in second), left @ left / (n - p)), []
        for lasts in np.geomspace(1 / 64, 1.2, 8):
            for k, ratio in enumerate([0.0, *np.geomspace(1e-2, 1e5, 22)]):
                slow = ratio * np.exp(-apart / lasts)
                inverse = np.linalg.inv(np.eye(n) + slow)
                off = y - x @ np.linalg.solve(x.T @ inverse @ x, x.T @ inverse @ y)
                square = off @ inverse @ off
                variance = max(square / (n - p), least)
                sizes = np.linalg.slogdet(x.T @ inverse @ x)[1] - np.linalg.slogdet(inverse)[1]
                twice = (n - p) * np.log(variance) + square / variance + sizes
                found.append((np.log(0.5 / 22 if k else 0.5) - twice / 2.0, variance * (np.eye(n) + 1.2 * slow)))
        chances = np.exp([one[0] - max(found, key=lambda each: each[0])[0] for one in found])
        expected = np.einsum("k,kij->ij", chances / chances.sum(), [one[1] for one in found])
        np.testing.assert_allclose(means.noise_covariance(x, y), expected, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(("rows", "seed"), [(600, 0), (600, 2), (240, 3)])
def test_legs_that_no_loop_explains_are_a_drift_of_the_zero(rows, seed):
    """Half of a rectangle as wide as the legs are apart, where that is three times what white noise gives."""
    fit = fit_ramp(made(1.0, noise=0.05, wander=0.02, rows=rows, seed=seed), reference=REFERENCE, highest=3)
    x, at = np.vander(fit.means.temperature(0.0), 3), np.vander(fit.places, 3)
    design = np.hstack([x, fit.means.rising[:, None] * x])
    half = np.linalg.inv(design.T @ design)[3:, 3:]
    white = np.outer(2.0 * np.sqrt(np.einsum("ki,ij,kj->k", at, half, at)), fit.means.white)
    apart = np.max(np.where(np.abs(fit.loops) > 3.0 * white, np.abs(fit.loops), 0.0), axis=0)
    assert apart.any() == (rows == 600)
    added, width = np.zeros((2, fit.order + 1)), (fit.places[7] - fit.places[0]) * 8.0 / 7.0
    added[:, 0], added[:, 1] = apart**2 / 3.0, (2.0 * apart / width) ** 2 / 3.0
    np.testing.assert_allclose(fit.loop_covariance, np.diag(added.ravel()), rtol=1e-6)


@pytest.mark.parametrize("wide", [lambda t: np.ones_like(t), lambda t: (t - LOW) * (LOW + SPAN - t) / 400.0])
def test_hysteresis_without_time_is_no_lag_and_its_loop_is_in_the_uncertainty(wide):
    """A play of 2 °C makes at one pace the loop of a lag of 60 s; Rayleigh's loop is as wide in the middle."""
    seconds = np.linspace(0.0, 4 * 2400.0, 2400)
    temperature = chamber(seconds, 1.0)
    element = temperature - wide(temperature) * np.where(seconds % 4800.0 < 2400.0, 1.0, -1.0)
    if wide(LOW) > 0.0:
        place = temperature[0]
        for k, value in enumerate(temperature):
            element[k] = place = min(max(place, value - 1.0), value + 1.0)
    fit = fitted(seconds, temperature, read(element) + 0.5 * np.random.default_rng(4).normal(size=(2400, 2)))
    assert not fit.uses_lag
    # The intervals hold the readings on the ways up and down, and are not much wider.
    way_up_less_down = read(PLACES - wide(PLACES)) - read(PLACES + wide(PLACES))
    error, reach, half = curve_error(fit.coefficients), 1.96 * u_of_curve(fit), way_up_less_down.T / 2.0
    assert np.max(np.abs(error)) < 0.1
    assert np.max(reach) < 1.3 * np.max(np.abs(half)) + 0.15
    assert np.mean(np.abs(np.stack([error - half, error + half])) < reach) > 0.8
    assert fit.loops.mean(axis=0) == pytest.approx(way_up_less_down.mean(axis=0), abs=0.15)


@pytest.mark.parametrize("lag", [0.0, 120.0])
def test_curve_and_lag_are_the_weighted_least_squares_of_numpy(lag):
    """Both channels share the lag, by which the model has a slope; the noise is that of each channel."""
    fit = fit_ramp(made(1.0, lag=lag, noise=0.3, rows=320), reference=REFERENCE, highest=3)
    means, p = fit.means, fit.order + 1
    assert (fit.uses_lag, fit.lag) == (lag > 0.0, pytest.approx(lag, rel=0.02))
    x, slopes = means.powers(fit.lag, fit.order), np.zeros_like(means.readings)
    if lag:
        ahead, behind = (means.powers(fit.lag + h, fit.order) for h in (1.0, -1.0))
        slopes = (ahead - behind) / 2.0 @ fit.coefficients.T
    columns, weights = np.zeros((2, len(x), 2 * p + 1)), []
    for c, (rows, slope, y) in enumerate(zip(columns, slopes.T, means.readings.T, strict=True)):
        rows[:, c * p : c * p + p], rows[:, -1] = x, slope
        own = np.column_stack([x, slope]) if lag else x
        weights.append(np.linalg.inv(means.noise_covariance(own, y)))
    used = slice(None) if lag else slice(-1)
    covariance = np.linalg.inv(sum(rows.T @ w @ rows for rows, w in zip(columns[..., used], weights, strict=True)))
    left = means.readings - x @ fit.coefficients.T
    step = covariance @ sum(r.T @ w @ y for r, w, y in zip(columns[..., used], weights, left.T, strict=True))
    u = np.sqrt(np.diag(covariance))
    assert np.abs(step / u).max() < 0.05
    np.testing.assert_allclose(np.sqrt(np.diag(fit.covariance)), u[: 2 * p], rtol=0.02)
    if lag:
        assert fit.u_lag == pytest.approx(u[-1], rel=0.02)


def test_the_uncertainty_covers_the_curve():
    """Of a zero that wanders; 160 rows take half the time of 2400, and each has the noise of a mean of 15."""
    inside = []
    for seed in range(5):
        record = made(1.0, wander=0.05 * sqrt(15.0), noise=1.0 / sqrt(15.0), seed=seed, rows=160)
        fit = fit_ramp(record, reference=REFERENCE, highest=3)
        assert not fit.uses_lag
        inside.append(np.abs(curve_error(fit.coefficients)) < 1.96 * u_of_curve(fit))
    # Ten curves, of ten places that depend on each other: 95 % within what so few curves can show.
    assert np.mean(inside) > 0.8


@pytest.mark.parametrize(
    ("seconds", "noise", "within"),
    [
        (np.arange(0.0, 7200.0, 11.0), 0.0, 0.002),
        (np.arange(0.0, 7200.0, 10.0), 0.03, 0.1),
        (np.add.outer(np.arange(0.0, 7200.0, 40.0), 0.001 * np.arange(10.0)).ravel(), 0.02, 0.05),
    ],
    ids=["rows far apart", "a noisy thermometer", "bursts of rows"],
)
def test_a_late_thermometer_leaves_the_curve_where_it_is(seconds, noise, within):
    """A slope from the rows before alone put curves off by 0.004, 0.2, 0.7 and 0.2 units."""
    draw = np.random.default_rng(8)
    late, readings = delayed(seconds, 1.0, 120.0), read(chamber(seconds, 1.0))
    thermometer = late + noise * draw.normal(size=len(seconds))
    fit = fitted(seconds, thermometer, readings + 0.005 * draw.normal(size=readings.shape))
    assert fit.lag == pytest.approx(-120.0, rel=0.02)
    error = np.abs(curve_error(fit.coefficients))
    assert np.max(error) < within
    if noise == 0.03:  # so few means that it is a fiftieth of their degrees, over √2
        assert len(fit.means.leg) == pytest.approx(0.02 * 3 * 38.5 / (sqrt(2.0) * noise), rel=0.1)
    assert np.sqrt(np.mean((error / u_of_curve(fit)) ** 2)) < 2.0
    if not noise:  # what the filter of a log makes of the turns is in the uncertainty of a temperature
        in_log = ThermalLag(fit.lag)(seconds, late) - chamber(seconds, 1.0)
        assert fit.u_element == pytest.approx(np.sqrt(np.mean(in_log**2)), rel=0.05)


def test_steps_of_the_thermometer_are_not_taken_for_drift_of_a_quiet_sensor():
    seconds, draw = np.arange(0.0, 9600.0, 4.0), np.random.default_rng(5)
    true = chamber(seconds, 0.5)
    readings = 3.0 * read(true) + 0.02 * draw.normal(size=(len(seconds), 2))
    for steps in (1.5, 4.0):
        fit = fitted(seconds, np.round(true / steps) * steps, readings)
        reach = 2.0 * (round((LOW + SPAN) / steps) - round(LOW / steps))  # steps on the way up and down
        assert fit.means.shift == pytest.approx(8.0 / reach * steps / sqrt(12.0), rel=0.06)
        error = np.abs(curve_error(fit.coefficients / 3.0))
        assert np.max(error) < 0.2
        assert np.mean(error <= 1.96 / 3.0 * u_of_curve(fit)) > 0.85


def test_a_second_lag_is_refused_with_the_pace_at_which_one_describes_the_record():
    """150 s behind 60 s. Records at 0.15 °C/min have no turn to see, those at 0.2 °C/min do."""

    def slopes(t, e):
        return [(chamber(t, 1.0) - e[0]) / 60.0, (e[0] - e[1]) / 150.0]

    seconds = np.linspace(0.0, 9600.0, 2400)
    _, element = solve_ivp(slopes, (0.0, seconds[-1]), [LOW, LOW], t_eval=seconds, max_step=30.0).y
    readings = read(element) + 0.1 * np.random.default_rng(5).normal(size=(2400, 2))
    with pytest.raises(EstimateError, match=r"residuals depend on temperature .* by a second one") as refusal:
        fitted(seconds, chamber(seconds, 1.0), readings)
    assert 0.1 < float(str(refusal.value).split("change the temperature at ")[1].split(" °C/min")[0]) < 0.3


def test_a_record_that_starts_on_the_way_is_refused():
    """The element is 2 °C behind its thermometer in the first row; one lag of 112 s took that up."""
    seconds = np.arange(0.0, 9600.0, 4.0)
    readings = read(delayed(seconds, 1.0, 120.0)) + 0.05 * np.random.default_rng(7).normal(size=(len(seconds), 2))
    late = seconds > 900.0
    with pytest.raises(EstimateError, match=r"not at rest at the start: begin at a temperature that was steady for 1"):
        fitted(seconds[late], chamber(seconds[late], 1.0), readings[late])


@pytest.mark.parametrize(
    ("record", "message"),
    [
        # Legs of 240 s against a lag of 120 s; eight lags are 40 °C at 2.5 °C/min.
        (made(10.0, lag=120.0, noise=0.1), r"a leg lasts 239 s.*change the temperature at 2\.5 °C/min or slower"),
        (made(0.25, legs=2, wander=3.0, seed=2), "does not separate it from drift"),
    ],
)
def test_a_record_that_does_not_separate_lag_and_drift_is_refused(record, message):
    with pytest.raises(EstimateError, match=message):
        fit_ramp(record, reference=REFERENCE, highest=3)

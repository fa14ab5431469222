"""The drift and the lag of a ramp, on records that the differential equation makes."""

from __future__ import annotations

from math import sqrt

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tiltcal.core.ramp.fit import fit_ramp
from tiltcal.core.ramp.record import RampRecord, ramp_record
from tiltcal.core.thermal_lag import ThermalLag
from tiltcal.errors import EstimateError

REFERENCE = 24.0
CURVES = np.array([[1000.0, 0.8, 0.010, -1e-4], [1000.0, -0.5, 0.004, 1e-4]])
"""unit, unit/°C, ..."""

LOW, SPAN = 5.0, 40.0


def chamber(seconds, pace):
    """From 5 to 45 °C and back, at a pace in °C/min."""
    return LOW + SPAN * np.abs((seconds / (SPAN / pace * 60.0) + 1.0) % 2.0 - 1.0)


def delayed(seconds, pace, lag):
    def slope(t, e):
        return (chamber(t, pace) - e) / lag

    return solve_ivp(slope, (0.0, seconds[-1]), [LOW], t_eval=seconds, max_step=lag / 2.0, rtol=1e-7).y[0]


def read(element):
    return np.stack([np.polynomial.polynomial.polyval(element - REFERENCE, curve) for curve in CURVES], axis=1)


def recorded(seconds, thermometer, readings):
    return ramp_record(seconds, thermometer, readings.T)


def made(pace, *, lag=0.0, legs=4, noise=1.0, seed=1, wander=0.0, rows=2400):
    """A record of a row every two seconds or more."""
    draw = np.random.default_rng(seed)
    seconds = np.linspace(0.0, legs * SPAN / pace * 60.0, rows)
    thermometer = chamber(seconds, pace)
    element = thermometer
    if lag > 0.0:
        element = delayed(seconds, pace, lag)
    elif lag < 0.0:
        thermometer = delayed(seconds, pace, -lag)
    readings = read(element) + noise * draw.normal(size=(len(seconds), 2))
    readings += wander * np.cumsum(draw.normal(size=readings.shape), axis=0)
    return recorded(seconds, thermometer, readings)


def curve_error(found, at=None):
    """How far the curves are off, shape (channels, temperatures), unit."""
    at = np.linspace(LOW + 2.0, LOW + SPAN - 2.0, 10) - REFERENCE if at is None else at
    own = np.vander(at, found.shape[1], increasing=True) @ found.T
    return (own - np.vander(at, 4, increasing=True) @ CURVES.T).T


PLACES = np.linspace(LOW + 2.0, LOW + SPAN - 2.0, 10)


def u_of_curve(fit, channel):
    p = fit.order + 1
    own = slice(channel * p, channel * p + p)
    powers = np.vander(PLACES - REFERENCE, p, increasing=True)
    return np.sqrt(np.einsum("ij,jk,ik->i", powers, fit.covariance[own, own] + fit.loop_covariance[own, own], powers))


def held_on_both_ways(fit, half):
    """Which readings on the ways up and down the intervals hold; ``half`` has the shape (channels, temperatures)."""
    error = curve_error(fit.coefficients)
    reach = np.stack([1.96 * u_of_curve(fit, channel) for channel in (0, 1)])
    # The middle is off by little, and the intervals are no wider than they have to be.
    assert np.max(np.abs(error)) < 0.15
    assert np.max(reach) < 1.3 * np.max(np.abs(half)) + 0.15
    return np.abs(np.stack([error - half, error + half])) < reach


@pytest.mark.parametrize(("pace", "legs"), [(0.25, 2), (2.0, 4)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_lag_of_120_s_is_found_within_1_percent(pace, legs, sign):
    fit = fit_ramp(made(pace, lag=sign * 120.0, legs=legs, noise=0.1), reference=REFERENCE)
    assert fit.lag == pytest.approx(sign * 120.0, rel=0.01)
    assert min(fit.explained) > 0.99


def test_hysteresis_without_time_is_no_lag_and_its_loop_is_in_the_uncertainty():
    """A play of 2 °C makes at one pace the loop of a lag of 60 s."""
    seconds = np.linspace(0.0, 4 * 2400.0, 2400)
    temperature = chamber(seconds, 1.0)
    element, place = temperature.copy(), temperature[0]
    for k, value in enumerate(temperature):
        element[k] = place = min(max(place, value - 1.0), value + 1.0)
    readings = read(element) + 0.5 * np.random.default_rng(4).normal(size=(2400, 2))
    fit = fit_ramp(recorded(seconds, temperature, readings), reference=REFERENCE)
    assert not fit.uses_lag
    assert np.mean(held_on_both_ways(fit, (read(PLACES + 1.0) - read(PLACES - 1.0)).T / 2.0)) > 0.8


@pytest.mark.parametrize(("pace", "legs"), [(0.5, 2), (1.0, 3), (1.0, 4)])
def test_a_loop_that_grows_from_both_turns_is_no_lag(pace, legs):
    """A loop of half a sine was taken for a small lag, and the curve was 1.3 times as far off as numpy's cubic."""
    seconds = np.linspace(0.0, legs * SPAN / pace * 60.0, 2400)
    temperature, way = chamber(seconds, pace), np.where((seconds // (SPAN / pace * 60.0)) % 2 == 0, -0.8, 0.8)
    loop = (way * np.sin(np.pi * (temperature - LOW) / SPAN))[:, None] * [1.0, -0.7]
    readings = read(temperature) + loop + 0.5 * np.random.default_rng(6).normal(size=(2400, 2))
    fit = fit_ramp(recorded(seconds, temperature, readings), reference=REFERENCE)
    assert not fit.uses_lag
    alone = np.polynomial.polynomial.polyfit(temperature - REFERENCE, readings, 3).T
    assert np.max(np.abs(curve_error(fit.coefficients))) < np.max(np.abs(curve_error(alone))) + 0.03
    assert np.mean(held_on_both_ways(fit, np.outer([0.8, 0.56], np.sin(np.pi * (PLACES - LOW) / SPAN)))) > 0.8


@pytest.mark.parametrize(("lag", "wander"), [(0.0, 0.0), (120.0, 0.0), (0.0, 0.05)], ids=["none", "lag", "wander"])
def test_the_uncertainty_covers_the_curve(lag, wander):
    inside = []
    for seed in range(5):
        # 160 rows take half the time of 2400; each has the noise of a mean of 15.
        record = made(1.0, lag=lag, wander=wander * sqrt(15.0), noise=1.0 / sqrt(15.0), seed=seed, rows=160)
        fit = fit_ramp(record, reference=REFERENCE)
        assert fit.uses_lag is (lag > 0.0)
        error = curve_error(fit.coefficients)
        inside += [np.abs(error[c]) < 1.96 * u_of_curve(fit, c) for c in (0, 1)]
    # Ten curves, of ten places that depend on each other: 95 % within what so few curves can show.
    assert np.mean(inside) > 0.8


def late_thermometer(seconds, own, noise):
    """Readings of 0.005 units of noise with a thermometer 120 s behind the chamber, and an element ``own`` s behind."""
    draw = np.random.default_rng(8)
    readings = read(delayed(seconds, 1.0, own) if own else chamber(seconds, 1.0))
    thermometer = delayed(seconds, 1.0, 120.0) + noise * draw.normal(size=len(seconds))
    return recorded(seconds, thermometer, readings + 0.005 * draw.normal(size=readings.shape))


@pytest.mark.parametrize(
    ("seconds", "own", "noise", "within"),
    [
        (np.arange(0.0, 7200.0, 11.0), 0.0, 0.0, 0.002),
        (np.arange(0.0, 7200.0, 10.0), 0.0, 0.05, 0.1),
        (np.add.outer(np.arange(0.0, 7200.0, 40.0), 0.001 * np.arange(10.0)).ravel(), 0.0, 0.02, 0.05),
    ],
    ids=["rows far apart", "a noisy thermometer", "bursts of rows"],
)
def test_a_late_thermometer_leaves_the_curve_where_it_is(seconds, own, noise, within):
    """A slope from the rows before alone put curves off by 0.004, 0.2, 0.7 and 0.2 units."""
    fit = fit_ramp(late_thermometer(seconds, own, noise), reference=REFERENCE)
    assert fit.lag == pytest.approx(own - 120.0, rel=0.02)
    error = np.abs(curve_error(fit.coefficients))
    assert np.max(error) < within
    assert np.sqrt(np.mean((error / [u_of_curve(fit, channel) for channel in (0, 1)]) ** 2)) < 2.0


def two_lags(seconds, second, share):
    """60 s, and ``share`` of the element that much later than this, by the differential equations."""

    def slopes(t, e):
        return [(chamber(t, 1.0) - e[0]) / 60.0, ((e[0] if share == 1.0 else chamber(t, 1.0)) - e[1]) / second]

    found = solve_ivp(slopes, (0.0, seconds[-1]), [LOW, LOW], t_eval=seconds, max_step=30.0)
    return share * found.y[1] + (1.0 - share) * found.y[0]


@pytest.mark.parametrize(("second", "share"), [(150.0, 1.0), (400.0, 0.4)], ids=["in series", "side by side"])
def test_a_second_lag_is_refused_with_the_pace_at_which_one_describes_the_record(second, share):
    """One lag follows the turns of two badly, which moves the curve; a twentieth of the pace has no turn to see."""
    seconds = np.linspace(0.0, 9600.0, 2400)
    readings = read(two_lags(seconds, second, share)) + 0.1 * np.random.default_rng(5).normal(size=(2400, 2))
    with pytest.raises(EstimateError, match=r"residuals turn with the temperature, .* by a second one") as refusal:
        fit_ramp(recorded(seconds, chamber(seconds, 1.0), readings), reference=REFERENCE)
    assert 0.01 < float(str(refusal.value).split("change the temperature at ")[1].split(" °C/min")[0]) < 0.9


@pytest.mark.parametrize(("noise", "steps"), [(0.0, 1.5), (0.0, 4.0), (1.0, 0.0)])
def test_noise_and_steps_of_the_thermometer_are_not_taken_for_drift_of_a_quiet_sensor(noise, steps):
    seconds = np.arange(0.0, 9600.0, 4.0)
    true = chamber(seconds, 0.5)
    draw = np.random.default_rng(5)
    thermometer = true + noise * draw.normal(size=len(true))
    thermometer = np.round(thermometer / steps) * steps if steps else thermometer
    record = recorded(seconds, thermometer, 3.0 * read(true) + 0.02 * draw.normal(size=(len(seconds), 2)))
    assert record.step == pytest.approx(steps)
    fit = fit_ramp(record, reference=REFERENCE)
    error = np.abs(curve_error(fit.coefficients / 3.0))
    assert np.max(error) < 0.2
    assert np.mean([error[c] <= 1.96 / 3.0 * u_of_curve(fit, c) for c in (0, 1)]) > 0.85


def test_what_the_filter_of_a_log_makes_of_the_turns_is_in_the_uncertainty_of_a_temperature():
    seconds = np.arange(0.0, 7200.0, 2.0)
    fit = fit_ramp(late_thermometer(seconds, 0.0, 0.0), reference=REFERENCE)
    in_log = ThermalLag(fit.lag)(seconds, delayed(seconds, 1.0, 120.0))
    assert fit.u_element == pytest.approx(np.sqrt(np.mean((in_log - chamber(seconds, 1.0)) ** 2)), rel=0.05)


def test_a_record_that_starts_on_the_way_is_refused():
    """The element is 2 °C behind its thermometer in the first row; one lag of 112 s took that up."""
    seconds = np.arange(0.0, 9600.0, 4.0)
    readings = read(delayed(seconds, 1.0, 120.0)) + 0.05 * np.random.default_rng(7).normal(size=(len(seconds), 2))
    late = seconds > 900.0
    with pytest.raises(EstimateError, match=r"not at rest at the start: begin at a temperature that was steady for 1"):
        fit_ramp(recorded(seconds[late], chamber(seconds[late], 1.0), readings[late]), reference=REFERENCE)


def test_one_way_is_refused_with_the_pace_to_take():
    with pytest.raises(EstimateError, match=r"goes only up.*let it come back.*at 2 °C/min or slower"):
        fit_ramp(made(2.0, legs=1), reference=REFERENCE)


def test_ways_that_share_too_little_are_refused():
    record = made(2.0, legs=2)
    part = slice(0, int(len(record.time) * 0.65))
    cut = RampRecord(record.time[part], record.temperature[part], record.readings[part], record.noise, record.rows)
    with pytest.raises(EstimateError, match="the ways up and down share 12 °C of 40 °C"):
        fit_ramp(cut, reference=REFERENCE)


def test_a_leg_of_few_rows_is_refused():
    """12 °C down and up again within six of 4,800 rows, in no mean of which a leg begins."""
    seconds = np.arange(0.0, 4800.0)
    thermometer = chamber(seconds, 1.0)
    thermometer[1203:1209] -= [4.0, 8.0, 12.0, 12.0, 8.0, 4.0]
    readings = read(thermometer) + 0.5 * np.random.default_rng(2).normal(size=(4800, 2))
    with pytest.raises(EstimateError, match="hardly any rows: let the temperature go all the way"):
        fit_ramp(recorded(seconds, thermometer, readings), reference=REFERENCE)


def test_too_fast_a_pace_is_refused_with_the_pace_to_take():
    """Legs of 240 s against a lag of 120 s; eight lags are 40 °C at 2.5 °C/min."""
    with pytest.raises(EstimateError, match=r"a leg lasts 239 s.*change the temperature at 2\.5 °C/min or slower"):
        fit_ramp(made(10.0, lag=120.0, noise=0.1), reference=REFERENCE)


def test_a_zero_that_wanders_too_far_is_refused():
    with pytest.raises(EstimateError, match="does not separate it from drift"):
        fit_ramp(made(0.25, legs=2, wander=3.0, seed=2), reference=REFERENCE)


def test_a_record_of_any_length_becomes_few_means():
    """The means of 100,000 rows are those of numpy."""
    n = 100_000
    seconds = np.arange(n, dtype=float)
    readings = np.random.default_rng(5).normal(size=n) + seconds
    record = ramp_record(seconds, seconds * 2.0, [readings])
    size = round(record.time[1] - record.time[0])
    assert 4096 <= len(record.time) < 8192
    expected = readings[: n // size * size].reshape(-1, size).mean(axis=1)
    assert record.readings[: len(expected), 0] == pytest.approx(expected)
    assert record.temperature == pytest.approx(2.0 * record.time)

"""Mean, noise and uncertainty of a run of samples, and of several: against numpy, scipy and the papers."""

from math import exp, inf, pi, sqrt

import numpy as np
import pytest
import scipy
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq
from scipy.special import digamma, polygamma

from tiltcal.core import samples as core
from tiltcal.core.model import Array
from tiltcal.core.samples import SampleSummary


def by_numpy(samples: Array, step: float) -> SampleSummary:
    """As :func:`summarise` has it, rounding by the first harmonic of Widrow."""
    n, std = len(samples), float(np.std(samples, ddof=1)) if len(samples) > 1 else 0.0
    noise, dof, correlation = std / sqrt(n), float(max(n - 1, 1)), None
    if n >= 20:
        means = samples[: n // 10 * 10].reshape(10, -1).mean(axis=1)
        off = means - means.mean()
        noise, dof, correlation = float(np.std(means, ddof=1)) / sqrt(10), 9.0, float(off[1:] @ off[:-1] / (off @ off))
    rounding = step / sqrt(12) * exp(-2 * pi**2 * max(std**2 / step**2 - 1 / 12, 0)) if step else 0.0
    return SampleSummary(float(samples.mean()), std, n, np.hypot(noise, rounding), rounding, dof, step, correlation)


@given(st.sampled_from((1, 2, 19, 20, 29, 240)), st.floats(0.2, 3.0), st.sampled_from((0.0, 0.5, 1.0)))
def test_a_summary_is_that_of_numpy_with_ten_block_means(n: int, noise: float, step: float) -> None:
    samples = np.random.default_rng(n).normal(7.0, noise, n)
    found, expected = core.summarise(samples, step), by_numpy(samples, step)
    for one in (found, core.summarise(samples).with_resolution(step)):
        assert (one.correlation is None) is (n < 20)
        known, wanted = ({k: v for k, v in vars(each).items() if v is not None} for each in (one, expected))
        assert known == pytest.approx(wanted, rel=1e-9, abs=1e-12)
    assert (found.noise**2 + found.quantisation**2, found.noise_unknown) == (pytest.approx(found.u**2), False)


def test_samples_that_are_all_alike_have_no_scatter() -> None:
    """A hundred times 0.1 is not 10 in binary digits; what has a step is uncertain by it."""
    for value, step in ((0.1, 0.0), (107.123, 1.0), (1 / 3, 0.1)):
        by_step = step / sqrt(12)
        assert core.summarise([value] * 97, step) == SampleSummary(value, 0.0, 97, by_step, by_step, 9.0, step, None)
    tables = (
        SampleSummary(1.0, 0.0, 1, 0.3, 0.3),
        SampleSummary(1.0, 0.0, 1, 0.3, 0.2),
        SampleSummary(1.0, 0.0, 1, 0.0),
    )
    assert [one.noise_unknown for one in tables] == [True, False, False]


@pytest.mark.parametrize("times", [np.arange(12) * 0.5, np.array([1.0, 3.0, 4.0]), np.array([0.0, 2.0]), np.ones(3)])
def test_a_drift_is_that_of_the_regression_line(times: Array) -> None:
    samples = 3.0 + 0.02 * times + np.random.default_rng(2).normal(0.0, 0.1, len(times))
    change = u = 0.0
    if np.ptp(times):
        line, span = scipy.stats.linregress(times, samples), np.ptp(times)
        change, u = line.slope * span, line.stderr * span
    assert core.drift(times.tolist(), samples.tolist()) == pytest.approx((change, u), rel=1e-9, abs=1e-12)


# Noise with a memory


def test_noise_with_a_memory_counts_as_it_does() -> None:
    """An exponential memory: the correlation that ten block means show of it, and what their scatter leaves out."""
    draw = np.random.default_rng(1).normal(size=(20_000, 10))
    for time in (0.02, 0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0, 1.4, 2.0, 3.0, 5.0, 10.0, 30.0):  # in blocks
        apart = np.abs(np.subtract.outer(np.arange(10), np.arange(10)))
        within = 2 * time - 2 * time**2 * (1 - exp(-1 / time))
        covariance = np.where(apart, time**2 * (np.exp(1 / time) - 2 + exp(-1 / time)) * np.exp(-apart / time), within)
        means = draw @ np.linalg.cholesky(covariance).T
        off = means - means.mean(axis=1, keepdims=True)
        shown = np.mean(np.sum(off[:, 1:] * off[:, :-1], axis=1) / np.sum(off**2, axis=1))
        found = core.correlated_noise([SampleSummary(0.0, 1.0, 100, 0.1, dof=9.0, correlation=float(shown))] * 80_000)
        assert found is not None
        truth = np.std(means.mean(axis=1)) / sqrt(np.mean(np.var(means, axis=1, ddof=1)) / 10)
        assert found.factor == pytest.approx(truth, rel=0.03 if time < 10.0 else 0.1)
        longer = float(found.note.split("at least ")[1].split()[0])
        assert longer == pytest.approx(max(5.0 * time, 1.0), rel=0.1 if time < 10.0 else 0.4)
        # Of sixteen it counts half a standard deviation above its mean.
        few = core.correlated_noise([SampleSummary(0.0, 1.0, 100, 0.1, correlation=float(shown) - 0.27 / 8.0)] * 16)
        assert few is None or few.factor == pytest.approx(found.factor, rel=0.03)
    # Of white noise it is -0.1, ± 0.27 in one position: 1.5 of these count, 4 are told.
    for sigmas, counts, told in ((1.4, False, False), (1.6, True, False), (3.9, True, False), (4.1, True, True)):
        one = SampleSummary(0.0, 1.0, 100, 0.1, correlation=-0.1 + sigmas * 0.27 / 4.0)
        some = core.correlated_noise([one] * 16 + [SampleSummary(0.0, 1.0, 1, 0.1)])
        assert ((some is not None), bool(some and some.note)) == (counts, told)
    assert core.correlated_noise([SampleSummary(0.0, 1.0, 1, 0.1)]) is None


# Rounding


def rounded(noise: float) -> tuple[float, float]:
    """The mean variance of readings rounded to 1, and the root mean square error of their mean, over all offsets."""
    at, steps = np.linspace(-0.5, 0.5, 401)[:, None], np.arange(-9.0, 10.0)
    shares = scipy.stats.norm.cdf((steps + 0.5 - at) / noise) - scipy.stats.norm.cdf((steps - 0.5 - at) / noise)
    mean = shares @ steps
    return float(np.mean(shares @ steps**2 - mean**2)), sqrt(np.mean((mean - at[:, 0]) ** 2))


@pytest.mark.parametrize("noise", [0.05, 0.15, 0.4, 0.8])
def test_the_noise_before_rounding_and_what_rounding_leaves(noise: float) -> None:
    core._rounded.cache_clear()
    variance, error = rounded(noise)
    assert core.noise_under_rounding(4.0 * variance, 2.0) == pytest.approx(2.0 * noise, rel=0.03)
    expected = pytest.approx(2.0 * error, rel=0.02, abs=1e-4)
    assert core.rounding_of_means(4.0 * variance / (1.0 - 0.25 / sqrt(4)), 2.0, 4) == expected
    assert core.noise_under_rounding(100.0, 1.0) == pytest.approx(sqrt(100.0 - 1.0 / 12.0))


def test_the_step_of_a_sensor_is_the_smallest_that_it_takes_within_a_position_else_the_stated_one() -> None:
    readings = core.ReadingStep()
    steps = [readings.step()]
    for x, y, stated in (
        ([1.25, 1.25], [2.5, 2.5], 0.0),
        ([7.25, 7.25], [2.5, 2.5], 0.01),  # from 1.25 it was tilted, which is no step
        ([1.25, 1.25], [3.0, 2.75], 0.02),
        ([1.25, 1.25, np.nan], [3.0, 3.0 + 1e-13, 2.5], 0.001),
    ):
        readings.add([np.array(x), np.array(y)], stated)
        steps.append(readings.step())
    assert steps == [0.0, 0.0, 0.01, 0.25, 0.25]


def test_the_step_of_a_converter() -> None:
    volts = np.round(np.random.default_rng(1).normal(0.0, 0.01, 3000) / 187.5e-6) * 187.5e-6
    assert core.even_step(np.round(volts, 7)) == pytest.approx(187.5e-6, rel=1e-3)
    few = np.repeat([1.0, 2.0, 4.0], 4)
    for samples, step in ((few, 1.0), (few[:-1], 0.0), (np.ones(20), 0.0), (np.where(few > 3.0, 4.05, few), 0.0)):
        assert core.even_step(samples) == step
    for readings, step in (([[0.5, 1.0], [1.0, 2.5]], 0.5), ([[0.0, 1.0], [0.5, 2.2]], 0.0), ([[1.0, 2.0]], 0.0)):
        assert core.common_step(np.array(readings)) == step


# The noise of several positions


def test_variances_that_scatter_are_drawn_together_by_smyths_estimators() -> None:
    """G. K. Smyth (2004), section 6.2, with its own equations; those that are known stay what they are."""
    draw, dof = np.random.default_rng(3), np.array([9.0, 9.0, 4.0, 9.0, 19.0] * 4)
    for prior in (3.0, inf):
        truth = 0.04 * (prior / scipy.stats.chi2.rvs(prior, size=20, random_state=draw) if prior < inf else np.ones(20))
        variance = truth * scipy.stats.chi2.rvs(dof, random_state=draw) / dof
        e = np.log(variance) - digamma(dof / 2) + np.log(dof / 2)
        more = np.var(e, ddof=1) - np.mean(polygamma(1, dof / 2))
        expected, freedom = np.full(20, dof @ variance / dof.sum()), np.full(20, dof.sum())
        if prior < inf:
            d0 = 2.0 * brentq(lambda half, more=more: float(polygamma(1, half)) - more, 1e-3, 1e3)
            common = exp(np.mean(e) + digamma(d0 / 2) - np.log(d0 / 2))
            expected, freedom = (d0 * common + dof * variance) / (d0 + dof), d0 + dof
        found = core.pooled(np.append(variance, 7.0), np.append(dof, inf))
        np.testing.assert_allclose(found, [[*expected, 7.0], [*freedom, inf]], rtol=1e-6)
        one = core.pooled(variance[:1], dof[:1])
        assert (one[0][0], one[1][0]) == (variance[0], dof[0])


def test_the_noise_of_means_is_their_own_that_of_all_or_of_rounding() -> None:
    """Three positions: continuous; with a memory; and of a step that the noise does not reach."""
    some = [SampleSummary(float(k), 0.2 + 0.1 * k, 100, 0.02 + 0.01 * k, dof=9.0) for k in range(3)]
    own = np.array([one.u**2 for one in some])
    variance, dof, rounding = core.noise_of_means(some)
    np.testing.assert_allclose((variance, dof), core.pooled(own, np.full(3, 9.0)))
    assert rounding.tolist() == [0.0] * 3
    memory = [SampleSummary(one.mean, one.std, 100, one.u, dof=9.0, correlation=0.3) for one in some]
    correlated = core.correlated_noise(memory)
    assert correlated is not None
    table = SampleSummary(9.0, 0.0, 1, 0.5)
    variance, dof, _ = core.noise_of_means([*memory, table], correlated)
    assert variance == pytest.approx([*[correlated.factor**2 * own.mean()] * 3, correlated.factor**2 * 0.25])
    assert dof.tolist() == [6.0, 6.0, 6.0, inf]
    # Two of the three read alike within half a step, and share its error.
    coarse = [SampleSummary(mean, 0.2, 100, 0.1, 0.08, 9.0, 1.0, -0.1) for mean in (5.0, 5.4, 9.0)]
    variance, dof, rounding = core.noise_of_means(coarse)
    assert variance == pytest.approx([0.1**2 - 0.08**2] * 3)
    assert dof.tolist() == [27.0] * 3
    assert rounding == pytest.approx(core.rounding_of_means(0.04, 1.0, 3) * np.sqrt([2.0, 2.0, 1.0]))
    fine = [SampleSummary(mean, 0.7, 100, 0.1, 0.08, 9.0, 1.0) for mean in (5.0, 5.4, 9.0)]
    assert core.noise_of_means(fine)[2].tolist() == [0.08] * 3

"""The noise of readings at rest, against other programs, published values and noise of known kind."""

from math import log, pi, sqrt

import numpy as np
import pytest
from scipy.stats import chi2
from support import coloured_noise as coloured

from tiltcal.core import noise as core
from tiltcal.core.noise import AllanFit, Average, ChannelNoise

DT = 0.01
"""Seconds between samples."""

FLICKER = sqrt(2.0 * log(2.0) / pi)


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def white(rows: int, sigma: float = 1.0, seed: int = 1) -> coloured.Samples:
    return coloured.white(rng(seed), rows, sigma)


def noise_of(samples: coloured.Samples) -> ChannelNoise:
    return core.characterise(samples, DT)


def test_the_allan_deviation_is_that_of_allantools() -> None:
    import allantools  # here, for it takes a second of every worker that collects this file

    samples = coloured.flicker(rng(), 20_000, 1.0) + 100.0
    factor, variance = core.allan_variance(samples)
    _, deviation, _, _ = allantools.oadev(samples, data_type="freq", taus=factor.astype(float))
    assert factor.tolist() == [2**k for k in range(13)]
    long = white((1 << 16) + 70)  # longer than what is summed up at once
    _, of_long, _, _ = allantools.oadev(long, data_type="freq", taus=factor[:6].astype(float))
    assert np.sqrt(core.allan_variance(long)[1][:6]) == pytest.approx(of_long, rel=1e-9)
    # Up to 32 samples every start counts; beyond, one in many, which changes less than the statistics leave open.
    assert np.sqrt(variance[:6]) == pytest.approx(deviation[:6], rel=1e-9)
    assert np.sqrt(variance[6:]) == pytest.approx(deviation[6:], rel=0.02)
    # A mean counts where half of its samples are there.
    gaps = np.where(rng(7).uniform(size=1000) < 0.4, np.nan, white(1000, seed=8) + 50.0)
    for size, found in zip(*core.allan_variance(gaps), strict=True):
        windows = np.lib.stride_tricks.sliding_window_view(gaps, size)
        there = np.sum(np.isfinite(windows), axis=1)
        means = np.where(2 * there >= size, np.nansum(windows, axis=1) / np.maximum(there, 1), np.nan)
        if size <= 32:
            assert found == pytest.approx(np.nanmean((means[size:] - means[:-size]) ** 2) / 2.0)
            usable = means[::size][np.isfinite(means[::size])]
            expected = (len(usable), usable.mean(), usable.std(ddof=1), np.ptp(usable))
            assert tuple(vars(core.average(gaps, int(size))).values())[1:] == pytest.approx(expected)


def test_the_limits_are_those_of_chi_square_and_one_octave_follows_any_term() -> None:
    variance, dof = np.array([0.04, 0.01]), np.array([3.0, 80.0])
    expected = [np.sqrt(dof * variance / chi2.ppf(tail, dof)) for tail in (0.975, 0.025)]
    np.testing.assert_allclose(core.limits(variance, dof), expected, rtol=1e-12)
    assert core.kinds_of_noise(np.array([DT]), variance[:1], np.array([1]), 64).follows


def test_kinds_of_noise() -> None:
    """White noise of 0.6 is 0.6 √dt at one second, its one-sided density 2 sigma² dt; the others by their formulas."""
    n = 400_000
    for more, term, value, within, limit in (
        (np.zeros(n), "N", 0.6 * sqrt(DT), 0.03, "record"),
        (coloured.flicker(rng(2), n, 0.05), "B", 0.05, 0.15, "flicker"),
        (coloured.ramp(n, 1e-4), "R", 1e-4 / DT, 0.03, "drift"),
    ):
        noise = noise_of(white(n, 0.6) + more)
        terms = noise.terms
        assert (core.sample_size(noise, DT, None)[1], noise.settled) == (limit, term != "N")
        tau, lowest = noise.lowest
        if term == "R":  # N²/τ + R² τ²/2 is least where N² = R² τ³
            assert tau == pytest.approx((0.6**2 * DT / value**2) ** (1 / 3), rel=0.05)
            assert lowest == pytest.approx(value * tau * sqrt(1.5), rel=0.05)
        assert terms.value[term] == pytest.approx(value, rel=within)


@pytest.mark.parametrize("terms", ["N", "NB", "NK", "NR", "NBR", "NBK"])
def test_kinds_of_noise_are_those_that_make_an_allan_variance(terms: str) -> None:
    """IEEE Std 952-1997, annex C, as it stands there; what a record of 400,000 samples can show of each."""
    factor, sizes = 2 ** np.arange(17), {"N": 0.06, "B": 0.05, "K": 0.02, "R": 1e-3}
    tau = factor * DT
    parts = {"N": 1.0 / tau, "B": 2.0 * log(2.0) / pi + 0.0 * tau, "K": tau / 3.0, "R": tau**2 / 2.0}
    found = core.kinds_of_noise(tau, sum(sizes[name] ** 2 * parts[name] for name in terms), factor, 400_000)
    assert found.value == pytest.approx({name: sizes[name] for name in terms}, rel=1e-6)
    assert (found.first, found.follows) == (0, True)


def test_what_is_not_there_is_seldom_found() -> None:
    assert sum(set(noise_of(white(8192, seed=seed)).terms.value) != {"N"} for seed in range(40)) <= 3
    swaying = np.sin(2.0 * pi * 0.05 * DT * np.arange(50_000))
    swayed = noise_of(white(50_000, 0.1) + swaying)
    assert not swayed.terms.follows
    assert core.sample_size(swayed, DT, None)[1] == "unknown"
    place = int(np.argmin(swayed.deviation))
    assert swayed.lowest == (swayed.tau[place], swayed.deviation[place])  # as it was measured
    assert swayed.uncertainty(swayed.tau) == pytest.approx(swayed.deviation)


def test_filtered_samples_are_not_taken_for_independent() -> None:
    """A mean over ten samples, running: white from some multiple of it on, with the density of its input."""
    noise = noise_of(np.convolve(white(100_009), np.full(10, 0.1), "valid"))
    assert noise.tau[noise.terms.first] >= 10 * DT
    assert noise.terms.value["N"] == pytest.approx(sqrt(DT), rel=0.08)
    assert noise.terms.follows


def test_within_the_record_more_samples_still_help() -> None:
    noise = noise_of(white(10_000))
    assert core.sample_size(noise, DT, 0.002) == (round(noise.tau[-1] / DT), "record")
    samples, limit = core.sample_size(noise, DT, 0.1)
    assert (samples, limit) == (pytest.approx(100, rel=0.03), "target")
    assert noise.uncertainty(np.array([samples, samples - 1]) * DT) == pytest.approx([0.1, 0.1], rel=0.02)


@pytest.mark.parametrize(
    ("last", "target", "samples"),
    [
        *((0.0, of, n) for of, n in ((9.0, 1), (8.0, 1), (5.0, 5), (4.0, 10), (3.0, 25), (2.0, 86), (0.5, 1000))),
        *((1.8, None, 100), (1.6, None, 1000), (1.6, 1.6, 1000), (1.6, 1.5, None)),
    ],
)
def test_the_number_of_samples_by_the_range_of_their_averages(last: float, target: float, samples: int) -> None:
    """8 units of single samples, 4 of ten, 1.9 of a hundred: between them on a straight line of logarithms.

    By hand: log(8/5) / log(8/4) of a decade are 4.8 samples, log(4/3) / log(4/1.9) are 10 times 2.43.
    """
    averages = [Average(10**k, 99, 0.0, 1.0, width) for k, width in enumerate((8.0, 4.0, 1.9, last))]
    one, terms = np.ones(1), AllanFit({"N": 1.0}, 0, np.ones(1), follows=True)
    assert core.sample_size_by_range(ChannelNoise(0.0, 99, 0.0, averages, one, one, one, one, terms), target) == samples


def test_flicker_noise_ends_what_averaging_gains() -> None:
    """White sigma/√n and flicker f make √(σ²/n + f²): twice n gains a tenth where σ²/n is f² 0.19/0.31."""
    floor = 0.08 * FLICKER
    noise = noise_of(white(400_000) + coloured.flicker(rng(2), 400_000, 0.08))
    samples, limit = core.sample_size(noise, DT, 0.1 * floor)
    assert limit == "flicker"
    assert samples == pytest.approx(0.31 / 0.19 / floor**2, rel=0.25)
    assert noise.uncertainty(np.array([samples * DT])) == pytest.approx(floor * sqrt(1.0 + 0.19 / 0.31), rel=0.1)


def test_rounding_ends_what_averaging_gains() -> None:
    """Noise of 0.28 steps leaves step/√12 exp(-2 (π 0.28)²) however long it is averaged (Widrow)."""
    left = float(np.exp(-2.0 * (pi * 0.28) ** 2) / sqrt(12.0))
    noise = noise_of(np.round(white(200_000, 0.28) + 0.25))
    samples, limit = core.sample_size(noise, DT, 0.1 * left)
    assert (noise.step, limit) == (1.0, "rounding")
    assert noise.uncertainty(np.array([samples * DT])) > left * 0.7


def test_degrees_of_freedom_are_those_of_nist_sp_1065() -> None:
    """Table 5 by hand, of 101 phases: averages of four samples; single ones of flicker noise with N - 2 squared."""
    assert core.degrees_of_freedom("white", 100.0, 4.0) == pytest.approx(32.9643, rel=1e-5)
    assert core.degrees_of_freedom("flicker", 100.0, 1.0) == pytest.approx(86.2005, rel=1e-5)
    assert core.degrees_of_freedom("flicker", 100.0, 4.0) == pytest.approx(5 * 101**2 / (16 * 113))
    assert core.degrees_of_freedom("walk", 100.0, 4.0) == pytest.approx(22.8430, rel=1e-5)

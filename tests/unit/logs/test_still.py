"""Finding when a sensor was held still, on logs whose still rows are known because they were made so."""

import re
from itertools import product
from math import inf

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from tiltcal.core.detection import STUCK
from tiltcal.errors import EstimateError
from tiltcal.logs.still import (
    Judge,
    PositionFit,
    different,
    farthest,
    find_still,
    fit_free,
    judge_of,
    may_be_means,
    mean_of,
)

Array = NDArray[np.float64]
HELD, MOVED = 300, 120
SENSITIVITY = np.array([[1.01, 0.004, -0.006], [0.0, 0.99, 0.008], [0.0, 0.0, 1.005]])
OFFSET = np.array([0.02, -0.03, 0.01])


def handled(n: int = 16, noise: float = 0.001, seed: int = 0, up: Array | None = None) -> Array:
    """A sensor held in n attitudes for 300 rows each, and turned by hand in 120 rows between them; unit g."""
    rng = np.random.default_rng(seed)
    if up is None:
        up = rng.normal(size=(n, 3))
    up, n = up / np.linalg.norm(up, axis=1, keepdims=True), len(up)
    rows = []
    for number, attitude in enumerate(up):
        rows.append(np.repeat(attitude[None], HELD, axis=0))
        if number + 1 < n:
            part = np.linspace(0.0, 1.0, MOVED)[:, None]
            path = attitude * (1 - part) + up[number + 1] * part
            shaking = 0.3 * np.sin(np.pi * part) * rng.normal(size=(MOVED, 3))
            rows.append(path / np.linalg.norm(path, axis=1, keepdims=True) + shaking)
    truth = np.concatenate(rows) @ SENSITIVITY.T + OFFSET
    return np.asarray(truth + noise * rng.normal(size=truth.shape))


def held(n: int = 16) -> NDArray[np.bool_]:
    """Which rows of :func:`handled` are still."""
    return np.arange(n * HELD + (n - 1) * MOVED) % (HELD + MOVED) < HELD


def test_every_attitude_is_found_and_nothing_of_the_motion() -> None:
    """The table hums from the tenth hold on, where a strict threshold finds nine attitudes; the trap of data/README.md:
    with these the misfit is zero, and the result anything. Rows are missing, one hold has a bump, and the reading
    freezes for 200 rows between two others."""
    log, period = handled(seed=1), HELD + MOVED
    log[9 * period :, 2] += 0.004 * np.sin(np.arange(9 * period, len(log)) * 1.7)
    log[100:110, 1] = np.nan
    log[period + 148 : period + 152] += 0.5
    place = 4 * period + HELD + MOVED // 2
    log = np.insert(log, place, np.repeat(log[place][None], 200, axis=0), axis=0)
    still = np.insert(held(), place, np.zeros(200, bool))
    still[100:110] = still[period + 148 : period + 152] = False
    chosen = find_still(log.T)
    found = np.zeros(len(log), dtype=bool)
    for segment in chosen.segments:
        found[segment.start : segment.end] = True
    assert list(dict.fromkeys(segment.name for segment in chosen.segments)) == [f"still-{k:02}" for k in range(1, 17)]
    assert [segment.name for segment in chosen.segments].count("still-02") == 2
    # A window may reach into the motion by the rows whose shaking is still below the noise.
    assert np.sum(found & ~still) <= 16 * 8
    assert np.sum(found & still) > 0.6 * np.sum(still)
    # 1 mg of noise over some 250 rows is 0.06 mg; nine unknowns from sixteen attitudes, each within five sigma.
    assert chosen.fit.offset == pytest.approx(OFFSET, abs=5e-4)
    assert np.diag(chosen.fit.sensitivity) == pytest.approx(np.diag(SENSITIVITY), abs=1e-3)
    assert chosen.threshold == chosen.multiple * chosen.noise
    assert chosen.noise == pytest.approx(0.001 * 3.0**0.5, rel=0.2)
    # Nine attitudes are as good as sixteen up to what their two degrees of freedom show: 1 + 1 / sqrt(4).
    for expanded, most in ((1.49, 16), (1.51, 9)):

        def judge(means: Array, _: Array, more: float = expanded) -> PositionFit:
            return PositionFit(("a",) * len(means), (), 2, more if len(means) > 9 else 1.0)

        assert len(find_still(log.T, judge).intervals) == most
    assert chosen.in_words(" g") == (
        f"{len(chosen.segments)} static intervals in 16 attitudes: standard deviation over {chosen.window} rows up to "
        f"{chosen.threshold:.4g} g, {chosen.multiple:g} times the noise of the stillest part"
    )


def test_a_coarse_reading_that_repeats_is_not_stuck() -> None:
    """Noise of a sixth of the step: whole windows of a hold are identical, others have a sample that is not."""
    log = np.round(handled(noise=0.001) / 0.006) * 0.006
    same = (np.diff(log, axis=0) == 0.0).all(axis=1)
    assert np.convolve(same, np.ones(STUCK), "valid").max() == STUCK
    assert len(find_still(log.T).intervals) >= 12


FACES = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)], float)
SET = {"level": (0, 0, 1), "x+": (0.5, 0, 0.866), "x-": (-0.5, 0, 0.866), "y+": (0, 0.5, 0.866), "y-": (0, -0.5, 0.866)}
MORE = "Hold the sensor still in more attitudes, and for longer in each"
TEN = "enough attitudes to determine the sensor and check the result (10, better 12 to 18): at most"
FEW = [
    (handled(n=9), None, f"{TEN} 9 in windows of 25 rows or more. {MORE}"),
    (
        handled(up=np.tile(FACES, (2, 1))),
        None,
        f"{TEN} 12, of which 6 are different in windows of 25 rows or more. Add other attitudes, such as the one with "
        "±x and ±y and ±z up",
    ),
    (
        np.vstack([handled(up=np.array(list(SET.values())[1:])), np.full((30, 3), 0.5)])[:, :2],
        judge_of(SET, "xy"),
        "the sensor still in every position: level is missing in windows of 25 rows or more; 30 rows are missing, or "
        f"stuck at one value. {MORE}",
    ),
    (9.81 * np.tile(FACES, (2, 1)), None, f"{TEN} 0 in windows of 25 rows or more. {MORE}"),
]


@pytest.mark.parametrize(("log", "judge", "said"), FEW)
def test_too_few_attitudes_are_refused_with_what_to_add(log: Array, judge: Judge | None, said: str) -> None:
    with pytest.raises(EstimateError) as refused:
        find_still(log.T, judge or fit_free)
    means = "; if each row is the mean of one position, say table" if len(log) == 12 else ""
    anyhow = re.sub("[+-](?=[xyz])", "±", str(refused.value))
    assert anyhow == f"no threshold finds {said}; or give the intervals with segments{means}"


def test_means_of_positions_are_told_from_readings() -> None:
    """Nine rows or more, as long as each other to 15 %, and apart."""
    means, half = 9.81 * np.tile(FACES, (2, 1)), [1.0] * 12
    for rows, are in (
        (means, True),
        (means[:9], True),
        (means[:8], False),
        (means[:, :2], False),
        (means * np.array([*half[:11], 1.2])[:, None], True),
        (means * np.array([*half[:10], 1.2, 1.2])[:, None], False),
        (np.tile(means[0], (12, 1)), False),
        (np.vstack([means, np.full((9, 3), np.nan)]), True),
    ):
        assert may_be_means(rows.T) is are, rows


def test_what_is_farthest_of_all_directions() -> None:
    """A face, an edge or a corner; directions within 5° of each other are one."""
    corners = np.array([one for one in product((-1.0, 0.0, 1.0), repeat=3) if any(one)])
    for absent, said in (((0, 0, -1), "-z"), ((-1, 1, 0), "-x and +y"), ((1, -1, 1), "+x and -y and +z")):
        others = np.array([one for one in corners if tuple(one) != absent])
        assert farthest(others / np.linalg.norm(others, axis=1, keepdims=True)) == said
    turned = FACES @ np.array([[np.cos(0.05), -np.sin(0.05), 0], [np.sin(0.05), np.cos(0.05), 0], [0, 0, 1]])
    readings = np.array([5.0, -3.0, 1.0]) + np.vstack([FACES, FACES[::-1], turned]) * [800.0, 790.0, 810.0]
    np.testing.assert_allclose(different(readings), FACES, atol=0.06)
    np.testing.assert_allclose(different(np.vstack([FACES, [[0.9, 0.9, 0.9]]]))[-1], np.full(3, 3.0**-0.5))


def test_mean_and_uncertainty_of_an_attitude() -> None:
    """They are those of all its rows together, whichever intervals these come from, beside a value that is missing."""
    readings = np.cumsum(np.random.default_rng(6).normal(size=(600_000, 3)), axis=0)
    readings[12_999] = np.nan
    for size in (20, 4000, 300_000):
        spans = np.array([(5, 5 + min(size, 12_000)), (13_000, 13_000 + size), (550_000, 550_009)])
        for some in (spans[:1], spans):
            samples = np.concatenate([readings[start:end] for start, end in some])
            blocks = samples[: len(samples) // 10 * 10].reshape(10, -1, 3).mean(axis=1)
            mean, uncertainty = mean_of(readings.T, some.tolist())
            assert mean == pytest.approx(samples.mean(axis=0), rel=1e-11)
            assert uncertainty == pytest.approx(blocks.std(axis=0, ddof=1) / np.sqrt(10), rel=1e-8)


def test_the_positions_of_two_axes_are_told_by_the_extreme_readings() -> None:
    """Level readings of 1000 and 1020 counts, 800 count/g, and tilts of 30°; one attitude leans towards none."""
    positions = {"x+": (0.5, 0, 0.87), "x-": (-0.5, 0, 0.87), "y+": (0, 0.5, 0.87), "y-": (0, -0.5, 0.87)}
    judge = judge_of(positions, "xy")
    assert judge is not None
    means = np.array([[1000, 1420], [600, 1020], [1200, 1220], [1400, 1020], [1001, 620], [1402, 1022]], float)
    found = judge(means, np.full(means.shape, 0.5))
    assert isinstance(found, PositionFit)
    assert found.names == ("y+", "x-", "", "x+", "y-", "x+")
    assert (found.absent, found.distinct, found.dof) == ((), 5, 2)
    design = np.array([[1, 0, 0.5], [1, -0.5, 0], [1, 0.5, 0], [1, 0, -0.5], [1, 0.5, 0]])
    readings = np.delete(means, 2, axis=0) * 0.5 / [401.0, 400.0]
    spread = np.mean(np.diag(np.linalg.inv(design.T @ design)))
    for u in (0.5, 50.0):
        squares = max(
            np.linalg.lstsq(design, readings)[1].sum() / 4, np.mean((u * 0.5 / np.array([401.0, 400.0])) ** 2)
        )
        found = judge(means, np.full(means.shape, u))
        assert found.expanded == pytest.approx(stats.t.ppf(0.975, 4) * np.sqrt(squares * spread))
    assert judge(means[1:], np.full((5, 2), 0.5)).expanded == inf
    aside = {"a": (0.4, 0.0, 0.9), "b": (0.7, 0.0, 0.7), "c": (0.4, 0.3, 0.87), "d": (0.7, 0.3, 0.65)}
    means = 1000.0 + 800.0 * np.array([*aside.values()])[[1, 3, 0, 2], :2]
    assert judge_of(aside, "xy")(means, np.full((4, 2), 0.5)).names == ("b", "d", "a", "c")
    assert judge_of({"level": (0, 0, 1), "x": (0.7, 0, 0.7), "y": (0, 0.7, 0.7)}, "xy") is None  # nothing is left over
    assert judge_of({**positions, "turned": (0.5, 0.05, 0.86)}, "xy") is None

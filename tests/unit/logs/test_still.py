"""Finding when a sensor was held still, on logs whose still rows are known because they were made so."""

from math import inf

import numpy as np
import pytest
from numpy.typing import NDArray

from tiltcal.core.detection import STUCK
from tiltcal.errors import EstimateError
from tiltcal.logs.still import PositionFit, StaticDetection, judge_of, mean_of
from tiltcal.logs.still import find_still as find_in_columns

Array = NDArray[np.float64]
HELD, MOVED = 300, 120
SENSITIVITY = np.array([[1.01, 0.004, -0.006], [0.0, 0.99, 0.008], [0.0, 0.0, 1.005]])
OFFSET = np.array([0.02, -0.03, 0.01])


def handled(n: int = 16, noise: float = 0.001, seed: int = 0) -> Array:
    """A sensor held in n attitudes for 300 rows each, and turned by hand in 120 rows between them; unit g."""
    rng = np.random.default_rng(seed)
    up = rng.normal(size=(n, 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
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


def find_still(log: Array) -> StaticDetection:
    return find_in_columns(log.T)


def rows_of(spans: object, size: int) -> NDArray[np.bool_]:
    mask = np.zeros(size, dtype=bool)
    for start, end in spans:  # type: ignore[attr-defined]
        mask[start:end] = True
    return mask


class TestFindStill:
    def test_every_attitude_and_nothing_of_the_motion(self) -> None:
        chosen = find_still(handled(seed=1))
        found = rows_of([span for spans in chosen.intervals for span in spans], len(held()))
        assert len(chosen.intervals) == 16
        # A window may reach into the motion by the rows whose shaking is still below the noise.
        assert np.sum(found & ~held()) <= 16 * 8
        assert np.sum(found & held()) > 0.6 * np.sum(held())
        # 1 mg of noise over some 250 rows is 0.06 mg; nine unknowns from sixteen attitudes, each within five sigma.
        assert chosen.fit.offset == pytest.approx(OFFSET, abs=5e-4)
        assert np.diag(chosen.fit.sensitivity) == pytest.approx(np.diag(SENSITIVITY), abs=1e-3)

    def test_choices_that_leave_nine_attitudes_are_never_taken(self) -> None:
        """The trap of data/README.md: with nine attitudes the misfit is zero, and the result anything."""
        log = handled()
        # From the tenth hold on the table hums: a strict threshold finds nine still attitudes, a looser one all.
        hum = 0.004 * np.sin(np.arange(len(log)) * 1.7)
        log[9 * (HELD + MOVED) :, 2] += hum[9 * (HELD + MOVED) :]
        assert len(find_still(log).intervals) == 16

    def test_rows_without_a_number_are_not_still_and_a_bump_does_not_make_two_attitudes(self) -> None:
        log = handled()
        log[100:110, 1] = np.nan
        log[HELD + MOVED + 148 : HELD + MOVED + 152] += 0.5
        chosen = find_still(log)
        found = rows_of([span for spans in chosen.intervals for span in spans], len(log))
        assert not found[100:110].any()
        assert len(chosen.intervals) == 16
        assert [segment.name for segment in chosen.segments if segment.name == "still-02"] == ["still-02"] * 2

    def test_too_few_attitudes_for_a_verdict(self) -> None:
        with pytest.raises(EstimateError, match="12 to 18"):
            find_still(handled(n=9))


class TestStuck:
    def test_a_stuck_stretch_is_no_attitude(self) -> None:
        """The reading freezes for 200 rows on its way between two attitudes."""
        log = handled(noise=0.001)
        place = HELD + MOVED // 2
        log = np.insert(log, place, np.repeat(log[place][None], 200, axis=0), axis=0)
        chosen = find_still(log)
        found = rows_of([span for spans in chosen.intervals for span in spans], len(log))
        assert not found[place + 1 : place + 199].any()
        assert len(chosen.intervals) == 16

    def test_a_coarse_reading_that_repeats_is_not_stuck(self) -> None:
        """Noise of a sixth of the step: whole windows of a hold are identical, others have a sample that is not."""
        step = 0.006
        log = np.round(handled(noise=0.001) / step) * step
        same = (np.diff(log, axis=0) == 0.0).all(axis=1)
        assert np.convolve(same, np.ones(STUCK), "valid").max() == STUCK
        chosen = find_still(log)
        assert len(chosen.intervals) >= 12


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
    assert judge(means[1:], np.full((5, 2), 0.5)).expanded == inf
    assert judge_of({"level": (0, 0, 1), "x": (0.7, 0, 0.7), "y": (0, 0.7, 0.7)}, "xy") is None  # nothing is left over
    assert judge_of({**positions, "turned": (0.5, 0.05, 0.86)}, "xy") is None

"""Matching a pair online: how fast, how well, and what happens where the stream is not what it should be."""

from dataclasses import replace

import numpy as np
import pytest
from support import accelerometer_disk as disk

from tiltcal.core.pair.model import Pair
from tiltcal.core.pair.online import Online

PAIR = Pair("a1", "a2", "a4")
TRUTH = disk.truth()


def pushed(taken: disk.Record, block: int = 5000) -> tuple[Online, list[str]]:
    online, said = Online(PAIR, disk.NAMES), []
    for start in range(0, len(taken.theta), block):
        part = taken.rows(slice(start, start + block))
        said += [str(notice) for notice in online.push(part.theta, part.readings.T)]
    return online, said


def joined(*parts: disk.Record) -> disk.Record:
    return disk.Record(
        *(np.concatenate([getattr(part, name) for part in parts]) for name in ("time", "theta", "readings"))
    )


def test_both_estimators_go_on_once_a_turn_whatever_the_blocks() -> None:
    taken = disk.record(seconds=60, rate=20)
    alone, together = (pushed(taken, block=size)[0] for size in (1, 100_000))
    assert len(set(alone.course)) == len(alone.course) == alone.turns == 7
    assert np.array(alone.course) == pytest.approx(np.array(together.course), abs=1e-12)


def test_the_recursive_estimator_needs_at_most_half_the_turns_at_the_papers_noise() -> None:
    """Of 200 turns, twice: until the matched sum stays as near to zero as the loops end."""
    needed = []
    for seed in range(2):
        # The source's 1.5e-7 g/√Hz at 16 samples a second, over a common acceleration of 1.5e-3 g.
        online, _ = pushed(disk.record(seconds=1600, rate=16, noise=9.6e-4, corner=0.05, seed=seed))
        away = np.hypot(*(np.array(online.course).reshape(-1, 2, 2) - TRUTH).T)  # of the loops, of the recursive one
        floor = float(np.max(away[0, -30:]))
        needed.append([int(np.flatnonzero(one > floor)[-1]) + 2 for one in away])
    loops, recursive = np.sum(needed, axis=0)
    assert recursive <= loops / 2


def test_p_and_q_that_drift_are_followed() -> None:
    """An aging of 1e-3 over 400 turns: the memory of 100 turns lags by 2.5e-4, a mean over all by 5e-4."""
    scales = [(3.383, 3.415 * (1 + 1e-3 * k / 40), 3.402, 3.390) for k in range(40)]
    parts = [disk.record(seconds=80, rate=10, scale=scale, wander=0.0, seed=k) for k, scale in enumerate(scales)]
    online, said = pushed(joined(*parts))
    p, _ = disk.truth(scale=scales[-1])
    assert said == []
    assert online.loops.coefficients().p == pytest.approx(p, abs=1e-4)
    assert online.recursive.coefficients().p == pytest.approx(p, abs=3e-4)


def test_the_uncertainty_over_gaps_is_that_of_the_error() -> None:
    """Six gaps of up to five turns in 100: the root mean square of error over stated uncertainty, 3.3 of the loops."""
    away = []
    for seed in range(12):
        taken, draw = disk.record(rate=10, noise=3e-3, seed=seed), np.random.default_rng(seed)
        kept = np.ones(len(taken.time), dtype=bool)
        for start in draw.integers(len(kept), size=6):
            kept[start : start + draw.integers(20, 400)] = False
        online, _ = pushed(taken.rows(kept))
        both = [online.coefficients(loops=loops) for loops in (False, True)]
        away.append([[(one.p - TRUTH[0]) / one.u_p, (one.q - TRUTH[1]) / one.u_q] for one in both])
    of_each = np.sqrt(np.mean(np.square(away), axis=(0, 2)))
    assert np.all((of_each > 0.7) & (of_each < 1.5)), of_each


# A stream that is not what it should be

BEFORE, AFTER = disk.record(seconds=240), disk.record(seconds=240, seed=5)
MISSING = BEFORE.readings.copy()
MISSING[3000:6000, 3] = np.nan
SINGLE = BEFORE.readings.copy()
SINGLE[::7, 1] = np.nan


@pytest.mark.parametrize(
    ("taken", "why"),
    [
        (joined(BEFORE, *[BEFORE.rows(slice(-1, None))] * 3000, AFTER), "the stage stands still"),
        (joined(BEFORE.rows(BEFORE.time < 101.3), BEFORE.rows(BEFORE.time > 130)), "the stream has a gap"),
        (replace(BEFORE, readings=MISSING), "values are missing"),
        (replace(BEFORE, readings=SINGLE, theta=np.where(np.arange(12_000) % 11, BEFORE.theta, np.nan)), ""),
    ],
    ids=["stands", "gap", "missing", "single values"],
)
def test_the_estimators_are_held_and_go_on(taken: disk.Record, why: str) -> None:
    online, said = pushed(taken)
    assert [line.split(": ")[1] for line in said] == ([f"held, {why}", "goes on"] if why else [])
    assert online.course[-1] == pytest.approx((*TRUTH, *TRUTH), abs=1e-4)
    if why == "values are missing":
        assert 3000 <= online.left_out < 3000 + 2 * 400

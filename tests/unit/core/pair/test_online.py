"""Matching a pair online: how fast, how well, and what happens where the stream is not what it should be."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from support import accelerometer_disk as disk

from tiltcal.core.model import Array
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


def solved(columns: Array, rows: Array) -> Array:
    """The components of a1, a2 and a4 in phase with the first two columns."""
    sine, cosine = np.linalg.lstsq(columns, rows[:, [0, 1, 3]], rcond=None)[0][:2]
    return np.asarray(sine + 1j * cosine)


def by_numpy(taken: disk.Record, per_turn: int) -> tuple[list[tuple[float, ...]], Array]:
    """p and q of both after each turn, and their standard uncertainties in the end: of the loops, of the recursive one.

    The loops go on by a part of what a turn alone gives; of the recursive estimator a turn counts 1/e after a hundred.
    """
    angle, row = np.radians(taken.theta), np.arange(len(taken.theta)) / per_turn
    waves = [wave(h * angle) for h in (1, 2, 3, 4) for wave in (np.sin, np.cos)]
    columns = np.stack([*waves, np.ones(len(row)), row], axis=1)
    first = int(np.argmax(taken.theta >= 45.0))  # an eighth of a turn
    bounds = list(range(first, len(row), per_turn))
    p, q, course, gains, alone = 0.0, 0.0, list[tuple[float, ...]](), list[float](), list[tuple[float, float]]()
    for number, (start, end) in enumerate(pairwise(bounds)):
        part = slice(start, end)
        one, two, four = solved(columns[part][:, [0, 1, 2, 3, 8, 9]], taken.readings[part])
        alone.append((1.0 + (two / one).real + q * (four / one).real, -(two / one).imag / (four / one).imag))
        gains.append(0.9 if number < 10 else max(1.0 / (1.0 / 0.9 + number - 9), 0.03))  # two of p alone, eight
        p += gains[-1] * (alone[-1][0] - p)
        q += gains[-1] * (alone[-1][1] - q) * (number > 1)
        weights = np.exp(((np.arange(first, end) - first) // per_turn - number) / 200.0)[:, None]
        one, two, four = solved(weights * columns[first:end], weights * taken.readings[first:end])
        matrix = np.linalg.inv([[one.real, four.real], [one.imag, four.imag]])
        rest, of_four = matrix @ [-two.real, -two.imag]
        course.append((p, q, 1.0 - rest, of_four))
    left = np.cumprod([1.0, *(1.0 - np.array(gains[::-1]))])
    squares, each = np.sum((left * [*gains[::-1], 1.0]) ** 2), np.array(alone[6:])
    variance = np.var(each, axis=0, ddof=1) * (len(each) - 1) / (len(each) - 3)
    size = len(each) // 10
    if size >= 4:
        slow = size * np.var(each[-10 * size :].reshape(10, size, 2).mean(axis=1), axis=0, ddof=1)
        variance = np.where(slow > 2.0 * variance, slow * 9.0 / 7.0, variance)
    by_noise = matrix @ (np.linalg.pinv(weights * columns[first:end]) * weights.T)[:2] * 1e-3
    recursive = np.linalg.norm(by_noise, axis=1) * np.sqrt(rest**2 + 1.0 + of_four**2)
    return course, np.array([np.sqrt(squares * variance), recursive])


@pytest.mark.parametrize(("seconds", "aging"), [(100, 0.0), (390, 0.0), (402, 5e-3)])
def test_both_estimators_are_those_of_numpy_whatever_the_blocks(seconds: float, aging: float) -> None:
    """Of readings far from zero, which drift; 11, 47 and 49 turns, in the last of which p drifts as well."""
    far = {"offset": (1e5,) * 4, "drift": (0.3, -0.2, 0.5, 0.1)}
    taken = disk.record(seconds=seconds, rate=4, start=1.0, noise=1e-3, **far)
    taken.readings[:, 1] += (taken.readings[:, 1] - 1e5) * aging * taken.time / seconds
    alone, together = (pushed(taken, block=size)[0] for size in (1, 100_000))
    course, u = by_numpy(taken, per_turn=32)
    assert len(alone.course) == alone.turns == len(course)
    for online in (alone, together):
        np.testing.assert_allclose(online.course, course, atol=2e-8)
        loops, recursive = online.loops.coefficients(), online.recursive.coefficients()
        assert online.turned == pytest.approx(0.125 * (seconds - 0.25))
        if len(course) > 11:
            assert (loops.u_p, loops.u_q) == pytest.approx(u[0], rel=1e-5)
        if not aging:
            assert (recursive.u_p, recursive.u_q) == pytest.approx(u[1], rel=0.15)


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

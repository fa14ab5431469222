"""Matching a pair online: how fast, how well, and what happens where the stream is not what it should be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from support import accelerometer_disk as disk

from tiltcal.core.pair.model import Pair
from tiltcal.core.pair.online import Online
from tiltcal.drivers.stage import Disk, Gradiometer

PAIR = Pair("a1", "a2", "a4")
TRUTH = disk.truth()


def pushed(taken: disk.Record, block: int = 5000) -> tuple[Online, list[str]]:
    online, said = Online(PAIR, disk.NAMES), []
    for start in range(0, len(taken.theta), block):
        part = taken.rows(slice(start, start + block))
        said += [str(notice) for notice in online.push(part.theta, part.readings.T)]
    return online, said


def estimates(online: Online) -> tuple[float, ...]:
    return (online.loops.p, online.loops.q, online.recursive.p, online.recursive.q)


def joined(*parts: disk.Record) -> disk.Record:
    return disk.Record(
        np.concatenate([part.time for part in parts]),
        np.concatenate([part.theta for part in parts]),
        np.concatenate([part.readings for part in parts]),
    )


TAKEN = disk.record(start=200.0)


@pytest.fixture(scope="module")
def online() -> Online:
    """Both estimators at the end of the laboratory record."""
    return pushed(TAKEN)[0]


def test_both_estimators_go_on_once_a_turn() -> None:
    online, course = Online(PAIR, disk.NAMES), []
    for start in range(0, 4000, 10):
        online.push(TAKEN.theta[start : start + 10], TAKEN.readings[start : start + 10].T)
        course.append(estimates(online))
    assert len(set(course)) == 1 + online.stream.turns == 1 + len(online.course)


class TestLaboratoryRecord:
    @pytest.mark.parametrize("kind", ["loops", "recursive"])
    def test_p_and_q_are_within_2e_5_and_suppress_1e5_times(self, online: Online, kind: str) -> None:
        """The figure of the source: 1e5 after p and q."""
        found = getattr(online, kind)
        assert (found.p, found.q) == pytest.approx(TRUTH, abs=2e-5)
        assert disk.suppression(TAKEN, found.p, found.q) > 1e5

    def test_1_over_f_noise_counts_with_what_it_has_at_the_turning(self) -> None:
        """With its corner at 0.1 Hz; the formula for white noise covers 87 %."""
        covered = []
        for seed in range(16):
            taken = disk.record(seconds=240, rate=5, corner=0.1, noise=3e-3, seed=seed)
            found = pushed(taken)[0].recursive.coefficients()
            covered += (np.abs(np.array([found.p, found.q]) - TRUTH) < 1.96 * np.array([found.u_p, found.u_q])).tolist()
        assert float(np.mean(covered)) > 0.88

    def test_readings_that_drift_far_away_do_not_reach_the_loops(self) -> None:
        """Over the record by 20 times their size, within a turn by a quarter of it."""
        taken = disk.record(drift=(80.0, -40.0, 0.0, 60.0))
        assert estimates(pushed(taken)[0]) == pytest.approx((*TRUTH, *TRUTH), abs=5e-5)

    def test_q_waits_until_p_has_settled(self, online: Online) -> None:
        first_q = next(one.turns for one in online.course if one.loops[1] != 0.0)
        at_that = next(one for one in online.course if one.turns == first_q)
        before = next(one for one in online.course if one.turns == first_q - 1.0)
        assert first_q > 2.0
        assert abs(before.loops[0] - TRUTH[0]) < 3e-3
        assert abs(at_that.loops[1] - TRUTH[1]) > 1e-3

    def test_one_by_one_gives_what_a_block_gives(self) -> None:
        taken = disk.record(seconds=60, rate=20)
        alone, together = (pushed(taken, block=size)[0] for size in (1, 100_000))
        assert estimates(alone) == pytest.approx(estimates(together), abs=1e-12)


# Fewer turns

TWIN = Disk(rate=16.0, noise=1.5e-7, corner=0.05, wander=0.02, encoder_noise=0.01)
TWIN_TRUTH = disk.truth(
    scale=[one.scale for one in TWIN.accelerometers], misalignment=[one.misalignment for one in TWIN.accelerometers]
)


def test_the_recursive_estimator_needs_at_most_half_the_turns_at_the_papers_noise() -> None:
    """200 turns of the twin: until the matched sum stays as near to zero as the loops end."""
    stage = Gradiometer(TWIN, seed=3)
    samples = [stage.sample(number) for number in range(200 * 128)]
    theta, readings = (np.array([getattr(one, name) for one in samples]) for name in ("theta", "readings"))
    online = Online(PAIR, disk.NAMES)
    online.push(theta, readings.T)
    away = {
        kind: np.hypot(*(np.array([getattr(one, kind) for one in online.course]) - TWIN_TRUTH).T)
        for kind in ("loops", "recursive")
    }
    floor = float(np.max(away["loops"][-30:]))
    loops, recursive = (int(np.flatnonzero(one > floor)[-1]) + 2 for one in away.values())
    assert recursive <= loops / 2


# A stream that is not what it should be


class TestHolding:
    BEFORE, AFTER = disk.record(seconds=240), disk.record(seconds=240, seed=5)

    def test_the_stage_stops_and_turns_again(self) -> None:
        standing = self.BEFORE.rows(slice(-1, None))
        taken = joined(self.BEFORE, *[standing] * 3000, self.AFTER)
        online, said = pushed(taken)
        assert [line.split(": ")[1] for line in said] == ["held, the stage stands still", "goes on"]
        assert int(said[0].split(": ")[0].removeprefix("row ")) < 12_000 + 400
        assert estimates(online) == pytest.approx((*TRUTH, *TRUTH), abs=1e-4)

    def test_while_the_stage_stands_p_and_q_are_held(self) -> None:
        online, _ = pushed(self.BEFORE)
        held = estimates(online)
        noise = np.random.default_rng(0).normal(0.0, 1.0, (20_000, 4))
        said = online.push(np.full(20_000, self.BEFORE.theta[-1]), noise.T)
        assert [notice.why for notice in said] == ["the stage stands still"]
        assert online.stream.why == "the stage stands still"
        assert estimates(online) == pytest.approx(held, abs=3e-5)

    def test_a_gap(self) -> None:
        later = self.BEFORE.rows(self.BEFORE.time > 130)
        online, said = pushed(joined(self.BEFORE.rows(self.BEFORE.time < 101.3), later))
        assert [line.split(": ")[1] for line in said] == ["held, the stream has a gap", "goes on"]
        assert estimates(online) == pytest.approx((*TRUTH, *TRUTH), abs=1e-4)

    @pytest.mark.parametrize("channel", [0, 1, 3])
    def test_a_channel_that_is_away_for_a_while(self, channel: int) -> None:
        readings = self.BEFORE.readings.copy()
        readings[3000:6000, channel] = np.nan
        online, said = pushed(replace(self.BEFORE, readings=readings))
        assert [line.split(": ")[1] for line in said] == ["held, values are missing", "goes on"]
        assert 3000 <= online.stream.left_out < 3000 + 2 * 400
        assert estimates(online) == pytest.approx((*TRUTH, *TRUTH), abs=1e-4)

    def test_single_values_that_are_missing_hold_nothing(self) -> None:
        readings, theta = self.BEFORE.readings.copy(), self.BEFORE.theta.copy()
        readings[::7, 1] = np.nan
        theta[::11] = np.nan
        online, said = pushed(replace(self.BEFORE, readings=readings, theta=theta))
        assert said == []
        assert estimates(online) == pytest.approx((*TRUTH, *TRUTH), abs=1e-4)

    def test_an_encoder_that_runs_backwards_and_forwards_again(self) -> None:
        backwards = replace(self.AFTER, theta=(360.0 - self.AFTER.theta) % 360.0)
        online, said = pushed(joined(self.BEFORE, backwards))
        assert [line.split(": ")[1] for line in said] == ["held, the stage runs backwards"]
        held = estimates(online)
        more = disk.record(seconds=400, seed=9)
        assert [notice.why for notice in online.push(more.theta, more.readings.T)] == [""]
        assert held == pytest.approx((*TRUTH, *TRUTH), abs=1e-4)
        assert estimates(online) == pytest.approx((*TRUTH, *TRUTH), abs=1e-4)

    def test_p_near_one_is_refused_with_the_reason(self) -> None:
        online, said = pushed(disk.record(seconds=80, scale=(3.4, 0.05, 3.4, 3.4)))
        assert "too near to 1" in online.refused
        assert any("too near to 1" in line for line in said)


def test_p_and_q_that_drift_are_followed() -> None:
    """An aging of 1e-3 over 400 turns: the memory of 100 turns lags by 2.5e-4, a mean over all by 5e-4."""
    parts = []
    for k in range(40):
        scale: Sequence[float] = (3.383, 3.415 * (1 + 1e-3 * k / 40), 3.402, 3.390)
        parts.append(disk.record(seconds=80, rate=10, scale=scale, wander=0.0, seed=k))
    online, said = pushed(joined(*parts))
    end = disk.truth(scale=(3.383, 3.415 * (1 + 1e-3 * 39 / 40), 3.402, 3.390))
    assert said == []
    assert online.loops.p == pytest.approx(end[0], abs=1e-4)
    assert online.recursive.p == pytest.approx(end[0], abs=3e-4)


@pytest.mark.parametrize("loops", [False, True], ids=["recursive", "loops"])
def test_the_uncertainty_over_gaps_is_that_of_the_error(loops: bool) -> None:
    """Six gaps of up to five turns in 100: the root mean square of error over stated uncertainty, 3.3 of the loops."""
    away = []
    for seed in range(24):
        taken, draw = disk.record(rate=10, noise=3e-3, seed=seed), np.random.default_rng(seed)
        kept = np.ones(len(taken.time), dtype=bool)
        for start in draw.integers(len(kept), size=6):
            kept[start : start + draw.integers(20, 400)] = False
        found = pushed(taken.rows(kept))[0].coefficients(loops=loops)
        away += [(found.p - TRUTH[0]) / found.u_p, (found.q - TRUTH[1]) / found.u_q]
    assert 0.7 < float(np.sqrt(np.mean(np.square(away)))) < 1.5

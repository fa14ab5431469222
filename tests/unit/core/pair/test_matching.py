"""Matching a pair offline: p and q of a record, their uncertainty, and what cannot be matched."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import islice
from math import hypot

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support import accelerometer_disk as disk

import tiltcal
from tiltcal.core.pair.demodulate import MOST_BLOCKS, Demodulation, demodulate
from tiltcal.core.pair.matching import Matching, PairCoefficients, match, solve
from tiltcal.core.pair.model import Pair, matched_sum, matching_coefficients
from tiltcal.core.pair.stage import follow, require_turns
from tiltcal.errors import EstimateError

PAIR = Pair("a1", "a2", "a4")
OTHER = Pair("a3", "a4", "a1")


def demodulated(taken: disk.Record) -> Demodulation:
    angle = follow(taken.theta)
    require_turns(angle)
    return demodulate(disk.NAMES, angle, taken.readings.T)


def solved(records: Iterable[disk.Record], together: int = 25) -> Iterator[PairCoefficients]:
    """p and q of each record; records of one stage are demodulated together, as channels of one record."""
    for some in batched(records, together):
        names = tuple(f"{name}/{number}" for number in range(len(some)) for name in disk.NAMES)
        found = demodulate(names, follow(some[0].theta), np.concatenate([one.readings.T for one in some]))
        for number in range(len(some)):
            yield solve(found, Pair(*(f"{name}/{number}" for name in PAIR.channels)))


def batched(records: Iterable[disk.Record], size: int) -> Iterator[list[disk.Record]]:
    """So many records at a time."""
    left = iter(records)
    while some := list(islice(left, size)):
        yield some


def test_records_that_are_demodulated_together_are_those_that_are_not() -> None:
    records = [disk.record(**SHORT, seed=seed) for seed in range(3)]
    for one, alone in zip(solved(records), records, strict=True):
        found = solve(demodulated(alone), PAIR)
        assert (one.p, one.q, one.u_p, one.u_q) == pytest.approx((found.p, found.q, found.u_p, found.u_q), rel=1e-9)


def matched(taken: disk.Record, pair: Pair = PAIR) -> Matching:
    return match(demodulated(taken), pair)


# The equations

small = st.floats(-0.05, 0.05)
scales = st.floats(2.0, 5.0)


class TestEquations:
    @given(st.tuples(scales, scales, scales), st.tuples(small, small, small), st.floats(0.0, 360.0))
    def test_eq_7_takes_the_common_acceleration_out_exactly(
        self, scale: tuple[float, float, float], misalignment: tuple[float, float, float], theta: float
    ) -> None:
        p, q = matching_coefficients(np.array(scale), np.array(misalignment))
        angles = np.deg2rad(theta) + np.deg2rad([0.0, 180.0, 270.0])
        felt = np.array(scale) * (np.sin(angles) + np.array(misalignment) * np.cos(angles))
        assert abs(float(matched_sum(*felt, p, q))) < 1e-13

    def test_eq_7_by_hand(self) -> None:
        # K 2, 1, 1 and δP 0.1, 0, 0: p = (2 - 1) / 2, q = 1 * 0.1 / 1.
        assert matching_coefficients(np.array([2.0, 1.0, 1.0]), np.array([0.1, 0.0, 0.0])) == (0.5, 0.1)

    def test_with_the_plus_signs_of_the_text_copy_nothing_is_nulled(self) -> None:
        scale, misalignment = np.array([3.383, 3.415, 3.390]), np.array([0.022, -0.015, -0.02])
        p, q = matching_coefficients(scale, misalignment)
        k1, k2, k4 = scale
        d1, d2, d4 = misalignment
        printed = (k1 + k2 / (1 - p) + q * k4 * d4 / (1 - p), k1 * d1 + k2 * d2 / (1 - p) + q * k4 / (1 - p))
        mended = (k1 - k2 / (1 - p) + q * k4 * d4 / (1 - p), k1 * d1 - k2 * d2 / (1 - p) - q * k4 / (1 - p))
        assert max(map(abs, mended)) < 1e-14
        assert min(map(abs, printed)) > 0.1


# The record of the laboratory

LABORATORY = disk.record(start=37.0, offset=(0.5, -0.2, 0.1, 0.0), drift=(0.01, 0.0, -0.02, 0.03))


class TestLaboratoryRecord:
    def test_p_and_q_are_within_2e_5(self) -> None:
        for pair, numbers in ((PAIR, (0, 1, 3)), (OTHER, (2, 3, 0)), (Pair("a3", "a4", "a2"), (2, 3, 1))):
            found = matched(LABORATORY, pair)
            p, q = disk.truth(pair=numbers)
            assert found.p == pytest.approx(p, abs=2e-5)
            assert found.q == pytest.approx(q, abs=2e-5)
            assert abs(found.p - p) < 4 * found.u_p
            assert abs(found.q - q) < 4 * found.u_q

    def test_the_common_acceleration_is_suppressed_5e4_times(self) -> None:
        found = matched(LABORATORY)
        assert disk.suppression(LABORATORY, found.p, found.q) > 5e4
        assert 5e4 < found.suppression["pq"] < 1e7

    def test_p_and_q_of_one_half_hold_in_the_other(self) -> None:
        half = len(LABORATORY.time) // 2
        found = matched(LABORATORY.rows(slice(None, half)))
        assert disk.suppression(LABORATORY.rows(slice(half, None)), found.p, found.q) > 5e4

    def test_components_are_those_of_an_independent_regression(self) -> None:
        found = matched(LABORATORY)
        a1, a2, _, a4 = LABORATORY.readings.T
        sums = {
            "before": a1 + a2,
            "after_p": a1 + a2 / (1 - found.p),
            "after_pq": a1 + (a2 + found.q * a4) / (1 - found.p),
        }
        for stage, signal in sums.items():
            one = found.components[stage]["sum"]
            assert (one.sin, one.cos) == pytest.approx(disk.judged(LABORATORY, signal), abs=2e-6)
        before = found.components["before"]["a1"]
        assert (before.sin, before.cos) == pytest.approx(disk.judged(LABORATORY, a1), abs=2e-5)


class TestWhatAllChannelsShare:
    """Noise-free, so that a bias has nowhere to hide."""

    def test_an_amplitude_that_wanders_changes_nothing(self) -> None:
        found = matched(disk.record(seconds=80, noise=0.0, wander=0.5))
        assert (found.p, found.q) == pytest.approx(disk.truth(), abs=1e-12)

    def test_nor_does_the_direction_of_the_acceleration(self) -> None:
        found = matched(disk.record(seconds=80, noise=0.0, start=123.0))
        assert (found.p, found.q) == pytest.approx(disk.truth(), abs=1e-12)

    def test_nor_the_noise_of_the_encoder(self) -> None:
        taken = disk.record(seconds=80, noise=0.0)
        noise = np.random.default_rng(1).normal(0.0, 0.5, len(taken.theta))
        found = matched(replace(taken, theta=taken.theta + noise))
        assert (found.p, found.q) == pytest.approx(disk.truth(), abs=1e-12)

    def test_nor_do_rows_that_are_missing(self) -> None:
        taken = disk.record(seconds=80, noise=0.0)
        kept = np.random.default_rng(1).random(len(taken.theta)) < 0.6
        found = matched(taken.rows(kept))
        assert (found.p, found.q) == pytest.approx(disk.truth(), abs=1e-12)

    def test_a_drift_that_is_left_out_would_cost_more_than_the_noise(self) -> None:
        taken = disk.record(seconds=24, noise=0.0, wander=0.0, drift=(0.0, 0.1, 0.0, 0.0))
        assert matched(taken).p == pytest.approx(disk.truth()[0], abs=1e-12)
        angle = np.deg2rad(taken.theta)
        columns = np.stack([np.sin(angle), np.cos(angle), np.ones_like(angle)], axis=1)
        without = np.linalg.lstsq(columns, taken.readings[:, 1], rcond=None)[0]
        assert abs(without[0] + 3.415) > 1e-3

    def test_an_offset_of_a_million_keeps_the_uncertainty(self) -> None:
        near, far = (matched(disk.record(seconds=80, offset=offset)) for offset in ((0.0,) * 4, (1e6, 1e6, 1e6, 1e6)))
        assert far.u_p == pytest.approx(near.u_p, rel=0.01)


# Uncertainty

RECORDS = 2500
SHORT = {"seconds": 200.0, "rate": 5.0, "spin": 0.125, "noise": 3e-3}


@pytest.fixture(scope="module")
def many() -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """p, q, u_p and u_q of 2,500 records of 25 turns."""
    found = solved(disk.record(**SHORT, seed=seed) for seed in range(RECORDS))
    return np.array([[one.p, one.q, one.u_p, one.u_q] for one in found])


class TestUncertainty:
    def test_a_95_percent_interval_has_the_truth_in_94_to_96_percent(self, many: np.ndarray) -> None:
        covered = np.abs(many[:, :2] - disk.truth()) < 1.96 * many[:, 2:]
        assert ((covered.mean(axis=0) > 0.94) & (covered.mean(axis=0) < 0.96)).all(), covered.mean(axis=0)

    def test_nothing_is_lost_against_the_cramer_rao_bound(self, many: np.ndarray) -> None:
        efficiency = bound() / many[:, :2].var(axis=0)
        assert (efficiency > 0.9).all(), efficiency

    def test_there_is_no_bias(self, many: np.ndarray) -> None:
        error = many[:, :2].mean(axis=0) - disk.truth()
        assert (np.abs(error) < 4 * many[:, :2].std(axis=0) / np.sqrt(RECORDS)).all()

    def test_noise_that_is_stronger_at_the_turning_counts(self) -> None:
        """A resonance at the turning: white noise between the harmonics would understate it fivefold."""
        ratio = []
        for seed in range(60):
            taken = disk.record(seconds=400, rate=10, noise=3e-4, seed=seed)
            draw = np.random.default_rng(seed + 1000)
            angle = np.deg2rad(taken.theta)
            turn = np.cumsum(np.diff(taken.theta, prepend=taken.theta[0]) < 0)
            sines, cosines = 3e-4 * draw.standard_normal((2, turn[-1] + 1))
            resonance = sines[turn] * np.sin(angle) + cosines[turn] * np.cos(angle)
            taken.readings[:, 1] += resonance
            found = matched(taken)
            ratio.append((found.p - disk.truth()[0]) / found.u_p)
        assert 0.75 < float(np.std(ratio)) < 1.3

    @pytest.mark.parametrize("turns", [10, 25])
    def test_1_over_f_noise_counts_with_what_it_has_at_the_turning(self, turns: int) -> None:
        """With its corner at 0.1 Hz; the formula for white noise covers 87 %."""
        taken = (disk.record(seconds=8.0 * turns, rate=10, corner=0.1, noise=3e-3, seed=seed) for seed in range(500))
        found = solved(taken)
        covered = [
            (abs(one.p - disk.truth()[0]) < 1.96 * one.u_p, abs(one.q - disk.truth()[1]) < 1.96 * one.u_q)
            for one in found
        ]
        assert 0.92 < float(np.mean(covered)) < 0.98

    def test_a_record_that_is_merged_to_coarser_blocks_says_the_same(self) -> None:
        turns = 3 * MOST_BLOCKS
        taken = disk.record(seconds=turns * 8.0, rate=3.0, noise=3e-3)
        found = matched(taken)
        p, q = disk.truth()
        assert abs(found.p - p) < 4 * found.u_p < 4e-4
        assert abs(found.q - q) < 4 * found.u_q < 4e-4


def bound() -> np.ndarray:
    """The Cramér-Rao bound of p and q for the short record: Fisher's information of the model, numerically."""
    n = round(SHORT["seconds"] * SHORT["rate"])
    time = np.arange(n) / SHORT["rate"]
    angle = 2 * np.pi * SHORT["spin"] * time
    p, q = disk.truth()

    def model(parameters: np.ndarray) -> np.ndarray:
        s1, c1, s4, c4, p, q = parameters[:6]
        s2, c2 = -(1 - p) * s1 - q * s4, -(1 - p) * c1 - q * c4
        lines = [s * np.sin(angle) + c * np.cos(angle) for s, c in ((s1, c1), (s2, c2), (s4, c4))]
        nuisance = parameters[6:].reshape(3, 2)
        return np.concatenate(
            [line + one[0] + one[1] * time / time[-1] for line, one in zip(lines, nuisance, strict=True)]
        )

    at = np.array([3.383, 3.383 * 0.022, -3.390 * 0.02, -3.390, p, q, *[0.0] * 6])
    steps = 1e-6 * np.eye(len(at))
    jacobian = np.stack([(model(at + step) - model(at - step)) / 2e-6 for step in steps], axis=1)
    covariance = np.linalg.inv(jacobian.T @ jacobian) * SHORT["noise"] ** 2
    return np.diag(covariance)[4:6]


# What cannot be matched


class TestRefusals:
    def refused(self, taken: disk.Record, pair: Pair = PAIR) -> str:
        with pytest.raises(EstimateError) as refusal:
            matched(taken, pair)
        return str(refusal.value)

    def test_less_than_two_turns(self) -> None:
        assert "has 1.87 turns of the stage; at least 2" in self.refused(disk.record(seconds=15.0))
        assert "has 1.99 turns of the stage; at least 2" in self.refused(disk.record(seconds=15.98))

    def test_two_turns_of_rows_are_two_turns(self) -> None:
        found = matched(disk.record(seconds=16.0))
        assert (found.p, found.q) == pytest.approx(disk.truth(), abs=1e-4)

    def test_a_stage_that_stands(self) -> None:
        taken = disk.record(seconds=80)
        assert "not turning" in self.refused(replace(taken, theta=np.full_like(taken.theta, 12.0)))

    def test_an_encoder_that_runs_backwards(self) -> None:
        taken = disk.record(seconds=80)
        assert "runs backwards, 10.00 turns" in self.refused(replace(taken, theta=360.0 - taken.theta))

    def test_a_stage_that_turns_back_to_where_it_began(self) -> None:
        taken = disk.record(seconds=80)
        theta = np.concatenate([taken.theta[:2000], taken.theta[2000:0:-1]])
        assert "in the middle of the record" in self.refused(replace(taken.rows(slice(4000)), theta=theta))

    def test_a_stage_that_turns_back_in_the_middle(self) -> None:
        taken = disk.record(seconds=80)
        theta = np.where(taken.time < 60, taken.theta, disk.record(seconds=80, spin=-0.125).theta)
        assert "in the middle of the record" in self.refused(replace(taken, theta=theta))

    def test_p_near_one(self) -> None:
        said = self.refused(disk.record(seconds=80, scale=(3.4, 0.05, 3.4, 3.4)))
        assert "p is 0.98" in said
        assert "a2 answers with 0.01" in said

    def test_a_second_accelerometer_of_the_wrong_polarity(self) -> None:
        assert "same polarity" in self.refused(disk.record(seconds=80, scale=(3.4, -3.4, 3.4, 3.4)))

    def test_an_axis_that_is_not_inclined(self) -> None:
        assert "a1 has no clear signal" in self.refused(disk.record(seconds=80, scale=(1e-6,) * 4))

    def test_an_orthogonal_channel_that_is_dead(self) -> None:
        assert "a4 has" in self.refused(disk.record(seconds=80, scale=(3.4, 3.4, 3.4, 1e-6)))

    def test_an_orthogonal_channel_that_is_opposite(self) -> None:
        assert "a2 is not orthogonal to a1" in self.refused(disk.record(seconds=80), Pair("a1", "a3", "a2"))


class TestStage:
    @given(st.floats(-0.12, 0.4), st.floats(0.0, 1.0), st.integers(2, 60), st.integers(1, 59))
    def test_wrapped_angles_are_followed_over_their_turns(
        self, step: float, start: float, count: int, cut: int
    ) -> None:
        turns = start + step * np.arange(count)
        theta = turns * 360.0 % 360.0
        first = follow(theta[:cut])
        followed = np.concatenate([first, follow(theta[cut:], float(first[-1]))])
        assert followed - followed[0] == pytest.approx(turns - turns[0], abs=1e-9)

    def test_a_jump_back_is_a_gap(self) -> None:
        angle = np.array([0.0, 10.0, 20.0, 240.0, 250.0])
        assert follow(angle) * 360.0 == pytest.approx(angle)

    def test_after_a_million_turns_the_angle_is_as_exact_as_the_encoders(self) -> None:
        theta = np.tile([0.0, 120.0, 240.0], 1_000_000)
        assert float(np.max(np.abs(follow(theta) % 1.0 - theta / 360.0))) < 1e-9


def test_gain_for_a_gradient_is_what_eq_1_gives() -> None:
    """Of the matched sum over two ideal accelerometers, by a regression at twice the turning."""
    taken = disk.record(seconds=80, noise=0.0, wander=0.0, gradient=(0.2, 0.1))
    found = matched(taken)
    a1, a2, _, a4 = taken.readings.T
    sine, cosine = disk.judged(taken, a1 + (a2 + found.q * a4) / (1 - found.p), harmonic=2)
    assert hypot(sine, cosine) / (2 * 3.383 * hypot(0.1, 0.1)) == pytest.approx(found.gradient_gain, abs=3e-4)


def test_intervals_hold_where_all_turns_share_one_rounding() -> None:
    """Readings in steps of 0.01 with a hundredth of that in noise; 200 rows a turn, at the same places of each."""
    draw, turn, inside = np.random.default_rng(11), 2.0 * np.pi * np.arange(4000) / 200.0, []
    phases = np.radians([0.0, 180.0, 270.0])
    for _ in range(60):
        k, d = 3.4 * (1.0 + 0.01 * draw.normal(size=3)), 0.002 * draw.normal(size=3)
        true = [k[i] * (np.sin(turn + phases[i]) + d[i] * np.cos(turn + phases[i])) for i in range(3)]
        rows = np.round((np.array(true) + 1e-4 * draw.normal(size=(3, 4000))) / 0.01) * 0.01
        log = {"theta": np.degrees(turn) % 360.0, **dict(zip(("a1", "a2", "a4"), rows, strict=True))}
        (found,) = tiltcal.match(log, [("a1", "a2", "a4")], phase="theta").matchings
        p = (k[0] - k[1] + (k[0] * d[0] - k[1] * d[1]) * d[2]) / (k[0] * (1.0 + d[0] * d[2]))  # the source's eq. 6
        inside.append(abs(found.p - p) < 1.96 * found.u_p)
    assert np.mean(inside) > 0.85  # 11 % where only the scatter between turns counts

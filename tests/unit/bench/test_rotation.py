"""A rotation at the bench: what is used, what is held, when it ends, and what the operator hears of it."""

from itertools import chain
from pathlib import Path

import numpy as np
import pytest
from support import accelerometer_disk as disk
from support.stage_bench import A1_A2, A3_A4, Attendant, turned

from tiltcal.bench.rotation import ALL_TURNS, CONVERGED, STOPPED
from tiltcal.core.pair.matching import Matching
from tiltcal.errors import BusError, HardwareError, Stopped

# 100 lines a turn at 50 a second.
RECORD = disk.record(seconds=80.0, rate=50.0, spin=0.5, noise=3e-4, offset=(0.2, -0.1, 0.3, 0.0))
PER_TURN = 100


def near(matching: Matching, truth: tuple[float, float], sigmas: float = 4.0) -> bool:
    return abs(matching.p - truth[0]) < sigmas * matching.u_p and abs(matching.q - truth[1]) < sigmas * matching.u_q


def test_both_pairs_find_the_truth_and_agree_with_a_regression() -> None:
    attendant = Attendant()
    found = turned(RECORD.lines(), attendant, pairs=(A1_A2, A3_A4), turns=30)
    assert found.provenance.stopped == ALL_TURNS
    assert found.spin.turns == pytest.approx(30.0, abs=0.5)
    assert found.spin.frequency == pytest.approx(0.5, rel=1e-3)
    for matching, indices in zip(found.matchings, ((0, 1, 3), (2, 3, 0)), strict=True):
        assert near(matching, disk.truth(pair=indices))
        used = RECORD.rows(slice(0, 30 * PER_TURN))
        assert disk.regressed(used, indices) == pytest.approx((matching.p, matching.q), abs=matching.u_p)
        # 2 s / (A sqrt(n)), the amplitude being that of the first accelerometer
        amplitude = float(np.hypot(*disk.judged(used, used.readings[:, indices[0]])))
        assert matching.u_p == pytest.approx(2 * 3e-4 / amplitude / 3000**0.5, rel=0.2)
    assert [(turn.turn, turn.of) for turn in attendant.turns] == [(number, 30) for number in range(1, 31)]
    uncertainties = [turn.u_p["a1_a2"] for turn in attendant.turns[2:7]]  # fewer turns do not show their phase
    assert uncertainties == sorted(uncertainties, reverse=True)
    assert attendant.told == []
    assert attendant.accepted.p == {one.pair.name: pytest.approx(one.p, abs=1e-9) for one in found.matchings}


def test_it_stops_where_p_and_q_are_known_as_asked() -> None:
    attendant = Attendant()
    found = turned(RECORD.lines(), attendant, turns=40, converged=8e-6)
    assert found.provenance.stopped == CONVERGED
    assert found.matchings[0].u_p <= 8e-6
    # 2 * 3e-4 / (3.383 * sqrt(100 n)) is 8e-6 after 4.9 turns
    assert len(attendant.turns) in (5, 6, 7)


def test_noise_that_is_not_white_keeps_it_from_stopping_early() -> None:
    """Amplitudes that wander by themselves scatter from turn to turn, which no white noise within a turn shows."""
    wild = disk.record(seconds=80.0, rate=50.0, spin=0.5, noise=1e-5)
    draw = np.random.default_rng(1)
    wild.readings[:, 1] *= 1.0 + 1e-3 * np.repeat(draw.standard_normal(40), PER_TURN)
    found = turned(wild.lines(), Attendant(), turns=30, converged=1e-5)
    assert found.provenance.stopped == ALL_TURNS
    assert found.matchings[0].u_p > 5e-5


def test_the_word_stop_ends_it_with_what_is_there_once_there_are_two_turns() -> None:
    attendant = Attendant(stop_after=[5, 40])
    found = turned(RECORD.lines(), attendant, turns=100)
    assert found.provenance.stopped == STOPPED
    assert 2.0 < found.spin.turns < 5.0
    assert near(found.matchings[0], disk.truth())
    (refused,) = attendant.told
    assert refused.startswith("refused: the stage has made ")
    assert "at least 2 are needed" in refused


def test_a_stage_that_never_turns_is_refused_after_its_patience_and_asked_for_again() -> None:
    still = [disk.line(12.0, 1.0, -1.0, 0.1, -0.1)] * (50 * 70)
    attendant = Attendant(readies=2)
    found = turned(chain(still, RECORD.lines()), attendant, turns=4)
    assert near(found.matchings[0], disk.truth())
    (refused,) = attendant.told
    assert "the stage does not turn: start it, and check that the encoder counts (waited for 60 s)" in refused
    backwards = disk.Record(RECORD.time, -RECORD.theta % 360, RECORD.readings).lines()
    attendant = Attendant(readies=1)
    with pytest.raises(Stopped, match="enough"):
        turned(backwards, attendant)
    assert "turns backwards: its angle is to count up" in attendant.told[-1]


def test_a_gap_is_held_and_what_was_before_counts() -> None:
    attendant = Attendant()
    printed = [*RECORD.rows(slice(0, 730)).lines(), *RECORD.rows(slice(765, 2000)).lines()]
    found = turned(printed, attendant, turns=15)
    assert attendant.told == ["the stream has a gap", "goes on"]
    assert found.provenance.samples.used > 1400
    assert near(found.matchings[0], disk.truth())


def test_an_encoder_that_lost_its_zero_while_the_line_was_gone_changes_neither_p_nor_q() -> None:
    """Nor do offsets that step meanwhile; the break is told once."""
    before, after = RECORD.rows(slice(0, 1000)), RECORD.rows(slice(1040, 4000))
    moved = disk.Record(after.time, (after.theta + 123.0) % 360, after.readings + np.array([0.5, -0.2, 0.1, 0.3]))
    attendant, gone = Attendant(), [BusError("has gone")] * 3
    found = turned([*before.lines(), *gone, *moved.lines()], attendant, turns=30)
    assert attendant.told == ["has gone; the samples before count", "goes on"]
    assert near(found.matchings[0], disk.truth())
    # By Fourier's sum over ten whole turns and twenty: nothing is lost to the other zero.
    used = np.r_[0:1000, 1040:3040]
    whole = 2.0 * abs(np.mean(RECORD.readings[used, 0] * np.exp(1j * np.radians(RECORD.theta[used]))))
    assert found.matchings[0].components["before"]["a1"].amplitude == pytest.approx(whole, rel=3e-4)
    assert found.provenance.samples.used > 2900


def test_a_damaged_line_is_left_out_and_told_once_a_turn() -> None:
    printed = RECORD.lines()
    printed[150] = b"12.0,3.1,4.1\r\n"
    printed[175] = b"12.0,3.1,x,4,5\r\n"
    attendant = Attendant()
    found = turned(printed, attendant, turns=5)
    assert attendant.told == ["2 damaged or lost on the line, and left out", "goes on"]
    assert found.provenance.samples.left_out == 2
    assert near(found.matchings[0], disk.truth())


def test_turns_too_few_to_tell_their_phase_do_not_survive_an_interruption() -> None:
    printed = RECORD.lines()
    printed[150:150] = [BusError("has gone")]
    attendant = Attendant()
    found = turned(printed, attendant, turns=6)
    assert "samples of fewer turns than 2 are left out" in attendant.told[0]
    assert found.provenance.samples.left_out > 80
    assert found.spin.turns == pytest.approx(6.0, abs=0.5)
    assert near(found.matchings[0], disk.truth())


def test_a_line_that_stays_away_ends_the_session_which_goes_on_once_it_is_back(tmp_path: Path) -> None:
    journal = tmp_path / "j.journal.jsonl"
    printed = [*RECORD.lines()[:520], *(BusError("has gone") for _ in range(9))]
    with pytest.raises(HardwareError, match="has gone"):
        turned(printed, Attendant(), turns=8, journal=journal)
    with pytest.raises(HardwareError, match="has gone"):
        turned(printed[-9:], Attendant(), turns=8, journal=journal, resume=True)
    attendant = Attendant()
    found = turned(RECORD.lines()[745:], attendant, turns=8, journal=journal, resume=True)
    assert attendant.turns[0].turn > 5
    assert near(found.matchings[0], disk.truth())


def test_pairs_without_a_signal_are_left_out_with_the_reason() -> None:
    dead = disk.record(seconds=40.0, rate=50.0, spin=0.5)
    dead.readings[:, 2] = 0.5 + 1e-4 * np.random.default_rng(2).standard_normal(len(dead.time))
    attendant = Attendant()
    found = turned(dead.lines(), attendant, pairs=(A1_A2, A3_A4), turns=6)
    assert [matching.pair for matching in found.matchings] == [A1_A2]
    (why,) = found.provenance.not_matched
    assert "a3 has no clear signal at the spin frequency" in why
    assert "a3 has no clear signal at the spin frequency" in attendant.turns[-1].unknown["a3_a4"]
    assert list(attendant.turns[-1].p) == ["a1_a2"]
    assert attendant.told == [why]

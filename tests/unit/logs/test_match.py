"""Matching a pair by a whole record: p and q, their uncertainty, and what cannot be matched."""

import re
from dataclasses import replace
from math import hypot

import numpy as np
import pytest
from support import accelerometer_disk as stage

from tiltcal.core.pair.matching import Matching
from tiltcal.core.pair.model import Pair
from tiltcal.errors import EstimateError, UsageError
from tiltcal.library.recorded import match
from tiltcal.logs.match import match_log

THETA = np.arange(0.0, 20 * 360.0, 7.0)
PAIR = ("a1", "a2", "a4")
PAIRS = [PAIR]


def disk(scale: float) -> dict[str, np.ndarray]:
    """Readings of a turning stage, times a scale."""
    turn, noise = np.radians(THETA), np.random.default_rng(5).normal(0.0, 1e-4, (3, THETA.size))
    waves = np.array([np.sin(turn), -1.01 * np.sin(turn), np.cos(turn)]) + noise
    return {"theta": THETA, "time": THETA / 36.0} | dict(zip(("a1", "a2", "a4"), scale * waves, strict=True))


def frame(taken: stage.Record) -> dict[str, np.ndarray]:
    return {"time": taken.time, "theta": taken.theta, **dict(zip(stage.NAMES, taken.readings.T, strict=True))}


def matched(taken: stage.Record, pair: tuple[str, str, str] = PAIR) -> Matching:
    (found,) = match(frame(taken), [pair], phase="theta").matchings
    return found


SHARED = stage.record(seconds=80, noise=0.0)
DRAW = np.random.default_rng(1)


def test_what_all_channels_share_changes_nothing() -> None:
    """Noise-free, so that a bias has nowhere to hide."""
    for what, taken in {
        "amplitude": stage.record(seconds=80, noise=0.0, wander=0.5),
        "direction": stage.record(seconds=80, noise=0.0, start=123.0),
        "noise of the encoder": replace(SHARED, theta=SHARED.theta + DRAW.normal(0.0, 0.5, len(SHARED.theta))),
        "missing rows": SHARED.rows(DRAW.random(len(SHARED.theta)) < 0.6),
        "drift": stage.record(seconds=24, noise=0.0, wander=0.0, drift=(0.0, 0.1, 0.0, 0.0)),
    }.items():
        found = matched(taken)
        assert (found.p, found.q) == pytest.approx(stage.truth(), abs=1e-12), what


def test_gain_for_a_gradient_is_what_eq_1_gives() -> None:
    """Of the matched sum over two ideal accelerometers, by a regression at twice the turning."""
    taken = stage.record(seconds=80, noise=0.0, wander=0.0, gradient=(0.2, 0.1))
    found = matched(taken)
    a1, a2, _, a4 = taken.readings.T
    sine, cosine = stage.judged(taken, a1 + (a2 + found.q * a4) / (1 - found.p), harmonic=2)
    assert hypot(sine, cosine) / (2 * 3.383 * hypot(0.1, 0.1)) == pytest.approx(found.gradient_gain, abs=3e-4)


# Uncertainty


@pytest.mark.parametrize(
    ("online", "loops"), [(False, False), (True, False), (True, True)], ids=["offline", "recursive", "loops"]
)
def test_intervals_hold_where_all_turns_share_one_rounding(online: bool, loops: bool) -> None:
    """Steps of 0.01 with a hundredth of that in noise; 200 rows a turn, at the same places of each."""
    draw, theta, inside = np.random.default_rng(11), np.tile(1.8 * np.arange(200.0), 30), []
    for _ in range(30):
        scale, tilt = 3.4 * (1.0 + 0.01 * draw.normal(size=4)), 0.002 * draw.normal(size=4)
        angle = np.radians(theta)[:, None] + stage.PHASES
        felt = scale * (np.sin(angle) + tilt * np.cos(angle)) + 1e-4 * draw.normal(size=angle.shape)
        columns = dict(zip(stage.NAMES, np.round(felt.T / 0.01) * 0.01, strict=True))
        (found,) = match({"theta": theta, **columns}, PAIRS, phase="theta", online=online, loops=loops).matchings
        inside.append(abs(found.p - stage.truth(scale, tilt)[0]) < 1.96 * found.u_p)
    assert np.mean(inside) > 0.85  # 11 % where only the scatter between turns counts


def test_a_scale_factor_that_drifts_is_said() -> None:
    """That of a2 rises by 1e-3 over 100 turns, so p falls by 1e-3, and q, 0.037, rises by as large a share of it."""
    said: list[str] = []
    taken = stage.record(rate=10, noise=3e-5, corner=0.1)
    match(frame(taken), PAIRS, phase="theta", say=said.append)
    assert said == []
    taken.readings[:, 1] *= 1.0 + 1e-3 * taken.time / taken.time[-1]
    match(frame(taken), PAIRS, phase="theta", say=said.append)
    (line,) = said
    assert re.match(
        r"a1 and a2 drift, p by -0.001 and q by 3.[678]e-05 over the record, and the result is the mean", line
    )


# Units, columns and spectra


def test_readings_whose_squares_vanish() -> None:
    with pytest.raises(EstimateError, match=r"a1 has no clear signal at the spin frequency \(1e-"):
        match(disk(1e-170), PAIRS, phase="theta")
    with pytest.raises(EstimateError, match="no spectral line is above the noise"):
        match(disk(1e-170), PAIRS)


def test_spectra_are_those_of_the_turning_and_the_noise() -> None:
    """Eight turns of 80 rows, rounded up to a power of two, make a segment; white noise has 2 sigma² / rate."""
    columns = frame(stage.record(seconds=400, rate=10))
    for rate in (10.0, 1.0):
        how = {"phase": "theta", "online": False, "loops": False, "skip_bad_rows": False, "say": print}
        record, log, _ = match_log(columns, [Pair(*PAIR)], **how)
        frequency, densities = log.densities(record.matchings[0])
        assert frequency[1] == pytest.approx(rate / 1024)
        assert frequency[np.argmax(densities["a1"])] == pytest.approx(0.0125 * rate, abs=0.001 * rate)
        assert (log.frequency, log.rate) == pytest.approx((0.0125 * rate, rate), rel=1e-3)
        # a1, a2 and q a4 have one noise each.
        assert np.median(densities["sum after p and q"]) == pytest.approx(2 * 2 * 3e-4**2 / rate, rel=0.3)
        assert (record.spin.frequency is None) is (columns.pop("time", None) is None)
    record, log, _ = match_log({name: column[:500] for name, column in columns.items()}, [Pair(*PAIR)], **how)
    with pytest.raises(EstimateError, match="the record is too short for a spectrum; 16 turns will do"):
        log.densities(record.matchings[0])


def test_online_takes_the_stage_angle() -> None:
    with pytest.raises(UsageError, match="online needs phase"):
        match(disk(1.0), PAIRS, online=True)

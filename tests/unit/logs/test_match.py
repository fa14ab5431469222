"""Frames of accelerometer pairs: what is said of them, and what cannot be matched."""

from __future__ import annotations

import re

import numpy as np
import pytest
import scipy
from support import accelerometer_disk as stage

from tiltcal.errors import EstimateError, InputError, UsageError
from tiltcal.library.match import match
from tiltcal.logs.match import match_log, pairs_of

THETA = np.arange(0.0, 20 * 360.0, 7.0)
PAIRS = [("a1", "a2", "a4")]


def disk(scale: float) -> dict[str, np.ndarray]:
    """Readings of a turning stage, times a scale."""
    turn, noise = np.radians(THETA), np.random.default_rng(5).normal(0.0, 1e-4, (3, THETA.size))
    waves = np.array([np.sin(turn), -1.01 * np.sin(turn), np.cos(turn)]) + noise
    return {"theta": THETA, "time": THETA / 36.0} | dict(zip(("a1", "a2", "a4"), scale * waves, strict=True))


@pytest.mark.parametrize("scale", [1e-130, 1e-9, 1e9, 1e130])
@pytest.mark.parametrize("phase", ["theta", None])
def test_the_unit_of_readings_does_not_matter(scale: float, phase: str | None) -> None:
    (found,), (usual,) = (match(disk(by), PAIRS, phase=phase).matchings for by in (scale, 1.0))
    assert (found.p, found.u_p, found.u_q) == pytest.approx((usual.p, usual.u_p, usual.u_q), rel=1e-6)


@pytest.mark.parametrize("scale", [1e-300, 1e-170])
@pytest.mark.parametrize("online", [False, True])
def test_readings_whose_squares_vanish_are_no_signal(scale: float, online: bool) -> None:
    """They divided by zero."""
    with pytest.raises(EstimateError, match=r"a1 has no clear signal at the spin frequency \(1e-"):
        match(disk(scale), PAIRS, phase="theta", online=online)


@pytest.mark.parametrize("scale", [1e-300, 1e-170])
def test_readings_whose_squares_vanish_have_no_spin(scale: float) -> None:
    with pytest.raises(EstimateError, match="no spectral line is above the noise"):
        match(disk(scale), PAIRS)


@pytest.mark.parametrize("phase", ["theta", None])
def test_readings_whose_squares_overflow_are_no_measurement(phase: str | None) -> None:
    """Their uncertainty was NaN."""
    with pytest.raises(InputError, match=r"column 'a1' has a reading of .*e\+200, which is no measurement"):
        match(disk(1e200), PAIRS, phase=phase)


def test_a_stage_angle_in_the_column_of_times() -> None:
    """It ended in a KeyError; the angle is what the column holds."""
    readings = disk(1.0)
    turned = {**readings, "time": readings["theta"]}
    assert str(match(turned, PAIRS, phase="time")) == str(match(readings, PAIRS, phase="theta"))


def frame(taken: stage.Record) -> dict[str, np.ndarray]:
    return {"time": taken.time, "theta": taken.theta, **dict(zip(stage.NAMES, taken.readings.T, strict=True))}


@pytest.mark.parametrize("corner", [0.0, 0.1], ids=["white", "1/f"])
def test_a_scale_factor_that_drifts_is_said(corner: float) -> None:
    """That of a2 rises by 1e-3 over 100 turns, so p falls by 1e-3, and q, 0.037, rises by as large a share of it."""
    said: list[str] = []
    taken = stage.record(rate=10, noise=3e-5, corner=corner)
    match(frame(taken), PAIRS, phase="theta", say=said.append)
    assert said == []
    taken.readings[:, 1] *= 1.0 + 1e-3 * taken.time / taken.time[-1]
    match(frame(taken), PAIRS, phase="theta", say=said.append)
    (line,) = said
    assert re.match(
        r"a1 and a2 drift, p by -0.001 and q by 3.[678]e-05 over the record, and the result is the mean", line
    )


def test_spectra_are_those_of_welch() -> None:
    taken = stage.record(seconds=400, rate=10)
    found = match_log(frame(taken), pairs_of(PAIRS), phase="theta")
    (matching,) = found.calibration.matchings
    frequency, densities = found.log.densities(matching)
    after_pq = taken.readings @ [1.0, 1.0 / (1.0 - matching.p), 0.0, matching.q / (1.0 - matching.p)]
    for name, signal in (("a1", taken.readings[:, 0]), ("sum after p and q", after_pq)):
        # Eight turns of 80 rows, rounded up to a power of two.
        expected = scipy.signal.welch(signal, 10.0, nperseg=1024, noverlap=512, detrend="constant")
        assert frequency == pytest.approx(expected[0], rel=1e-3)
        assert densities[name] == pytest.approx(expected[1], rel=1e-3, abs=1e-15)


@pytest.mark.parametrize("loops", [False, True], ids=["recursive", "loops"])
def test_intervals_online_hold_where_all_turns_share_one_rounding(loops: bool) -> None:
    """Steps of 0.01 with a hundredth of that in noise; 200 rows a turn, at the same places of each."""
    draw, theta, inside = np.random.default_rng(11), np.tile(1.8 * np.arange(200.0), 30), []
    for _ in range(30):
        scale, tilt = 3.4 * (1.0 + 0.01 * draw.normal(size=4)), 0.002 * draw.normal(size=4)
        angle = np.radians(theta)[:, None] + stage.PHASES
        felt = scale * (np.sin(angle) + tilt * np.cos(angle)) + 1e-4 * draw.normal(size=angle.shape)
        columns = dict(zip(stage.NAMES, np.round(felt.T / 0.01) * 0.01, strict=True))
        (found,) = match({"theta": theta, **columns}, PAIRS, phase="theta", online=True, loops=loops).matchings
        inside.append(abs(found.p - stage.truth(scale, tilt)[0]) < 1.96 * found.u_p)
    assert np.mean(inside) > 0.85


def test_online_takes_the_stage_angle() -> None:
    with pytest.raises(UsageError, match="--online needs --phase"):
        match(disk(1.0), PAIRS, online=True)

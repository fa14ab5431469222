"""Whether two calibrations differ, over benches that are simulated here, by hand."""

from __future__ import annotations

from math import radians

import numpy as np
import pytest

import tiltcal
from tiltcal.calibration.calibrate import calibrate
from tiltcal.calibration.calibration import Calibration
from tiltcal.calibration.measurement import BenchUncertainty, MeasuredSensor, Measurement
from tiltcal.core.statistics import SampleSummary
from tiltcal.files.calibration import SensorIdentity
from tiltcal.files.procedure_file import find_procedure

SENSOR = SensorIdentity("sca100t-d02", "S", "count", ("x", "y"))
ZERO_45 = find_procedure("zero-45")
NOISE, PLACEMENT = 0.06, 0.2


def calibrated(rng: np.random.Generator, offset: float = 1024.0, jig: float | None = None) -> Calibration:
    """Level and 45° of each axis, set by hand with an error of 0.2° in each angle."""
    measurements = []
    for position in ZERO_45.positions:
        x, y, z = position.gravity
        turn = np.radians(rng.normal(0.0, PLACEMENT, 3))
        up = np.array([x, y, z]) + np.cross(turn, [x, y, z])
        mean = offset + 819.0 * up[:2] + rng.normal(0.0, NOISE, 2)
        summaries = {c: SampleSummary(float(v), 0.6, 100, NOISE, 0.0, 9.0) for c, v in zip("xy", mean, strict=True)}
        measurements.append(Measurement(position.name, position.gravity, position.tilt, None, summaries))
    return Calibration(calibrate([MeasuredSensor(SENSOR, measurements)], ZERO_45, BenchUncertainty(jig))[0])


def test_files_that_rest_on_noise_alone_call_no_unchanged_part_changed() -> None:
    """819 count/g times 0.2° is 2.9 counts, 48 times the noise: all 200 of 200 were called changed."""
    rng = np.random.default_rng(1)
    pairs = [tiltcal.compare(calibrated(rng), calibrated(rng)) for _ in range(4)]
    assert {one.verdict.word for one in pairs} == {"unknown"}
    assert "rests on noise alone" in str(pairs[0])
    assert pairs[0].as_data()["changed"] == []


def test_a_stated_jig_tells() -> None:
    """Two sessions with 0.2° of jig: a change of 20 counts is five times sqrt(2) 819 radians(0.2)."""
    rng = np.random.default_rng(2)
    old = calibrated(rng, jig=PLACEMENT)
    assert tiltcal.compare(old, calibrated(rng, jig=PLACEMENT)).verdict.word == "unchanged"
    moved = tiltcal.compare(old, calibrated(rng, 1044.0, jig=PLACEMENT))
    assert moved.verdict.word == "changed"
    (change,) = (one for one in moved.changes if one.name == "offset.x")
    assert change.u == pytest.approx(np.sqrt(2) * 819.0 * radians(PLACEMENT), rel=0.05)

"""What the estimate of set positions remarks; readings are simulated here, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from tiltcal.calibration.joint_fit import fit_jointly
from tiltcal.calibration.measurement import BenchUncertainty, MeasuredSensor, Measurement
from tiltcal.core.statistics import SampleSummary
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity
from tiltcal.files.procedure import find_procedure

SENSOR = SensorIdentity("recorded", "S", "g", ("x", "y", "z"))
NOISE, JIG = 1e-4, 0.1


def calibrated(stated: float, seed: int) -> CalibrationRecord:
    """The six faces, each four times over, set with an error of 0.1° in each angle."""
    rng = np.random.default_rng(seed)
    measurements = []
    for number, up in enumerate(np.tile(np.vstack([np.eye(3), -np.eye(3)]), (4, 1))):
        leaning = up + np.cross(np.radians(rng.normal(0.0, JIG, 3)), up)
        mean = leaning + rng.normal(0.0, NOISE, 3)
        summaries = {c: SampleSummary(float(v), 1e-3, 100, NOISE, 0.0, 9.0) for c, v in zip("xyz", mean, strict=True)}
        measurements.append(Measurement(f"p{number}", tuple(up.tolist()), None, None, summaries))
    sensor = MeasuredSensor(SENSOR, measurements)
    return fit_jointly([sensor], find_procedure("six-face"), BenchUncertainty(stated))[0]


def too_good(calibration: CalibrationRecord) -> bool:
    return any(note.startswith("the positions agree better than a jig of") for note in calibration.fit.notes)


@pytest.mark.parametrize("seed", range(3))
def test_a_jig_stated_twice_too_large_is_remarked(seed: int) -> None:
    assert too_good(calibrated(2 * JIG, seed))


def test_a_jig_as_stated_is_not() -> None:
    """A false alarm in 2 of 100."""
    assert sum(too_good(calibrated(JIG, seed)) for seed in range(10)) <= 1

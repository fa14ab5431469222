"""What the estimate of set positions states; readings are simulated here, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from tiltcal.calibration.fit import fit_jointly
from tiltcal.calibration.measurement import BenchUncertainty, MeasuredSensor, Measurement
from tiltcal.core.samples import SampleSummary
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity
from tiltcal.files.procedure import find_procedure

SENSOR = SensorIdentity("recorded", "S", "g", ("x", "y", "z"))
NOISE, JIG = 1e-4, 0.1


def calibrated(stated: float | None, seed: int, visits: int = 4) -> CalibrationRecord:
    """The six faces, each some times over, set with an error of 0.1° in each angle."""
    rng = np.random.default_rng(seed)
    measurements = []
    for number, up in enumerate(np.tile(np.vstack([np.eye(3), -np.eye(3)]), (visits, 1))):
        leaning = up + np.cross(np.radians(rng.normal(0.0, JIG, 3)), up)
        mean = leaning + rng.normal(0.0, NOISE, 3)
        summaries = {c: SampleSummary(float(v), 1e-3, 100, NOISE, 0.0, 9.0) for c, v in zip("xyz", mean, strict=True)}
        measurements.append(Measurement(f"p{number}", tuple(up.tolist()), None, None, summaries))
    sensor = MeasuredSensor(SENSOR, measurements)
    return fit_jointly([sensor], find_procedure("six-face"), BenchUncertainty(stated))[0]


@pytest.mark.parametrize("stated", [JIG, None], ids=["stated jig", "estimated jig"])
def test_derived_quantities_have_a_coverage_factor(stated: float | None) -> None:
    """The misalignment of z is that of its cross terms, so that its factor lies between theirs: Student's, where few
    residuals tell the jig."""
    found = calibrated(stated, 1, visits=2)
    terms = [found.uncertainty.coverage_factor[f"sensitivity.z.{axis}"] for axis in "xy"]
    assert found.derived.uncertainty is not None
    factor = found.derived.uncertainty.coverage_factor
    assert factor is not None
    for own in (factor.misalignment_degrees["z"], factor.cross_axis_percent["z"]):
        assert min(terms) - 0.02 < own < max(terms) + 0.02
        assert (own > 2.0) == (stated is None)

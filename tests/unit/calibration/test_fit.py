"""What follows from the estimate of set positions has the coverage factor of its terms."""

from dataclasses import replace

import numpy as np
import pytest
from support.measured import measured

from tiltcal.calibration.fit import fit_jointly
from tiltcal.calibration.measurement import BenchUncertainty, MeasuredSensor
from tiltcal.files.calibration import SensorIdentity
from tiltcal.files.procedure import find_procedure

SENSOR = SensorIdentity("recorded", "S", "g", ("x", "y", "z"))
SIX = find_procedure("six-face")


@pytest.mark.parametrize("stated", [0.1, None], ids=["stated jig", "estimated jig"])
def test_derived_quantities_have_a_coverage_factor(stated: float | None) -> None:
    """The misalignment of z is that of its cross terms, so that its factor lies between theirs: Student's, where few
    residuals tell the jig. Each face is set twice, with an error of 0.1° in each angle."""
    rng = np.random.default_rng(1)
    positions = [replace(one, name=f"{one.name}-{turn}") for turn in (1, 2) for one in SIX.positions]
    means = measured(
        positions, lambda one: one.gravity + np.cross(np.radians(rng.normal(0.0, 0.1, 3)), one.gravity), rng, 1e-4
    )
    (found,) = fit_jointly([MeasuredSensor(SENSOR, means)], SIX, BenchUncertainty(stated))
    terms = [found.uncertainty.coverage_factor[f"sensitivity.z.{axis}"] for axis in "xy"]
    factor = found.derived.uncertainty.coverage_factor
    for own in (factor.misalignment_degrees["z"], factor.cross_axis_percent["z"]):
        assert min(terms) - 0.05 < own < max(terms) + 0.05
        assert (own > 2.0) == (stated is None)

"""The calibration between two others, against calculations by hand."""

from __future__ import annotations

import numpy as np
import pytest

from tiltcal.calibration.interpolation import Interval
from tiltcal.core.model import Coefficients, Thermal
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity
from tiltcal.files.uncertainty import Uncertainty


def calibration(reference: float, factors: dict[str, float]) -> CalibrationRecord:
    """One channel that is uncertain by 0.1 at its reference, and by 0.1 more per °C."""
    thermal = Thermal(reference, None, np.array([[0.5]]), np.zeros((1, 0)))
    return CalibrationRecord(
        SensorIdentity("sca100t-d02", "S-1", "count", ("x",)),
        Coefficients(("x",), ("x",), np.array([1000.0]), np.array([[800.0]]), thermal),
        Uncertainty({"offset.x": 0.1, "temperature.offset.x.1": 0.1}, {}, factors),
    )


def test_an_offset_at_another_reference_has_the_degrees_of_freedom_of_the_drift_too() -> None:
    """By hand: u² = 0.1² + (20 * 0.1)² = 4.01, of which 4 has 1 degree of freedom: 1 in all, and t = 12.7, not 1.96."""
    before = calibration(20.0, {"temperature.offset.x.1": 12.706})
    found = Interval.between(before, calibration(0.0, {}), 100.0, "two files").at(0.0).uncertainty
    assert found["offset.x"] == pytest.approx(np.sqrt(4.01))
    assert found.coverage_factor["offset.x"] == pytest.approx(12.7, abs=0.1)
    assert found.coverage_factor["temperature.offset.x.1"] == pytest.approx(12.706, rel=1e-3)

"""The mounting of a calibrated sensor, against readings that are worked out by hand."""

from dataclasses import replace
from math import radians, sin, sqrt

import numpy as np
import pytest
import scipy
from support.measured import mean_of

from tiltcal.calibration.complete import mount
from tiltcal.calibration.measurement import Measurement
from tiltcal.core.attitude import mounting_matrix
from tiltcal.core.model import Coefficients, Mounting, Thermal
from tiltcal.core.samples import SampleSummary
from tiltcal.errors import EstimateError
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity
from tiltcal.files.coefficients import Uncertainty

LEVEL_X_Y = ((0.0, 0.0, 1.0), (0.5, 0.0, sqrt(0.75)), (0.0, 0.5, sqrt(0.75)))
"""Gravity in the application's frame: level, x up to 30°, y up to 30°."""


def base_of(sensitivity: list[list[float]], axes: tuple[str, ...]) -> CalibrationRecord:
    known = Coefficients(("x", "y"), axes, np.zeros(2), np.array(sensitivity))
    return CalibrationRecord(SensorIdentity("bench-built", "S-1", "count", ("x", "y")), known)


def positions(readings: list[tuple[float, float]], temperature: float | None = None) -> list[Measurement]:
    """Return the positions of ``LEVEL_X_Y`` with the readings of x and y, whose noise nothing states."""
    return [
        Measurement(f"p{k}", LEVEL_X_Y[k], None, temperature, {c: SampleSummary(u, 0.0, 1, 0.0) for c, u in pair})
        for k, pair in enumerate(zip("xy", row, strict=True) for row in readings)
    ]


def drifting(drift: float) -> CalibrationRecord:
    """Return a straight sensor of 819 count/g whose offset drifts from 24 °C on, count/°C."""
    base = base_of([[819.0, 0.0], [0.0, 819.0]], ("x", "y"))
    thermal = Thermal(24.0, None, np.full((2, 1), drift), np.zeros((2, 0)))
    return replace(base, coefficients=replace(base.coefficients, thermal=thermal))


@pytest.mark.parametrize("jig", [None, 0.1])
def test_the_z_column_counts_upside_down(jig: float | None) -> None:
    """Roll 180°: the sensor sees (x, -y, -z), and x reads 800 x - 8 z; taken for upright, x is wrong by 2 × 8/800."""
    base = base_of([[800.0, 0.0, 8.0], [0.0, 800.0, 0.0]], ("x", "y", "z"))
    read = [(800.0 * x - 8.0 * z, -800.0 * y) for x, y, z in LEVEL_X_Y]
    found = mount(base, positions(read), jig=jig)
    assert found.coefficients.mounting is not None
    np.testing.assert_allclose(mounting_matrix(found.coefficients.mounting), np.diag([1.0, -1.0, -1.0]), atol=1e-5)
    assert max(found.fit.mounting.residuals_degrees.values()) < 1e-3
    assert (found.fit.mounting.degrees_of_freedom, found.fit.mounting.p_value) == (3, 1.0 if jig else None)
    if jig:  # both angles of each direction are good to the jig: the Fisher information of the turn, by hand
        information = sum(np.eye(3) - np.outer(up, up) for up in LEVEL_X_Y)
        u = jig * np.sqrt(np.diag(np.linalg.inv(information)))
        assert [found.uncertainty[f"mounting.{angle}"] for angle in ("roll", "pitch", "yaw")] == pytest.approx(
            u, rel=1e-3
        )


def test_in_gimbal_lock_any_roll_and_yaw_are_stated_and_the_pitch_is_known() -> None:
    """Any angle of 360° has u = 180°/√3, and 0.95 √3 of them hold 95 %."""
    axes = ("x", "y", "z")
    known = Coefficients(axes, axes, np.zeros(3), 819.0 * np.eye(3))
    base = CalibrationRecord(SensorIdentity("bench-built", "S-1", "count", axes), known)
    read = 819.0 * np.array(LEVEL_X_Y) @ mounting_matrix(Mounting(0.0, radians(89.95), 0.0))
    seen = [mean_of(f"p{k}", up, row, 1e-3) for k, (up, row) in enumerate(zip(LEVEL_X_Y, read, strict=True))]
    found = mount(base, seen, jig=0.1)
    assert found.derived.gimbal_lock
    assert (found.coefficients.mounting.pitch, found.fit.mounting.chi_square) == pytest.approx(
        (radians(89.95), 0.0), abs=1e-4
    )
    information = sum(np.eye(3) - np.outer(up, up) for up in LEVEL_X_Y)
    u = {"roll": 180.0 / sqrt(3.0), "pitch": 0.1 * sqrt(np.linalg.inv(information)[1, 1]), "yaw": 180.0 / sqrt(3.0)}
    factors = found.uncertainty.coverage_factor
    assert {angle: found.uncertainty[f"mounting.{angle}"] for angle in u} == pytest.approx(u, rel=1e-3)
    assert [factors[f"mounting.{angle}"] for angle in u] == pytest.approx(
        [0.95 * sqrt(3.0), 1.96, 0.95 * sqrt(3.0)], abs=1e-3
    )


def test_a_base_that_drifts_needs_the_temperature_of_each_position() -> None:
    """At 5 °C the readings are 19 counts low: at the reference that is a roll and a pitch of asin(19/819) = 1.33°."""
    read = [(819.0 * x - 19.0, 819.0 * y - 19.0) for x, y, _ in LEVEL_X_Y]
    with pytest.raises(EstimateError, match="S-1 changes with temperature, and p0 has none"):
        mount(drifting(1.0), positions(read), jig=None)
    found = mount(drifting(1.0), positions(read, temperature=5.0), jig=None).coefficients.mounting
    assert found is not None
    np.testing.assert_allclose(mounting_matrix(found), np.eye(3), atol=1e-5)


def test_the_probability_is_that_of_chi_square_with_the_base_among_its_causes() -> None:
    """An offset that is 0.1° off is no turn: at 30° it leaves 0.013°, far more than a jig of 0.002°, unless stated."""
    off = 819.0 * sin(radians(0.1))
    read = positions([(819.0 * x + off, 819.0 * y) for x, y, _ in LEVEL_X_Y])
    base = base_of([[819.0, 0.0], [0.0, 819.0]], ("x", "y"))
    exact = mount(base, read, jig=0.002).fit.mounting
    assert exact.degrees_of_freedom == 3
    assert exact.p_value == pytest.approx(scipy.stats.chi2.sf(exact.chi_square, 3), rel=0.02)
    assert exact.p_value < 1e-3
    stated = mount(replace(base, uncertainty=Uncertainty({"offset.x": off, "offset.y": off})), read, jig=0.002)
    assert stated.fit.mounting.chi_square == exact.chi_square
    # A direction is uncertain by the offsets over 819, and by z, which follows x and y; half counts, of two angles.
    of_base = [sin(radians(0.1)) ** 2 * (2.0 + (x * x + y * y) / (z * z)) / 2.0 for x, y, z in LEVEL_X_Y]
    off = np.radians(list(stated.fit.mounting.residuals_degrees.values()))
    chi_square = np.sum(off**2 / (radians(0.002) ** 2 + np.array(of_base)))
    assert stated.fit.mounting.p_value == pytest.approx(scipy.stats.chi2.sf(chi_square, 3), rel=0.01)

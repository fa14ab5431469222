"""``--typical-temperature``: the data sheet's mean curves, asked for by name and told in the file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.command import measure

from tiltcal.calibration.stated import stated_uncertainty
from tiltcal.core.angle_uncertainty import CompensationWithUncertainty
from tiltcal.core.compensation import Compensation
from tiltcal.files.calibration import read_calibration


def offcorr(t: float) -> float:
    """The data sheet's mean offset curve in degrees (section 6 of the device facts), typed from there."""
    return -0.0000006 * t**3 + 0.0001 * t**2 - 0.0039 * t + 0.0522


def scorr(t: float) -> float:
    """The data sheet's mean sensitivity curve in per cent."""
    return -0.00011 * t**2 + 0.0022 * t + 0.0408


@pytest.fixture(scope="module")
def calibration(tmp_path_factory: pytest.TempPathFactory):
    folder = tmp_path_factory.mktemp("typical")
    result = measure("--typical-temperature", cwd=folder)
    assert result.returncode == 0, result.stderr
    return read_calibration(folder / "S-1.yaml")


def test_it_is_the_data_sheets_curve(calibration) -> None:
    thermal, reference = calibration.coefficients.thermal, calibration.coefficients.thermal.reference
    for t in (-20.0, 0.0, 40.0, 60.0):
        dt = t - reference
        drift = sum(k * dt**power for power, k in enumerate(thermal.drift[0], start=1))
        assert drift == pytest.approx(819.0 * 0.017453293 * (offcorr(t) - offcorr(reference)), abs=0.02)
        gain = sum(k * dt**power for power, k in enumerate(thermal.gain[1], start=1))
        expected = (1 + scorr(t) / 100) / (1 + scorr(reference) / 100) - 1
        assert gain == pytest.approx(expected, abs=2e-7)


def test_the_file_says_so_and_how_far_a_part_may_differ(calibration) -> None:
    assert any("not this unit's own" in line for line in calibration.derived.assumed)
    # ±0.008 °/°C and ±0.014 %/°C over the parts.
    assert calibration.uncertainty["temperature.offset.x.1"] == pytest.approx(819 * 0.017453293 * 0.008, rel=1e-3)
    assert calibration.uncertainty["temperature.sensitivity.y.1"] == pytest.approx(1.4e-4)


def test_the_spread_of_the_parts_is_in_the_angles(calibration) -> None:
    """±0.008 °/°C over the parts is ±0.32° at level, 40 °C away from the reference; noise and fit add 1 % to it."""
    known = calibration.coefficients
    inputs, _ = stated_uncertainty(calibration.uncertainty, known)
    temperatures = known.thermal.reference + np.array([40.0, 0.0])
    readings = known.predict(np.array([[0.0, 0.0, 1.0]] * 2), temperatures)
    _, (standard, _) = CompensationWithUncertainty(Compensation(known), known, inputs)(readings, temperatures)
    warm, usual = standard[:2].T
    assert np.sqrt(warm**2 - usual**2) == pytest.approx(0.32, rel=0.03)


def test_a_units_own_run_wins_and_other_models_have_no_curves(tmp_path: Path) -> None:
    refused = measure("--typical-temperature", cwd=tmp_path, procedure="mavs")
    assert (refused.returncode, "or measures them" in refused.stderr) == (2, True)
    refused = measure("--typical-temperature", "--sensor", "sca3000-d01", cwd=tmp_path)
    assert (refused.returncode, "measure it" in refused.stderr) == (2, True)

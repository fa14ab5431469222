"""The decision rule of a verification (ISO 14253-1), over parts that are simulated here, by hand."""

from dataclasses import replace

import numpy as np
import pytest
from support.measured import mean_of

from tiltcal.calibration.measurement import BenchUncertainty
from tiltcal.calibration.verification import verify
from tiltcal.core.model import Coefficients, Thermal
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity

PERFECT = CalibrationRecord(
    SensorIdentity("sca100t-d02", "S", "count", ("x", "y")),
    Coefficients(("x", "y"), ("x", "y"), np.array([1024.0, 1024.0]), np.diag([819.0, 819.0])),
)


TEXT = """\
sca100t-d02 S, limit 0.3°
  x-30         x  +30.000° read  +30.000°  y   +0.000° read   +0.000°   off by 0.00 ± 0.25°   passed
  level        x   +0.000° read   +0.210°  y   +0.000° read   +0.000°   off by 0.21 ± 0.24°   not decided
  y-90         x   +0.000° read   +0.000°  y  -90.000° read     +nan°   off by inf ± 0.2°   FAILED
FAILED: worst inf ± 0.2° at y-90"""


def test_an_error_is_judged_with_the_expanded_uncertainty_of_jig_and_noise() -> None:
    """A count at 30° is degrees(1 / 819 / cos 30°) = 0.0808°; an arcsine of 1.05 has no angle; ISO 14253-1 by hand."""
    seen = [
        mean_of("x-30", (0.5, 0.0, np.sqrt(0.75)), (1433.5, 1024.0), 1.0),
        mean_of("level", (0.0, 0.0, 1.0), (1024.0 + 819.0 * np.sin(np.radians(0.21)), 1024.0), 1.0),
        mean_of("y-90", (0.0, -1.0, 0.0), (1024.0, 1024.0 - 819.0 * 1.05), 0.0),
    ]
    found = verify(PERFECT, seen, 0.3, BenchUncertainty(0.1))
    u = [np.hypot(0.1, np.degrees(1.0 / 819.0) / slope) for slope in (np.cos(np.radians(30.0)), 1.0)]
    assert [one.expanded for one in found.positions[:2]] == pytest.approx(1.959964 * np.array(u))
    assert [one.error for one in found.positions] == pytest.approx([0.0, 0.21, np.inf], abs=1e-9)
    assert str(found) == TEXT
    data = found.as_data()
    assert [(one["position"], one["verdict"], one["passed"], one["flag"]) for one in data.pop("positions")] == [
        ("x-30", "passed", True, 1), ("level", "not decided", False, 1), ("y-90", "failed", False, 4)
    ]  # fmt: skip
    worst = {"position": "y-90", "error": np.inf}
    assert data == {"sensor": "S", "limit": 0.3, "jig": 0.1, "verdict": "failed", "passed": False, "worst": worst}


def test_of_three_axes_the_direction_is_judged() -> None:
    """1° off about x where y is up by 53.13°; two angles have a factor of sqrt(-2 ln 0.05) = 2.4477 for 95 %."""
    axes, turn = ("x", "y", "z"), np.radians(53.130102 + 1.0)
    known = Coefficients(axes, axes, np.zeros(3), np.eye(3))
    record = replace(PERFECT, sensor=PERFECT.sensor.replaced(channels=axes, unit="g"), coefficients=known)
    one = mean_of("p", (0.0, 0.8, 0.6), (0.0, np.sin(turn), np.cos(turn)), 1e-3)
    (found,) = verify(record, [one], 0.3, BenchUncertainty(0.1)).positions
    assert found.expected == pytest.approx({"x": 0.0, "y": 53.130102, "z": 36.869898})
    assert (found.error, found.flag) == (pytest.approx(1.0, abs=1e-6), 1)
    assert found.expanded == pytest.approx(2.447747 * np.hypot(0.1, np.degrees(1e-3)))


def test_a_position_is_judged_at_its_temperature() -> None:
    """4 count/°C over 10 °C are 40 counts, which without them are asin(40 / 819) = 2.80°."""
    thermal = Thermal(24.0, None, np.array([[4.0], [0.0]]), np.zeros((2, 0)))
    drifting = replace(PERFECT, coefficients=replace(PERFECT.coefficients, thermal=thermal))
    for temperature, error in ((34.0, 0.0), (24.0, 2.8)):
        one = mean_of("level", (0.0, 0.0, 1.0), (1064.0, 1024.0), 0.01, temperature=temperature)
        assert verify(drifting, [one]).positions[0].error == pytest.approx(error, abs=1e-2)

"""The decision rule of a verification (ISO 14253-1), over parts that are simulated here, by hand."""

from dataclasses import replace

import numpy as np
import pytest
from support.measured import mean_of, measured

from tiltcal.calibration.measurement import BenchUncertainty
from tiltcal.calibration.verification import Verification, VerifiedPosition, verify
from tiltcal.core.model import Coefficients, Thermal
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity
from tiltcal.files.procedure import find_procedure

PERFECT = CalibrationRecord(
    SensorIdentity("sca100t-d02", "S", "count", ("x", "y")),
    Coefficients(("x", "y"), ("x", "y"), np.array([1024.0, 1024.0]), np.diag([819.0, 819.0])),
)


def verified(rng: np.random.Generator, jig: float, stated: float | None = None) -> Verification:
    """A part that reads what it should, in positions that are set with an error of ``jig``, degrees."""
    positions = measured(
        find_procedure("verify").positions,
        lambda one: 1024.0 + 819.0 * np.sin(np.arcsin(one.gravity[:2]) + np.radians(rng.normal(0.0, jig, 2))),
        rng,
        0.06,
    )
    return verify(PERFECT, positions, 0.3, BenchUncertainty(stated))


def test_a_perfect_part_does_not_fail_for_its_jig() -> None:
    """At 0.3° with a jig of 0.1° 16 % failed, where the positions counted as exact."""
    rng = np.random.default_rng(1)
    assert [verified(rng, 0.1).verdict for _ in range(60)].count("failed") >= 2
    assert [verified(rng, 0.1, stated=0.1).verdict for _ in range(60)].count("failed") == 0


def test_the_limit_is_guarded_on_both_sides() -> None:
    """U = 1.96 times 0.1° = 0.196°: within 0.3 - 0.196 = 0.104 passed, beyond 0.3 + 0.196 = 0.496 failed."""
    for error, verdict in {0.10: "passed", 0.11: "not decided", 0.49: "not decided", 0.50: "failed"}.items():
        position = VerifiedPosition("p", {"x": 10.0}, {"x": 10.0 + error}, error, 1.959964 * 0.1, 1)
        assert position.verdict(0.3) == verdict


def test_noise_counts_by_the_slope_of_the_angle() -> None:
    """At 30° a count is degrees(1 / 819 / cos 30°) = 0.0808°."""
    (found,) = verify(PERFECT, [mean_of("x-30", (0.5, 0.0, np.sqrt(0.75)), (1433.5, 1024.0), 1.0)]).positions
    assert found.expanded == pytest.approx(1.96 * 0.0808, rel=1e-3)
    assert found.error == pytest.approx(0.0, abs=1e-9)


def test_a_position_is_judged_at_its_temperature() -> None:
    """4 count/°C over 10 °C are 40 counts, which without them are asin(40 / 819) = 2.80°."""
    thermal = Thermal(24.0, None, np.array([[4.0], [0.0]]), np.zeros((2, 0)))
    drifting = replace(PERFECT, coefficients=replace(PERFECT.coefficients, thermal=thermal))
    for temperature, error in ((34.0, 0.0), (24.0, 2.8)):
        one = mean_of("level", (0.0, 0.0, 1.0), (1064.0, 1024.0), 0.01, temperature=temperature)
        assert verify(drifting, [one]).positions[0].error == pytest.approx(error, abs=1e-2)

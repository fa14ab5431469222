"""The decision rule of a verification (ISO 14253-1), over parts that are simulated here, by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tiltcal.calibration.measurement import Measurement
from tiltcal.calibration.verification import Verification, VerifiedPosition, verify
from tiltcal.core.model import Coefficients, Thermal
from tiltcal.core.samples import SampleSummary
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity
from tiltcal.files.procedure import find_procedure

SENSOR = SensorIdentity("sca100t-d02", "S", "count", ("x", "y"))
PERFECT = CalibrationRecord(
    SENSOR, Coefficients(("x", "y"), ("x", "y"), np.array([1024.0, 1024.0]), np.diag([819.0, 819.0]))
)
POSITIONS = find_procedure("verify").positions
NOISE = 0.06


def verified(rng: np.random.Generator, jig: float, bias: float = 0.0, stated: float | None = None) -> Verification:
    """A part that reads every angle ``bias`` degrees too high, in positions that are set with an error of ``jig``."""
    measurements = []
    for position in POSITIONS:
        tilt = np.degrees(np.arcsin(position.gravity[:2])) + rng.normal(0.0, jig, 2) + bias
        mean = 1024.0 + 819.0 * np.sin(np.radians(tilt)) + rng.normal(0.0, NOISE, 2)
        summaries = {c: SampleSummary(float(v), 0.6, 100, NOISE, 0.0, 9.0) for c, v in zip("xy", mean, strict=True)}
        measurements.append(Measurement(position.name, position.gravity, position.tilt, None, summaries))
    return verify(PERFECT, measurements, 0.3, stated)


def test_a_perfect_part_does_not_fail_for_its_jig() -> None:
    """At 0.3° with a jig of 0.1° 16 % failed, where the positions counted as exact."""
    rng = np.random.default_rng(1)
    exact = [verified(rng, 0.1).verdict for _ in range(60)]
    stated = [verified(rng, 0.1, stated=0.1).verdict for _ in range(60)]
    assert exact.count("failed") >= 2
    assert stated.count("failed") == 0


def test_the_limit_is_guarded_on_both_sides() -> None:
    """U = 1.96 times 0.1° = 0.196°: within 0.3 - 0.196 = 0.104 passed, beyond 0.3 + 0.196 = 0.496 failed."""
    for error, verdict in {0.10: "passed", 0.11: "not decided", 0.49: "not decided", 0.50: "failed"}.items():
        position = VerifiedPosition("p", {"x": 10.0}, {"x": 10.0 + error}, error, 1.959964 * 0.1, 1)
        assert position.verdict(0.3) == verdict


def test_noise_counts_by_the_slope_of_the_angle() -> None:
    """At 30° a count is degrees(1 / 819 / cos 30°) = 0.0808°."""
    summaries = {"x": SampleSummary(1433.5, 10.0, 100, 1.0), "y": SampleSummary(1024.0, 0.1, 100, 0.01)}
    one = Measurement("x-30", (0.5, 0.0, float(np.sqrt(0.75))), {"x": 30.0}, None, summaries)
    (found,) = verify(PERFECT, [one]).positions
    assert found.expanded == pytest.approx(1.96 * 0.0808, rel=1e-3)
    assert found.error == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("temperature", "error"), [(34.0, 0.0), (24.0, 2.8)])
def test_a_position_is_judged_at_its_temperature(temperature: float, error: float) -> None:
    """4 count/°C over 10 °C are 40 counts, which without them are asin(40 / 819) = 2.80°."""
    thermal = Thermal(24.0, None, np.array([[4.0], [0.0]]), np.zeros((2, 0)))
    drifting = replace(PERFECT, coefficients=replace(PERFECT.coefficients, thermal=thermal))
    summaries = {"x": SampleSummary(1064.0, 0.1, 100, 0.01), "y": SampleSummary(1024.0, 0.1, 100, 0.01)}
    one = Measurement("level", (0.0, 0.0, 1.0), {"x": 0.0, "y": 0.0}, temperature, summaries)
    (found,) = verify(drifting, [one]).positions
    assert found.error == pytest.approx(error, abs=1e-2)

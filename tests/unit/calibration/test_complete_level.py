"""The offset that a level position renews: its value, its covariance, and what the angles are uncertain by after it."""

from dataclasses import replace
from math import inf, pi, radians, sqrt

import numpy as np
import pytest
import scipy
from support import FIXTURES
from support.measured import mean_of

from tiltcal.calibration.calibrate import calibrate
from tiltcal.calibration.comparison import compare_records
from tiltcal.calibration.complete import NO_LEVEL, NO_NOISE, level
from tiltcal.calibration.measurement import BenchUncertainty, MeasuredSensor
from tiltcal.calibration.wording import level_summary
from tiltcal.core.model import Array, Mounting
from tiltcal.files.calibration import CalibrationRecord, read_calibration
from tiltcal.files.procedure import find_procedure

COMPLETE = read_calibration(FIXTURES / "complete.yaml")
"""Two channels over x, y and z, with a drift."""
NOISE = 0.05
JIG = 0.05


def levelled(
    base: CalibrationRecord,
    readings: Array,
    temperature: float | None = 24.0,
    *,
    jig: float | None = JIG,
    alignment: float | None = None,
    dof: float = inf,
    table: float | None = None,
) -> CalibrationRecord:
    """The base with the offset of one level position."""
    measurement = mean_of("level", (0.0, 0.0, 1.0), readings, NOISE, temperature=temperature)
    summaries = {channel: replace(one, dof=dof) for channel, one in measurement.summaries.items()}
    measurement = replace(measurement, summaries=summaries)
    sensor = MeasuredSensor(base.sensor, [measurement], base=base)
    procedure = find_procedure("level").with_alignment(alignment)
    return calibrate([sensor], procedure, BenchUncertainty(jig, 0.1, table))[0]


def covariance_of(record: CalibrationRecord, *names: str) -> Array:
    stated = record.uncertainty.covariance
    assert stated is not None
    places = [stated.parameters.index(name) for name in names]
    return np.array(stated.matrix)[np.ix_(places, places)]


@pytest.mark.parametrize("mounting", [None, Mounting(roll=pi)])
def test_the_offset_is_what_is_left_of_the_reading(mounting: Mounting | None) -> None:
    """o = r - S_xz z - k dT by hand, with its variance and covariances by the GUM; all else is the base's."""
    base = COMPLETE if mounting is None else COMPLETE.with_mounting(mounting)
    found = levelled(base, np.array([1030.0, 1010.0]), 10.0)
    old, new, z = base.coefficients, found.coefficients, 1.0 if mounting is None else -1.0
    dt = 10.0 - old.thermal.reference
    assert new.offset[0] == pytest.approx(1030.0 - old.sensitivity[0, 2] * z - old.thermal.drift[0, 0] * dt, abs=1e-3)
    names = ("sensitivity.x.z", "temperature.offset.x.1")
    known = covariance_of(COMPLETE, *names)
    slopes = -np.array([z, dt])
    level = (radians(JIG) * np.linalg.norm(old.sensitivity[0, :2])) ** 2
    by_hand = slopes @ known @ slopes + NOISE**2 + level + (0.1 * old.thermal.drift[0, 0]) ** 2
    assert found.uncertainty["offset.x"] == pytest.approx(sqrt(by_hand), rel=1e-3)
    joint = covariance_of(found, "offset.x", *names)
    np.testing.assert_allclose(joint[0, 1:], slopes @ known, rtol=1e-2)
    np.testing.assert_array_equal(joint[1:, 1:], known)
    np.testing.assert_array_equal(new.sensitivity, old.sensitivity)
    assert found.limits == COMPLETE.limits


def test_the_change_has_the_coverage_factor_of_its_noise() -> None:
    """Noise from ten block means beside a known error of the thermometer: the squares of both intervals add."""
    base = replace(COMPLETE, uncertainty=replace(COMPLETE.uncertainty, standard={}, covariance=None))
    found = levelled(base, np.array([1030.0, 1010.0]), jig=0.0, dof=9.0).fit.level
    thermometer = 0.1 * COMPLETE.coefficients.thermal.drift[:, 0]
    normal, student = scipy.stats.norm.ppf(0.975), scipy.stats.t.ppf(0.975, 9.0)
    expected = np.hypot(normal * thermometer, student * NOISE) / np.hypot(thermometer, NOISE)
    assert [found.change_coverage_factor[channel] for channel in "xy"] == pytest.approx(expected.tolist(), abs=1e-3)


def test_two_headings_share_a_lean_and_a_thermometer_and_halve_the_rest() -> None:
    """Turned by 90° from above, a lean (a, b) is (b, -a) for the sensor: the mean of both is (a + b, b - a)/2."""
    base = replace(COMPLETE, uncertainty=replace(COMPLETE.uncertainty, standard={}, covariance=None))
    seen = [mean_of(f"{h}", (0.0, 0.0, 1.0), (1020.0, 1020.0), 0.3, temperature=24.0, heading=h) for h in (0.0, 90.0)]
    found = level(base, seen, find_procedure("level"), BenchUncertainty(0.04, 0.5, 0.5))
    own, drift = COMPLETE.coefficients.sensitivity[:, :2], COMPLETE.coefficients.thermal.drift[:, :1]
    by = own @ np.array([[0.5, 0.5], [-0.5, 0.5]]) * radians(0.5)
    rest = radians(0.04) ** 2 * own @ own.T / 2.0 + 0.3**2 * np.eye(2) / 2.0 + 0.5**2 * drift @ drift.T
    np.testing.assert_allclose(covariance_of(found, "offset.x", "offset.y"), by @ by.T + rest, rtol=2e-3, atol=2e-4)
    assert found.fit.level.jig_degrees == pytest.approx(np.hypot(0.04, 0.5), rel=1e-3)
    assert (found.fit.level.temperature, len(found.positions)) == (24.0, len(COMPLETE.positions) + 2)


def test_the_change_is_told_and_judged() -> None:
    """25 counts of 819 per g are 1.7°; a change within the level's own 0.05° is none."""
    offset = COMPLETE.coefficients.offset + COMPLETE.coefficients.sensitivity[:, 2]
    record = levelled(COMPLETE, offset + np.array([25.0, 0.1]))
    assert record.fit.level.change["x"] == pytest.approx(25.0, abs=0.5)
    assert record.fit.level.verdict.startswith("changed: offset.x by more")
    assert "(+1.7" in level_summary(record)
    assert levelled(COMPLETE, offset).fit.level.verdict.startswith("unchanged")
    # 1.96 times 2°/√3 sin 30°, as how-to/mounting.md shows it.
    assert "up to 2° askew" in (told := level_summary(levelled(COMPLETE, offset, alignment=2.0)))
    assert "±1.2° (95 %) where the other axis" in told
    unsaid = levelled(COMPLETE, offset + 25.0, jig=None)
    assert unsaid.fit.level.verdict.startswith("no verdict")
    assert NO_LEVEL in unsaid.fit.notes
    silent = mean_of("level", (0.0, 0.0, 1.0), (1020.0, 1020.0), 1e-9, temperature=24.0)
    summaries = {c: replace(one, std=0.0, quantisation=1e-9, dof=inf) for c, one in silent.summaries.items()}
    found = level(COMPLETE, [replace(silent, summaries=summaries)], find_procedure("level"), BenchUncertainty(0.0, 0.0))
    assert NO_NOISE in found.fit.notes


def test_a_comparison_with_the_base_states_the_change_as_the_file_does() -> None:
    """A base and its renewal share all but the reading at level, less what the base expects there: o + S_xz."""
    base = read_calibration(FIXTURES / "plane.yaml")
    renewed = levelled(base, base.coefficients.predict(np.array([[0.0, 0.0, 1.0]]))[0] + 5.0)
    changes = {change.name: change for change in compare_records(base, renewed).changes}
    for row, channel in enumerate("xy"):
        change, known = (
            changes[f"offset.{channel}"],
            covariance_of(base, f"offset.{channel}", f"sensitivity.{channel}.z"),
        )
        level = radians(JIG) * np.linalg.norm(base.coefficients.sensitivity[row, :2])
        assert change.difference == pytest.approx(5.0, abs=0.01)
        assert change.u == pytest.approx(sqrt(known.sum() + level**2 + NOISE**2), rel=3e-3)
        assert change.u == pytest.approx(renewed.fit.level.change_uncertainty[channel], rel=1e-3)

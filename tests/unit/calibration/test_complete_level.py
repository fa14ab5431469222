"""The offset that a level position renews: its value, its covariance, and what the angles are uncertain by after it."""

from dataclasses import replace
from math import inf, radians, sqrt

import numpy as np
import pytest
import scipy
from scipy.spatial.transform import Rotation
from support import FIXTURES
from support.measured import mean_of

from tiltcal.calibration.calibrate import calibrate
from tiltcal.calibration.comparison import compare_records
from tiltcal.calibration.complete import NO_LEVEL, NO_NOISE, level
from tiltcal.calibration.measurement import BenchUncertainty, MeasuredSensor
from tiltcal.calibration.wording import level_summary
from tiltcal.core.attitude import mounting_matrix
from tiltcal.core.model import Array, Mounting, vector_of, with_vector
from tiltcal.files.calibration import CalibrationRecord, read_calibration
from tiltcal.files.procedure import find_procedure
from tiltcal.library.calibration import Calibration

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


def test_the_offset_is_what_is_left_of_the_reading() -> None:
    """o = r - S_xz - k dT by hand, with its variance and covariances by the GUM; all else is the base's."""
    found = levelled(COMPLETE, np.array([1030.0, 1010.0]), 10.0)
    old, new = COMPLETE.coefficients, found.coefficients
    dt = 10.0 - old.thermal.reference
    assert new.offset[0] == pytest.approx(1030.0 - old.sensitivity[0, 2] - old.thermal.drift[0, 0] * dt, abs=1e-3)
    names = ("sensitivity.x.z", "temperature.offset.x.1")
    known = covariance_of(COMPLETE, *names)
    slopes = -np.array([1.0, dt])
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


@pytest.mark.parametrize(("mounting", "times"), [(None, 30), (Mounting(0.2, -0.3, 2.0), 15)])
def test_after_many_replugs_the_tilt_holds_its_interval(mounting: Mounting | None, times: int) -> None:
    """Turns of up to 2° about any axis, tilts of up to 45° to every side, 5 to 30 °C, with the errors of the base."""
    rng = np.random.default_rng(7)
    stated = COMPLETE.uncertainty.covariance
    truth = replace(COMPLETE.coefficients, mounting=None)
    frame = np.eye(3) if mounting is None else mounting_matrix(mounting)
    vector = vector_of(truth, stated.parameters)
    held = []
    for _ in range(times):
        drawn = rng.multivariate_normal(vector, np.array(stated.matrix))
        base = replace(COMPLETE, coefficients=replace(with_vector(truth, stated.parameters, drawn), mounting=mounting))
        seat = Rotation.random(random_state=rng).as_rotvec()
        seat = Rotation.from_rotvec(seat / np.linalg.norm(seat) * radians(2.0) * rng.uniform() ** (1 / 3))
        lean = np.append(radians(JIG) * rng.normal(size=2), 1.0)
        at_level = truth.predict(seat.apply(lean / np.linalg.norm(lean))[None] @ frame, np.array([21.0]))[0]
        found = Calibration(levelled(base, at_level + NOISE * rng.normal(size=2), 21.0))
        tilt, direction = radians(45.0) * np.sqrt(rng.uniform(size=40)), rng.uniform(0.0, 2.0 * np.pi, 40)
        up = np.column_stack([np.sin(tilt) * np.cos(direction), np.sin(tilt) * np.sin(direction), np.cos(tilt)])
        temperature = rng.uniform(5.0, 30.0, 40)
        x, y = truth.predict(seat.apply(up) @ frame, temperature).T
        out = found.apply({"x": x, "y": y, "temperature": temperature}, uncertainty=True, reading_noise=0.0)
        for axis, known in zip("xy", np.degrees(np.arcsin(up[:, :2])).T, strict=True):
            held.append(np.abs(out[f"tilt_{axis}"] - known) <= out[f"U95_tilt_{axis}"])
    assert np.mean(held) > 0.95


def test_a_lean_of_the_table_turns_with_the_headings_of_the_sensor() -> None:
    """Turned by 90° from above, a lean (a, b) is (b, -a) for the sensor: the mean of both is (a + b, b - a)/2."""
    base = replace(COMPLETE, uncertainty=replace(COMPLETE.uncertainty, standard={}, covariance=None))
    seen = [mean_of(f"{h}", (0.0, 0.0, 1.0), (1020.0, 1020.0), 1e-3, temperature=24.0, heading=h) for h in (0.0, 90.0)]
    found = level(base, seen, find_procedure("level"), BenchUncertainty(0.0, 0.0, 0.5))
    by = COMPLETE.coefficients.sensitivity[:, :2] @ np.array([[0.5, 0.5], [-0.5, 0.5]]) * radians(0.5)
    np.testing.assert_allclose(covariance_of(found, "offset.x", "offset.y"), by @ by.T, rtol=1e-2, atol=1e-3)


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


def test_noise_that_a_table_does_not_state_is_said_to_be_left_out() -> None:
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

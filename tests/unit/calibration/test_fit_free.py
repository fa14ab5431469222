"""Free positions are judged by their expanded uncertainty; readings are simulated here, by hand."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation
from support.measured import mean_of

import tiltcal
from tiltcal.calibration.calibrate import calibrate
from tiltcal.calibration.measurement import BenchUncertainty, MeasuredSensor
from tiltcal.errors import EstimateError
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity
from tiltcal.files.procedure import find_procedure

SENSOR = SensorIdentity("recorded", "S", "g", ("x", "y", "z"))
OFFSET = np.array([0.02, -0.03, 0.01])
SENSITIVITY = np.array([[1.01, 0.005, -0.01], [0.0, 0.98, 0.01], [0.0, 0.0, 1.02]])
FREE = find_procedure("free")

Directions = NDArray[np.float64]


def sphere(count: int) -> Directions:
    """Directions that point every way, by a golden spiral."""
    number = np.arange(count)
    height, angle = 1 - (2 * number + 1) / count, number * np.pi * (3 - np.sqrt(5))
    ring = np.sqrt(1 - height**2)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), height], axis=1)


def cone(count: int, half_angle: float, rng: np.random.Generator) -> Directions:
    """Directions within a cone about +z."""
    height = rng.uniform(np.cos(np.radians(half_angle)), 1.0, count)
    angle = rng.uniform(0.0, 2.0 * np.pi, count)
    ring = np.sqrt(1 - height**2)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), height], axis=1)


def calibrated(up: Directions, noise: float, rng: np.random.Generator) -> CalibrationRecord:
    mean = OFFSET + up @ SENSITIVITY.T + rng.normal(0.0, noise, up.shape)
    positions = [mean_of(f"p{k}", (0.0, 0.0, 1.0), row, noise) for k, row in enumerate(mean)]
    return calibrate([MeasuredSensor(SENSOR, positions)], FREE, BenchUncertainty())[0]


def off_by(calibration: CalibrationRecord) -> float:
    """The largest error of an offset or a sensitivity, mg."""
    coefficients = calibration.coefficients
    offsets, sensitivities = coefficients.offset - OFFSET, coefficients.sensitivity - SENSITIVITY
    return 1e3 * float(max(np.max(np.abs(offsets)), np.max(np.abs(sensitivities))))


def by_hand(rng: np.random.Generator, sway: float, memory: float) -> tuple[dict[str, Directions], list[dict[str, Any]]]:
    """Eighteen holds of 3 s at 100 Hz in a hand that sways (degrees; seconds of memory), with noise of 1 mg."""
    fade, samples = np.exp(-0.01 / memory), 300
    rows, segments = [], []
    for number, up in enumerate(Rotation.random(random_state=rng).apply(sphere(18))):
        drive = rng.normal(0.0, np.radians(sway), (samples, 2))
        drive[1:] *= np.sqrt(1.0 - fade**2)
        across = np.linalg.svd(up[None])[2][1:]
        held = up + np.tan(lfilter([1.0], [1.0, -fade], drive, axis=0)) @ across
        rows.append(held / np.linalg.norm(held, axis=1)[:, None])
        segments.append({"position": f"p{number}", "start": samples * number, "end": samples * (number + 1)})
    read = OFFSET + np.concatenate(rows) @ SENSITIVITY.T
    read += rng.normal(0.0, 1e-3, read.shape)
    return {axis: read[:, k] for k, axis in enumerate("xyz")}, segments


@pytest.mark.parametrize(("sway", "memory"), [(0.3, 5.0), (1.0, 1.0)])
def test_sway_of_the_hand_is_no_noise_of_the_length_of_gravity(sway: float, memory: float) -> None:
    """It was taken for noise with a memory: the uncertainty was up to a hundred times the error."""
    rng = np.random.default_rng(11)
    errors, expanded = [], []
    for _ in range(25):
        columns, segments = by_hand(rng, sway, memory)
        found = tiltcal.fit("free", columns, segments=segments, serial="S", unit="g")
        assert found.fit.warning is None
        assert not any("sample each position" in note for note in found.fit.notes)
        truth = {f"offset.{axis}": (found.offset[axis], OFFSET[k]) for k, axis in enumerate("xyz")}
        for i, j in zip(*np.triu_indices(3), strict=True):
            truth[f"sensitivity.{'xyz'[i]}.{'xyz'[j]}"] = found.sensitivity["xyz"[i], "xyz"[j]], SENSITIVITY[i, j]
        errors.append([abs(value - true) for value, true in truth.values()])
        expanded.append([found.uncertainty[name] * found.uncertainty.coverage_factor[name] for name in truth])
    # 225 intervals; those of one recording are correlated, so that 93 % is two standard deviations below 95 %.
    assert np.mean(np.array(errors) <= expanded) >= 0.93
    assert np.median(expanded) < 3.0 * np.percentile(errors, 95.0)


def disturbed(count: int, bad: dict[int, Sequence[float]], rng: np.random.Generator) -> dict[str, Any]:
    """A table of attitudes of which some are off, g, with noise of 0.3 mg."""
    mean = OFFSET + Rotation.random(random_state=rng).apply(sphere(count)) @ SENSITIVITY.T
    mean += rng.normal(0.0, 3e-4, mean.shape)
    for number, off in bad.items():
        mean[number] += off
    columns = {axis: mean[:, k] for k, axis in enumerate("xyz")}
    return {"position": [f"p{n}" for n in range(count)], **columns, **{f"u{axis}": [3e-4] * count for axis in "xyz"}}


def test_two_attitudes_of_24_that_are_off_by_300_mg_are_left_out_and_named() -> None:
    """They were fitted, 66 mg wrong in the median."""
    rng = np.random.default_rng(12)
    named = 0
    for _ in range(30):
        table = disturbed(24, {5: [0.3, 0.0, 0.0], 17: [0.0, -0.3, 0.0]}, rng)
        found = tiltcal.fit("free", table, serial="S", unit="g")
        named += set(found.fit.left_out_mg) == {"p5", "p17"}
        if set(found.fit.left_out_mg) == {"p5", "p17"}:
            assert off_by(found.record) < 1.5
            assert "left out, because the length of gravity does not agree with the other attitudes: p5 (" in str(found)
            assert len(found.positions) == 24
            assert set(found.fit.residuals) == {f"p{n}" for n in range(24)} - {"p5", "p17"}
    assert named >= 28


@pytest.mark.parametrize(
    ("count", "bad"),
    [
        # Twelve must remain.
        (12, {4: [0.3, 0.2, 0.1]}),
        # At most a fifth may be left out.
        (24, {n: [0.3, 0.2 + 0.02 * n, 0.1] for n in range(1, 12, 2)}),
    ],
)
def test_more_than_a_fifth_or_too_few_others_is_refused(count: int, bad: dict[int, Sequence[float]]) -> None:
    rng = np.random.default_rng(13)
    with pytest.raises(EstimateError, match=r"does not agree with the other attitudes.*Take them again") as refused:
        tiltcal.fit("free", disturbed(count, bad, rng), serial="S", unit="g")
    assert all(f"p{number} (" in str(refused.value) for number in bad if count == 12)


def test_a_sensor_that_hardly_turns_is_refused_with_the_directions_to_add() -> None:
    rng = np.random.default_rng(2)
    with pytest.raises(EstimateError, match=r"mg, more than 50 mg.*add attitudes in which \+x, -x, \+y, -y, -z"):
        calibrated(cone(20, 40.0, rng), 2e-4, rng)


def test_an_angle_that_no_attitude_shows_is_warned_of_and_all_else_is_found() -> None:
    """Six faces and tilts about x and y alone, as in a recording that others have published: x and y never meet."""
    tilts = np.radians([30.0, 45.0, 60.0])
    about_y = np.stack([np.sin(tilts), 0.0 * tilts, np.cos(tilts)], axis=1)
    about_x = np.stack([0.0 * tilts, np.sin(tilts), -np.cos(tilts)], axis=1)
    rng = np.random.default_rng(5)
    up = np.concatenate([np.eye(3), -np.eye(3), about_y, about_x]) + rng.normal(0.0, 0.02, (12, 3))
    found = calibrated(up / np.linalg.norm(up, axis=1)[:, None], 1e-3, rng)
    warning = found.fit.warning
    assert warning is not None
    assert warning.startswith("sensitivity.x.y has an expanded uncertainty of ")
    assert warning.endswith("add attitudes between the axes x and y, with both about 45° up or down")
    assert (
        50.0 < 1e3 * found.uncertainty["sensitivity.x.y"] * found.uncertainty.coverage_factor["sensitivity.x.y"] < 200.0
    )
    assert found.coefficients.offset == pytest.approx(OFFSET, abs=0.005)


@pytest.mark.parametrize("change", [(1, 1, 1.6), (0, 1, 0.6)], ids=["unequal", "skew"])
def test_coefficients_of_no_sensor_are_refused(change: tuple[int, int, float], monkeypatch: pytest.MonkeyPatch) -> None:
    row, column, value = change
    odd = SENSITIVITY.copy()
    odd[row, column] = value
    monkeypatch.setitem(globals(), "SENSITIVITY", odd)
    with pytest.raises(EstimateError, match=r"sensitivities to gravity come out 1\.[678] times apart"):
        calibrated(sphere(18), 1e-3, np.random.default_rng(5))

"""``tiltcal measure mounting`` and Wahba's problem beneath it."""

from math import radians
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.command import tiltcal
from support.simulated_bench import XYZ, design, fixture, measured, part, plan_of

from tiltcal.calibration.complete import mount
from tiltcal.calibration.measurement import Measurement
from tiltcal.calibration.stated import rounded, stated_section, stated_uncertainty
from tiltcal.core.angle_uncertainty import CompensationWithUncertainty
from tiltcal.core.attitude import mounting_matrix
from tiltcal.core.compensation import Compensation
from tiltcal.core.estimation.estimate import estimate_jointly
from tiltcal.core.model import Mounting
from tiltcal.core.samples import SampleSummary
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity, read_calibration

POSITIONS = np.array([[0, 0, 1], [0.5, 0, 0.866], [-0.5, 0, 0.866], [0, 0.5, 0.866], [0, -0.5, 0.866]])
KNOWN = POSITIONS / np.linalg.norm(POSITIONS, axis=1, keepdims=True)


def noisy(rng: np.random.Generator, matrix: np.ndarray, sigma: float) -> np.ndarray:
    turned = [Rotation.from_rotvec(rng.normal(0.0, sigma, 3)).apply(known) for known in KNOWN]
    return np.array(turned) @ matrix


def test_the_angles_of_a_mounted_sensor_hold_the_truth() -> None:
    """Base and mounting err together: 40 sensors are calibrated on one jig and mounted on another, both of 0.2°."""
    rng = np.random.default_rng(31)
    plan, sigma, inside, scatter = plan_of(12, noise=1e-4, jig=0.2), radians(0.2), [], []
    for _ in range(40):
        truth, turned = part(rng), mounting_matrix(Mounting(*rng.uniform(-1.2, 1.2, 3)))
        (found,) = estimate_jointly(fixture(measured(rng, plan, [truth]), design(plan, jig=0.2)))
        identity = SensorIdentity("bench-built", "S-1", "g", XYZ)
        base = CalibrationRecord(identity, rounded(found), stated_section(found.uncertain))
        read = truth.reading(noisy(rng, turned, sigma), np.zeros(len(KNOWN)))
        mounted = mount(base, [_measured(known, row) for known, row in zip(KNOWN, read, strict=True)], jig=0.2)
        doubt, _ = stated_uncertainty(mounted, reading_noise=0.0)
        kernel = CompensationWithUncertainty(Compensation(mounted.coefficients), mounted.coefficients, doubt)
        gravity = Rotation.from_euler("xy", rng.uniform(-40.0, 40.0, (20, 2)), degrees=True).apply([0.0, 0.0, 1.0])
        compensated, (standard, expanded) = kernel(truth.reading(gravity @ turned, np.zeros(20)), np.zeros(20))
        error = (compensated.tilt[:, :2] - np.degrees(np.arcsin(gravity[:, :2]))).T
        inside.append(np.mean(np.abs(error) <= expanded[:2]))
        scatter.append(np.mean((error / standard[:2]) ** 2))
    assert np.mean(inside) == pytest.approx(0.95, abs=3 * np.std(inside) / np.sqrt(len(inside)) + 0.005)
    assert np.sqrt(np.mean(scatter)) == pytest.approx(1.0, abs=0.12)


def _measured(gravity: np.ndarray, readings: np.ndarray) -> Measurement:
    summaries = {c: SampleSummary(float(value), 0.0, 1, 0.0) for c, value in zip(XYZ, readings, strict=True)}
    x, y, z = gravity.tolist()
    return Measurement("here", (x, y, z), None, None, summaries)


TWIN = """\
tiltcal: 1
kind: twin
model: {model}
seed: 4
truth:
  offset: {offset}
  sensitivity: {sensitivity}
  noise: {noise}
  jig: 0.01
  mounting: {mounting}
"""
SCA3000 = {
    "model": "sca3000-d01",
    "offset": "{x: 20, y: -15, z: 8}",
    "sensitivity": "{x: {x: 1330, y: 9, z: -4}, y: {x: 5, y: 1341, z: 2}, z: {x: -7, y: 3, z: 1325}}",
    "noise": "{x: 1.5, y: 1.5, z: 1.5}",
}
SCA100T = {
    "model": "sca100t-d02",
    "offset": "{x: 1026, y: 1021}",
    "sensitivity": "{x: {x: 817, y: 9, z: 0}, y: {x: -5, y: 821, z: 0}}",
    "noise": "{x: 0.6, y: 0.6}",
}


def mounted(folder: Path, facts: dict[str, str], procedure: str, mounting: str) -> Path:
    """Calibrate a part straight on the jig, then mount it and find how."""
    (folder / "straight.yaml").write_text(TWIN.format(**facts, mounting="{}"))
    (folder / "mounted.yaml").write_text(TWIN.format(**facts, mounting=mounting))
    options = ["--sensor", facts["model"], "--serial", "M-1", "--operator", "sim", "--samples", "60", "--settle", "0.2"]
    tiltcal(
        "measure", procedure, *options, "--address", "sim:?twin=straight.yaml", "-o", "M-1.yaml", cwd=folder, code=0
    )
    tiltcal(
        *("measure", "mounting", *options, "--address", "sim:?twin=mounted.yaml"),
        *("--base", "M-1.yaml", "--jig", "0.02", "-o", "M-1-mounted.yaml"),
        cwd=folder,
        code=0,
    )
    return folder / "M-1-mounted.yaml"


@pytest.mark.parametrize(
    ("facts", "procedure", "angles"),
    [
        (SCA3000, "six-face", (170.0, 40.0, -120.0)),
        (SCA3000, "six-face", (-90.0, 0.0, 0.0)),
        (SCA100T, "plane", (3.0, -5.0, 60.0)),
        (SCA100T, "plane", (180.0, 0.0, 0.0)),
    ],
)
def test_a_sensor_in_any_mounting(
    facts: dict[str, str], procedure: str, angles: tuple[float, float, float], tmp_path: Path
) -> None:
    """A meter that hangs upside down has its sensor not calibrated again."""
    path = mounted(tmp_path, facts, procedure, "{{roll: {}, pitch: {}, yaw: {}}}".format(*angles))
    found, before = read_calibration(path), read_calibration(tmp_path / "M-1.yaml")
    mounting, truth = found.coefficients.mounting, mounting_matrix(Mounting(*map(radians, angles)))
    assert mounting is not None
    np.testing.assert_allclose(mounting_matrix(mounting), truth, atol=radians(0.12 if facts is SCA3000 else 0.25))
    assert {"mounting.roll", "mounting.pitch", "mounting.yaw"} <= set(found.uncertainty)
    np.testing.assert_array_equal(found.coefficients.sensitivity, before.coefficients.sensitivity)
    tiltcal("replay", "M-1-mounted.journal.jsonl", "--golden", "M-1-mounted.yaml", cwd=tmp_path, code=0)


@pytest.mark.parametrize("angles", [(170.0, 40.0, -120.0), (-90.0, 0.0, 0.0)])
def test_a_three_axis_sensor_in_any_mounting(angles: tuple[float, float, float], tmp_path: Path) -> None:
    path = mounted(tmp_path, SCA3000, "six-face", "{{roll: {}, pitch: {}, yaw: {}}}".format(*angles))
    found = read_calibration(path)
    mounting = found.coefficients.mounting
    assert mounting is not None
    assert np.degrees([mounting.roll, mounting.pitch, mounting.yaw]) == pytest.approx(angles, abs=0.12)
    assert {"mounting.roll", "mounting.pitch", "mounting.yaw"} <= set(found.uncertainty)
    before = read_calibration(tmp_path / "M-1.yaml")
    np.testing.assert_array_equal(found.coefficients.sensitivity, before.coefficients.sensitivity)
    tiltcal("replay", "M-1-mounted.journal.jsonl", "--golden", "M-1-mounted.yaml", cwd=tmp_path, code=0)


@pytest.mark.parametrize("angles", [(3.0, -5.0, 60.0), (180.0, 0.0, 0.0)])
def test_a_two_axis_sensor_upright_or_inverted(angles: tuple[float, float, float], tmp_path: Path) -> None:
    """The meter hangs upside down and the sensor is not calibrated again."""
    path = mounted(tmp_path, SCA100T, "plane", "{{roll: {}, pitch: {}, yaw: {}}}".format(*angles))
    mounting = read_calibration(path).coefficients.mounting
    assert mounting is not None
    truth = mounting_matrix(Mounting(*map(radians, angles)))
    np.testing.assert_allclose(mounting_matrix(mounting), truth, atol=radians(0.25))

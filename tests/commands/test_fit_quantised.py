"""``tiltcal fit`` of logs whose readings are coarse, or whose channels were stuck."""

from __future__ import annotations

import subprocess
from math import sqrt
from pathlib import Path

import numpy as np
import pytest
from support.command import tiltcal

from tiltcal.files.calibration import CalibrationRecord, read_calibration

FACES = {
    "x-up": (1, 0, 0),
    "x-down": (-1, 0, 0),
    "y-up": (0, 1, 0),
    "y-down": (0, -1, 0),
    "z-up": (0, 0, 1),
    "z-down": (0, 0, -1),
}
SAMPLES = 100


def readings(noise: float, seed: int = 4, scale: float = 100.0) -> np.ndarray:
    """Of an ideal sensor with odd offsets, shape (faces, samples, 3)."""
    rng = np.random.default_rng(seed)
    still = np.array([7.31, -3.83, 11.27]) + scale * np.array(list(FACES.values()), dtype=float)
    return still[:, None, :] + rng.normal(0.0, noise, (6, SAMPLES, 3))


def fitted(folder: Path, data: np.ndarray, *options: str) -> subprocess.CompletedProcess[str]:
    lines = ["x,y,z", *(",".join(f"{value:.6g}" for value in row) for row in data.reshape(-1, 3))]
    (folder / "log.csv").write_text("\n".join(lines) + "\n")
    rows = [f"{name},{k * SAMPLES},{(k + 1) * SAMPLES}" for k, name in enumerate(FACES)]
    (folder / "faces.csv").write_text("\n".join(["position,start,end", *rows]) + "\n")
    return tiltcal(
        *("fit", "six-face", "log.csv", "--segments", "faces.csv", "--unit", "count", "--serial", "C-1"),
        *("-o", "C-1.yaml", "--jig", "0", *options),
        cwd=folder,
    )


def calibrated(folder: Path, data: np.ndarray) -> CalibrationRecord:
    result = fitted(folder, data)
    assert result.returncode == 0, result.stderr
    return read_calibration(folder / "C-1.yaml")


class TestQuantisation:
    def test_a_channel_that_stands_at_a_rounded_value_is_uncertain_by_the_rounding(self, tmp_path: Path) -> None:
        """One count, rectangular: 1/sqrt(12) a reading. Four faces read alike and share theirs: the offset is the mean
        of one of them and the two others."""
        coarse = readings(noise=1.0)
        coarse[:, :, 1] = 100.0 * np.array([[0], [0], [1], [-1], [0], [0]]) - 4.0
        found = calibrated(tmp_path, np.round(coarse))
        assert found.uncertainty["offset.y"] == pytest.approx(1.0 / sqrt(12) / sqrt(3), rel=0.01)

    def test_noise_of_a_step_averages_it_out(self, tmp_path: Path) -> None:
        """What is left is noise and rounding of single samples over the root of all of them."""
        found = calibrated(tmp_path, np.round(readings(noise=1.0)))
        assert found.uncertainty["offset.y"] == pytest.approx(sqrt((1.0 + 1 / 12) / 6 / SAMPLES), rel=0.15)

    def test_a_converter_ten_times_coarser_than_the_noise(self, tmp_path: Path) -> None:
        """Most faces read one value in all channels: they are quantised, not stuck, and the rounding counts."""
        found = calibrated(tmp_path, np.round(readings(noise=0.1, seed=5, scale=103.37)))
        assert 0.7 / sqrt(12) / sqrt(3) < found.uncertainty["offset.x"] < 1.1 / sqrt(12) / sqrt(3)
        assert abs(found.coefficients.offset[0] - 7.31) < 2 * found.uncertainty["offset.x"]


class TestStuck:
    def test_a_channel_that_is_stuck_in_one_face(self, tmp_path: Path) -> None:
        data = readings(noise=0.5)
        data[2, :, 0] = data[1, -1, 0]
        result = fitted(tmp_path, data)
        assert result.returncode == 2
        assert "faces.csv:4: segment y-up: all samples of x are identical, and elsewhere they scatter" in result.stderr
        assert not (tmp_path / "C-1.yaml").exists()

    def test_a_channel_that_never_moves(self, tmp_path: Path) -> None:
        data = readings(noise=0.5)
        data[:, :, 2] = 37.0
        result = fitted(tmp_path, data)
        assert result.returncode == 2
        assert "z reads 37 in every position: it is stuck; is it connected?" in result.stderr

"""Three accelerometers of hobby boards that were written apart from the drivers, behind /dev/i2c-1."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.command import TILTCAL
from support.emulated.bench import Accelerometer, run_on_i2c

from tiltcal.files.calibration import read_calibration

BOARDS = {"mpu6050": (0x68, 500, 16384), "adxl345": (0x53, 400, 256), "lis3dh": (0x18, 400, 1000)}
"""Address, samples a second, and count/g."""


@pytest.mark.parametrize("model", BOARDS)
def test_six_faces_find_the_truth_of_a_part_that_has_no_more_than_it_needs(model: str, tmp_path: Path) -> None:
    """Offset and sensitivity within 1 mg, of 100 samples a face with 2.5 mg of noise: five standard deviations."""
    pytest.importorskip("smbus2", reason="the smbus2 package is not installed")
    address, rate, digits = BOARDS[model]
    where = f"i2c:///dev/i2c-1?address={address:#x}&rate={rate}"
    part = Accelerometer(model)
    program = [
        *(*TILTCAL, "measure", "six-face", "--sensor", model, "--address", where),
        *("--serial", "B-1", "-o", str(tmp_path / "B-1.yaml"), "--operator", "json", "--settle", "0.15"),
    ]
    with run_on_i2c(program, part, address) as bench:
        told = bench.lead()
        assert bench.exit_code == 0, bench.errors()
    assert told[-1]["event"] == "done"
    read = read_calibration(tmp_path / "B-1.yaml")
    np.testing.assert_allclose(np.divide(read.coefficients.offset, digits), part.offset, atol=0.001)
    np.testing.assert_allclose(np.divide(read.coefficients.sensitivity, digits), part.sensitivity, atol=0.001)
    if model == "mpu6050":
        assert [position.temperature for position in read.positions] == pytest.approx([24.0] * 6, abs=0.01)

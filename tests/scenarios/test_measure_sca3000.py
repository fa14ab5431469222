"""An SCA3000 that was written apart from ours, on SPI and on I2C, is led through ``six-face`` by a program.

The bounds are those of a bench with 1.5 count of noise and a 0.01° jig: offsets within 0.9 count and sensitivities
within 0.9 count/g of the part's truth.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from support.command import TILTCAL, tiltcal
from support.emulated.bench import Sca3000, run_on_i2c, run_on_spi
from support.warm_start import WarmStart

from tiltcal.files.calibration import read_calibration

ON_SPI = ("sca3000-d01", "spi:///dev/spidev0.0")
ON_I2C = ("sca3000-i2c", "i2c:///dev/i2c-1?address=0x1d&counts_per_g=1333&rate=250")


def program(start: Sequence[str], sensor: str, address: str, folder: Path, *options: str) -> list[str]:
    return [
        *(*start, "measure", "six-face", "--sensor", sensor, "--address", address),
        *("--serial", "A-3000", "-o", str(folder / "A-3000.yaml"), "--operator", "json", "--settle", "0.15", *options),
    ]


def require_true(told: list[dict[str, object]], folder: Path, part: Sca3000) -> None:
    assert told[-1]["event"] == "done"
    found = read_calibration(folder / "A-3000.yaml").coefficients
    np.testing.assert_allclose(found.offset, part.offset, atol=0.9)
    np.testing.assert_allclose(found.sensitivity, part.sensitivity, atol=0.9)


def test_six_face_on_spi(tmp_path: Path) -> None:
    pytest.importorskip("spidev", reason="the spidev package is not installed")
    with run_on_spi(program(TILTCAL, *ON_SPI, tmp_path), Sca3000()) as bench:
        told = bench.lead()
        assert bench.exit_code == 0, bench.errors()
    require_true(told, tmp_path, Sca3000())
    positions = read_calibration(tmp_path / "A-3000.yaml").positions
    # The part's own thermometer: 24 °C is raw 257.8, sent as 258, read as 24.1 °C.
    assert [position.temperature for position in positions] == pytest.approx([24.11] * 6, abs=0.01)


def test_six_face_on_i2c(warm: WarmStart, tmp_path: Path) -> None:
    pytest.importorskip("smbus2", reason="the smbus2 package is not installed")
    part = Sca3000(thermometer=False, seed=2)
    with run_on_i2c(program(warm.program, *ON_I2C, tmp_path), part, 0x1D) as bench:
        told = bench.lead()
        assert bench.exit_code == 0, bench.errors()
    require_true(told, tmp_path, part)


def test_a_twin_file_with_too_few_channels_is_refused(tmp_path: Path) -> None:
    (tmp_path / "flat.yaml").write_text(
        "tiltcal: 1\nkind: twin\ntruth:\n  offset: {x: 10.0, y: 11.0}\n"
        "  sensitivity: {x: {x: 1333.0, y: 0.0}, y: {x: 0.0, y: 1333.0}}\n"
    )
    refused = tiltcal("probe", "--sensor", "sca3000-d01", "--address", "sim:twin=flat.yaml", cwd=tmp_path)
    assert refused.returncode == 2
    assert "the twin file has no z, which a sca3000-d01 reads" in refused.stderr

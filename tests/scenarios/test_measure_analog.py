"""Analog sensors through whole procedures: with converters that were written apart from ours, and on the virtual bench.

The independent ones stand behind the real bus libraries at a supply of 4.9 V that wanders; offsets are found within
2 mV and sensitivities within 3 mV/g of the part's truth at 5 V.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from support.command import tiltcal
from support.emulated.bench import Bench, PartFacts, run_on_i2c, run_on_spi
from support.warm_start import WarmStart

from tiltcal.files.calibration import CalibrationRecord, read_calibration


@dataclass(frozen=True)
class Ads1115Sca100t:
    """The truth of the independent part: see :mod:`support.analog_part`."""

    kind: ClassVar[str] = "ads1115"

    offset: tuple[float, float] = (2.5134, 2.4819)
    sensitivity: tuple[tuple[float, float, float], tuple[float, float, float]] = (
        (2.0312, 0.0441, 0.0),
        (-0.0317, 1.9884, 0.0),
    )
    supply: float = 4.9
    wander: float = 0.03
    noise: float = 5e-4
    jig: float = 0.01
    seed: int = 1


@dataclass(frozen=True)
class Mcp3208Sca100t(Ads1115Sca100t):
    """The same sensor at the other converter."""

    kind: ClassVar[str] = "mcp3208"


def program(start: Sequence[str], address: str, folder: Path, *options: str) -> list[str]:
    return [
        *(*start, "measure", "plane", "--sensor", "sca100t-d02-analog"),
        *("--address", address, "--serial", "S-7", "-o", str(folder / "S-7.yaml")),
        *("--operator", "json", "--settle", "0.2", *options),
    ]


def found(bench: Bench, folder: Path) -> CalibrationRecord:
    said = bench.lead()
    assert bench.exit_code == 0, bench.errors()
    assert said[-1]["event"] == "done"
    return read_calibration(folder / "S-7.yaml")


def assert_true(calibration: CalibrationRecord, part: Ads1115Sca100t) -> None:
    np.testing.assert_allclose(calibration.coefficients.offset, part.offset, atol=2e-3)
    np.testing.assert_allclose(
        calibration.coefficients.sensitivity[:, :2], np.array(part.sensitivity)[:, :2], atol=3e-3
    )


@pytest.mark.parametrize("rate", ["", "&rate=860"])
def test_plane_at_an_ads1115_and_4_9_volts(rate: str, warm: WarmStart, tmp_path: Path) -> None:
    pytest.importorskip("smbus2", reason="the smbus2 package is not installed")
    address, part = f"ads1115+i2c:///dev/i2c-1?address=0x48&x=0&y=1&supply=2{rate}", Ads1115Sca100t()
    with run_on_i2c(program(warm.program, address, tmp_path, "--samples", "25"), part, 0x48) as bench:
        assert_true(found(bench, tmp_path), part)


def test_plane_at_an_mcp3208_and_4_9_volts(warm: WarmStart, tmp_path: Path) -> None:
    pytest.importorskip("spidev", reason="the spidev package is not installed")
    address, part = "mcp3208+spi:///dev/spidev0.0?x=0&y=1&vref=5.0", Mcp3208Sca100t()
    with run_on_spi(program(warm.program, address, tmp_path, "--samples", "25"), part) as bench:
        assert_true(found(bench, tmp_path), part)


def refused(start: Sequence[str], address: str, part: PartFacts, folder: Path, at: int) -> str:
    """What is said where the first look at the sensor already fails."""
    with run_on_i2c(program(start, address, folder), part, at) as bench:
        assert bench.exit_code == 3
        return bench.errors()


@pytest.mark.parametrize(
    ("part", "at", "why"),
    [
        (Ads1115Sca100t(), 0x49, "no device acknowledges at address 0x48"),
        (Ads1115Sca100t(supply=3.3), 0x48, "where the sensor needs 4.75 to 5.25 V"),
    ],
)
def test_faults_at_the_bus_end_with_exit_code_3(
    part: PartFacts, at: int, why: str, warm: WarmStart, tmp_path: Path
) -> None:
    pytest.importorskip("smbus2", reason="the smbus2 package is not installed")
    assert why in refused(warm.program, "ads1115+i2c:///dev/i2c-1?address=0x48&x=0&y=1&supply=2", part, tmp_path, at)


def test_a_twin_at_4_9_volts_from_a_file(tmp_path: Path) -> None:
    (tmp_path / "twin.yaml").write_text(
        "tiltcal: 1\nkind: twin\nmodel: sca100t-d02-analog\nseed: 4\ntruth:\n"
        "  offset: {x: 2.5134, y: 2.4819}\n"
        "  sensitivity: {x: {x: 2.0312, y: 0.0441}, y: {x: -0.0317, y: 1.9884}}\n"
        "  noise: {x: 0.0005, y: 0.0005}\n  supply: 4.9\n  jig: 0.01\n"
    )
    place = ["--sensor", "sca100t-d02-analog", "--serial", "S-7", "-o", "S-7.yaml", "--operator", "sim"]
    result = tiltcal("measure", "plane", *place, "--address", "sim:twin=twin.yaml", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert_true(read_calibration(tmp_path / "S-7.yaml"), Ads1115Sca100t())


def test_a_session_cut_between_any_two_transactions_goes_on(tmp_path: Path) -> None:
    """A conversion is started by one transaction and read by a later one: the drivers begin anew."""
    path = tmp_path / "S-7.journal.jsonl"
    place = ["--sensor", "sca100t-d02-analog", "--address", "sim:?seed=1", "--serial", "S-7", "-o", "S-7.yaml"]
    quick = ["--operator", "sim", "--samples", "5", "--settle", "0.5"]
    assert tiltcal("measure", "plane", *place, *quick, cwd=tmp_path).returncode == 0
    lines, golden = path.read_bytes().splitlines(keepends=True), read_calibration(tmp_path / "S-7.yaml")
    # A sample is four conversions of three transactions or a few more.
    for kept in range(200, 218):
        path.write_bytes(b"".join(lines[:kept]))
        result = tiltcal("measure", "--resume", path.name, cwd=tmp_path)
        assert result.returncode == 0, result.stderr
        found = read_calibration(tmp_path / "S-7.yaml")
        assert found.positions[0] == golden.positions[0], lines[kept]
        assert found.coefficients.offset == pytest.approx(golden.coefficients.offset, abs=5e-3), lines[kept]


def test_probe_of_a_thermistor(tmp_path: Path) -> None:
    result = tiltcal("probe", "--sensor", "thermistor", "--address", "sim:", "--json", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert json.loads(result.stdout)["answers"]["temperature"] == "24.00 °C"

"""The length of gravity in every row of three axes, the sign of two axes on edge, and calibrations in doubt."""

import re
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from tests.support.command import tiltcal
from tiltcal import read

NOTE = "|g| is"


@pytest.fixture(autouse=True)
def in_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def calibration(
    name: str = "cal.yaml", *, unit: str = "g", scale: float = 1.0, fit: str = "", axes: str = "xyz"
) -> str:
    own = [f"    {a}: {{{', '.join(f'{b}: {scale if a == b else 0.0}' for b in axes)}}}" for a in axes]
    Path(name).write_text(
        "tiltcal: 1\nkind: tilt\n"
        f"sensor: {{model: bench-built, serial: S-1, unit: {unit}, channels: [{', '.join(axes)}]}}\n"
        f"calibration:\n  offset: {{{', '.join(f'{a}: 0.0' for a in axes)}}}\n  sensitivity:\n"
        + "\n".join(own)
        + f"\n{fit}"
    )
    return name


def still(rows: int = 1000, tilt: float = 0.0, noise: float = 5e-4) -> np.ndarray:
    """An independent simulation: a still SCL3300 whose x axis points up by some degrees, g."""
    up = np.array([np.sin(np.radians(tilt)), 0.0, np.cos(np.radians(tilt))])
    return up + np.random.default_rng(1).normal(0.0, noise, (rows, 3))


def applied(
    readings: np.ndarray, *options: str, name: str = "log.csv", cal: str = "cal.yaml"
) -> tuple[pl.DataFrame, str]:
    table = pl.DataFrame(dict(zip("xyz", readings.T, strict=False)))
    (table.write_parquet if name.endswith("parquet") else table.write_csv)(name)
    out = f"out-{name}"
    done = tiltcal("apply", cal, name, "-o", out, *options, code=0)
    return (pl.read_parquet if name.endswith("parquet") else pl.read_csv)(out), done.stderr


def test_what_a_tilt_does_not_show() -> None:
    calibration()
    for name, changed, flag, length in (
        ("as calibrated", lambda g: g, 1, ""),
        ("a third of gravity", lambda g: g / 3.0, 4, "0.333"),
        ("supply 3 % low", lambda g: 0.97 * g, 3, "0.97"),
        ("broken z wire", lambda g: g * (1.0, 1.0, 0.0), 4, "0.48"),
        ("broken z wire, tilted", lambda g: g * (1.6, 1.0, 0.0), 3, "0.77"),
        ("m/s² under g", lambda g: 9.80665 * g, 4, "9.8"),
        ("counts under g", lambda g: 30.0 * g, 4, "20"),
        ("supply 1 % low, which a row may have", lambda g: 0.99 * g, 1, "0.99"),
    ):
        out, said = applied(changed(still(tilt=29.0)))
        assert set(zip(out["flag"], out["reason"], strict=True)) == {(flag, 0 if flag == 1 else 256)}, name
        for angle in ("tilt_x", "tilt_y", "tilt_z", "pitch", "roll", "inclination"):
            assert out[angle].is_nan().sum() == (1000 if flag == 4 else 0)
        assert said.count(NOTE) == bool(length)
        assert not length or re.search(
            rf"\|g\| is {re.escape(length)}\d*: supply, unit, place or zero differ from", said
        )


class TestMeans:
    def test_the_readings_are_judged_not_their_mean(self) -> None:
        """A mooring that sways by ±40°: each reading has 1 g, and their mean 0.77."""
        calibration()
        sway = np.radians(np.tile([-40.0, 40.0], 50))
        out, said = applied(np.stack([np.sin(sway), np.zeros(100), np.cos(sway)], axis=1), "--average", "10")
        assert out["flag"].to_list() == [1] * 10
        assert NOTE not in said


class TestOnEdge:
    def test_the_sign_that_nothing_shows(self) -> None:
        """A meter that stands, its sensor on edge: 20, -20 and 30° read 20, 20 and 30°."""
        calibration(axes="xy")
        tilt = np.radians([20.0, -20.0, 30.0, 89.0, 60.0])  # of the meter's y axis; the sensor's y points down by them
        own = np.stack([np.zeros(5), -np.cos(tilt)], axis=1)
        out, said = applied(own, "--mounting", "roll=90")
        assert out["flag"].to_list() == [4, 4, 4, 1, 1]
        assert out["reason"].to_list() == [128, 128, 128, 0, 0]
        assert out["tilt_x"].to_list() == pytest.approx([0.0] * 5)
        assert out["tilt_y"].is_nan().to_list() == [True] * 3 + [False] * 2
        assert out["tilt_y"].to_list()[3:] == pytest.approx([89.0, 60.0])
        assert out["g_y"].is_nan().to_list() == [True] * 3 + [False] * 2
        assert said.count("in 3 rows the sensor is more than 45° from level, mounted on edge") == 1


def test_a_calibration_that_is_not_credible() -> None:
    fit = "fit: {degrees_of_freedom: 8, chi_square: 363.0, p_value: 1.0e-73}\n"
    calibration(fit=fit)
    _, said = applied(still(10))
    assert said.count("not credible") == 1
    assert "S-1" in said
    remarks: list[str] = []
    read("cal.yaml").apply({"x": np.zeros(1), "y": np.zeros(1), "z": np.ones(1)}, say=remarks.append)
    assert ["not credible" in remark for remark in remarks] == [True]
    calibration(fit=fit.replace("1.0e-73", "0.002"))
    assert "not credible" not in applied(still(10))[1]


@pytest.mark.parametrize("options", [(), ("--average", "10")])
def test_each_sensor_of_a_folder_has_its_own_note_and_flags(options: tuple[str, ...]) -> None:
    """Calibrations over time, and two sensors side by side, in one pass."""
    Path("season").mkdir()
    for serial in ("S-1", "S-2"):
        for month in (5, 9):
            name = calibration(f"season/{serial}-{month}.yaml")
            end = f"provenance: {{ended: '2026-0{month}-01T00:00:00Z'}}\n"
            Path(name).write_text(Path(name).read_text().replace("serial: S-1", f"serial: {serial}") + end)
    good, low = still(100), 0.97 * still(100)
    low[50] *= 0.3
    columns = {f"{s}_{a}": g[:, k] for s, g in (("S-1", good), ("S-2", low)) for k, a in enumerate("xyz")}
    june = 1782000000.0  # 2026
    pl.DataFrame({"time": june + 40000.0 * np.arange(100), **columns}).write_csv("log.csv")
    done = tiltcal("apply", "--calibrations", "season", "log.csv", "-o", "out.csv", *options, code=0)
    out, size = pl.read_csv("out.csv"), 10 if options else 100
    assert out["S-1_flag"].to_list() == [1] * size
    bad = 50 // (100 // size)
    assert out["S-2_flag"].to_list() == [4 if row == bad else 3 for row in range(size)]
    assert out["S-2_reason"].to_list() == [256] * size
    assert out["S-2_tilt_x"].is_nan().to_list() == [row == bad for row in range(size)]
    assert done.stderr.count("|g| is") == done.stderr.count("S-2: |g| is 0.97:") == 1

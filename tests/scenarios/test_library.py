"""The same calibration from the command line and from Python, and from every kind of data."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest
import xarray as xr
from support.command import tiltcal as command

import tiltcal

FACES = {
    "x-up": (1, 0, 0),
    "x-down": (-1, 0, 0),
    "y-up": (0, 1, 0),
    "y-down": (0, -1, 0),
    "z-up": (0, 0, 1),
    "z-down": (0, 0, -1),
}
ROWS = 60
OFFSET, SENSITIVITY = np.array([0.1, -0.2, 0.05]), np.diag([9.7, 9.8, 9.9])


@pytest.fixture(scope="module")
def columns() -> dict[str, Any]:
    """Readings in the six faces one after the other, m/s²."""
    rng = np.random.default_rng(7)
    up = np.repeat(np.array(list(FACES.values()), dtype=float), ROWS, axis=0)
    read = OFFSET + up @ SENSITIVITY.T + rng.normal(0.0, 0.01, up.shape)
    return {f"acc_{axis}": np.round(read[:, k], 6) for k, axis in enumerate("xyz")}


@pytest.fixture(scope="module")
def segments() -> list[dict[str, Any]]:
    return [{"position": name, "start": k * ROWS, "end": (k + 1) * ROWS} for k, name in enumerate(FACES)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, columns: dict[str, Any], segments: list[dict[str, Any]]) -> Path:
    folder = tmp_path_factory.mktemp("library")
    pl.DataFrame(columns).write_csv(folder / "log.csv")
    pl.DataFrame(segments).write_csv(folder / "segments.csv")
    return folder


NAMED = {"x": "acc_x", "y": "acc_y", "z": "acc_z"}
SENSOR: dict[str, Any] = {"serial": "IMU1", "unit": "m/s2"}


def test_a_log_gives_the_same_file(folder: Path) -> None:
    result = command(
        *("fit", "six-face", "log.csv", "--segments", "segments.csv", "--columns", "x=acc_x,y=acc_y,z=acc_z"),
        *("--unit", "m/s2", "--serial", "IMU1", "--jig", "0.1", "-o", "command.yaml"),
        cwd=folder,
        code=0,
    )
    found = tiltcal.fit(
        "six-face", folder / "log.csv", segments=folder / "segments.csv", columns=NAMED, jig=0.1, **SENSOR
    )
    found.save(folder / "library.yaml")
    assert (folder / "library.yaml").read_bytes() == (folder / "command.yaml").read_bytes()
    assert result.stdout == f"{found}\n"
    assert tiltcal.read(folder / "command.yaml") == found


@pytest.mark.parametrize(
    "frame",
    [pl.DataFrame, pd.DataFrame, pa.table, dict, lambda data: xr.Dataset({k: ("row", v) for k, v in data.items()})],
    ids=["polars", "pandas", "pyarrow", "dict", "xarray"],
)
def test_a_frame_gives_the_calibration_of_its_log(
    frame: Any, folder: Path, columns: dict[str, Any], segments: list[dict[str, Any]]
) -> None:
    of_log = tiltcal.fit("six-face", folder / "log.csv", segments=folder / "segments.csv", columns=NAMED, **SENSOR)
    found = tiltcal.fit("six-face", frame(columns), segments=segments, columns=NAMED, **SENSOR)
    assert _without_provenance(found) == _without_provenance(of_log)


def test_an_option_that_there_is_not_is_named(tmp_path: Path) -> None:
    shutil.copy(FIXTURES / "mavs.yaml", tmp_path)
    pair = tiltcal.read(FIXTURES / "rotation.yaml")
    for calibration in (pair, tiltcal.open_calibrations(tmp_path)):
        with pytest.raises(
            TypeError, match=r"there is no option 'uncertanty' \(did you mean 'uncertainty'\?\); the options"
        ):
            calibration.apply({}, uncertanty=True)


def test_a_frame_of_positions_is_a_table(folder: Path) -> None:
    means = np.array([OFFSET + SENSITIVITY @ up for up in FACES.values()])
    table = {
        "position": list(FACES),
        **{axis: means[:, k].tolist() for k, axis in enumerate("xyz")},
        **{f"u{axis}": [0.01] * 6 for axis in "xyz"},
    }
    pl.DataFrame(table).write_csv(folder / "means.csv")
    of_file = tiltcal.fit("six-face", folder / "means.csv", table=True, **SENSOR)
    for frame in (pl.DataFrame(table), pd.DataFrame(table), table):
        found = tiltcal.fit("six-face", frame, **SENSOR)
        assert (found.offset, found.sensitivity) == (of_file.offset, of_file.sensitivity)
        assert found.uncertainty == of_file.uncertainty


def test_a_table_whose_noise_is_not_stated_is_not_judged_by_it() -> None:
    """Its rounding alone would be no noise, against which sound positions are not credible."""
    rng = np.random.default_rng(5)
    placed = [np.array(up) + np.cross(rng.normal(0.0, np.radians(0.3), 3), up) for up in FACES.values()]
    means = np.array([OFFSET + SENSITIVITY @ (up / np.linalg.norm(up)) for up in placed]).round(6)
    table = {"position": list(FACES), **{axis: means[:, k].tolist() for k, axis in enumerate("xyz")}}
    found = tiltcal.fit("six-face", table, jig=0.5, **SENSOR).fit
    assert (found.degrees_of_freedom, found.chi_square, found.p_value) == (6, None, None)
    assert any("states no uncertainties of its means" in note for note in found.notes)
    stated = tiltcal.fit("six-face", table | {f"u{axis}": [0.001] * 6 for axis in "xyz"}, jig=0.5, **SENSOR).fit
    assert (stated.p_value or 0.0) > 0.001


def test_apply_and_apply_log_agree(folder: Path, columns: dict[str, Any], segments: list[dict[str, Any]]) -> None:
    found = tiltcal.fit("six-face", columns, segments=segments, columns=NAMED, **SENSOR)
    assert isinstance(found, tiltcal.Calibration)
    frame = pl.read_csv(folder / "log.csv")
    tilted = found.apply(frame, columns=NAMED, uncertainty=True)
    summary = tiltcal.apply_log(found, folder / "log.csv", folder / "tilt.parquet", columns=NAMED, uncertainty=True)
    assert repr(summary).startswith(f"{6 * ROWS} rows\n  flag 1 pass: ")
    assert tilted.equals(pl.read_parquet(folder / "tilt.parquet"))
    assert tilted["pitch"][0] == pytest.approx(90.0, abs=0.5)
    with pytest.raises(tiltcal.InputError, match="in g"):
        found.apply(frame, columns=NAMED, unit="g")


FIXTURES = Path(__file__).parents[2] / "fixtures"


def test_pairs_are_matched_from_frame_and_file_alike(tmp_path: Path) -> None:
    """Two accelerometers at 0° and 180° of a turning disk, the second 1 % larger, a third at a right angle."""
    theta, rng = np.arange(0.0, 360.0 * 20, 7.0), np.random.default_rng(5)
    up, across = np.sin(np.radians(theta)), np.cos(np.radians(theta))
    columns = {"a1": up, "a2": -1.01 * up, "a4": across}
    noisy = {name: values + rng.normal(0, 1e-4, len(theta)) for name, values in columns.items()}
    frame = pl.DataFrame({"theta": theta, **noisy})
    frame.write_csv(tmp_path / "disk.csv")
    for name, how, options in (("disk", {}, ()), ("loops", {"online": True, "loops": True}, ("--online", "--loops"))):
        pair = ("--pair", "a1,a2", "--orthogonal", "a4", "--phase", "theta", "-o", f"{name}.yaml")
        result = command("match", "disk.csv", *pair, *options, cwd=tmp_path, code=0)
        of_file = tiltcal.match(tmp_path / "disk.csv", [("a1", "a2", "a4")], phase="theta", **how)
        assert of_file == tiltcal.read(tmp_path / f"{name}.yaml")
        assert result.stdout == f"{of_file}\n"
        (found,) = tiltcal.match(frame, [("a1", "a2", "a4")], phase="theta", **how).matchings
        assert (found.p, found.q) == (of_file.matchings[0].p, of_file.matchings[0].q)
        assert found.p == pytest.approx(1.0 - 1.01, abs=1e-4)
    with pytest.raises(tiltcal.UsageError, match="three different columns"):
        tiltcal.match(frame, [("a1", "a1", "a4")], phase="theta")


def _without_provenance(calibration: tiltcal.Calibration) -> str:
    from tiltcal.files.results import Provenance

    return replace(calibration.record, provenance=Provenance()).text

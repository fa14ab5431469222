"""``tiltcal fit`` of a log whose times are dates: the file has them, and a folder of calibrations uses it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray
from support.command import tiltcal

from tiltcal.core.model import Array
from tiltcal.files.calibration import CalibrationRecord, read_calibration

PLACES = {"x-tilt1": (30.0, 0.0), "x-tilt2": (-30.0, 0.0), "y-tilt1": (0.0, 30.0), "y-tilt2": (0.0, -30.0)}
ROWS = 20
SEGMENTS = "position,start,end\n" + "".join(f"{name},{k * ROWS},{(k + 1) * ROWS}\n" for k, name in enumerate(PLACES))


def readings() -> list[Array]:
    """An ideal sensor of 1 V/g in four positions."""
    rng = np.random.default_rng(3)
    return [np.sin(np.radians(angles)) + rng.normal(0.0, 1e-3, 2) for angles in PLACES.values() for _ in range(ROWS)]


def fitted(folder: Path, times: list[str], *options: str) -> CalibrationRecord:
    """The calibration of a CSV log with these times, whose column has another name where there are options."""
    rows = [f"{time},{x:.5f},{y:.5f}" for time, (x, y) in zip(times, readings(), strict=True)]
    (folder / "log.csv").write_text("\n".join([f"{'when' if options else 'time'},x,y", *rows]) + "\n")
    return fitted_log(folder, "log.csv", *options)


def fitted_log(folder: Path, log: str, *options: str) -> CalibrationRecord:
    (folder / "segments.csv").write_text(SEGMENTS)
    result = tiltcal(
        *("fit", "plane", log, "--segments", "segments.csv", "--unit", "V", "--serial", "S", "--jig", "0.1"),
        *(*options, "-o", "S.yaml"),
        cwd=folder,
    )
    assert result.returncode == 0, result.stderr
    return read_calibration(folder / "S.yaml")


@pytest.mark.parametrize("options", [(), ("--columns", "time=when")])
@pytest.mark.parametrize("written", ["2026-05-01T12:{:02}:{:02}Z", "seconds"])
def test_positions_have_the_time_of_their_last_row(tmp_path: Path, written: str, options: tuple[str, ...]) -> None:
    noon = 1777636800  # date -u -d 2026-05-01T12:00:00Z +%s
    times = [str(noon + k) if written == "seconds" else written.format(*divmod(k, 60)) for k in range(4 * ROWS)]
    found = fitted(tmp_path, times, *options)
    ends = ["12:00:19", "12:00:39", "12:00:59", "12:01:19"]
    assert [position.time for position in found.positions] == [f"2026-05-01T{end}.000Z" for end in ends]
    assert found.provenance.started == "2026-05-01T12:00:00.000Z"
    assert found.provenance.ended == "2026-05-01T12:01:19.000Z"


@pytest.mark.parametrize("time", ["{}", "{}.5", "after {} s", ""])
def test_without_dates_there_is_none(tmp_path: Path, time: str) -> None:
    found = fitted(tmp_path, [time.format(k) for k in range(4 * ROWS)])
    assert {position.time for position in found.positions} == {None}
    assert (found.provenance.started, found.provenance.ended) == (None, None)


@pytest.mark.parametrize(
    "time",
    [
        ("row", np.arange(4 * ROWS), {"units": "months since 2026-01-01"}),
        ("row", np.zeros(4 * ROWS, bool)),
        ("other", np.zeros(3)),
        ((), 5.0),
    ],
    ids=["months", "booleans", "another dimension", "a single number"],
)
def test_a_variable_that_is_no_time_of_the_rows_is_left_alone(tmp_path: Path, time: tuple[object, ...]) -> None:
    x, y = np.array(readings()).T
    log = xarray.Dataset({"x": ("row", x), "y": ("row", y), "time": time})
    log.to_netcdf(tmp_path / "log.nc", engine="h5netcdf")
    assert fitted_log(tmp_path, "log.nc").provenance.ended is None


def test_a_folder_of_calibrations_uses_what_was_fitted(tmp_path: Path) -> None:
    (tmp_path / "calibrations").mkdir()
    fitted(tmp_path, [f"2026-05-01T12:{k // 60:02}:{k % 60:02}Z" for k in range(4 * ROWS)])
    (tmp_path / "S.yaml").rename(tmp_path / "calibrations" / "S.yaml")
    (tmp_path / "later.csv").write_text("time,x,y\n2026-06-01T00:00:00Z,0.4,0\n")
    result = tiltcal("apply", "--calibrations", "calibrations", "later.csv", "--serial", "S", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert float(result.stdout.split()[1].split(",")[5]) == pytest.approx(23.578, abs=0.2)  # asin 0.4
    assert result.stdout.rstrip().endswith(",3,64")

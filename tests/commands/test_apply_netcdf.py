"""``tiltcal apply`` on NetCDF: the file stays as it is, and what is added says what it is."""

import os
import re
import sys
from math import nan
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from support import FIXTURES
from support.applied import apply, refused

from tiltcal.errors import InputError, UsageError
from tiltcal.logs.cf_attributes import describe

xarray = pytest.importorskip("xarray")
h5netcdf = pytest.importorskip("h5netcdf")
h5py = pytest.importorskip("h5py")

CAL = str(FIXTURES / "mavs.yaml")
OWN = ("x", "y", "temperature", "note", "time", "spectrum")


@pytest.fixture(autouse=True)
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a log whose temperature is packed, with one that is missing."""
    monkeypatch.chdir(tmp_path)
    rows = 6
    log = xarray.Dataset(
        {
            "x": ("time", np.array([1024, 1100, 1800, 2047, 700, 1024], np.int32), {"units": "count"}),
            "y": ("time", np.array([1024, 1000, nan, 1024, 1024, 1024], np.float32)),
            "temperature": ("time", [10.0, 12.5, 11.0, 11.0, nan, 60.0], {"units": "degC"}),
            "note": ("time", np.array(["a", "", "b", "ü", "c", "d"], dtype=object)),
            "spectrum": (("time", "f"), np.ones((rows, 3))),
        },
        coords={"time": ("time", np.arange(rows) * 0.5, {"units": "hours since 2026-05-01"}), "site": 4.0},
        attrs={"history": "2026-05-01 recorded", "title": "night"},
    )
    log["x"].encoding["coordinates"], log["y"].encoding["coordinates"] = "site", None
    packed = {"dtype": "i2", "scale_factor": 0.01, "_FillValue": np.int16(-999)}
    log.to_netcdf("log.nc", engine="h5netcdf", unlimited_dims=["time"], encoding={"temperature": packed})
    return tmp_path


def raw(path: str) -> dict[str, tuple[bytes, dict[str, object]]]:
    """Every variable as it lies in the file, with its attributes; HDF5's own say where it lies."""
    own = ("DIMENSION_LIST", "REFERENCE_LIST")
    with h5py.File(path) as file:
        return {
            name: (
                repr(variable[()].tolist()).encode(),
                {key: repr(value) for key, value in variable.attrs.items() if key not in own},
            )
            for name, variable in file.items()
        }


def test_values_and_flags_are_those_of_csv() -> None:
    with xarray.open_dataset("log.nc", decode_times=False) as log:
        plain = pl.DataFrame({name: log[name].values.astype(float) for name in ("x", "y", "temperature")})
    plain.write_csv("log.csv")
    for name in ("log.csv", "log.nc"):
        assert apply(CAL, name, "--uncertainty", "-o", "out-" + name).exit_code == 0
    expected = pl.read_csv("out-log.csv", infer_schema_length=None)
    with xarray.open_dataset("out-log.nc", decode_times=False, mask_and_scale=False) as found:
        for name in expected.columns[3:]:
            np.testing.assert_array_equal(found[name].values, expected[name].to_numpy(), err_msg=name)
        assert found["flag"].values.tolist()[2] == 9
        assert (found["flag"].dtype, found["reason"].dtype) == (np.uint8, np.uint16)


def test_what_the_file_held_stays_as_it_lay() -> None:
    apply(CAL, "log.nc", "-o", "out.nc")
    before, after = raw("log.nc"), raw("out.nc")
    assert {name: after[name] for name in before} == before
    with h5netcdf.File("out.nc") as file:
        assert file.dimensions["time"].isunlimited()
        assert file.attrs["title"] == "night"


def test_what_is_added_says_what_it_is() -> None:
    apply(CAL, "log.nc", "--uncertainty", "-o", "out.nc")
    with xarray.open_dataset("out.nc", decode_times=False, decode_coords=False) as found:
        added = [name for name in found.variables if name not in (*OWN, "site")]
        for name in added:
            expected = describe(name, added, {"units": "count", "coordinates": "site"})
            assert {key: np.asarray(text).tolist() for key, text in found[name].attrs.items()} == {
                key: np.asarray(text).tolist() for key, text in expected.items()
            }
            whole = name in ("flag", "reason")
            packing = found[name].encoding
            assert ("_FillValue" in packing, packing["chunksizes"], packing["shuffle"]) == (not whole, (6,), True)
        assert found["reason"].attrs["flag_masks"].dtype == found["reason"].dtype
        first, second = found.attrs["history"].split("\n")
        assert first == "2026-05-01 recorded"
        made = r"\d{4}-\d\d-\d\dT[\d:]+Z tiltcal \S+ apply: calibration mavs\.yaml, sha256 \w{64}, serial \S+"
        assert re.fullmatch(made, second)


def test_there_is_no_way_between_netcdf_and_the_others() -> None:
    for log, output in (("log.nc", "-"), ("log.nc", "out.csv"), ("log.nc", "out.parquet"), ("log.csv", "out.nc")):
        assert "NetCDF" in refused(apply(CAL, log, "-o", output), UsageError)


def test_means_keep_variables_of_text(bench: Path) -> None:
    """Means of a log with any text were refused: nothing could be added."""
    data = {"x": 1024.0, "y": 1024.0, "temperature": 20.0, "note": "öre", "time": "2026-05-01T12:00:00"}
    rows = {name: ("row", [value] * 4) for name, value in data.items()}
    rows["time"] = ("row", [f"2026-05-01T12:00:{second:02}" for second in (0, 5, 10, 15)])
    xarray.Dataset(rows, {}, {}).to_netcdf("text.nc", engine="h5netcdf")
    assert apply(CAL, "text.nc", "--every", "10s", "-o", "means.nc").exit_code == 0
    with xarray.open_dataset("means.nc", engine="h5netcdf") as means:
        assert means["count"].values.tolist() == [2, 2]
        assert means["note"].values.tolist() == ["öre", "öre"]
        assert means["time"].values.tolist() == ["2026-05-01T12:00:02.500Z", "2026-05-01T12:00:12.500Z"]


def test_what_is_no_netcdf() -> None:
    for content in (b"", b"x,y\n1,2\n", b"\x89HDF\r\n\x1a\n" + b"\0" * 100):
        Path("bad.nc").write_bytes(content)
        said = refused(apply(CAL, "bad.nc", "-o", "out.nc"), InputError)
        assert said.startswith("bad.nc: this is no NetCDF-4 file, or a damaged one")
    Path("old.nc").write_bytes(b"CDF\x01" + bytes(100))
    assert "nccopy -k nc4" in refused(apply(CAL, "old.nc", "-o", "out.nc"), InputError)


def test_a_column_that_will_not_do(bench: Path) -> None:
    for columns, said in {
        "x=VoutX": "log.nc: there is no column 'VoutX'",
        "x=note": "column 'note' holds",
        "x=spectrum": "column 'spectrum' has 2 dimensions (time, f)",
        "x=site": "column 'site' has 0 dimensions",
    }.items():
        assert said in refused(apply(CAL, "log.nc", "--columns", columns, "-o", "out.nc"), InputError)
        assert os.listdir(bench) == ["log.nc"]


def test_libraries_that_are_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "h5netcdf", None)
    assert "pip install 'tiltcal[netcdf]'" in refused(apply(CAL, "log.nc", "-o", "out.nc"), UsageError)

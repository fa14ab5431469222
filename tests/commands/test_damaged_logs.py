"""Damaged Parquet and NetCDF files: an error that names them, or the library's own end; never a half-written output."""

from __future__ import annotations

import shutil
from pathlib import Path

import h5netcdf
import numpy as np
import polars as pl
from support import FIXTURES
from support.command import tiltcal, tiltcal_process

from tiltcal.logs.formats import open_log

DAMAGED = Path(__file__).parents[1] / "support" / "damaged"
CAL = str(FIXTURES / "mavs.yaml")


def netcdf(path: Path, rows: int = 4, **attributes: object) -> None:
    with h5netcdf.File(path, "w") as file:
        file.dimensions = {"time": rows}
        for name in ("time", "x", "y"):
            variable = file.create_variable(name, ("time",), "f8", chunks=(min(rows, 1024),))
            for key, value in attributes.items():
                variable.attrs[key] = value
            if rows < 100:
                variable[:] = np.full(rows, 1024.0)


def test_an_engine_that_panics(tmp_path: Path) -> None:
    """It raises what no handler of errors catches, and prints words of its own before."""
    shutil.copy(DAMAGED / "panic.parquet", tmp_path)
    done = tiltcal_process("apply", CAL, "panic.parquet", "-o", "out.csv", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith("tiltcal: panic.parquet: this is no Parquet file, or a damaged one")
    assert not (tmp_path / "out.csv").exists()


def test_an_offset_that_is_text(tmp_path: Path) -> None:
    netcdf(tmp_path / "log.nc", add_offset="two")
    done = tiltcal("apply", CAL, "log.nc", "-o", "out.nc", cwd=tmp_path)
    assert done.returncode == 2
    assert "log.nc: this is no NetCDF-4 file, or a damaged one: " in done.stderr


def test_rows_that_are_only_declared_take_no_memory(tmp_path: Path) -> None:
    """10¹² rows of three variables would be 24 TB."""
    netcdf(tmp_path / "log.nc", rows=10**12)
    with open_log(tmp_path / "log.nc") as log:
        assert len(next(log.rows([0, 1, 2]))) <= 1 << 21


def test_every_kind_of_column_to_csv(tmp_path: Path) -> None:
    """What polars cannot write as text is written in words, or refused."""
    readings = pl.DataFrame({"x": [1024.0, 1024.0], "y": [1024.0, 1024.0]})
    columns = {
        "passed": (pl.Series([90_000_000, None], dtype=pl.Duration("us")), ["PT1M30S", ""]),
        "day": (pl.Series([0, None], dtype=pl.Date), ["1970-01-01", ""]),
        "kind": (pl.Series(["a", None], dtype=pl.Categorical), ["a", ""]),
        "price": (pl.Series(["1.50", None]).cast(pl.Decimal(10, 2)), ["1.50", ""]),
        "nothing": (pl.Series([None, None], dtype=pl.Null), ["", ""]),
    }
    for name, (column, expected) in columns.items():
        readings.with_columns(column.alias(name)).write_parquet(tmp_path / "log.parquet")
        done = tiltcal("apply", CAL, "log.parquet", "-o", "out.csv", cwd=tmp_path)
        assert done.returncode == 0, (name, done.stderr)
        found = pl.read_csv(tmp_path / "out.csv", infer_schema=False)[name].fill_null("").to_list()
        assert found == expected
    readings.with_columns(list=pl.Series([[1], [2]])).write_parquet(tmp_path / "log.parquet")
    done = tiltcal("apply", CAL, "log.parquet", "-o", "out.csv", cwd=tmp_path)
    assert (done.returncode, "log.parquet: this log cannot become CSV: " in done.stderr) == (2, True)

"""Damaged files of every kind: an error that names them, or the library's own end; never a half-written output."""

import io
import shutil
from dataclasses import replace
from pathlib import Path

import h5netcdf
import numpy as np
import polars as pl
import pytest
from support import FIXTURES
from support.command import tiltcal, tiltcal_process

import tiltcal as tiltcal_library
from tiltcal.files.coefficients import Covariance
from tiltcal.logs.formats import open_log

PANICS = Path(__file__).parents[1] / "support" / "damaged" / "panic.parquet"
CAL = str(FIXTURES / "mavs.yaml")
LEVELS = 1024.0 + np.random.default_rng(0).random((20_000, 2))


def parquet() -> bytes:
    stream = io.BytesIO()
    pl.DataFrame(LEVELS, schema=["x", "y"]).write_parquet(stream)
    return stream.getvalue()


JOURNAL, PARQUET = (FIXTURES / "plane.journal.jsonl").read_bytes(), parquet()
BOMB = "a0: &a0 [x, x]\n" + "".join(f"a{n}: &a{n} [*a{n - 1}, *a{n - 1}]\n" for n in range(1, 30))
DAMAGED = {
    "torn.journal.jsonl": JOURNAL[: JOURNAL.index(b"\n", 5000) - 9],
    "changed.journal.jsonl": JOURNAL.replace(b',"s",', b',"S",', 1),
    "short.parquet": PARQUET[:-2000],
    "holed.parquet": PARQUET[:100_000] + bytes(100_000) + PARQUET[200_000:],
    "zeros.csv": b"x,y\n" + bytes(5000),
    "bomb.yaml": BOMB.encode(),
    "binary.yaml": bytes(range(256)) * 8,
}


@pytest.mark.parametrize("name", DAMAGED)
def test_it_is_named_wherever_it_is_given(name: str, tmp_path: Path) -> None:
    """`benchmarks/fuzz.py` tries many more."""
    (tmp_path / name).write_bytes(DAMAGED[name])
    (tmp_path / "log.csv").write_text("x,y\n1024,1024\n")
    (tmp_path / "out.csv").write_text("the one before")
    before = sorted(path.name for path in tmp_path.iterdir())
    for command in (
        f"check {name}",
        f"replay {name} -o new.yaml",
        f"apply {CAL} {name} -o out.csv",
        f"apply {name} log.csv -o out.csv",
        f"fit level {name} --base {CAL} -o new.yaml",
        f"fit level log.csv --base {name} -o new.yaml",
        f"report {CAL} {name} -o page.html",
    ):
        done = tiltcal(*command.split(), cwd=tmp_path)
        interrupted = command == "check torn.journal.jsonl"
        assert (done.returncode, name in done.stdout + done.stderr) == (1 if interrupted else 2, True), command
        assert ("its last line is torn off" in done.stdout) is interrupted
    assert sorted(path.name for path in tmp_path.iterdir()) == before
    assert (tmp_path / "out.csv").read_text() == "the one before"


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
    shutil.copy(PANICS, tmp_path)
    done = tiltcal_process("apply", CAL, "panic.parquet", "-o", "out.csv", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith("tiltcal: panic.parquet: this is no Parquet file, or a damaged one")
    assert not (tmp_path / "out.csv").exists()


def test_an_offset_that_is_text_and_rows_that_are_only_declared(tmp_path: Path) -> None:
    """10¹² rows of three variables would be 24 TB."""
    netcdf(tmp_path / "log.nc", add_offset="two")
    done = tiltcal("apply", CAL, "log.nc", "-o", "out.nc", cwd=tmp_path, code=2)
    assert "log.nc: this is no NetCDF-4 file, or a damaged one: " in done.stderr
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
        done = tiltcal("apply", CAL, "log.parquet", "-o", "out.csv", cwd=tmp_path, code=0)
        found = pl.read_csv(tmp_path / "out.csv", infer_schema=False)[name].fill_null("").to_list()
        assert found == expected
    readings.with_columns(list=pl.Series([[1], [2]])).write_parquet(tmp_path / "log.parquet")
    done = tiltcal("apply", CAL, "log.parquet", "-o", "out.csv", cwd=tmp_path, code=2)
    assert "log.parquet: this log cannot become CSV: " in done.stderr
    # The engine's calendar, chrono's, ends in the year 262142: 8.21e15 ms or 95 million days after 1970.
    for beyond in (
        pl.Series([0, 9_200_000_000_000_000_000]).cast(pl.Datetime("us")),
        pl.Series([0, -9_200_000_000_000_000]).cast(pl.Datetime("ms", "UTC")),
        pl.Series([0, 100_000_000], dtype=pl.Int32).cast(pl.Date),
    ):
        readings.with_columns(late=beyond).write_parquet(tmp_path / "log.parquet")
        done = tiltcal("apply", CAL, "log.parquet", "-o", "beyond.csv", cwd=tmp_path, code=2)
        assert "column 'late' has a date after the year 262142" in done.stderr
    assert not (tmp_path / "beyond.csv").exists()


def test_a_calibration_that_every_command_would_refuse_is_not_written(tmp_path: Path) -> None:
    calibration = tiltcal_library.read(FIXTURES / "plane.yaml")
    uncertainty = calibration.record.uncertainty
    matrix = ((1.0, 2.0), (2.0, 1.0))  # a correlation of 2
    wrong = replace(uncertainty, covariance=Covariance(parameters=("offset.x", "offset.y"), matrix=matrix))
    contradictory = type(calibration)(replace(calibration.record, uncertainty=wrong))
    with pytest.raises(tiltcal_library.EstimateError, match=r"S\.yaml is not written, for the result"):
        contradictory.save(tmp_path / "S.yaml")
    assert not (tmp_path / "S.yaml").exists()

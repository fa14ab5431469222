"""The times of a log: how they may be written, and that what is none of these is refused where it decides something."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, date, datetime, time
from io import BytesIO
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from tiltcal.errors import InputError
from tiltcal.logs.formats.csv import CsvReader
from tiltcal.logs.formats.parquet import ParquetReader
from tiltcal.logs.log import LogSource
from tiltcal.logs.text_to_numbers import seconds

NOON = datetime(2026, 5, 1, 12, tzinfo=UTC).timestamp()


def csv(text: str, *, skip_bad_rows: bool = False, block: int = 1 << 20) -> list[float]:
    source = LogSource(BytesIO(text.encode()), "-", "log.csv", skip_bad_rows=skip_bad_rows)
    return [time for rows in CsvReader(source, block=block).rows([0, 1], 0, needs_time=True) for time in rows.values[0]]


def parquet(folder: Path, times: Sequence[object]) -> list[float]:
    path = folder / "log.parquet"
    pl.DataFrame({"time": pl.Series(times), "x": np.zeros(len(times))}).write_parquet(path)
    with path.open("rb") as stream:
        reader = ParquetReader(LogSource(stream, str(path), "log.parquet"))
        return [time for rows in reader.rows([0, 1], 0, needs_time=True) for time in rows.values[0]]


@pytest.mark.parametrize(
    ("text", "after_noon"),
    [
        ("2026-05-01T12:00:00Z", 0.0),
        ("2026-05-01 12:00", 0.0),
        ("2026-05-01T12:00Z", 0.0),
        ("2026-05-01 12:00 UTC", 0.0),
        ("2026-05-01 12:00:00.25 UTC", 0.25),
        (" 2026-05-01 12:00:01Z ", 1.0),
        ("2026-05-01 14:00:00+02:00", 0.0),
        ("2026-05-01T14:00+0200", 0.0),
        ("2026-05-01 14:00:00 +02", 0.0),
        ("2026-05-01", -43200.0),
    ],
)
def test_a_moment_may_leave_out_seconds_and_zone(text: str, after_noon: float) -> None:
    assert seconds(pl.Series([text, "2026-05-01T12:00:00"])).tolist() == [NOON + after_noon, NOON]


@pytest.mark.parametrize("text", ["01.05.2026 12:00:00", "05/01/2026 12:00", "12:00:01", "2026-05-01T25:00", "noon"])
@pytest.mark.parametrize("block", [8, 1 << 20])
def test_text_that_is_no_time_is_refused_with_its_line(text: str, block: int) -> None:
    with pytest.raises(InputError, match=f"^log.csv:3: column 'time' holds '{text}', neither seconds nor ISO 8601"):
        csv(f"time,x\n,1\n{text},2\n{text},3\n", block=block)


def test_missing_times_and_bad_rows_are_no_text() -> None:
    assert np.isnan(csv("time,x\n,1\nNaN,2\n")).all()
    assert np.isnan(csv("time,x\nnoon,y\nnoon,1,2\n", skip_bad_rows=True)).all()


def test_text_is_missing_where_no_time_is_needed() -> None:
    source = LogSource(BytesIO(b"time,x\nnoon,1\n"), "-", "log.csv")
    assert [len(rows) for rows in CsvReader(source).rows([0, 1], 0)] == [1]


def test_a_text_behind_the_first_times_counts_as_missing() -> None:
    assert csv("time,x\n1,1\nnoon,2\n", block=8) == pytest.approx([1.0, np.nan], nan_ok=True)


def test_a_date_in_parquet_is_its_midnight(tmp_path: Path) -> None:
    assert parquet(tmp_path, [date(2026, 5, 1), None]) == pytest.approx([NOON - 43200.0, np.nan], nan_ok=True)


@pytest.mark.parametrize(
    ("times", "found"), [([None, time(12, 0, 1)], "12:00:01"), ([None, "01.05.2026"], "01.05.2026")]
)
def test_a_time_of_day_in_parquet_is_refused_with_its_row(tmp_path: Path, times: list[object], found: str) -> None:
    with pytest.raises(InputError, match=f"^log.parquet: row 1: column 'time' holds '{found}', neither"):
        parquet(tmp_path, times)

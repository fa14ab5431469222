"""The times of a log: how they may be written, and that what is none of these is refused where it decides something."""

from collections.abc import Callable, Sequence
from datetime import UTC, date, datetime, time
from io import BytesIO
from pathlib import Path

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest
import xarray

from tiltcal.errors import InputError
from tiltcal.logs.formats.csv import CsvReader
from tiltcal.logs.formats.parquet import ParquetReader
from tiltcal.logs.frames import FrameReader
from tiltcal.logs.log import LogSource
from tiltcal.logs.numbers_and_times import seconds

NOON = datetime(2026, 5, 1, 12, tzinfo=UTC).timestamp()


def csv(text: str, *, skip_bad_rows: bool = False, block: int = 1 << 20) -> list[float]:
    source = LogSource(BytesIO(text.encode()), "-", "log.csv", skip_bad_rows=skip_bad_rows)
    return [time for rows in CsvReader(source, block=block).rows([0, 1], 0, needs_time=True) for time in rows.values[0]]


def parquet(folder: Path, times: Sequence[object]) -> list[float]:
    path = folder / "log.parquet"
    pl.DataFrame({"time": pl.Series(times), "x": np.zeros(len(times))}).write_parquet(path)
    with path.open("rb") as stream:
        reader = ParquetReader(LogSource(stream, str(path), "log.parquet", path.stat().st_size))
        return [time for rows in reader.rows([0, 1], 0, needs_time=True) for time in rows.values[0]]


def test_a_moment_may_leave_out_seconds_and_zone() -> None:
    moments = {
        **dict.fromkeys(("2026-05-01T12:00:00Z", "2026-05-01 12:00", "2026-05-01T12:00Z", "2026-05-01 12:00 UTC"), 0.0),
        **dict.fromkeys(("2026-05-01 14:00:00+02:00", "2026-05-01T14:00+0200", "2026-05-01 14:00:00 +02"), 0.0),
        "2026-05-01 12:00:00.25 UTC": 0.25,
        " 2026-05-01 12:00:01Z ": 1.0,
        "2026-05-01": -43200.0,
        "2026-05-01 24:00": 43200.0,
        "2026-05-01 12:59:60.5": 3600.5,
        **dict.fromkeys(("13-May-26 12:00", "13.05.2026 12:00", "13.5.26, 12.00"), 12 * 86400.0),
        "1.5.2026 1:30 PM": 5400.0,
        "1-may-2026 12:00:07.5 AM": -43192.5,
        "2026/5/1 11:59:59 am": -1.0,
    }
    for text, after_noon in moments.items():
        assert seconds(pl.Series([text, "2026-05-01T12:00:00"])).tolist() == [NOON + after_noon, NOON], text
    for order, text in (("month", "05/13/2026 12:00:00 pm"), ("day", "13/05/26 12:00"), ("open", "13/05/2026 12:00")):
        found = seconds(pl.Series([text, "2026-05-13 12:00"]), order)
        assert found[0] == pytest.approx(found[1] if order != "open" else np.nan, nan_ok=True)


@pytest.mark.parametrize("block", [8, 1 << 20])
def test_text_that_is_no_time_is_refused_with_its_line(block: int) -> None:
    for text in ("01.13.2026 12:00:00", "2026-05-01T25:00", "25:00:00", "12:60", "12:00:61", "noon"):
        with pytest.raises(InputError, match=f"^log.csv:6: column 'time' holds '{text}', neither seconds nor ISO 8601"):
            csv(f"time,x\n,1\n# more\n,1\n# more\n{text},2\n{text},3\n", block=block)


def test_a_text_behind_the_first_times_counts_as_missing() -> None:
    assert csv("time,x\n1,1\nnoon,2\n", block=8) == pytest.approx([1.0, np.nan], nan_ok=True)


def test_a_date_in_parquet_is_its_midnight_and_a_time_of_day_is_refused_with_its_row(tmp_path: Path) -> None:
    assert parquet(tmp_path, [date(2026, 5, 1), None]) == pytest.approx([NOON - 43200.0, np.nan], nan_ok=True)
    for times, found in (([None, time(12, 0, 1)], "12:00:01"), ([None, "01.13.2026"], "01.13.2026")):
        with pytest.raises(InputError, match=f"^log.parquet: row 1: column 'time' holds '{found}', neither"):
            parquet(tmp_path, times)


def frame_times(frame: object) -> list[float]:
    return [
        time
        for rows in FrameReader(frame).rows([0, 1], 0, needs_time=True)
        for time in np.asarray(rows.values[0]).tolist()
    ]


FRAMES: dict[str, Callable[[Sequence[object]], object]] = {
    "polars": lambda times: pl.DataFrame({"time": times, "x": [0.0] * len(times)}),
    "pandas": lambda times: pd.DataFrame({"time": times, "x": [0.0] * len(times)}),
    "pyarrow": lambda times: pa.table({"time": times, "x": [0.0] * len(times)}),
    "xarray": lambda times: xarray.Dataset({"time": ("row", [*times]), "x": ("row", np.zeros(len(times)))}),
    "dict": lambda times: {"time": [*times], "x": [0.0] * len(times)},
    "dict of objects": lambda times: {"time": np.array(times, object), "x": [0.0] * len(times)},
}


@pytest.mark.parametrize("made", FRAMES.values(), ids=FRAMES)
def test_text_in_a_frame_that_is_no_time_is_refused_with_its_row(made: Callable[..., object]) -> None:
    with pytest.raises(InputError, match=r"^the frame: row 1: column 'time' holds 'noon', neither"):
        frame_times(made(["", "noon", "noon"]))
    assert frame_times(made(["", "noon", "7"])) == pytest.approx([np.nan, np.nan, 7.0], nan_ok=True)
    assert np.isnan(frame_times(made(["", "NaN"]))).all()

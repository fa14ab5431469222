"""``tiltcal apply`` on Parquet: the columns keep their types, and the result is what it is for CSV."""

import hashlib
import json
from datetime import UTC, date, datetime, timedelta
from decimal import Decimal
from math import nan
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from polars.testing import assert_frame_equal
from support import FIXTURES
from support.applied import apply, refused

from tiltcal.errors import InputError
from tiltcal.logs.formats import open_log

WARM = """\
tiltcal: 1
kind: tilt
sensor: {model: bench-built, serial: S-1, unit: V, channels: [x, y]}
calibration:
  offset: {x: 2.5, y: 2.5}
  sensitivity: {x: {x: 2.0, y: 0.01}, y: {x: -0.02, y: 2.0}}
  temperature:
    reference: 20.0
    range: [5.0, 30.0]
    offset: {x: [0.01], y: [0.002]}
    sensitivity: {x: [0.001], y: [0.0]}
"""
ADDED = ["g_x", "g_y", "tilt_x", "tilt_y", "flag", "reason"]
LOG = pl.DataFrame({"time": [0.0, 0.1, 0.2, 0.3], "x": [3.5, None, nan, 9.0], "y": [2.5, 1.5, 2.5, 2.5]})


@pytest.fixture(autouse=True)
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a calibration and a log."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cal.yaml").write_text(WARM)
    LOG.write_parquet("log.parquet")
    return tmp_path


def applied(log: pl.DataFrame, *arguments: str) -> pl.DataFrame:
    """What comes out, as Parquet."""
    log.write_parquet("in.parquet")
    result = apply("cal.yaml", "in.parquet", "-o", "out.parquet", *arguments)
    assert result.exit_code == 0, result.exception
    return pl.read_parquet("out.parquet")


class TestOutput:
    def test_the_logs_own_columns_come_first_in_value_type_and_order(self) -> None:
        rows = 5
        log = pl.DataFrame(
            {
                "when": pl.Series([datetime(2026, 5, 1, 12, tzinfo=UTC) + timedelta(seconds=k) for k in range(rows)]),
                "day": [date(2026, 5, k + 1) for k in range(rows)],
                "note": ["level", None, "", "é,\n", "x"],
                "n": pl.Series([1, None, 3, 2**63 - 1, -5], dtype=pl.Int64),
                "y": pl.Series([2.5] * rows, dtype=pl.Float32),
                "small": pl.Series([1, 2, 3, None, 255], dtype=pl.UInt8),
                "kind": pl.Series(["a", "b", "a", None, "b"], dtype=pl.Enum(["a", "b"])),
                "x": [3.5, 2.5, None, nan, 1.5],
                "good": [True, None, False, True, True],
                "raw": [b"\x00\xff", None, b"", b"a", b"b"],
                "money": pl.Series([Decimal("1.10")] * rows, dtype=pl.Decimal(10, 2)),
                "list": [[1, 2], None, [], [3], [4]],
                "pair": [{"a": 1, "b": "x"}] * rows,
                "for": [timedelta(milliseconds=k) for k in range(rows)],
            }
        )
        found = applied(log)
        assert found.columns == [*log.columns, *ADDED]
        assert_frame_equal(found.select(log.columns), log, check_exact=True)
        assert (found.schema["flag"], found.schema["reason"]) == (pl.UInt8, pl.UInt16)
        assert found["flag"].to_list() == [3, 3, 9, 9, 3]  # no temperature in this log
        assert found["reason"].to_list() == [16, 16, 32, 32, 16]

    def test_numbers_of_any_type_are_readings(self) -> None:
        log = pl.DataFrame({"x": [3.0, 2.0], "y": [2.0, 3.0], "temperature": [20.0, 25.0]})
        expected = applied(log).select(ADDED)
        for kind in (pl.Int8, pl.UInt16, pl.Int64, pl.Float32, pl.Decimal(10, 3)):
            assert_frame_equal(applied(log.cast(kind)).select(ADDED), expected)

    def test_order_stays_over_many_blocks_and_row_groups(self) -> None:
        rows = 300_000
        log = pl.DataFrame({"n": np.arange(rows), "x": np.linspace(1.5, 3.5, rows), "y": 2.5, "temperature": 20.0})
        log.write_parquet("many.parquet", row_group_size=7_001)
        assert json.loads(apply("cal.yaml", "many.parquet", "-o", "out.pq", "--json").stdout)["rows"] == rows
        found = pl.read_parquet("out.pq")
        assert_frame_equal(found.select(log.columns), log)
        assert found["g_x"].is_sorted()

    def test_the_file_says_what_it_was_made_with_and_what_it_said_before(self) -> None:
        LOG.write_parquet("said.parquet", metadata={"site": "north"})
        apply("cal.yaml", "said.parquet", "-o", "out.parquet")
        notes = pl.read_parquet_metadata("out.parquet")
        assert notes["site"] == "north"
        made = json.loads(notes["tiltcal"])
        assert (made["serial"], made["calibration"]) == ("S-1", "cal.yaml")
        assert made["sha256"] == hashlib.sha256(WARM.encode()).hexdigest()


@pytest.mark.parametrize("uncertainty", [False, True])
def test_flags_and_values_are_those_of_csv_whichever_way_they_go(uncertainty: bool) -> None:
    """Every pair of odd readings, and every odd temperature with a sound one."""
    calibration, more = (str(FIXTURES / "mavs.yaml"), ["--uncertainty"]) if uncertainty else ("cal.yaml", [])
    odd = (None, nan, 2.5, 3.123456789012345, 4.5, 4.6, -10.0, 1e300, 5e-324)
    rows = [(x, y, 20.0) for x in odd for y in odd] + [(2.5, 2.5, celsius) for celsius in odd]
    log = pl.DataFrame(rows, schema={"x": pl.Float64, "y": pl.Float64, "temperature": pl.Float64}, orient="row")
    log.write_parquet("same.parquet")
    log.write_csv("same.csv")
    for start in ("same.parquet", "same.csv"):
        for end in ("out.parquet", "out.csv"):
            assert apply(calibration, start, "-o", f"{start}.{end}", *more).exit_code == 0
    typed, from_text = (pl.read_parquet(f"{start}.out.parquet") for start in ("same.parquet", "same.csv"))
    added = typed.columns[3:]
    assert_frame_equal(typed.select(added), from_text.select(added), check_exact=True)
    texts = [pl.read_csv(f"{start}.out.csv", infer_schema=False) for start in ("same.parquet", "same.csv")]
    assert_frame_equal(texts[0].select(added), texts[1].select(added))
    plain = texts[0].select(added).cast({name: typed.schema[name] for name in added})
    assert_frame_equal(plain, typed.select(added), check_exact=True)


class TestFromCsvToParquet:
    def typed(self, text: str, *arguments: str) -> pl.DataFrame:
        result = apply("cal.yaml", "-", "-o", "out.parquet", *arguments, stdin=text.encode())
        assert result.exit_code == 0, result.exception
        return pl.read_parquet("out.parquet")

    def test_columns_of_numbers_are_numbers_and_all_others_text_as_it_stood(self) -> None:
        found = self.typed(
            "time,when,x,y,serial,long,note,empty,n\n"
            '0.5,2026-05-01T12:00:00Z,3.5,2.5,0042,12345678901234567890,"a, ""b""",,1\n'
            "0.6,2026-05-01T12:00:01Z,NA,2.5,0043,1,,,\n"
        )
        assert found["time"].to_list() == [0.5, 0.6]
        assert found["when"].to_list() == ["2026-05-01T12:00:00Z", "2026-05-01T12:00:01Z"]
        assert found["x"].to_list() == [3.5, None]
        assert found["serial"].to_list() == ["0042", "0043"]
        assert found["long"].to_list() == ["12345678901234567890", "1"]
        assert found["note"].to_list() == ['a, "b"', None]
        assert found["empty"].to_list() == [None, None]
        assert found["n"].to_list() == [1.0, None]
        assert found["flag"].to_list() == [3, 9]

    @pytest.mark.parametrize("quote", ["", '"'])
    def test_bad_rows_are_kept_with_the_text_they_had(self, quote: str) -> None:
        text = f"note,x,y,n\n{quote}a{quote},3.5,2.5,1\nb,oops,2.5,2\nc\n\nd,1,2,3,4\ne,3.5,2.5,5\n"
        found = self.typed(text, "--skip-bad-rows")
        assert found["flag"].to_list() == [3, 9, 9, 9, 3]
        assert [(note or "").strip('"') for note in found["note"].to_list()[:3]] == ["a", "b,oops,2.5,2", "c"]
        assert found["n"].to_list()[0] == 1.0
        assert found["n"].to_list()[-1] == 5.0
        assert len(found) == 5

    def test_a_column_that_changes_its_type_far_down_is_named_with_the_row(self, bench: Path) -> None:
        text = b"x,y,n\n" + b"3.5,2.5,1\n" * 700_000 + b"3.5,2.5,off\n"
        said = refused(apply("cal.yaml", "-", "-o", "out.parquet", stdin=text), InputError)
        assert "row 700000: column 'n' holds 'off', and numbers above it" in said
        assert not (bench / "out.parquet").exists()


class TestRefusals:
    def test_rows_that_the_engine_loses_in_silence_are_missed(self, monkeypatch: pytest.MonkeyPatch) -> None:
        with open_log("log.parquet") as log:
            monkeypatch.setattr(log, "_rows", 5)
            with pytest.raises(InputError, match="gives 4 of 5 rows"):
                list(log.rows([1]))

"""A log as evenly spaced samples."""

from __future__ import annotations

from io import BytesIO

import numpy as np
import pytest

from tiltcal.errors import InputError
from tiltcal.logs.formats.csv import CsvReader
from tiltcal.logs.log import LogSource
from tiltcal.logs.numbers import read_columns
from tiltcal.logs.uniform_sampling import SamplingInterval, evenly_spaced


def paced(text: str) -> tuple[SamplingInterval, list[float]]:
    """The interval of a log with a column x, and its samples."""
    numbers = read_columns(CsvReader(LogSource(BytesIO(text.encode()), "log.csv", "log.csv")), [1, 0], 0)
    (samples,), interval = evenly_spaced([numbers.columns[0]], numbers.columns[1], "log.csv")
    return interval, samples.tolist()


def log_of(times: list[str]) -> str:
    return "time,x\n" + "".join(f"{time},{number}\n" for number, time in enumerate(times))


def test_a_gap_is_filled_with_what_is_missing() -> None:
    pace, samples = paced(log_of(["0", "0.5", "1.0", "3.0", "3.5"]))
    assert samples == pytest.approx([0, 1, 2, np.nan, np.nan, np.nan, 3, 4], nan_ok=True)
    assert pace == SamplingInterval(interval=0.5, rows=5, gaps=1, lost=3)


def test_a_jitter_is_no_gap() -> None:
    times = [k * 0.01 + (0.004 if k % 3 else 0.0) for k in range(300)]
    pace, samples = paced(log_of([f"{time:.5f}" for time in times]))
    assert pace.gaps == 0
    assert len(samples) == 300
    assert pace.interval == pytest.approx(0.01, rel=0.01)


@pytest.mark.parametrize("rate", [400.0, 714.0, 1000.0, 2500.0])
def test_times_to_the_millisecond_make_no_gaps(rate: float) -> None:
    pace, _ = paced(log_of([f"2026-01-02T03:04:{5 + k / rate:06.3f}Z" for k in range(5000)]))
    assert pace.gaps == 0
    assert pace.interval == pytest.approx(1.0 / rate, rel=1e-3)


@pytest.mark.parametrize(
    "form", ["2026-01-02T03:04:{:06.3f}Z", "2026-01-02 03:04:{:06.3f}", '"2026-01-02T03:04:{:02.0f}"']
)
def test_iso_8601(form: str) -> None:
    pace, samples = paced(log_of([form.format(second) for second in (0, 1, 2, 5, 6)]))
    assert pace.interval == pytest.approx(1.0)
    assert pace.lost == 2
    assert len(samples) == 7


def test_a_row_without_a_time_keeps_its_place() -> None:
    pace, samples = paced(log_of(["0", "1", "2", "", "4", "5", "8"]))
    assert samples == pytest.approx([0, 1, 2, 3, 4, 5, np.nan, np.nan, 6], nan_ok=True)
    assert pace == SamplingInterval(interval=1.0, rows=7, gaps=1, lost=2)


@pytest.mark.parametrize(
    ("times", "said"),
    [
        (["3", "2", "1"], "goes back at row 1"),
        (["0", "0", "0"], "do not change"),
        (["soon", "later"], "neither seconds nor ISO 8601"),
        (["0"], "no two rows"),
    ],
)
def test_what_tells_no_pace(times: list[str], said: str) -> None:
    with pytest.raises(InputError, match=said):
        paced(log_of(times))


def test_a_clock_that_is_set_while_it_records_is_no_gap() -> None:
    times = [f"{start + k * 0.01:.2f}" for start in (0, 1_767_000_000) for k in range(1000)]
    with pytest.raises(InputError, match=r"leaps by 1\.767e\+09 s at row 1000: cut the log there, or state --rate HZ"):
        paced(log_of(times))

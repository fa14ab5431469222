"""A log as evenly spaced samples."""

from __future__ import annotations

from io import BytesIO

import numpy as np
import pytest

from tiltcal.errors import InputError
from tiltcal.logs.formats.csv import CsvReader
from tiltcal.logs.log import LogSource
from tiltcal.logs.uniform_sampling import SamplingInterval, UniformLog


def paced(
    text: str, rate: float | None = None, block: int = 1 << 20, *, skip_bad_rows: bool = False
) -> tuple[SamplingInterval, list[float]]:
    """The pace of a log with a column x, and its samples."""
    log = CsvReader(LogSource(BytesIO(text.encode()), "log.csv", "log.csv", skip_bad_rows=skip_bad_rows), block=block)
    rows = UniformLog(log, ["x"], {}, rate)
    samples = [float(value) for part in rows.samples() for value in part[:, 0]]
    return rows.pace, samples


def log_of(times: list[str]) -> str:
    return "time,x\n" + "".join(f"{time},{number}\n" for number, time in enumerate(times))


@pytest.mark.parametrize("block", [1 << 20, 16])
def test_a_gap_is_filled_with_what_is_missing(block: int) -> None:
    pace, samples = paced(log_of(["0", "0.5", "1.0", "3.0", "3.5"]), block=block)
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


def test_a_stated_rate_stands_over_the_times() -> None:
    pace, samples = paced(log_of(["0", "1", "9", "3"]), rate=20.0)
    assert pace.interval == 0.05
    assert samples == [0, 1, 2, 3]


@pytest.mark.parametrize("block", [1 << 20, 8])
def test_a_row_that_is_at_fault_keeps_its_place(block: int) -> None:
    text = log_of(["0", "1", "2", "3", "4", "5"]).replace("3,3", "3;3")
    pace, samples = paced(text, block=block, skip_bad_rows=True)
    assert samples == pytest.approx([0, 1, 2, np.nan, 4, 5], nan_ok=True)
    assert pace == SamplingInterval(interval=1.0, rows=6, faulty=1)


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


@pytest.mark.parametrize("block", [1 << 20, 64])
def test_a_clock_that_is_set_while_it_records_is_no_gap(block: int) -> None:
    times = [f"{start + k * 0.01:.2f}" for start in (0, 1_767_000_000) for k in range(1000)]
    with pytest.raises(InputError, match=r"leaps by 1\.767e\+09 s at row 1000: cut the log there, or state --rate HZ"):
        paced(log_of(times), block=block)
    assert len(paced(log_of(times), rate=100.0)[1]) == 2000


def test_no_column_of_time() -> None:
    with pytest.raises(InputError, match=r"log.csv:1: .*--columns time=NAME, or state --rate HZ"):
        paced("x\n1\n2\n")

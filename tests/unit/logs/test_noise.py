"""A log of a sensor at rest as evenly spaced samples."""

import numpy as np
import pytest

import tiltcal
from tiltcal.errors import InputError
from tiltcal.logs.noise import Pace, evenly_spaced


def paced(times: list[float]) -> tuple[Pace, list[float]]:
    """The pace of rows with the readings 0, 1, 2, ..., and these at even distances."""
    (samples,), pace = evenly_spaced([np.arange(float(len(times)))], np.array(times), "log.csv")
    return pace, samples.tolist()


def test_a_gap_is_filled_with_what_is_missing() -> None:
    pace, samples = paced([0.0, 0.5, 1.0, 3.0, 3.5])
    assert samples == pytest.approx([0, 1, 2, np.nan, np.nan, np.nan, 3, 4], nan_ok=True)
    assert pace == Pace(interval=0.5, rows=5, gaps=1, lost=3)


def test_a_row_without_a_time_keeps_its_place() -> None:
    pace, samples = paced([0, 1, 2, np.nan, 4, 5, 8])
    assert samples == pytest.approx([0, 1, 2, 3, 4, 5, np.nan, np.nan, 6], nan_ok=True)
    assert pace == Pace(interval=1.0, rows=7, gaps=1, lost=2)


def test_jitter_and_times_to_the_millisecond_are_no_gaps() -> None:
    assert paced([k * 0.01 + (0.004 if k % 3 else 0.0) for k in range(300)])[0].gaps == 0
    for rate in (400.0, 714.0, 1000.0, 2500.0):
        pace, _ = paced([round(5 + k / rate, 3) for k in range(5000)])
        assert pace.gaps == 0, rate
        assert pace.interval == pytest.approx(1.0 / rate, rel=1e-3)


@pytest.mark.parametrize(
    ("times", "said"),
    [
        ([3.0, 2.0, 1.0], "goes back at row 1"),
        ([0.0, 0.0, 0.0], "do not change"),
        ([np.nan, np.nan], "no row has a time"),
        ([0.0], "no two rows"),
        (
            [start + k * 0.01 for start in (0, 1_767_000_000) for k in range(1000)],
            r"leaps by 1\.767e\+09 s at row 1000: cut the log there, or state rate HZ",
        ),
    ],
)
def test_times_that_show_no_pace(times: list[float], said: str) -> None:
    with pytest.raises(InputError, match=said):
        paced(times)


def test_times_in_iso_8601() -> None:
    seconds = [*range(40), *range(43, 70)]
    time = [f"2026-01-02T03:{4 + second // 60:02}:{second % 60:02}Z" for second in seconds]
    found = tiltcal.noise({"time": time, "x": np.random.default_rng(1).normal(size=len(time))})
    assert found.pace == Pace(interval=pytest.approx(1.0), rows=67, gaps=1, lost=3)


def test_times_to_the_second_are_those_of_faster_rows() -> None:
    """A logger that writes whole seconds at 100 Hz: no row is lost between two of them."""
    columns, pace = evenly_spaced([np.arange(1000.0)], np.repeat(np.arange(10.0), 100), "log.csv")
    assert (len(columns[0]), pace.gaps) == (1000, 0)
    assert pace.interval == pytest.approx(9.0 / 999.0)

"""Times in the units of CF, in the spellings of UDUNITS."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest

from tiltcal.errors import InputError
from tiltcal.logs.cf_attributes import seconds_since_1970


@pytest.mark.parametrize(
    ("unit", "seconds"),
    [
        *[(unit, 1e-9) for unit in ("ns", "nanosecond", "nanoseconds")],
        *[(unit, 1e-6) for unit in ("us", "µs", "microsecond", "microseconds")],
        *[(unit, 1e-3) for unit in ("ms", "msec", "millisecond", "Milliseconds")],
        *[(unit, 1.0) for unit in ("s", "sec", "second", "Seconds")],
        *[(unit, 60.0) for unit in ("min", "minute", "minutes")],
        *[(unit, 3600.0) for unit in ("h", "hr", "hour", "hours")],
        *[(unit, 86400.0) for unit in ("d", "day", "days")],
    ],
)
@pytest.mark.parametrize("since", ["1970-01-01", "2000-1-1 0:0:0"])
def test_every_spelling_of_a_unit_is_counted(unit: str, seconds: float, since: str) -> None:
    epoch = 0.0 if since[0] == "1" else 946684800.0
    count = np.array([0.0, 3.0, np.nan])
    assert seconds_since_1970(count, f"{unit} since {since}") == pytest.approx(epoch + count * seconds, nan_ok=True)
    assert seconds_since_1970(count, unit) == pytest.approx(count * seconds, nan_ok=True)


@pytest.mark.parametrize(
    ("epoch", "moment"),
    [
        ("2000-1-1", datetime(2000, 1, 1, tzinfo=UTC)),
        ("2000-01-01 6", datetime(2000, 1, 1, 6, tzinfo=UTC)),
        ("1992-10-8 15:15:42.5 -6:00", datetime(1992, 10, 8, 21, 15, 42, 500000, tzinfo=UTC)),  # of the CF conventions
        ("2000-01-01T00:00:00Z", datetime(2000, 1, 1, tzinfo=UTC)),
        ("2000-01-01 12:30 UTC", datetime(2000, 1, 1, 12, 30, tzinfo=UTC)),
        ("2000-01-01 00:00:0.0", datetime(2000, 1, 1, tzinfo=UTC)),
        ("1-1-1", datetime(1, 1, 1, tzinfo=UTC)),
    ],
)
def test_an_epoch_needs_no_leading_zeros(epoch: str, moment: datetime) -> None:
    assert seconds_since_1970(np.zeros(1), f"days since {epoch}").item() == moment.timestamp()


@pytest.mark.parametrize(
    ("unit", "why"),
    [
        ("furlongs since 2000-01-01", "'furlongs' is no unit of time"),
        ("months since 2000-01-01", "'months' is a unit that differs in length"),
        ("years", "'years' is a unit that differs in length"),
        ("days since the flood", "'the flood' is no moment"),
        ("seconds since 2000-13-01", "is no moment"),
    ],
)
def test_what_counts_in_no_unit_or_from_no_moment_is_refused(unit: str, why: str) -> None:
    with pytest.raises(InputError, match=f"^deck.nc: .*{why}"):
        seconds_since_1970(np.zeros(1), unit, "deck.nc")


@pytest.mark.parametrize("unit", [None, "", "1", "count", "m"])
def test_what_names_no_time_is_seconds(unit: str | None) -> None:
    assert seconds_since_1970(np.array([2.5]), unit).item() == 2.5


def test_a_moment_is_the_nearest_double_to_its_count() -> None:
    assert seconds_since_1970(np.array([1767225600020.0]), "ms since 1970-01-01").item() == 1767225600.02

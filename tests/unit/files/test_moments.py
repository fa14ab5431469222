"""Moments as text, in UTC."""

from datetime import UTC, datetime, timedelta, timezone

import pytest

from tiltcal.errors import InputError
from tiltcal.files.moments import moment, stamp, to_the_second

NOON = datetime(2026, 5, 1, 12, 0, 0, 500_000, tzinfo=UTC)


@pytest.mark.parametrize("text", ["2026-05-01T12:00:00.5Z", "2026-05-01T12:00:00.5", "2026-05-01T14:00:00.5+02:00"])
def test_a_moment_is_in_utc_where_it_names_no_zone(text: str) -> None:
    assert moment(text) == NOON
    assert moment(text).utcoffset() == timedelta(0)


def test_what_is_no_moment_is_refused_with_its_file() -> None:
    with pytest.raises(InputError, match=r"a\.yaml: 'tomorrow' is no date"):
        moment("tomorrow", "a.yaml")


def test_moments_are_written_in_utc() -> None:
    assert stamp(NOON.astimezone(timezone(timedelta(hours=2)))) == "2026-05-01T12:00:00.500Z"
    assert to_the_second(NOON) == "2026-05-01T12:00:00Z"

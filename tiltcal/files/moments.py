"""Moments as text: ISO 8601, UTC."""

from __future__ import annotations

from datetime import UTC, date, datetime, timedelta
from pathlib import Path

from tiltcal.errors import InputError

_LAST_YEAR = 2999  # a moment behind it is none, so that what is added to one stays a date


def moment(text: str | date, path: str | Path | None = None) -> datetime:
    """Return a moment in ISO 8601, or one of Python; UTC where it names no zone. An InputError where it is none."""
    try:
        found = datetime.fromisoformat(str(text))
    except ValueError:
        found = datetime.max
    if found.year > _LAST_YEAR:
        raise InputError(f"{str(text)!r} is no date: write it as 2026-05-01T12:00:00Z", file=path)
    return found.replace(tzinfo=UTC) if found.tzinfo is None else found.astimezone(UTC)


LEAST_SECONDS, MOST_SECONDS = 1e8, 253402300799.0  # since 1970, to the end of 9999: fewer or more are no moment


def moment_after(start: datetime, elapsed_ns: int) -> datetime:
    """Return the moment that is a number of nanoseconds after another one."""
    return start + timedelta(microseconds=elapsed_ns / 1000)


def stamp(moment: datetime) -> str:
    """Return a moment as text, to the millisecond."""
    return moment.astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def stamp_of(seconds: float) -> str | None:
    """Return seconds since 1970 as text, to the millisecond; None where they count from another beginning."""
    return stamp(datetime.fromtimestamp(seconds, UTC)) if LEAST_SECONDS < seconds < MOST_SECONDS else None


def to_the_second(moment: datetime) -> str:
    """Return a moment as text; it is in UTC."""
    return f"{moment:%Y-%m-%dT%H:%M:%SZ}"

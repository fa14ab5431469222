"""The records of a calibration file, whose inside nobody has checked: what is not there, or is odd, is absent."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import isfinite
from typing import Any


def section(record: Any, *keys: str) -> Mapping[str, Any]:
    """The mapping below some keys; empty where there is none."""
    for key in keys:
        record = record.get(key) if isinstance(record, Mapping) else None
    return record if isinstance(record, Mapping) else {}


def number(record: Any, *keys: str) -> float | None:
    """The finite number below some keys; None where there is none."""
    *path, last = keys
    value = section(record, *path).get(last)
    if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
        return None
    return float(value)


def numbers(record: Any, *keys: str) -> dict[str, float]:
    """The finite numbers of the mapping below some keys, by name."""
    own = section(record, *keys)
    return {str(name): value for name in own if (value := number(own, name)) is not None}


def text(record: Any, *keys: str) -> str | None:
    """What is said below some keys, as text; None where nothing is."""
    *path, last = keys
    value = section(record, *path).get(last)
    return None if value is None or isinstance(value, Mapping) else in_words(value)


def items(record: Any, *keys: str) -> Sequence[Any]:
    """The list below some keys; empty where there is none."""
    *path, last = keys
    value = section(record, *path).get(last)
    return value if isinstance(value, Sequence) and not isinstance(value, str) else ()


def leaves(record: Mapping[str, Any], lead: str = "") -> Iterator[tuple[str, str]]:
    """Everything that a record says, by its dotted name."""
    for key, value in record.items():
        if isinstance(value, Mapping):
            yield from leaves(value, f"{lead}{key}.")
        else:
            yield f"{lead}{key}", in_words(value)


def in_words(value: Any) -> str:
    """A value as a person writes it."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:g}" if abs(value) < 1e6 else str(value)
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {in_words(one)}" for key, one in value.items())
    if isinstance(value, Sequence) and not isinstance(value, str):
        return ", ".join(in_words(one) for one in value)
    return "" if value is None else str(value)

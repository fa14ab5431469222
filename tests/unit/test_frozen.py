"""A frozen class behaves as one that ``dataclass(frozen=True)`` made."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import FrozenInstanceError, asdict, dataclass, field, fields, replace
from inspect import signature
from typing import Any

import pytest

from tiltcal.frozen import frozen


@frozen
class Position:
    """One that is read and written on the way between processes."""

    name: str
    tilt: tuple[float, ...] = (0.0,)
    notes: list[str] = field(default_factory=list, compare=False)


@frozen(kw_only=True)
class SetPosition(Position):
    """One with a field of its own."""

    heading: float | None = None


def reading(decorate: Callable[[type], type]) -> Any:
    """Return one class as a decorator makes it."""

    @decorate
    class Reading:
        x: float
        y: float = 1.0
        faults: dict[int, str] = field(default_factory=dict)

    return Reading


def twins() -> list[Any]:
    """Return the same class as made by the standard library, and by ours."""
    return [reading(dataclass(frozen=True)), reading(frozen)]


@pytest.mark.parametrize(
    ("args", "values"), [((1.5,), {}), ((1.5, 2.0), {}), ((), {"x": 0.0, "faults": {3: "torn"}}), ((1.0,), {"y": 4.0})]
)
def test_values_are_those_of_a_dataclass(args: tuple[float, ...], values: dict[str, Any]) -> None:
    theirs, ours = (cls(*args, **values) for cls in twins())
    assert asdict(ours) == asdict(theirs)
    assert [(one.name, one.default) for one in fields(ours)] == [(one.name, one.default) for one in fields(theirs)]
    assert repr(ours) == repr(theirs)
    assert asdict(replace(ours, y=7.0)) == asdict(replace(theirs, y=7.0))


@pytest.mark.parametrize(
    ("args", "values"), [((), {}), ((), {"y": 1.0}), ((1.0,), {"x": 2.0}), ((1.0,), {"z": 2.0}), ((1, 2, 3, 4), {})]
)
def test_wrong_fields_are_refused(args: tuple[float, ...], values: dict[str, Any]) -> None:
    for cls in twins():
        with pytest.raises(TypeError):
            cls(*args, **values)


def test_equal_fields_make_equal_values() -> None:
    one, same, other = Position("a"), Position("a", notes=["not compared"]), Position("b")
    assert one == same
    assert hash(one) == hash(same)
    assert one != other
    assert one != SetPosition("a")
    assert len({one, same, other}) == 2


def test_without_eq_a_value_is_equal_to_itself_alone() -> None:
    @frozen(eq=False)
    class Table:
        rows: list[int]

    one = Table([1])
    assert one == one
    assert one != Table([1])


def test_a_field_cannot_be_changed() -> None:
    with pytest.raises(FrozenInstanceError):
        Position("a").name = "b"  # type: ignore[misc]
    with pytest.raises(FrozenInstanceError):
        del Position("a").name


def test_a_subclass_has_all_fields() -> None:
    assert SetPosition("a", heading=3.0) == replace(SetPosition("a"), heading=3.0)
    with pytest.raises(TypeError):
        SetPosition("a", (1.0,), [], 3.0)  # type: ignore[call-arg]


def test_a_value_goes_between_processes() -> None:
    there = SetPosition("a", (1.0,), ["set by hand"], heading=3.0)
    assert asdict(pickle.loads(pickle.dumps(there))) == asdict(there)


def test_a_value_of_defaults_has_its_own_list() -> None:
    assert Position("a").notes is not Position("a").notes


def test_what_follows_the_fields_is_called() -> None:
    @frozen
    class Range:
        low: float
        high: float

        def __post_init__(self) -> None:
            if self.low > self.high:
                raise ValueError("low is above high")

    with pytest.raises(ValueError, match="above"):
        Range(2.0, 1.0)


def test_help_shows_the_fields_that_a_value_is_made_of() -> None:
    ours, usual = (signature(reading(decorate)) for decorate in (frozen, dataclass(frozen=True)))
    assert [(p.name, p.kind, p.annotation) for p in ours.parameters.values()] == [
        (p.name, p.kind, p.annotation) for p in usual.parameters.values()
    ]
    assert str(ours) == "(x: 'float', y: 'float' = 1.0, faults: 'dict[int, str]' = {})"

"""A thread that reads ahead keeps the order, the errors and nothing else."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from itertools import count

import pytest

from tiltcal.logs.streams import read_ahead


def test_the_items_come_in_order_from_another_thread() -> None:
    def items() -> Iterator[tuple[int, int]]:
        for number in range(50):
            yield number, threading.get_ident()

    found = list(read_ahead(items()))
    assert [number for number, _ in found] == list(range(50))
    assert {thread for _, thread in found}.isdisjoint({threading.get_ident()})


def test_an_error_comes_in_its_place() -> None:
    def items() -> Iterator[int]:
        yield 1
        yield 2
        raise ValueError("the disk is gone")

    ahead = read_ahead(items())
    assert [next(ahead), next(ahead)] == [1, 2]
    with pytest.raises(ValueError, match="the disk is gone"):
        next(ahead)


def test_the_thread_ends_when_the_reader_stops() -> None:
    before = threading.active_count()
    ahead = read_ahead(count(1))
    assert next(ahead) == 1
    ahead.close()  # type: ignore[attr-defined]
    assert threading.active_count() == before

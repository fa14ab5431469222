"""A journal that was captured by another program, or forged, is told from one that replays."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from support import FIXTURES

from tiltcal.bench.session import Session
from tiltcal.errors import JournalError
from tiltcal.files.journal import Event, JournalWriter, read_journal

PLANE = FIXTURES / "plane.journal.jsonl"


def forged(path: Path, change: Callable[[Event], tuple[Any, ...] | None]) -> Path:
    """The fixture's journal written anew, with right checks and an end, its events changed."""
    journal = read_journal(PLANE)
    writer = JournalWriter.create(path, journal.header)
    for event in journal.events:
        changed = change(event)
        if changed is not None:
            writer.append(event.dt_ns, *changed)
    writer.finish(0)
    writer.close()
    return path


def replay(path: Path) -> None:
    Session.of_journal(path).replay()


def same(event: Event) -> tuple[Any, ...]:
    return (event.kind, *event.payload)


def test_the_same_events_replay(tmp_path: Path) -> None:
    replay(forged(tmp_path / "j.jsonl", same))


def test_a_summary_that_the_samples_do_not_give(tmp_path: Path) -> None:
    def change(event: Event) -> tuple[Any, ...]:
        if event.kind != "p":
            return same(event)
        return ("p", {**event.payload[0], "position": "elsewhere"})

    with pytest.raises(JournalError, match="the samples give") as failure:
        replay(forged(tmp_path / "j.jsonl", change))
    assert failure.value.line == next(event.line for event in read_journal(PLANE).events if event.kind == "p")


def test_a_transaction_that_the_driver_does_not_send(tmp_path: Path) -> None:
    def change(event: Event) -> tuple[Any, ...]:
        return ("s", "0a00", "ffff") if event.line == 50 else same(event)

    with pytest.raises(JournalError, match="another version") as failure:
        replay(forged(tmp_path / "j.jsonl", change))
    assert failure.value.line == 50


def test_events_that_are_left_over(tmp_path: Path) -> None:
    path = tmp_path / "j.jsonl"
    journal = read_journal(PLANE)
    writer = JournalWriter.create(path, journal.header)
    for event in [*journal.events, journal.events[-1]]:
        writer.append(event.dt_ns, *same(event))
    writer.finish(0)
    writer.close()
    with pytest.raises(JournalError, match="at its end"):
        replay(path)


def test_events_that_are_missing(tmp_path: Path) -> None:
    last = read_journal(PLANE).events[-1].line
    with pytest.raises(JournalError, match="interrupted here"):
        replay(forged(tmp_path / "j.jsonl", lambda event: None if event.line == last else same(event)))

"""A rig that does not act on refusals is given up."""

from __future__ import annotations

from typing import Any

import pytest

from tiltcal.bench.operators.operator import StageTurn
from tiltcal.bench.operators.rig import RigRotationOperator
from tiltcal.errors import Stopped


class Table:
    """A stage whose program hears every event."""

    def __init__(self) -> None:
        self.heard: list[dict[str, Any]] = []

    def rotation(self, ask: dict[str, Any]) -> dict[str, Any]:
        return {"answer": "ready"}

    def refused(self, event: dict[str, Any]) -> None:
        self.heard.append(event)


def test_a_stage_that_never_turns_is_refused_100_times() -> None:
    operator = RigRotationOperator(table := Table())
    for _ in range(99):
        operator.refused("the stage does not turn")
    with pytest.raises(Stopped, match="rotation was asked for 100 times in a row in vain"):
        operator.refused("the stage does not turn")
    assert len(table.heard) == 100


def test_refusals_before_a_turn_do_not_count() -> None:
    operator = RigRotationOperator(table := Table())
    for number in range(1, 4):
        for _ in range(99):
            operator.refused("the stage has made 0.50 whole turns")
        operator.turn_completed(StageTurn(number, 10, {}, {}))
    assert len(table.heard) == 3 * 99

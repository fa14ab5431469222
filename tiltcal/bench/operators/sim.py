"""The operator of a virtual bench: the virtual jig has taken the position before it is asked, so it answers yes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tiltcal.bench.operators.operator import Live, OperatorAnswer, StageTurn, pair_in_words
from tiltcal.drivers.model import Model, Reading
from tiltcal.errors import Stopped
from tiltcal.files.procedure import Position, Procedure

if TYPE_CHECKING:
    from tiltcal.bench.position_result import PositionResult
    from tiltcal.core.pair.matching import Matching
    from tiltcal.core.pair.model import Pair

REFUSALS = 10
"""Refusals of one position in a row after which it gives up: the virtual jig does the same again."""


def _silent(line: str) -> None:
    pass


class _Sim:
    """The two operators' common part.

    say: takes one line of talk; dropped by default.
    """

    def __init__(self, say: Callable[[str], None] = _silent) -> None:
        self._say = say

    def confirm_write(self, files: list[Path]) -> OperatorAnswer:
        return OperatorAnswer("yes")

    def done(self, files: list[Path], journal: Path) -> None:
        for path in files:
            self._say(f"wrote {path}")
        self._say(f"journal {journal}")


class SimOperator(_Sim):
    """Answers ready to every position of a virtual jig."""

    def __init__(self, say: Callable[[str], None] = _silent) -> None:
        super().__init__(say)
        self._models: Mapping[str, Model] = {}
        self._numbers: dict[str, str] = {}
        self._refusals = 0

    def begin(self, procedure: Procedure, models: Mapping[str, Model]) -> None:
        names = [position.name for position in procedure.positions]
        self._numbers = {
            name: f"{number:{len(str(len(names)))}}/{len(names)}" for number, name in enumerate(names, start=1)
        }
        self._models = models
        self._say(f"{procedure.title}: {procedure.length}")

    def position(self, position: Position, number: int, live: Live) -> OperatorAnswer:
        return OperatorAnswer("ready")

    def look(self, position: Position, readings: Mapping[str, Reading], why: str, seconds: float) -> None:
        pass

    def review(self, result: PositionResult) -> OperatorAnswer:
        return OperatorAnswer("accept")

    def accepted(self, result: PositionResult) -> None:
        self._refusals = 0
        number = self._numbers[result.position.name]
        for serial, measurement in result.measurements.items():
            values = "  ".join(
                f"{name} {summary.mean:.6g} ± {summary.std:.2g}" for name, summary in measurement.summaries.items()
            )
            whose = f"{serial}  " if len(result.measurements) > 1 else ""
            warmth = "" if measurement.temperature is None else f"  at {measurement.temperature:.1f} °C"
            unit = self._models[serial].unit
            self._say(f"  {number} {result.position.name:<12} {whose}{values} {unit}{warmth}")

    def refused(self, position: Position, why: str) -> None:
        self._say(f"  {position.name} refused: {why}")
        self._refusals += 1
        if self._refusals >= REFUSALS:
            raise Stopped(f"{position.name} was refused {self._refusals} times in a row: {why}")

    def lost(self, serial: str, why: str) -> None:
        self._say(f"  {serial} is dropped, the others continue: {why}")


class SimRotationOperator(_Sim):
    """Lets a virtual stage turn."""

    def begin(self, title: str) -> None:
        self._say(title)

    def turning(self, prompt: str, pairs: Sequence[Pair], turns: int) -> OperatorAnswer:
        self._say(f"{len(pairs)} pairs, up to {turns} turns of the virtual stage")
        return OperatorAnswer("ready")

    def poll(self) -> OperatorAnswer | None:
        return None

    def turn_completed(self, turn: StageTurn) -> None:
        self._say(f"  {turn}")

    def paused(self, why: str) -> None:
        self._say(f"  held: {why}")

    def resumed(self) -> None:
        self._say("  goes on")

    def refused(self, why: str) -> None:
        # Asked again, the virtual stage would do the same.
        raise Stopped(why)

    def matched(self, turns: float, matchings: Sequence[Matching]) -> None:
        for matching in matchings:
            self._say(f"  {pair_in_words(matching.pair.name, matching)} after {turns:.1f} turns")

"""The operator of a virtual bench: the virtual jig has taken the position before it is asked, so it says yes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from tiltcal.bench.operators.answer import OperatorAnswer
from tiltcal.bench.operators.operator import Live, MeasuredPosition
from tiltcal.bench.operators.sim_stage import StageTurn, said
from tiltcal.core.pair.matching import Matching
from tiltcal.core.pair.model import Pair
from tiltcal.drivers.device import Reading
from tiltcal.errors import Stopped
from tiltcal.files.procedure import Position


class SimOperator:
    """Answers every question with yes, and tells what happens in plain lines.

    Parameters
    ----------
    say : callable
        Takes one line of talk.
    """

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._positions = 0
        self._number = 0

    def begin(self, title: str, positions: int) -> None:
        self._positions = positions
        self._say(f"{title}: {positions} positions" if positions else title)

    def position(self, position: Position, number: int, live: Live) -> OperatorAnswer:
        self._number = number
        return OperatorAnswer("ready")

    def look(self, position: Position, readings: Mapping[str, Reading], why: str) -> None:
        pass

    def review(self, position: Position, measured: list[MeasuredPosition]) -> OperatorAnswer:
        return OperatorAnswer("accept")

    def accepted(self, position: Position, measured: list[MeasuredPosition]) -> None:
        for one in measured:
            values = "  ".join(f"{channel} {mean:.6g} ± {one.std[channel]:.2g}" for channel, mean in one.mean.items())
            whose = f"{one.serial}  " if len(measured) > 1 else ""
            warmth = "" if one.temperature is None else f"  at {one.temperature:.1f} °C"
            self._say(f"  {self._number}/{self._positions} {position.name:<12} {whose}{values} {one.unit}{warmth}")

    def refused(self, position: Position, why: str) -> None:
        self._say(f"  {position.name} refused: {why}")

    def lost(self, serial: str, why: str) -> None:
        self._say(f"  {serial} is given up, the others go on: {why}")

    def turning(self, prompt: str, pairs: Sequence[Pair], turns: int) -> OperatorAnswer:
        self._say(f"{len(pairs)} pairs, up to {turns} turns of the virtual stage")
        return OperatorAnswer("ready")

    def poll(self) -> OperatorAnswer | None:
        return None

    def turned(self, turn: StageTurn) -> None:
        self._say(f"  {turn}")

    def held(self, why: str) -> None:
        self._say(f"  held: {why}")

    def resumed(self) -> None:
        self._say("  goes on")

    def turning_refused(self, why: str) -> None:
        # Asked again, the virtual stage would do the same.
        raise Stopped(why)

    def matched(self, turns: float, matchings: Sequence[Matching]) -> None:
        for one in matchings:
            self._say(f"  {said(one.pair.name, one)} after {turns:.1f} turns")

    def write(self, files: list[Path]) -> OperatorAnswer:
        return OperatorAnswer("yes")

    def done(self, files: list[Path], journal: Path) -> None:
        for path in files:
            self._say(f"wrote {path}")
        self._say(f"journal {journal}")

"""The positions of a session: which are accepted, which are open, and which may be taken next or again."""

from __future__ import annotations

from collections import Counter

from tiltcal.errors import InputError
from tiltcal.files.procedure import Position
from tiltcal.journal.header import Setup
from tiltcal.journal.lines import OperatorAnswer
from tiltcal.journal.positions import PositionResult


class TakenPositions:
    """The positions of a session so far.

    ``accepted`` are in the order of time, and ``last`` is the last of all, be it withdrawn.
    """

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        self._ramps = setup.steps.continuous
        self.accepted: list[PositionResult] = []
        self.last: PositionResult | None = None
        self._again: Counter[str] = Counter()

    @property
    def open(self) -> list[Position]:
        """The positions that are still to be taken, in the procedure's order."""
        done = {result.position.name for result in self.accepted}
        return [position for position in self.setup.steps.positions if position.name not in done]

    def takes(self, name: str) -> int:
        """Return how often a position was taken, be it one that is taken now."""
        return 1 + self._again[name]

    def accept(self, result: PositionResult) -> None:
        """Take an accepted position."""
        self.accepted.append(result)
        self.last = result

    @property
    def choosable(self) -> list[Position]:
        """The open positions that may be taken next: those of the first one's temperature, heading and stage."""
        alike = [(one.temperature, one.heading or 0.0, one.stage) for one in self.open]
        fixed = bool(self.setup.steps.why_not_again)
        return self.open[:1] if fixed else [p for p, one in zip(self.open, alike, strict=True) if one == alike[0]]

    def require_possible(self, answer: OperatorAnswer, asked: str) -> None:
        """Refuse, with an InputError, to go back, to take a position again or to choose one where that cannot be."""
        steps, names = self.setup.steps, [result.position.name for result in self.accepted]
        if answer.answer in ("again", "back") and self._ramps:
            raise InputError(steps.why_not_again)
        if answer.answer == "back" and not names:
            raise InputError("this is the first position: there is none before it to go back to")
        chosen = answer.position
        if not chosen or chosen == asked or chosen in [one.name for one in self.choosable]:
            return
        if answer.answer == "again" and steps.why_not_again:
            raise InputError(steps.why_not_again)
        if answer.answer == "again" and chosen in names:
            return
        if chosen in [one.name for one in self.open]:
            raise InputError(
                f"{chosen} has another temperature, heading or stage angle: it comes in the procedure's order"
            )
        there = f"accepted are {', '.join(names)}" if names else "none is accepted yet"
        raise InputError(f"{chosen!r} is no position that could be taken now; {there}")

    def withdraw(self, answer: OperatorAnswer) -> None:
        """Withdraw the position that is taken ``again``, or of ``back`` the one that was accepted last in time."""
        if answer.answer == "again":
            kept = [result for result in self.accepted if result.position.name != answer.position]
            self._again[answer.position] += len(self.accepted) - len(kept)
            self.accepted[:] = kept
        # A session refuses to go back over the leg of a ramp, and before the first position.
        elif answer.answer == "back" and not self._ramps:
            del self.accepted[-1:]

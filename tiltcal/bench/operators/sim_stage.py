"""Who attends a turning stage: asked once, told turn by turn, free to stop at any time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from tiltcal.bench.operators.answer import OperatorAnswer
from tiltcal.core.pair.matching import Matching, PairCoefficients
from tiltcal.core.pair.model import Pair

QUESTION = "rotation"
"""What the operator is asked, and what refusals belong to."""


@dataclass(frozen=True)
class StageTurn:
    """How far a stage is.

    Attributes
    ----------
    number : int
        Whole turns that count.
    of : int
        The most that are made.
    pairs : mapping of str to PairCoefficients
        What is known of p and q by now, by the name of the pair; pairs of which nothing is known are not there.
    unknown : mapping of str to str
        Why nothing more is learnt of others.
    left_out : int
        Samples that were held or damaged so far.
    """

    number: int
    of: int
    pairs: Mapping[str, PairCoefficients]
    unknown: Mapping[str, str]
    left_out: int = 0

    def __str__(self) -> str:
        parts = [f"turn {self.number} of {self.of}", *(said(name, one) for name, one in self.pairs.items())]
        parts += [f"{name}: {why}" for name, why in self.unknown.items()]
        if self.left_out:
            parts.append(f"{self.left_out} samples left out")
        return "   ".join(parts)


class SimStageOperator(Protocol):
    """Asked and told by the runner of a rotation; only its answers enter the journal."""

    def turning(self, prompt: str, pairs: Sequence[Pair], turns: int) -> OperatorAnswer:
        """Let the stage turn: ``ready`` or ``quit``."""
        ...

    def poll(self) -> OperatorAnswer | None:
        """What the operator wants while the stage turns, without waiting: ``stop``, or nothing.

        Raises
        ------
        Stopped
            The operator quit.
        """
        ...

    def turned(self, turn: StageTurn) -> None:
        """Another turn is made."""
        ...

    def held(self, why: str) -> None:
        """What comes now does not count."""
        ...

    def resumed(self) -> None:
        """It counts again."""
        ...

    def turning_refused(self, why: str) -> None:
        """The stage does not turn, or it is too early to stop."""
        ...

    def matched(self, turns: float, matchings: Sequence[Matching]) -> None:
        """The pairs are matched."""
        ...


def said(name: str, found: PairCoefficients | Matching) -> str:
    """p and q of a pair in a line: ``a1_a2: p 0.012345 ± 3e-05, q ...``."""
    return f"{name}: p {found.p:.7f} ± {found.u_p:.1g}, q {found.q:.7f} ± {found.u_q:.1g}"

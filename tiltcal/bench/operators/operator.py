"""The operator of a session: its questions, its answers, and the events that it gets.

A procedure of positions is carried out by a :class:`PositionOperator`, one of a turning stage by a
:class:`RotationOperator`. A person at a terminal (``terminal.py``), a program or a Python object (``rig.py``,
``json_lines.py``) and the virtual bench (``sim.py``) each have one of both kinds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import dist
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from tiltcal.core.attitude import gravity_from_tilt, normalised
from tiltcal.core.rounding import plus_minus
from tiltcal.drivers.model import Model, Reading
from tiltcal.errors import InputError
from tiltcal.files.procedure import Position, Procedure

if TYPE_CHECKING:
    from tiltcal.bench.position_result import PositionResult
    from tiltcal.core.pair.matching import Matching, PairCoefficients
    from tiltcal.core.pair.model import Pair

SAME = 1e-4
"""Directions that differ by less are one, g: 0.006°."""

Live = Callable[[], Mapping[str, Reading]]
"""Takes one sample of every sensor, by serial number."""


@dataclass(frozen=True)
class OperatorAnswer:
    """An answer of the operator, as the journal keeps it. An operator that quits raises ``Stopped`` instead.

    Attributes
    ----------
    word : str
        ``ready``, ``redo`` or ``back`` to a position; ``accept``, ``redo`` or ``back`` to what was measured;
        ``yes`` to writing the files; ``ready`` to a rotation, and ``stop`` while the stage turns.
    tilt : dict of str to float
        Angles actually set, degrees; empty where they are as asked.
    gravity : tuple of float or None
        Direction actually set; None where it is as asked.
    temperature : float or None
        °C, typed; None where it is left to the thermometer.
    """

    word: str
    tilt: dict[str, float] = field(default_factory=dict)
    gravity: tuple[float, ...] | None = None
    temperature: float | None = None

    def as_set(self, position: Position) -> Position:
        """Return a position with the angles and the temperature that the operator actually set.

        InputError: no direction has these angles, or they contradict the direction that was set.
        """
        if self.temperature is not None:
            position = replace(position, temperature=self.temperature if position.temperature is not None else None)
        direction = None if self.gravity is None else normalised(self.gravity)
        if self.tilt:
            tilt = {**(position.tilt or {}), **self.tilt}
            reached = gravity_from_tilt(tilt)
            if direction is not None and min(dist(direction, reached), dist(direction, position.gravity)) > SAME:
                raise InputError(
                    "the answer has a tilt and a gravity that contradict each other: give the one that was reached"
                )
            return replace(position, gravity=reached, tilt=tilt)
        return position if direction is None else replace(position, gravity=direction, tilt=None)

    def record(self) -> dict[str, Any]:
        """Return plain data for the journal."""
        return {
            "answer": self.word,
            **({"tilt": self.tilt} if self.tilt else {}),
            **({"gravity": list(self.gravity)} if self.gravity is not None else {}),
            **({"temperature": self.temperature} if self.temperature is not None else {}),
        }

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> OperatorAnswer:
        """Return the answer of a :meth:`record`."""
        gravity = record.get("gravity")
        return cls(
            record["answer"],
            dict(record.get("tilt", {})),
            tuple(gravity) if gravity is not None else None,
            record.get("temperature"),
        )


class Operator(Protocol):
    """The questions that every operator is asked, and the end of a session."""

    def confirm_write(self, files: list[Path]) -> OperatorAnswer:
        """Answer ``yes``: the calibration files may be written.

        Stopped: they may not.
        """
        ...

    def done(self, files: list[Path], journal: Path) -> None:
        """Handle the end of the session: all is written."""
        ...


class PositionOperator(Operator, Protocol):
    """The operator of a procedure of positions. Every question raises ``Stopped`` where the operator quits."""

    def begin(self, procedure: Procedure, models: Mapping[str, Model]) -> None:
        """Handle the start of a session, or its resumption; the models are by serial number."""
        ...

    def position(self, position: Position, number: int, live: Live) -> OperatorAnswer:
        """Bring the sensors to a position: ``ready``, ``redo`` or ``back``."""
        ...

    def look(self, position: Position, readings: Mapping[str, Reading], why: str, seconds: float) -> None:
        """Show readings while the session waits or samples, so many seconds after the answer."""
        ...

    def review(self, result: PositionResult) -> OperatorAnswer:
        """Judge a measured position: ``accept``, ``redo`` or ``back``."""
        ...

    def accepted(self, result: PositionResult) -> None:
        """Handle a position that is accepted."""
        ...

    def refused(self, position: Position, why: str) -> None:
        """Handle a position that is refused; it is asked for again.

        Stopped: the operator gives up.
        """
        ...

    def lost(self, serial: str, why: str) -> None:
        """Handle a sensor that is given up; the others go on."""
        ...


@dataclass(frozen=True)
class StageTurn:
    """One turn of a stage, with what is known by then.

    Attributes
    ----------
    number : int
        Whole turns that count.
    of : int
        The most that are made.
    pairs : mapping of str to PairCoefficients
        p and q by now, by the name of the pair; a pair of which nothing is known is not there.
    unknown : mapping of str to str
        Why the estimators of other pairs stopped.
    left_out : int
        Samples that were held or damaged so far.
    """

    number: int
    of: int
    pairs: Mapping[str, PairCoefficients]
    unknown: Mapping[str, str]
    left_out: int = 0

    def __str__(self) -> str:
        parts = [f"turn {self.number} of {self.of}", *(pair_in_words(name, pair) for name, pair in self.pairs.items())]
        parts += [f"{name}: {why}" for name, why in self.unknown.items()]
        if self.left_out:
            parts.append(f"{self.left_out} samples left out")
        return "   ".join(parts)


class RotationOperator(Operator, Protocol):
    """The operator of a turning stage: asked once, informed turn by turn, free to stop at any time."""

    def begin(self, title: str) -> None:
        """Handle the start of a session, or its resumption."""
        ...

    def turning(self, prompt: str, pairs: Sequence[Pair], turns: int) -> OperatorAnswer:
        """Let the stage turn: ``ready``.

        Stopped: the operator quits.
        """
        ...

    def poll(self) -> OperatorAnswer | None:
        """Return ``stop`` where the operator has said so, without waiting.

        Stopped: the operator quits.
        """
        ...

    def turn_completed(self, turn: StageTurn) -> None:
        """Handle a completed turn."""
        ...

    def paused(self, why: str) -> None:
        """Handle the start of a time in which samples do not count."""
        ...

    def resumed(self) -> None:
        """Handle its end: samples count again."""
        ...

    def refused(self, why: str) -> None:
        """Handle a stage that does not turn, or a stop that comes too early."""
        ...

    def matched(self, turns: float, matchings: Sequence[Matching]) -> None:
        """Handle the matched pairs."""
        ...


def pair_in_words(name: str, found: PairCoefficients | Matching) -> str:
    """Return p and q of a pair in a line: ``a1_a2: p 0.012345 ± 0.000030, q ...``."""
    return f"{name}: p {plus_minus(found.p, found.u_p)}, q {plus_minus(found.q, found.u_q)}"

"""Who carries out the positions: a person, a program, or the virtual jig."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from tiltcal.bench.operators.stage import StageOperator
from tiltcal.drivers.device import Reading
from tiltcal.files.procedure import Position

Live = Callable[[], Mapping[str, Reading]]
"""Takes one sample of every sensor, by serial number."""


@dataclass(frozen=True)
class Measured:
    """What one sensor gave in one position.

    Attributes
    ----------
    serial, unit : str
    mean, std, expected : dict of str to float
        Per channel, in ``unit``; ``expected`` is what the positions so far let one expect, empty where nobody
        can say.
    n : int
        Number of samples.
    temperature : float or None
        °C.
    """

    serial: str
    unit: str
    mean: dict[str, float]
    std: dict[str, float]
    expected: dict[str, float]
    n: int
    temperature: float | None


@dataclass(frozen=True)
class Answer:
    """What the operator said.

    Attributes
    ----------
    word : str
        ``ready``, ``accept``, ``redo``, ``back``, ``quit``, ``yes`` or ``no``; ``stop`` while a stage turns.
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

    def record(self) -> dict[str, Any]:
        """As plain data for the journal."""
        return {
            "answer": self.word,
            **({"tilt": self.tilt} if self.tilt else {}),
            **({"gravity": list(self.gravity)} if self.gravity is not None else {}),
            **({"temperature": self.temperature} if self.temperature is not None else {}),
        }

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> Answer:
        """The inverse of :meth:`record`."""
        gravity = record.get("gravity")
        return cls(
            record["answer"],
            dict(record.get("tilt", {})),
            tuple(gravity) if gravity is not None else None,
            record.get("temperature"),
        )


class Operator(StageOperator, Protocol):
    """Asked and told by the runner; only its answers enter the journal."""

    def begin(self, title: str, positions: int) -> None:
        """The session starts, or goes on."""
        ...

    def position(self, position: Position, number: int, live: Live) -> Answer:
        """Bring the sensors to a position: ``ready``, ``redo``, ``back`` or ``quit``."""
        ...

    def look(self, position: Position, readings: Mapping[str, Reading], why: str) -> None:
        """Shown while the session waits or samples."""
        ...

    def review(self, position: Position, measured: list[Measured]) -> Answer:
        """Judge a measured position: ``accept``, ``redo``, ``back`` or ``quit``."""
        ...

    def accepted(self, position: Position, measured: list[Measured]) -> None:
        """The position counts."""
        ...

    def refused(self, position: Position, why: str) -> None:
        """The position does not count; it is asked for again."""
        ...

    def lost(self, serial: str, why: str) -> None:
        """A sensor is given up; the others go on."""
        ...

    def write(self, files: list[Path]) -> Answer:
        """May the calibration files be written: ``yes`` or ``no``."""
        ...

    def done(self, files: list[Path], journal: Path) -> None:
        """All is written."""
        ...

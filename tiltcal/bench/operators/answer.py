"""What an operator answers, as the journal keeps it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class OperatorAnswer:
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
    def from_record(cls, record: Mapping[str, Any]) -> OperatorAnswer:
        """The inverse of :meth:`record`."""
        gravity = record.get("gravity")
        return cls(
            record["answer"],
            dict(record.get("tilt", {})),
            tuple(gravity) if gravity is not None else None,
            record.get("temperature"),
        )

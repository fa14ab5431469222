"""Who carries out the positions: a person, a program, or the virtual jig."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from tiltcal.bench.operators.answer import OperatorAnswer
from tiltcal.bench.operators.sim_stage import SimStageOperator
from tiltcal.drivers.device import Reading
from tiltcal.files.procedure import Position

Live = Callable[[], Mapping[str, Reading]]
"""Takes one sample of every sensor, by serial number."""


@dataclass(frozen=True)
class MeasuredPosition:
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


class Operator(SimStageOperator, Protocol):
    """Asked and told by the runner; only its answers enter the journal."""

    def begin(self, title: str, positions: int) -> None:
        """The session starts, or goes on."""
        ...

    def position(self, position: Position, number: int, live: Live) -> OperatorAnswer:
        """Bring the sensors to a position: ``ready``, ``redo``, ``back`` or ``quit``."""
        ...

    def look(self, position: Position, readings: Mapping[str, Reading], why: str) -> None:
        """Shown while the session waits or samples."""
        ...

    def review(self, position: Position, measured: list[MeasuredPosition]) -> OperatorAnswer:
        """Judge a measured position: ``accept``, ``redo``, ``back`` or ``quit``."""
        ...

    def accepted(self, position: Position, measured: list[MeasuredPosition]) -> None:
        """The position counts."""
        ...

    def refused(self, position: Position, why: str) -> None:
        """The position does not count; it is asked for again."""
        ...

    def lost(self, serial: str, why: str) -> None:
        """A sensor is given up; the others go on."""
        ...

    def write(self, files: list[Path]) -> OperatorAnswer:
        """May the calibration files be written: ``yes`` or ``no``."""
        ...

    def done(self, files: list[Path], journal: Path) -> None:
        """All is written."""
        ...

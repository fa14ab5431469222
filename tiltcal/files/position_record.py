"""The records of the procedure as run and of its positions in a calibration file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from tiltcal.files.coefficients import CHANNELS
from tiltcal.files.declaration import ANY, ByChannel, ByName, Context, Format, ListOf, Section, entry
from tiltcal.files.moments import MOMENT
from tiltcal.files.node import Node
from tiltcal.files.scalars import FROM_ZERO, Integer, Number, Text


@dataclass(frozen=True, kw_only=True)
class PositionSet:
    """The attitude of a position as it was set."""

    tilt: Mapping[str, float] | None = entry(ByChannel(Number()), "angles, degrees", default=None)
    gravity: tuple[float, ...] | None = entry(
        ListOf(Number(), 3, 3), "the direction that points up, in the sensor frame", default=None
    )
    heading: float | None = entry(Number(), "how far the fixture was turned about the vertical, degrees", default=None)
    stage: float | None = entry(Number(), "angle of the rotary stage, degrees", default=None)
    temperature: float | None = entry(Number(), "°C", default=None)


@dataclass(frozen=True, kw_only=True)
class CompletingRun:
    """A procedure that completes a calibration, as run."""

    samples: int | None = entry(Integer(minimum=1), "per position", default=None)
    settle_seconds: float | None = entry(FROM_ZERO, "over which the reading held still", default=None)
    positions: tuple[str, ...] = entry(ListOf(Text()), "their names", default=())


@dataclass(frozen=True, kw_only=True)
class ProcedureRecord:
    """The procedure as run."""

    name: str | None = entry(Text(), "its name", default=None)
    title: str | None = entry(Text(), "its title", default=None)
    source: str | None = entry(Text(), "the document it comes from", default=None)
    samples: int | None = entry(Integer(minimum=1), "samples per position", default=None)
    settle_seconds: float | None = entry(FROM_ZERO, "seconds over which the reading held still", default=None)
    set: Mapping[str, PositionSet] = entry(
        ByName(Section(PositionSet)), "per position `tilt` or `gravity` as it was set", default={}
    )
    mounting: CompletingRun | None = entry(
        Section(CompletingRun), "`samples`, `settle_seconds` and `positions` of the mounting procedure", default=None
    )
    level: CompletingRun | None = entry(Section(CompletingRun), "likewise of `level`", default=None)


@dataclass(frozen=True)
class RowRanges(Format[tuple[tuple[int, int], ...]]):
    """Rows of a log: ``[first, end]``, or a list of such where the position was interrupted."""

    def read(self, node: Node, context: Context = ANY) -> tuple[tuple[int, int], ...]:
        items = node.items()
        parts = items if any(isinstance(item.content, list) for item in items) else [node]
        return tuple(self._part(part) for part in parts)

    def write(self, value: tuple[tuple[int, int], ...]) -> list[Any]:
        parts = [list(part) for part in value]
        return parts[0] if len(parts) == 1 else parts

    def schema(self) -> dict[str, Any]:
        part = {"type": "array", "items": {"type": "integer", "minimum": 0}, "minItems": 2, "maxItems": 2}
        return {"anyOf": [part, {"type": "array", "items": part}]}

    @staticmethod
    def _part(node: Node) -> tuple[int, int]:
        rows = [item.integer(minimum=0) for item in node.items()]
        if len(rows) != 2:
            raise node.error(f"rows are two numbers [first, end], found {len(rows)}")
        return rows[0], rows[1]


@dataclass(frozen=True, kw_only=True)
class PositionRecord:
    """The readings of one position."""

    position: str = entry(Text(), "its name")
    mean: Mapping[str, float] = entry(CHANNELS, "mean readings, unit", default={})
    std: Mapping[str, float] | None = entry(
        ByChannel(FROM_ZERO), "standard deviations of the samples, unit", default=None
    )
    u: Mapping[str, float] | None = entry(
        ByChannel(FROM_ZERO), "standard uncertainties of the means, unit", default=None
    )
    n: int | None = entry(Integer(minimum=0), "number of samples", default=None)
    left_out: int | None = entry(
        Integer(minimum=0), "samples that were far off the others, and were left out or taken again", default=None
    )
    temperature: float | None = entry(Number(), "°C", default=None)
    time: str | None = entry(MOMENT, "when it was measured, UTC", default=None)
    rows: tuple[tuple[int, int], ...] | None = entry(
        RowRanges(), "its rows `[first, end]` of the log, the end exclusive", default=None
    )
    line: int | None = entry(Integer(minimum=1), "its line of the table", default=None)

"""The records of the procedure as run and of its positions in a calibration file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from msgspec import Meta

from tiltcal.files.record import ByAxis, Count, Finite, FiniteFromZero, FromOne, Record, Text, about


class PositionSet(Record, kw_only=True):
    """The attitude of a position as it was set."""

    tilt: Annotated[ByAxis[Finite] | None, about("angles, degrees")] = None
    gravity: Annotated[
        Annotated[tuple[Finite, ...], Meta(min_length=3, max_length=3)] | None,
        about("the direction that points up, in the sensor frame"),
    ] = None
    heading: Annotated[Finite | None, about("how far the fixture was turned about the vertical, degrees")] = None
    stage: Annotated[Finite | None, about("angle of the rotary stage, degrees")] = None
    temperature: Annotated[Finite | None, about("°C")] = None


class CompletingRun(Record, kw_only=True):
    """A procedure that completes a calibration, as run."""

    samples: Annotated[FromOne | None, about("per position")] = None
    settle_seconds: Annotated[FiniteFromZero | None, about("over which the reading held still")] = None
    positions: Annotated[tuple[Text, ...], about("their names")] = ()


class ProcedureRecord(Record, kw_only=True):
    """The procedure as run."""

    name: Annotated[Text | None, about("its name")] = None
    title: Annotated[Text | None, about("its title")] = None
    source: Annotated[Text | None, about("the document it comes from")] = None
    samples: Annotated[FromOne | None, about("samples per position")] = None
    settle_seconds: Annotated[FiniteFromZero | None, about("seconds over which the reading held still")] = None
    set: Annotated[Mapping[str, PositionSet], about("per position `tilt` or `gravity` as it was set")] = {}
    mounting: Annotated[
        CompletingRun | None, about("`samples`, `settle_seconds` and `positions` of the mounting procedure")
    ] = None
    level: Annotated[CompletingRun | None, about("likewise of `level`")] = None


# A constrained number beside a tuple of two in a union makes msgspec 0.22 crash: the rows are not bounded here.
class PositionRecord(Record, kw_only=True):
    """The readings of one position."""

    position: Annotated[Text, about("its name")]
    mean: Annotated[ByAxis[Finite], about("mean readings, unit")] = {}
    std: Annotated[ByAxis[FiniteFromZero] | None, about("standard deviations of the samples, unit")] = None
    u: Annotated[ByAxis[FiniteFromZero] | None, about("standard uncertainties of the means, unit")] = None
    n: Annotated[Count | None, about("number of samples")] = None
    left_out: Annotated[
        Count | None, about("samples that were far off the others, and were left out or taken again")
    ] = None
    temperature: Annotated[Finite | None, about("°C")] = None
    time: Annotated[Text | None, about("when it was measured, UTC")] = None
    rows: Annotated[
        tuple[int | tuple[Count, Count], ...] | None,
        about("its rows `[first, end]` of the log, the end exclusive"),
    ] = None
    line: Annotated[FromOne | None, about("its line of the table")] = None

    @property
    def row_ranges(self) -> tuple[tuple[int, int], ...]:
        """Its rows of the log, part by part; empty where it was not measured in a log, or they are no such pairs."""
        match self.rows:
            case (int(first), int(end)) if min(first, end) >= 0:
                return ((first, end),)
            case rows:
                return tuple(part for part in rows or () if isinstance(part, tuple))

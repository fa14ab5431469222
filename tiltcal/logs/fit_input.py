"""Where the positions of a fit come from: a log with its still segments, given or found, or a table of means."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tiltcal.calibration.calibrate import Measurement
from tiltcal.calibration.unit_gravity import directions
from tiltcal.core.rounding import significant
from tiltcal.files.positions import read_positions
from tiltcal.files.procedure import Procedure
from tiltcal.files.segments import Segment, read_segments
from tiltcal.logs.columns import parse_columns
from tiltcal.logs.digest import sha256_of
from tiltcal.logs.static_detection import WINDOWS, find_still, still_segments, told
from tiltcal.logs.static_intervals import (
    RecordedReadings,
    StaticInterval,
    holds_of,
    holds_of_table,
    oriented,
    placed,
    read_record,
)


@dataclass(frozen=True)
class FitInput:
    """Recorded data as the user names them.

    Attributes
    ----------
    log : Path
        A log, or a table of positions.
    segments : Path or None
        The still segments of the log; None where they are to be found, and for a table.
    table : bool
        Whether ``log`` is a table of positions.
    columns : str
        What ``--columns`` says.
    window : int or None
        Rows over which the sensor must be still, where segments are found; None to try several.
    """

    log: Path
    segments: Path | None = None
    table: bool = False
    columns: str = ""
    window: int | None = None

    @property
    def finds(self) -> bool:
        """Whether the still segments are to be found."""
        return not self.table and self.segments is None


@dataclass(frozen=True)
class FitPositions:
    """The positions of a source, and how they came about.

    Attributes
    ----------
    measurements : sequence of Measurement
    provenance : mapping of str to Any
        Names and checksums of what was read.
    found : sequence of Segment
        The segments, where they were found.
    """

    measurements: Sequence[Measurement]
    provenance: Mapping[str, Any]
    found: Sequence[Segment] = ()


def set_positions(source: FitInput, channels: Sequence[str], procedure: Procedure) -> FitPositions:
    """Positions in the directions of a procedure, or in those that the segments give.

    Parameters
    ----------
    source : FitInput
        With segments, or a table.
    channels : sequence of str
    procedure : Procedure

    Raises
    ------
    InputError
        A file is wrong; the message names file and line.
    """
    holds, provenance = _given(source, channels)
    return FitPositions(placed(holds, procedure, file=str(source.segments or source.log)), provenance)


def free_positions(source: FitInput, channels: Sequence[str], unit: str, say: Callable[[str], None]) -> FitPositions:
    """Positions that nobody set, in the directions that the readings themselves say.

    Parameters
    ----------
    source : FitInput
    channels : sequence of str
        Three.
    unit : str
        Of the readings.
    say : callable
        Told what was found, where the segments are.

    Raises
    ------
    InputError
        A file is wrong; the message names file and line.
    EstimateError
        The readings lie on no ellipsoid, or no still segments are found.
    """
    if not source.finds:
        holds, provenance = _given(source, channels)
        return FitPositions(oriented(holds, directions([hold.summaries for hold in holds])), provenance)
    record = _record(source, channels)
    chosen, tried = find_still(record.readings(channels), WINDOWS if source.window is None else (source.window,))
    say(told(chosen, tried, unit))
    found = still_segments(chosen)
    holds = holds_of(record, found, file=str(source.log))
    attitudes = directions([hold.summaries for hold in holds])
    for hold, (x, y, z) in zip(holds, attitudes.tolist(), strict=True):
        rows = [segment for segment in found if segment.name == hold.position]
        n = hold.summaries[channels[0]].n
        say(f"  {hold.name}: {n} of rows {rows[0].start} to {rows[-1].end - 1}, up ({x:+.3f}, {y:+.3f}, {z:+.3f})")
    how = {
        "found": "standard deviation in a window below a threshold",
        "window_rows": chosen.window,
        "threshold": significant(chosen.threshold, 4),
        "times_noise": chosen.multiple,
    }
    return FitPositions(oriented(holds, attitudes), {**_log(source, record), "segments": how}, found)


def _given(source: FitInput, channels: Sequence[str]) -> tuple[list[StaticInterval], dict[str, Any]]:
    """What the sensor read in the segments or the table that were given, and where these come from."""
    if source.segments is None:
        holds = holds_of_table(read_positions(source.log, channels))
        return holds, {"table": {"name": source.log.name, "sha256": sha256_of(source.log)}}
    segments = read_segments(source.segments)
    record = _record(source, channels)
    origin = {"name": source.segments.name, "sha256": sha256_of(source.segments)}
    return holds_of(record, segments, file=str(source.segments)), {**_log(source, record), "segments": origin}


def _record(source: FitInput, channels: Sequence[str]) -> RecordedReadings:
    return read_record(source.log, channels, parse_columns(source.columns, channels))


def _log(source: FitInput, record: RecordedReadings) -> dict[str, Any]:
    return {"log": {"name": source.log.name, "rows": record.rows, "sha256": sha256_of(source.log)}}

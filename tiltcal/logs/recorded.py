"""A recorded log as positions: the still segments of a log, ready for the estimator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

import numpy as np

from tiltcal.calibrate import Measurement
from tiltcal.core.model import Array
from tiltcal.core.statistics import summarise
from tiltcal.errors import InputError
from tiltcal.files.procedure import Position, Procedure
from tiltcal.files.segments import Segment
from tiltcal.logs.columns import TEMPERATURE, locate_columns
from tiltcal.logs.csv_log import CsvLog

FEWEST = 2
"""Samples that a segment needs for a standard deviation."""


@dataclass(frozen=True)
class Record:
    """The number columns of a log, whole.

    Attributes
    ----------
    path : Path
    columns : mapping of str to ndarray, shape (rows,)
        By role: the channels and, where there is one, the temperature; NaN where a value is missing.
    """

    path: Path
    columns: Mapping[str, Array]

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(next(iter(self.columns.values())))


def read_record(path: Path, channels: Sequence[str], named: Mapping[str, str]) -> Record:
    """Read the readings of a CSV log.

    Parameters
    ----------
    path : Path
    channels : sequence of str
    named : mapping of str to str
        Column name by role, from ``--columns``.

    Raises
    ------
    InputError
        A column is missing, or a row cannot be parsed.
    """
    try:
        with open(path, "rb") as stream:
            log = CsvLog(stream, name=str(path))
            where = locate_columns(log.names, channels, named, file=str(path))
            blocks = [rows.values for rows in log.rows(sorted(set(where.values())))]
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=path) from None
    return Record(path, {role: np.concatenate([block[index] for block in blocks]) for role, index in where.items()})


def measurements_of(
    record: Record, segments: Sequence[Segment], procedure: Procedure, *, file: str
) -> list[Measurement]:
    """The mean reading of every segment.

    Parameters
    ----------
    record : Record
    segments : sequence of Segment
    procedure : Procedure
        Says the direction of a position that the segment only names.
    file : str
        The segments file, for messages.

    Returns
    -------
    list of Measurement
        One a segment, in their order.

    Raises
    ------
    InputError
        A segment reaches beyond the log, has a missing value, or names a position that the procedure does not have.
    """
    positions = {position.name: position for position in procedure.positions}
    return [_measurement(record, segment, _place(segment, positions, procedure, file), file) for segment in segments]


def _place(segment: Segment, positions: Mapping[str, Position], procedure: Procedure, file: str) -> Position:
    """The position that a segment was taken in."""
    if segment.gravity is not None:
        return Position(segment.name, "", segment.gravity)
    if segment.name in positions:
        return positions[segment.name]
    near = get_close_matches(segment.name, positions, n=1)
    raise InputError(
        f"{procedure.name} has no position {segment.name!r}"
        + (f" (did you mean {near[0]!r}?)" if near else f"; it has {', '.join(positions)}")
        + ", and the segment gives no gx, gy, gz",
        file=file,
        line=segment.line,
    )


def _measurement(record: Record, segment: Segment, position: Position, file: str) -> Measurement:
    def refuse(why: str) -> InputError:
        return InputError(f"segment {segment.name}: {why}", file=file, line=segment.line)

    if segment.end > record.rows:
        raise refuse(f"ends at row {segment.end}; {record.path} has {record.rows} rows")
    if segment.end - segment.start < FEWEST:
        raise refuse(f"has {segment.end - segment.start} row; at least {FEWEST} are needed")
    samples = {role: values[segment.start : segment.end] for role, values in record.columns.items()}
    temperature = samples.pop(TEMPERATURE, None)
    for channel, values in samples.items():
        lost = np.flatnonzero(~np.isfinite(values))
        if len(lost):
            raise refuse(f"{channel} has no number in row {segment.start + int(lost[0])} of {record.path}")
    if all(np.ptp(values) == 0.0 for values in samples.values()):
        raise refuse("all samples are identical: the sensor was stuck, not still; choose other rows")
    known = None if temperature is None else temperature[np.isfinite(temperature)]
    return Measurement(
        segment.name,
        position.gravity,
        position.tilt,
        position.temperature if known is None or not len(known) else summarise(known.tolist()).mean,
        {channel: summarise(values.tolist()) for channel, values in samples.items()},
        {"rows": [segment.start, segment.end]},
    )

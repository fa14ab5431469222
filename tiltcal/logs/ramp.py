"""The continuous record of a ramp from a log of any length, in bounded memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.core.ramp.record import RampRecord, RecordAverager
from tiltcal.errors import InputError
from tiltcal.files.segments import Segment
from tiltcal.logs.columns import TEMPERATURE, TIME, locate_readings
from tiltcal.logs.formats import open_log


@dataclass(frozen=True)
class RampLog:
    """A record, and how many rows it was made of.

    Attributes
    ----------
    rows : int
        Of the log.
    missing : int
        Of these, within the segment: rows that miss a value, or whose temperature jumps, and were left out.
    """

    record: RampRecord
    rows: int
    missing: int


def read_ramp(
    log: object, channels: Sequence[str], named: Mapping[str, str], unit: str, segment: Segment | None = None
) -> RampLog:
    """Read the record of a ramp.

    Parameters
    ----------
    named : mapping of str to str
        Column name by role, from ``--columns``.
    unit : str
        Of the readings.
    segment : Segment, optional
        The rows that count; without it all.

    Raises
    ------
    InputError
        A column is missing or in another unit, a row cannot be parsed, or the segment reaches beyond the log.
    EstimateError
        There are too few rows, or too many temperatures jump.
    """
    first, last = (0, np.inf) if segment is None else (segment.start, segment.end)
    averager, rows, used = RecordAverager(len(channels), first), 0, 0
    with open_log(log) as reader:
        where = locate_readings(reader, channels, named, unit, (TIME, TEMPERATURE))
        columns = [where[channel] for channel in channels]
        for block in reader.rows(sorted(set(where.values())), where[TIME]):
            part = slice(max(first - rows, 0), int(min(max(last - rows, 0), len(block))))
            readings = block.readings(columns)[part]
            averager.add(block.values[where[TIME]][part], block.values[where[TEMPERATURE]][part], readings)
            rows += len(block)
            used += len(readings)
    if segment is not None and segment.end > rows:
        raise InputError(
            f"segment {segment.name} ends at row {segment.end}, and the log has {rows}", file=str(reader.name)
        )
    record = averager.record()
    return RampLog(record, rows, used - record.rows)

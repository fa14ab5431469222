"""The continuous record of a ramp from a log of any length, in bounded memory."""

from __future__ import annotations

import numpy as np

from tiltcal.core.ramp.record import RampRecord, RecordAverager
from tiltcal.errors import InputError
from tiltcal.files.tables import Segment
from tiltcal.logs.interval_samples import TO_THE_END
from tiltcal.logs.recorded_readings import RecordedReadings


def read_ramp(record: RecordedReadings, segment: Segment | None = None) -> tuple[RampRecord, int]:
    """Return the record of a ramp from a log with temperatures and times, and how many of its rows were left out.

    These miss a value, or their temperature jumps.

    Parameters
    ----------
    segment : Segment, optional
        The rows that count; without it all.

    Raises
    ------
    InputError
        A row cannot be parsed, or the segment reaches beyond the log.
    EstimateError
        There are too few rows, or too many temperatures jump.
    """
    first, end = (0, TO_THE_END) if segment is None else (segment.start, segment.end)
    averager, used = RecordAverager(len(record.channels), first), 0
    for start, values in record.blocks():
        part = np.stack(values)[:, max(first - start, 0) : max(end - start, 0)]
        averager.add(part[-1], part[-2], part[:-2].T)
        used += part.shape[1]
    if segment is not None and segment.end > record.rows:
        raise InputError(
            f"segment {segment.name} ends at row {segment.end}, and the log has {record.rows}", file=record.name
        )
    found = averager.record()
    return found, used - found.rows

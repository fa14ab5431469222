"""The continuous record of a ramp from a log of any length."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tiltcal.core.ramp.record import RampRecord, ramp_record
from tiltcal.errors import InputError
from tiltcal.files.calibration import SensorIdentity
from tiltcal.files.results import LogRecord
from tiltcal.files.tables import Segment
from tiltcal.logs.columns import TEMPERATURE, TIME, locate_readings
from tiltcal.logs.formats import open_log
from tiltcal.logs.log import Progress
from tiltcal.logs.numbers import read_columns


def read_ramp(
    data: Any,
    sensor: SensorIdentity,
    named: Mapping[str, str],
    segment: Segment | None = None,
    progress: Progress | None = None,
) -> tuple[RampRecord, LogRecord | None]:
    """Return the record of a ramp in the rows of a segment, or in all, and the log that it is from; None of a frame.

    ``named`` are columns by role, from ``--columns``. Rows that miss a value, or whose temperature jumps, are left out.
    """
    is_file = isinstance(data, str | Path)
    with open_log(data, digest=is_file, progress=progress) as log:
        where = locate_readings(log, sensor.channels, named, sensor.unit, (TIME, TEMPERATURE))
        columns = [where[role] for role in (*sensor.channels, TEMPERATURE, TIME)]
        numbers = read_columns(log, columns, where[TIME], needs_time=True)
    rows = len(numbers)
    first, end = (0, rows) if segment is None else (segment.start, segment.end)
    if segment is not None and end > rows:
        raise InputError(f"segment {segment.name} ends at row {end}, and the log has {rows}", file=log.name)
    *readings, temperature, time = (column[first:end] for column in numbers.columns)
    record = ramp_record(time, temperature, readings, first)
    if not is_file or log.sha256 is None:
        return record, None
    missing = end - first - record.rows
    return record, LogRecord(name=Path(data).name, sha256=log.sha256, rows=rows, missing=missing or None)

"""A calibration applied to a log, block after block: one way for every format, and for frames."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from tiltcal.calibration.record import record_in
from tiltcal.calibration.season import CalibrationFolder
from tiltcal.column_names import AXES, TEMPERATURE, TIME
from tiltcal.core.column_statistics import ColumnStatistics
from tiltcal.core.earth_frame import VELOCITY, FieldLength
from tiltcal.core.flags import FLAGS, REASONS, count_flags
from tiltcal.errors import Argument, UsageError
from tiltcal.files.atomic import require_apart
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.document import read_document
from tiltcal.files.pair import PairRecord
from tiltcal.logs.columns import HEADING, column_names, locate_columns, named_columns, require_units
from tiltcal.logs.formats import create_log, open_log, require_way
from tiltcal.logs.kernel import PreparedCalibration, RoleValues, prepare, with_lag
from tiltcal.logs.log import LogBlock, LogReader, Progress, Table
from tiltcal.logs.means import BlockOfMeans, Means
from tiltcal.logs.options import ApplyOptions, require_consistent
from tiltcal.logs.recordings import require_no_signs
from tiltcal.logs.streams import STANDARD, log_sink, read_ahead, sha256_of, with_writeback
from tiltcal.printable import counted
from tiltcal.stated_arguments import require_path

NO_TIME = (
    "note: the log has no column of times, and the sensing element follows its thermometer with a lag: rows are "
    "compensated with the thermometer's temperature, flag 3 (--columns time=NAME)"
)

Applied = CalibrationRecord | PairRecord | CalibrationFolder | str | Path
"""What can be applied: a calibration, its file, or a folder of them, of which each row takes that of its time."""


def apply_to_log(
    calibration: Applied, log: str | Path, output: str | Path, options: ApplyOptions, progress: Progress | None = None
) -> ApplySummary:
    """Apply a calibration to a recorded log, and write the result, whole or not at all.

    The arguments, errors and what is returned are those of :func:`tiltcal.apply_log`.
    """
    require_path("the log", log)
    require_path("the output", output)
    require_way(log, output)
    if str(output) != STANDARD:
        require_apart(output, log, *([calibration] if isinstance(calibration, str | Path) else []))
    ready = prepare_any(calibration, options)
    with open_log(log, skip_bad_rows=options["skip_bad_rows"], progress=progress) as reader:
        prepared = ready(reader)
        _require_new_columns(reader, prepared)
        rows = CompensatedLog(reader, prepared, options)
        with log_sink(str(output)) as sink:
            writer = create_log(output, sink, reader, prepared.columns, prepared.origin, rows.units)
            writer.write(with_writeback(sink, rows.blocks(frames=writer.frames)))
    return rows.summary


def apply_frame(
    calibration: CalibrationRecord | PairRecord | CalibrationFolder, frame: Any, options: ApplyOptions
) -> Any:
    """Apply a calibration to a frame, and return the same kind with the columns that are added to a log."""
    from tiltcal.logs.frames import FrameReader

    if options["skip_bad_rows"]:
        raise UsageError(option="skip_bad_rows", why="is for logs: a frame has no row that cannot be parsed")
    reader = FrameReader(frame)
    prepared = prepare_any(calibration, options)(reader)
    _require_new_columns(reader, prepared)
    log = CompensatedLog(reader, prepared, options)
    return reader.with_columns(list(log.blocks()), log.channels, log.units)


def _require_new_columns(log: LogReader, prepared: PreparedCalibration) -> None:
    if taken := [name for name in prepared.columns if name in log.names]:
        why = f"{log.name} has a column {taken[0]!r} already: rename it, or apply to the log as it was recorded"
        raise UsageError(why)


def prepare_any(calibration: Applied, options: ApplyOptions) -> Callable[[LogReader], PreparedCalibration]:
    """Make a calibration, its file or a folder ready for a log; options that are not for it are a UsageError."""
    require_consistent(options)
    if isinstance(calibration, str | Path) and os.path.isdir(calibration):
        calibration = CalibrationFolder(calibration)
    if isinstance(calibration, CalibrationFolder):
        from tiltcal.logs.apply_library import prepare_library

        folder = calibration
        return lambda log: prepare_library(folder, log, options)
    for name in ("serial", "stability", "start"):
        if options[name] is not None:
            raise UsageError(option=name, why=("is for a folder of calibrations (", Argument("calibrations"), ")"))
    if isinstance(calibration, str | Path):
        path, record = Path(calibration), record_in(read_document(calibration))
        prepared = prepare(record, options, file=path, origin={"calibration": path.name, "sha256": sha256_of(path)})
    else:
        prepared = prepare(calibration, options)
    return lambda log: prepared


class CompensatedLog:
    """The rows of a log with what a calibration makes of them; ``summary`` counts the rows as they pass."""

    def __init__(self, log: LogReader, prepared: PreparedCalibration, options: ApplyOptions) -> None:
        self.log, self.prepared, self._say = log, prepared, options["say"]
        self._lagged = any(sensor.lag for sensor in prepared.sensors)
        thermometers = [name for one in prepared.sensors if one.lead and (name := one.lead + TEMPERATURE) in log.names]
        require_no_signs(options["columns"], log.names)
        of_fit = ((one.lead + axis, name) for one in prepared.sensors for axis, name in one.named.items())
        named = {role: name for role, name in of_fit if name in log.names}
        named |= named_columns(options["columns"], [*prepared.channels, *thermometers], prepared.roles)
        takes_time = TIME not in prepared.roles and (self._lagged or prepared.averaging is not None)
        timed = takes_time and (TIME in named or TIME in column_names(log.names, (TIME,), {}))
        roles = (*prepared.roles, *((TIME,) if timed else ()))
        where = locate_columns(log, [*prepared.channels, *thermometers], named, roles)
        self._vectors = {
            role: tuple(locate_columns(log, names, {}, option=role)[name] for name in names)
            for role, names in prepared.vectors.items()
        }
        self._sensors = [
            replace(
                sensor,
                kernel=with_lag(sensor.kernel, sensor.lag, log.name),
                columns=tuple(where[sensor.lead + channel] for channel in sensor.channels),
                thermometer=where[sensor.lead + TEMPERATURE] if sensor.lead + TEMPERATURE in thermometers else None,
            )
            for sensor in prepared.sensors
        ]
        units = {one.lead + channel: one.unit for one in prepared.sensors if one.unit for channel in one.channels}
        require_units(log, where, units, stated=options["unit"])
        for first, *others in self._vectors.values():
            if (unit := log.unit(first)) is not None:
                beside = dict(zip(AXES[1:], others, strict=True))
                require_units(log, beside, dict.fromkeys(beside, unit), repr(log.names[first]))
        self.channels = tuple(chain(*(sensor.columns for sensor in self._sensors)))
        self.roles = {role: where[role] for role in (TEMPERATURE, *roles) if role in where}
        if self._lagged and TIME not in self.roles:
            self._say(NO_TIME)
        self._needs_time = TIME in prepared.roles or self._lagged
        self._field_length = FieldLength() if "magnetometer" in self._vectors else None
        self.summary = ApplySummary()

    @property
    def units(self) -> dict[str, str | None]:
        """The unit of each earth velocity: that of the column of the first component."""
        velocity = self._vectors.get("velocity")
        return {} if velocity is None else dict.fromkeys(VELOCITY, self.log.unit(velocity[0]))

    def blocks(self, *, frames: bool = False) -> Iterator[tuple[LogBlock, Table]]:
        """Yield the log's own blocks, in order, and the columns that belong behind theirs.

        With ``frames`` each block has all its columns with their types.
        """
        time = self.roles.get(TIME)
        thermometers = [one.thermometer for one in self._sensors if one.thermometer is not None]
        wanted = {*self.channels, *thermometers, *self.roles.values(), *chain(*self._vectors.values())}
        means = None
        if (size := self.prepared.averaging) is not None:
            heading = self.roles.get(HEADING)
            judged = partial(self._table, judged=True)
            means = Means(size, self.log, self._sensors, judged, time, heading, self.roles.get(TEMPERATURE))
        rows = self.log.rows(
            sorted(wanted),
            time,
            temperatures={*thermometers, *(index for role, index in self.roles.items() if role == TEMPERATURE)},
            frames=frames or means is not None,
            needs_time=self._needs_time,
        )
        for block in rows if means is None else means.blocks(rows):
            table: Table = self._table(block)
            if self._field_length is not None:
                table = self._field_length.flagged(table, block.readings(self._vectors["magnetometer"]))
            if isinstance(block, BlockOfMeans):
                table = block.marked(table)
            self.summary.add(table, len(block.faults) + block.bad_rows)
            yield block, table
        odd = self.log.clock.remarks if self.prepared.averaging is not None else []
        for remark in [*self.log.remarks, *odd]:
            self._say(f"note: {remark}")
        for sensor in self.prepared.sensors:
            for remark in sensor.remarks:
                self._say(f"note: {sensor.lead.rstrip('_')}{': ' * bool(sensor.lead)}{remark}")

    def _table(self, block: LogBlock, *, judged: bool = False) -> dict[str, Any]:
        """Return the columns of some rows; ``judged`` are readings one by one, before their means."""
        shared: dict[str, Any] = {role: block.values[index] for role, index in self.roles.items()}
        shared |= {role: block.readings(indices) for role, indices in self._vectors.items()}
        table: dict[str, Any] = {}
        for number, sensor in enumerate(self._sensors):
            own = {} if sensor.thermometer is None else {TEMPERATURE: block.values[sensor.thermometer]}
            count = None if block.counts is None else block.counts[:, number]
            kernel = sensor.judge if judged and sensor.judge is not None else sensor.kernel
            part = kernel(RoleValues(block.readings(sensor.columns), **{**shared, **own}, count=count))
            table |= {f"{sensor.lead}{name}": column for name, column in part.items()}
        return table


def look_over(log: LogReader, prepared: PreparedCalibration, options: ApplyOptions) -> ColumnStatistics:
    """Return what a report shows of a log, by its readings; columns that a calibration has added count for nothing.

    Rows are counted where the roles of the calibration have no time.
    """
    angles = prepared.led(lambda sensor: sensor.angles)
    overview, compensated = ColumnStatistics(angles), CompensatedLog(log, prepared, options)
    time = compensated.roles[TIME] if TIME in prepared.roles else None
    for block, table in read_ahead(compensated.blocks()):
        times = overview.rows + np.arange(float(len(block))) if time is None else block.values[time]
        shown = np.stack([np.asarray(table[angle], float) for angle in angles]).T
        overview.add(times, shown, table["flag"], table["reason"])
    return overview


@dataclass(repr=False)
class ApplySummary:
    """The counts of an applied log: rows by flag and by reason.

    rows: written, every one that was read.
    flags: rows by flag.
    reasons: rows by bit of the reason; a row may have several.
    bad_rows: rows that could not be parsed and were kept as missing.
    sensors: of each sensor, by serial number, where the log has several; the whole then counts the worst flag of a row,
        and every reason of it.
    """

    rows: int = 0
    flags: Counter[int] = field(default_factory=Counter)
    reasons: Counter[int] = field(default_factory=Counter)
    bad_rows: int = 0
    sensors: dict[str, ApplySummary] = field(default_factory=dict)

    def add(self, table: Table, bad_rows: int = 0) -> None:
        """Count some rows, and those of them that could not be parsed."""
        flags, reasons = [], []
        for lead in [name.removesuffix("flag") for name in table if name.rpartition("_")[2] == "flag"]:
            flags.append(np.asarray(table[f"{lead}flag"], np.uint16))
            reasons.append(np.asarray(table[f"{lead}reason"], np.uint16))
            if lead:
                of_sensor = self.sensors.setdefault(lead.removesuffix("_"), ApplySummary())
                of_sensor.add({"flag": flags[-1], "reason": reasons[-1]})
        worst = np.maximum.reduce(flags)
        self.rows += len(worst)
        self.bad_rows += bad_rows
        count_flags(self.flags, self.reasons, worst, np.bitwise_or.reduce(reasons))

    def as_data(self) -> dict[str, Any]:
        """Return the counts as plain data, every flag and reason that occurred."""
        data = {"rows": self.rows, **self._counts(), "bad_rows": self.bad_rows}
        if self.sensors:
            data["sensors"] = {serial: sensor._counts() for serial, sensor in self.sensors.items()}
        return data

    def _counts(self) -> dict[str, dict[str, int]]:
        return {
            "flags": {str(flag): self.flags[flag] for flag in FLAGS if self.flags[flag]},
            "reasons": {str(bit): self.reasons[bit] for bit in REASONS if self.reasons[bit]},
        }

    def __str__(self) -> str:
        """Return the counts in words, one line for each."""
        lines = [counted(self.rows, "row")]
        for serial, summary in (self.sensors or {"": self}).items():
            lead = f"  {serial} " if serial else "  "
            for what, names, counts in (("flag", FLAGS, summary.flags), ("reason", REASONS, summary.reasons)):
                lines += [f"{lead}{what} {code} {name}: {counts[code]}" for code, name in names.items() if counts[code]]
        if self.bad_rows:
            lines.append(f"  {counted(self.bad_rows, 'row')} could not be parsed and kept as missing")
        return "\n".join(lines)

    __repr__ = __str__

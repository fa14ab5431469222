"""A calibration applied to a log, block after block: one way for every format, and for frames."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tiltcal.calibration.record import record_in
from tiltcal.calibration.season import CalibrationFolder
from tiltcal.errors import InputError, UsageError
from tiltcal.files.atomic import require_apart
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.document import read_document
from tiltcal.files.pair import PairRecord
from tiltcal.logs.apply_summary import ApplySummary, ColumnWidths
from tiltcal.logs.cf_attributes import DEGREE, same_unit
from tiltcal.logs.columns import (
    HEADING,
    TEMPERATURE,
    TIME,
    SensorColumns,
    locate_columns,
    named_columns,
    require_celsius,
    require_degrees,
    require_one_unit,
    require_unit,
)
from tiltcal.logs.formats import create_log, open_log, require_way
from tiltcal.logs.kernel import PreparedCalibration, RoleValues, prepare
from tiltcal.logs.log import LogBlock, LogReader, Progress, Table
from tiltcal.logs.options import ApplyOptions, require_consistent
from tiltcal.logs.streams import STANDARD, log_sink, sha256_of, with_writeback
from tiltcal.stated_arguments import require_path

NO_TIME = (
    "note: the log has no column of times, and the sensing element follows its thermometer with a lag: rows are "
    "compensated with the thermometer's temperature, flag 3 (--columns time=NAME)"
)

if TYPE_CHECKING:
    from tiltcal.core.heading import FieldLength
    from tiltcal.logs.means import Means


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
        rows = CompensatedLog.of(reader, prepared, options)
        with log_sink(str(output)) as sink:
            writer = create_log(output, sink, reader, prepared.columns, prepared.origin, rows.units)
            writer.write(with_writeback(sink, rows.blocks(frames=writer.frames)))
    return rows.summary


def apply_frame(
    calibration: CalibrationRecord | PairRecord | CalibrationFolder, frame: Any, options: ApplyOptions
) -> Any:
    """Apply a calibration to a frame, and return the same kind with the columns that are added to a log.

    UsageError: the frame is of no known kind, or has a column of a name that the result needs.
    InputError: a column is not there or holds no numbers, or the readings are in another unit than the calibration's.
    """
    from tiltcal.logs.frames import FrameReader

    if options["skip_bad_rows"]:
        raise UsageError("--skip-bad-rows is for logs: a frame has no row that cannot be parsed")
    reader = FrameReader(frame)
    prepared = prepare_any(calibration, options)(reader)
    log = CompensatedLog.of(reader, prepared, options)
    blocks = list(log.blocks(count=False))
    if prepared.averaging is not None:
        return reader.of_means(blocks, log.channels, log.units)
    ((_block, table),) = blocks
    return reader.with_columns(table, log.channels, log.units)


def prepare_any(calibration: Applied, options: ApplyOptions) -> Callable[[LogReader], PreparedCalibration]:
    """Make a calibration, its file or a folder ready for a log.

    UsageError: the options are not for this calibration.
    InputError: the calibration is wrong.
    """
    require_consistent(options)
    if not isinstance(calibration, str | Path) or os.path.isdir(calibration):
        from tiltcal.logs.apply_library import prepare_library

        folder = CalibrationFolder(calibration) if isinstance(calibration, str | Path) else calibration
        if isinstance(folder, CalibrationFolder):
            return lambda log: prepare_library(folder, log, options)
        calibration = folder
    for name in ("serial", "stability", "start"):
        if options[name] is not None:
            raise UsageError(f"--{name} is for a folder of calibrations (--calibrations)")
    if isinstance(calibration, str | Path):
        path, record = Path(calibration), record_in(read_document(calibration))
        prepared = prepare(record, options, file=path, origin={"calibration": path.name, "sha256": sha256_of(path)})
    else:
        prepared = prepare(calibration, options)
    return lambda log: prepared


@dataclass(frozen=True)
class CompensatedLog:
    """The rows of a log with what a calibration makes of them.

    Attributes
    ----------
    channels : tuple of int
        Where each reading stands in the log, in the order of the calibration.
    roles : mapping of str to int
        Where the temperature stands, if there is one, and each role that the calibration asks for.
    vectors : mapping of str to tuple of int
        Where the components of ``magnetometer`` and ``velocity`` stand, if they are asked for.
    summary : ApplySummary
        Counts the rows as they pass.
    say : callable
        Called with each remark on the rows, when all have passed.
    field_length : FieldLength or None
        Remembers the usual length of the magnetic field.
    """

    log: LogReader
    prepared: PreparedCalibration
    channels: tuple[int, ...]
    roles: Mapping[str, int]
    vectors: Mapping[str, tuple[int, ...]]
    summary: ApplySummary
    say: Callable[[str], None]
    field_length: FieldLength | None = None

    @classmethod
    def of(cls, log: LogReader, prepared: PreparedCalibration, options: ApplyOptions) -> CompensatedLog:
        """Find the readings of a log, and whatever else the calibration asks for; report it if there is no time.

        UsageError: the log has a column of a name that the result needs.
        InputError: a column is not there, or its unit is not that of the calibration.
        """
        named = named_columns(options["columns"], prepared.channels, prepared.roles)
        optional = (*prepared.optional_roles, *(() if prepared.averaging is None else (TIME,)))
        roles = (*prepared.roles, *(role for role in optional if role in named or role in log.names))
        where = locate_columns(log, prepared.channels, named, roles)
        vectors = {role: _locate_vector(log, role, names) for role, names in prepared.vectors.items()}
        if taken := [name for name in prepared.columns if name in log.names]:
            why = f"{log.name} has a column {taken[0]!r} already: rename it, or apply to the log as it was recorded"
            raise UsageError(why)
        channels = tuple(where[channel] for channel in prepared.channels)
        for channel, unit in prepared.units.items():
            require_unit(log, [where[channel]], unit)
            if (stated := options["unit"]) is not None and unit != DEGREE and not same_unit(stated, unit):
                why = f"column {log.names[where[channel]]!r} is in {stated}, and the calibration in {unit}"
                raise InputError(f"{why}: convert the readings", file=log.name)
        require_celsius(log, where)
        if HEADING in where:
            require_degrees(log, where[HEADING], "headings")
        for columns_of in vectors.values():
            require_one_unit(log, columns_of)
        for sensor in prepared.sensors:
            if sensor.thermometer is not None:
                require_celsius(log, {TEMPERATURE: channels[sensor.thermometer]})
        present = {role: where[role] for role in (TEMPERATURE, *roles) if role in where}
        if TIME in prepared.optional_roles and TIME not in present:
            options["say"](NO_TIME)
        field_length = None
        if vectors.get("magnetometer"):
            from tiltcal.core.heading import FieldLength

            field_length = FieldLength()
        summary = ApplySummary(widths={name: ColumnWidths() for name in prepared.watched})
        return cls(log, prepared, channels, present, vectors, summary, options["say"], field_length)

    @property
    def units(self) -> dict[str, str | None]:
        """The unit of each earth velocity: that of the column of the first component."""
        if "velocity" not in self.vectors:
            return {}
        from tiltcal.core.heading import VELOCITY

        return dict.fromkeys(VELOCITY, self.log.unit(self.vectors["velocity"][0]))

    def blocks(
        self, time: int | None = None, *, frames: bool = False, count: bool = True
    ) -> Iterator[tuple[LogBlock, Table]]:
        """Yield the log's own blocks, in order, and the columns that belong behind theirs.

        Parameters
        ----------
        time : int, optional
            A column of times that is needed too; without it, the one that the calibration asks for.
        frames : bool
            Give each block all columns with their types.
        count : bool
            Add the rows to :attr:`summary`.
        """
        needs_time = time is not None or self._needs_time()
        time = self.roles.get(TIME, time)
        wanted = {*self.channels, *self.roles.values(), *chain(*self.vectors.values())}
        means = self._means()
        rows: Iterable[LogBlock] = self.log.rows(
            sorted(wanted if time is None else wanted | {time}),
            time,
            frames=frames or means is not None,
            needs_time=needs_time,
        )
        if self.prepared.lagged and time is not None:
            rows = _in_order(rows, time, self.log.name)
        for block in rows if means is None else means.blocks(rows):
            values = self._values(block)
            table = self.prepared.kernel(values)
            if self.field_length is not None and values.magnetometer is not None:
                table = self.field_length.flagged(table, values.magnetometer)
            if means is not None:
                table = means.added(block, table)
            if count:
                self.summary.add(table, len(block.faults) + block.bad_rows)
            yield block, table
        for lead, remarks in (self.prepared.readings or self.prepared).remarks.items():
            for remark in remarks:
                self.say(f"note: {lead.rstrip('_')}{': ' * bool(lead)}{remark}")

    def _needs_time(self) -> bool:
        """Return whether the time decides something; means of so many rows merely have one."""
        averaging = self.prepared.averaging
        every = averaging is not None and averaging.seconds is not None
        return every or TIME in (*self.prepared.roles, *self.prepared.optional_roles)

    def _values(self, block: LogBlock) -> RoleValues:
        given = {role: block.values[index] for role, index in self.roles.items()}
        given |= {role: block.readings(indices) for role, indices in self.vectors.items()}
        values = RoleValues(block.readings(self.channels), **given)  # type: ignore[arg-type]
        if block.counts is None:
            return values
        return replace(values, count=block.counts if self.prepared.sensors else block.counts[:, 0])

    def _means(self) -> Means | None:
        if self.prepared.averaging is None:
            return None
        from tiltcal.logs.means import Means

        sensors = [sensor.of(self.channels) for sensor in self.prepared.sensors] or [SensorColumns("", self.channels)]
        time, heading = self.roles.get(TIME), self.roles.get(HEADING)
        return Means(self.prepared.averaging, self.log.names, sensors, self._judged, time, heading, self.log.name)

    def _judged(self, block: LogBlock) -> Table:
        """Return what is made of readings one by one, before their means."""
        return (self.prepared.readings or self.prepared).kernel(self._values(block))


def _in_order(blocks: Iterable[LogBlock], time: int, name: str) -> Iterator[LogBlock]:
    """Yield blocks whose times go on, s; a temperature follows its thermometer with a lag in no others."""
    last, first = nan, 0
    for block in blocks:
        known = np.flatnonzero(np.isfinite(block.values[time]))
        steps = np.diff(block.values[time][known], prepend=last)
        if np.any(steps <= 0.0):
            wrong = int(np.argmax(steps <= 0.0))
            how = "goes back" if steps[wrong] < 0.0 else "stands still"
            why = f"time {how} at row {first + int(known[wrong])}, and the calibration follows a thermal lag"
            raise InputError(
                f"{why}: sort the log, or name a column of times that go on (--columns time=NAME)", file=name
            )
        last = float(block.values[time][known[-1]]) if len(known) else last
        first += len(block)
        yield block


def _locate_vector(log: LogReader, role: str, names: Sequence[str]) -> tuple[int, ...]:
    """Return where the three columns of an option such as ``--magnetometer`` stand."""
    where = locate_columns(log, names, {}, option=f"--{role} ")
    return tuple(where[name] for name in names)

"""From recorded data to a calibration: a log with its static intervals, given or found, or a table of positions."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import tiltcal
from tiltcal.calibration.calibrate import calibrate
from tiltcal.calibration.fit import NO_SENSITIVITY
from tiltcal.calibration.measurement import (
    BenchUncertainty,
    MeasuredSensor,
    Measurement,
    rails_of,
    require_no_jig,
    require_tilt,
)
from tiltcal.calibration.record import bases_of
from tiltcal.core.estimation.free import fit_free
from tiltcal.core.model import AXES
from tiltcal.core.ramp.record import RampRecord, ramp_record
from tiltcal.core.rounding import significant
from tiltcal.core.samples import SampleSummary
from tiltcal.drivers import find_model
from tiltcal.drivers.model import Model
from tiltcal.errors import EstimateError, InputError, UsageError
from tiltcal.files.calibration import UNKNOWN_MODEL, CalibrationRecord, SensorIdentity, read_calibration
from tiltcal.files.moments import stamp_of
from tiltcal.files.procedure import Procedure, find_procedure
from tiltcal.files.record import Record, keys_of
from tiltcal.files.results import FileRecord, LogRecord, Provenance, SegmentsRecord
from tiltcal.files.tables import (
    Segment,
    SegmentRow,
    TabledPosition,
    TabledRow,
    read_positions,
    read_segments,
    tabled_channels,
)
from tiltcal.logs.cf_attributes import spelt
from tiltcal.logs.columns import (
    TEMPERATURE,
    TIME,
    column_names,
    named_columns,
    require_celsius,
    require_unit,
)
from tiltcal.logs.formats import CSV, log_format, open_log
from tiltcal.logs.frames import FrameReader, rows_of
from tiltcal.logs.log import Progress
from tiltcal.logs.numbers import RecordedColumns, read_readings
from tiltcal.logs.options import FitOptions
from tiltcal.logs.positions import (
    SOAKS,
    TO_THE_END,
    Rails,
    StaticInterval,
    intervals_of,
    intervals_of_table,
    placed,
    require_positions,
)
from tiltcal.logs.still import WINDOWS, Judge, choice_table, find_still, judge_of
from tiltcal.logs.streams import sha256_of
from tiltcal.stated_arguments import require_name

R = TypeVar("R", LogRecord, FileRecord, SegmentsRecord)

FOUND_ONLY = "--window and --segments-out are for static intervals that are found: leave --segments and --table out"


def fit_recorded(
    procedure: str | Path,
    data: Any,
    options: FitOptions,
    progress: Progress | None = None,
) -> CalibrationRecord:
    """Calibrate a sensor from recorded data; arguments and errors are those of :func:`tiltcal.fit`."""
    steps = find_procedure(procedure, options["tilt"]).with_alignment(options["alignment"])
    steps.require_positions()
    table = _is_table(data, options["segments"]) if options["table"] is None else options["table"]
    source = FitSource(data, options["segments"], table, options["columns"], options["window"], progress)
    source.require_sound(steps)
    require_no_jig(steps, options["jig"])
    bench = BenchUncertainty(options["jig"], options["thermometer"], options["table_lean"], options["heading"])
    gravity, base, say = options["gravity"], options["base"], options["say"]
    model = find_model(options["sensor"]) if options["sensor"] else None
    if model is not None:
        require_tilt(steps, model)
    serial = _serial(options["serial"], base)
    known = bases_of(steps, base, [serial]).get(serial)
    own = None if known is None else known.calibration
    unit = options["unit"] or (source.header.unit if own is None and model is None else None)
    identity = _identity(own, model, steps, unit, serial)
    if own is None and model is None:
        identity = identity.replaced(channels=source.channels(steps, say))
    columns = {axis: name for axis, name in source.header.columns.items() if axis in identity.channels and name != axis}
    identity = identity.replaced(columns=columns or identity.columns)
    nominal = None if model is None or model.unit != identity.unit else model
    source = replace(source, rails=rails_of(identity.channels, nominal, own))
    source.require_unit(identity.unit)
    positions = source.ramp(identity, steps) if steps.ramp is not None else source.positions(identity, steps, say)
    for measurement in positions.measurements:
        if "left_out" in measurement.when:
            far = measurement.when["left_out"]
            which = "1 sample is" if far == 1 else f"{far} samples are"
            say(f"{measurement.position}: {which} far off the others or missing, and left out")
    measured = MeasuredSensor(
        identity,
        positions.measurements,
        nominal,
        thermometer=None if model is None else model.thermometer_rounding,
        base=own,
        ramp=positions.ramp,
    )
    (found,) = calibrate([measured], steps, bench, table=source.table, gravity=gravity)
    origin = None if known is None else known.origin
    return replace(found, provenance=positions.provenance.replaced(base=origin))


@dataclass(frozen=True)
class FitPositions:
    """The positions of recorded data, names and checksums of what was read, and of a ramp its continuous record."""

    measurements: Sequence[Measurement]
    provenance: Provenance
    ramp: RampRecord | None = None


@dataclass(frozen=True)
class LogHeader:
    """The column of each axis that a log has, and the unit that all of them state."""

    columns: Mapping[str, str] = field(default_factory=dict)
    unit: str | None = None


@dataclass(frozen=True)
class FitSource:
    """Recorded data as the user names them; the attributes are the arguments of :func:`tiltcal.fit`."""

    data: Any
    segments: Any
    table: bool
    columns: Mapping[str, str] | str
    window: int | None
    progress: Progress | None = None
    rails: Rails = field(default_factory=dict)

    def require_sound(self, procedure: Procedure) -> None:
        """Raise UsageError for what contradicts itself."""
        if self.table and self.segments is not None:
            raise UsageError("a --table has its positions already: leave --segments out")
        if self.table and self.columns:
            raise UsageError("a --table names its columns itself (position, x, y, z, ...): leave --columns out")
        if procedure.ramp is not None and self.table:
            raise UsageError(f"{procedure.name} takes a continuous record, not a --table of positions")
        if finds_intervals(procedure, self.table, self.segments):
            _judge(procedure, procedure.determines.axes or AXES)
        elif self.window is not None:
            raise UsageError(FOUND_ONLY)

    @property
    def _is_stream(self) -> bool:
        """Whether the log is read once."""
        if not isinstance(self.data, str | Path) or log_format(self.data) != CSV or os.path.isfile(self.data):
            return False
        return str(self.data) == "-" or os.path.exists(self.data)

    @cached_property
    def header(self) -> LogHeader:
        """What the log says of its readings before the first row; nothing of a table and of a stream."""
        if self.table or self._is_stream:
            return LogHeader()
        with open_log(self.data) as log:
            columns = column_names(log.names, AXES, named_columns(self.columns, AXES))
            if not columns and any("linear" in name.lower() for name in log.names):
                without = "it has linear acceleration, without gravity: record the acceleration with gravity"
                raise InputError(without, file=log.name, line=1)
            units = {
                spelt(log.unit(log.names.index(name)) or "")
                or ("g" if name.lower().startswith(("gf", "g-f")) else None)
                for name in columns.values()
            }
        return LogHeader(columns, units.pop() if len(units) == 1 else None)

    def require_unit(self, unit: str) -> None:
        """Raise InputError for a table in an xarray Dataset whose means are in another unit; a log is checked later."""
        if not (self.table and hasattr(self.data, "data_vars")):
            return
        table = FrameReader(self.data, name="the table")
        where = {name: index for index, name in enumerate(table.names)}
        means = [where[name] for axis in AXES for name in (axis, f"u{axis}") if name in where]
        require_unit(table, means, unit, "the --unit")
        require_celsius(table, where)

    def channels(self, procedure: Procedure, say: Callable[[str], None]) -> tuple[str, ...]:
        """Return the axes of a procedure that the data have a reading of: a sensor of two axes has no column z."""
        axes = procedure.determines.axes
        if procedure.determines.free or not axes or self._is_stream:
            return axes or AXES
        if self.table:
            found = tabled_channels(_path_or_rows(self.data, "the table", TabledRow), axes)
        else:
            named = named_columns(self.columns, axes)
            found = tuple(axis for axis in axes if axis in named or axis in self.header.columns)
        if not found:
            return axes
        absent = [axis for axis in axes if axis not in found]
        if absent:
            say(f"there is no {' and no '.join(absent)}: the sensor has {' and '.join(found)}")
        return found

    def positions(self, sensor: SensorIdentity, procedure: Procedure, say: Callable[[str], None]) -> FitPositions:
        """Return positions in the directions of a procedure or of the segments, or free ones.

        Names are checked before the log is read, which may be long, if the procedure has to say directions.
        """
        free, thermal = procedure.determines.free, procedure.determines.drift or procedure.determines.gain
        soak = (procedure.soak.thermometer or SOAKS * procedure.soak.seconds) if thermal else 0.0
        named: Sequence[Segment] | Sequence[TabledPosition] = ()
        if self.table:
            named = table = read_positions(_path_or_rows(self.data, "the table", TabledRow), sensor.channels)
        elif self.segments is not None:
            named = segments = read_segments(_path_or_rows(self.segments, "the segments", SegmentRow))
        if not free:
            require_positions(named, procedure, file=self._name)
        if self.table:
            intervals, provenance = intervals_of_table(table), self._provenance()
        else:
            origin = _origin(self.segments, SegmentsRecord)
            judge = _judge(procedure, sensor.channels) if self.segments is None else None
            record = self._record(sensor)
            if judge is not None:
                intervals, origin = self._found(record, sensor, judge, soak, say)
            else:
                if self.segments is None:  # the whole log is the one position
                    segments = [Segment(procedure.positions[0].name, 0, TO_THE_END, None, None)]
                file = record.name if self.segments is None else self._name
                intervals = intervals_of(record, sensor.channels, segments, self.rails, file=file, soak=soak)
            times = [interval.times for interval in intervals if interval.times is not None]
            provenance = self._provenance(record, origin, times)
        found = [interval.measurement for interval in intervals]
        return FitPositions(found if free else placed(intervals, procedure, file=self._name), provenance)

    def _found(
        self,
        record: RecordedColumns,
        sensor: SensorIdentity,
        judge: Judge,
        soak: float,
        say: Callable[[str], None],
    ) -> tuple[list[StaticInterval], SegmentsRecord]:
        """Return what the sensor read in the static intervals of a log, and how these were found."""
        windows = WINDOWS if self.window is None else (self.window,)
        chosen, tried = find_still(record.of(sensor.channels), windows, judge)
        say(choice_table(chosen, tried, sensor.unit))
        segments = chosen.segments
        intervals = intervals_of(record, sensor.channels, segments, self.rails, file=record.name, soak=soak)
        for interval, (x, y, z) in zip(intervals, chosen.directions.tolist(), strict=True):
            measured = interval.measurement
            rows = measured.when["rows"]
            first, last = (rows[0][0], rows[-1][1]) if isinstance(rows[0], tuple) else rows
            n = measured.summaries[sensor.channels[0]].n
            say(f"  {measured.position}: {n} of rows {first} to {last - 1}, up ({x:+.3f}, {y:+.3f}, {z:+.3f})")
        return intervals, SegmentsRecord(
            found="standard deviation in a window below a threshold",
            window_rows=chosen.window,
            threshold=significant(chosen.threshold, 4),
            times_noise=chosen.multiple,
        )

    def ramp(self, sensor: SensorIdentity, procedure: Procedure) -> FitPositions:
        """Return the continuous record of a ramp: the whole log, or the rows of its one segment."""
        segment = None
        if self.segments is not None:
            segment, *more = read_segments(_path_or_rows(self.segments, "the segments", SegmentRow))
            if more:
                raise InputError(
                    f"{procedure.name} takes one continuous record, and these are {1 + len(more)} segments: name the "
                    "first row and the last of the whole ramp",
                    file=self._name,
                )
        record = self._record(sensor, (TIME, TEMPERATURE))
        start, end = (0, len(record)) if segment is None else (segment.start, segment.end)
        if segment is not None and end > len(record):
            why = f"segment {segment.name} ends at row {end}, and the log has {len(record)}"
            raise InputError(why, file=record.name)
        *readings, temperature, time = (c[start:end] for c in record.of((*sensor.channels, TEMPERATURE, TIME)))
        ramp = ramp_record(time, temperature, readings, start)
        first = procedure.positions[0]
        gravity = first.gravity
        if segment is not None:
            known = {position.name: position.gravity for position in procedure.positions}
            gravity = segment.gravity or known.get(segment.name, gravity)
        attitude = Measurement(
            first.name if segment is None else segment.name,
            gravity,
            first.tilt if gravity == first.gravity else None,
            None,
            dict.fromkeys(sensor.channels, SampleSummary(0.0, 0.0, 1, 0.0)),
        )
        origin = _origin(self.segments, SegmentsRecord)
        missing = end - start - ramp.rows or None
        times = [(ramp.time[0], ramp.time[-1])]
        return FitPositions([attitude], self._provenance(record, origin, times, missing), ramp)

    @property
    def _name(self) -> str:
        """Where the positions are named, for messages."""
        if self.segments is not None:
            return str(self.segments) if isinstance(self.segments, str | Path) else "the segments"
        return str(self.data) if isinstance(self.data, str | Path) else "the table"

    def _record(self, sensor: SensorIdentity, others: Sequence[str] = ()) -> RecordedColumns:
        """Read the log."""
        named = named_columns(self.columns, sensor.channels)
        return read_readings(self.data, sensor.channels, named, sensor.unit, self.progress, others)

    def _provenance(
        self,
        record: RecordedColumns | None = None,
        segments: SegmentsRecord | None = None,
        times: Sequence[tuple[float, float]] = (),
        missing: int | None = None,
    ) -> Provenance:
        """Return what was read; ``times`` are those of the first and the last row of each interval, s."""
        log = None
        if record is not None and record.sha256 is not None:
            name = Path(self.data).name
            log = LogRecord(name=name, sha256=record.sha256, rows=len(record), missing=missing)
        return Provenance(
            made_by=f"fit of a {'table of positions' if self.table else 'recorded log'}",
            log=log,
            table=_origin(self.data, FileRecord) if self.table else None,
            segments=segments,
            software=f"tiltcal {tiltcal.__version__}",
            started=stamp_of(min(begin for begin, _ in times)) if times else None,
            ended=stamp_of(max(end for _, end in times)) if times else None,
        )


def finds_intervals(procedure: Procedure, table: bool | None, segments: Any) -> bool:
    """Return whether the static intervals of a log are to be found: of one position the whole log is taken."""
    several = procedure.determines.free or len(procedure.positions) > 1
    return several and procedure.ramp is None and not table and segments is None


def _judge(procedure: Procedure, channels: Sequence[str]) -> Judge | None:
    """Return what judges static intervals; None of one position. A UsageError where readings do not tell positions."""
    if procedure.determines.free:
        return fit_free
    if len(procedure.positions) == 1:
        return None
    gravity = {position.name: position.gravity for position in procedure.positions}
    judge = judge_of(gravity, channels) if procedure.determines.axes else None
    if judge is None:
        raise UsageError(
            "say with --segments which rows were taken in which position (or that LOG is a --table of positions): the "
            f"readings alone do not tell the positions of {procedure.name} apart"
        )
    return judge


def _serial(serial: str | None, base: str | Path | None) -> str:
    """The serial number that is named, or that of the base."""
    if serial is not None:
        require_name(serial, "the serial number")
        return serial
    if base is None or os.path.isdir(base):
        raise UsageError("state the sensor's --serial number")
    return read_calibration(base).sensor.serial


def _is_table(data: Any, segments: Any) -> bool:
    """Return whether a frame is one of positions."""
    if segments is not None or isinstance(data, str | Path):
        return False
    return "position" in FrameReader(data).names


def _path_or_rows(table: Any, name: str, row: type[Record]) -> str | Path | list[dict[str, Any]]:
    return table if isinstance(table, str | Path) else rows_of(table, name, keys_of(row))


def _origin(source: Any, record: type[R]) -> R | None:
    """Name and checksum of a file; None of a frame."""
    if not isinstance(source, str | Path):
        return None
    return record(name=Path(source).name, sha256=sha256_of(Path(source)))


def _identity(
    base: CalibrationRecord | None, model: Model | None, steps: Procedure, unit: str | None, serial: str
) -> SensorIdentity:
    """Return the identity of the sensor, and the unit of its readings."""
    if base is not None:
        for what, said, known in (
            ("--unit", unit, base.sensor.unit),
            ("--sensor", model and model.name, base.sensor.model),
        ):
            if said not in (None, known):
                raise UsageError(f"{what} {said} contradicts the --base, which has {known}: leave it out")
        return base.sensor
    if unit is None and model is None:
        raise UsageError("state the --unit of the readings (such as m/s2), or the --sensor model")
    if model is not None and unit not in (None, model.unit) and not steps.determines.axes:
        raise UsageError(
            f"{steps.name} takes the nominal sensitivity of {model.name}, which is per g in {model.unit} and not in "
            f"{unit}: name the model that reads {unit}, or leave --unit out"
        )
    if model is None and not (steps.determines.axes or steps.determines.free):
        raise EstimateError(f"{steps.name} {NO_SENSITIVITY}")
    channels = tuple(model.channels) if model else steps.determines.axes or ("x", "y", "z")
    unit = str(model and model.unit) if unit is None else unit
    for what, text in (("the serial number", serial), ("the unit", unit)):
        require_name(text, what)
    return SensorIdentity(model.name if model else UNKNOWN_MODEL, serial, unit, channels)

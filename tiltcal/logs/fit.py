"""From recorded data to a calibration: a log with its static intervals, given or found, or a table of positions."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

import tiltcal
from tiltcal.calibration.calibrate import calibrate
from tiltcal.calibration.measurement import BenchUncertainty, MeasuredSensor, Measurement, rails_of, require_tilt
from tiltcal.calibration.priors import SENSITIVITY_FROM
from tiltcal.calibration.record import bases_of
from tiltcal.column_guess import LENGTHS
from tiltcal.column_names import TEMPERATURE, TIME
from tiltcal.core.estimation.free import fit_free
from tiltcal.core.model import AXES, Array
from tiltcal.core.ramp.record import RampRecord, ramp_record
from tiltcal.core.rounding import significant
from tiltcal.core.samples import SampleSummary, even_step
from tiltcal.drivers.model import OF_G, Model
from tiltcal.errors import Argument, EstimateError, InputError, UsageError
from tiltcal.files.calibration import UNKNOWN_MODEL, CalibrationRecord, SensorIdentity, read_calibration
from tiltcal.files.device import model_named
from tiltcal.files.moments import stamp_of
from tiltcal.files.procedure import PositionProcedure, Ramp, find_procedure
from tiltcal.files.record import Record, keys_of
from tiltcal.files.results import FileRecord, Provenance, SegmentsRecord
from tiltcal.files.tables import Segment, SegmentRow, TabledRow, read_positions, read_segments, tabled_channels
from tiltcal.logs.columns import ReadingsHeader, named_columns, readings_header, require_units
from tiltcal.logs.frames import FrameReader, rows_of
from tiltcal.logs.log import Progress
from tiltcal.logs.options import FitOptions, Remark
from tiltcal.logs.positions import (
    Rails,
    Trimmed,
    intervals_of,
    intervals_of_table,
    placed,
    position_of,
    require_positions,
    soak_of,
    trimmed,
)
from tiltcal.logs.recordings import (
    Recordings,
    are_paths,
    length_remark,
    of_raw_readings,
    open_recordings,
    split_signs,
    unit_of_length,
    upside_down_remark,
    with_signs,
)
from tiltcal.logs.still import WINDOWS, Judge, find_still, judge_of
from tiltcal.logs.streams import sha256_of
from tiltcal.stated_arguments import require_name

R = TypeVar("R", FileRecord, SegmentsRecord)
IDLE = 1e-6  # gravity along an axis that differs by less between positions determines nothing, g
WEIGHTLESS = 0.5  # readings whose length is below this most of the time are without gravity, g
UNSTATED = "1"  # stands for a unit that nothing states yet; it fits all


def fit_recorded(
    procedure: str | Path, data: Any, options: FitOptions, progress: Progress | None = None
) -> CalibrationRecord:
    """Calibrate a sensor from recorded data; arguments and errors are those of :func:`tiltcal.fit`."""
    steps = find_procedure(procedure, options["tilt"]).with_alignment(options["alignment"]).in_positions()
    steps.require_usable(jig=options["jig"])
    data = data[0] if are_paths(data) and len(data) == 1 else data
    table = _is_table(data, options["segments"]) if options["table"] is None else options["table"]
    if table:
        _require_table_alone(data, steps, options)
    bench = BenchUncertainty(options["jig"], options["thermometer"], options["table_lean"], options["heading"])
    model = model_named(options["sensor"]) if options["sensor"] else None
    if model is not None:
        require_tilt(steps, model)
    serial = _serial(options["serial"], options["base"])
    known = bases_of(steps, options["base"], [serial]).get(serial)
    own, skip = None if known is None else known.calibration, options["skip_bad_rows"]
    with nullcontext() if table else open_recordings(data, skip_bad_rows=skip, progress=progress) as logs:
        header, options, signs = _header_of(logs, options)
        unknown = own is None and model is None
        if signs and not unknown:
            known_by = model.name if own is None and model is not None else "the base calibration"
            why = f"turns the sign of {' and '.join(signs)}, and what {known_by} says is of its readings as they are"
            raise UsageError(option="columns", why=why, advice="leave the minus out")
        unit = options["unit"] or (header.unit if unknown else None)
        by_length = unknown and unit is None and not steps.continuous and not header.units
        by_length = by_length and not (table and steps.known)
        identity = _identity(own, model, steps, UNSTATED if by_length else unit, serial)
        if unknown:
            identity = identity.replaced(channels=_channels(data, None if table else header, steps, options))
        columns = {axis: name for axis, name in header.columns.items() if axis in identity.channels and name != axis}
        identity = identity.replaced(columns=columns or identity.columns)
        nominal = None if model is None or model.unit != identity.unit else model
        if logs is None:
            positions = _of_table(data, identity, steps, options)
        elif isinstance(steps, Ramp):
            positions = _of_ramp(logs, identity, steps, options, signs)
        else:
            positions = _of_log(logs, identity, steps, options, rails_of(identity.channels, nominal, own), signs)
        if by_length:
            identity = _with_unit(identity, positions, options["say"])
        elif remark := length_remark(positions.lengths, identity.unit, positions.columns):
            options["say"](f"note: {remark}")
        for said in () if logs is None else logs.remarks:
            options["say"](f"note: {said}")
    steps = _without_idle_axes(steps, identity, positions.measurements, options["say"])
    measured = MeasuredSensor(
        identity,
        positions.measurements,
        nominal,
        thermometer_rounding=0.0 if model is None else model.thermometer_rounding,
        base=own,
        ramp=positions.ramp,
        attitude_stated=options["segments"] is not None,
        temperature_step=positions.temperature_step,
    )
    (found,) = calibrate([measured], steps, bench, table=table, gravity=options["gravity"], angles=options["angles"])
    found = replace(found, provenance=positions.provenance.replaced(base=None if known is None else known.origin))
    if positions.holds is not None and (note := positions.holds.not_credible):
        found = replace(found, fit=found.fit.replaced(notes=(*found.fit.notes, note)))
    if logs is not None and (remark := upside_down_remark(found)) and not signs:
        options["say"](f"note: {remark}")
    return of_raw_readings(found, signs)


def _header_of(logs: Recordings | None, options: FitOptions) -> tuple[ReadingsHeader, FitOptions, dict[str, float]]:
    """Return what the first log says of its readings, the options with its columns, and which of them are reversed."""
    if logs is None:
        return ReadingsHeader(), options, {}
    named, signs = split_signs(options["columns"], logs.logs[0].names)
    header = readings_header(logs.logs[0], named)
    if header.guessed:
        options["say"](f"{logs.name} has no names: its columns of numbers are taken for x, y and z")
    return header, {**options, "columns": {**header.guessed, **named}}, signs


def _without_idle_axes(
    steps: PositionProcedure, sensor: SensorIdentity, measurements: Sequence[Measurement], say: Remark
) -> PositionProcedure:
    """Return a procedure without the axes that a sensor has no channel of, and along which no position differs."""
    if not (steps.known and measurements):
        return steps
    reach = np.ptp([measurement.gravity for measurement in measurements], axis=0)
    idle = [axis for axis in steps.axes if axis not in sensor.channels and reach[AXES.index(axis)] < IDLE]
    if idle:
        say(f"no position tilts {' or '.join(idle)}: the sensitivity to it counts as zero")
    return replace(steps, axes=tuple(axis for axis in steps.axes if axis not in idle))


def _with_unit(sensor: SensorIdentity, positions: FitPositions, say: Remark) -> SensorIdentity:
    """Return the identity of a sensor with the unit in which gravity at rest is as long."""
    unit = None if positions.lengths is None else unit_of_length(positions.lengths, positions.columns)
    if unit is None:
        raise UsageError(
            ("state the ", Argument("unit"), " of the readings (such as m/s2), or the ", Argument("sensor"), " model"),
            advice="neither names nor the length of gravity at rest show it",
        )
    say(f"the unit is {unit}: at rest the readings are as long as gravity")
    return sensor.replaced(unit=unit, unit_from="length")


@dataclass(frozen=True)
class FitPositions:
    """The positions of recorded data, names and checksums of what was read, and of a ramp its continuous record.

    ``temperature_step`` is that of the thermometer, °C; 0 where it is continuous. ``lengths`` are the mean readings at
    rest, (n, channels), of the ``columns`` of a log; ``holds`` what is left of those that were found.
    """

    measurements: Sequence[Measurement]
    provenance: Provenance
    ramp: RampRecord | None = None
    temperature_step: float = 0.0
    lengths: Array | None = None
    columns: Sequence[Array] = ()
    holds: Trimmed | None = None


def _require_table_alone(data: Any, procedure: PositionProcedure, options: FitOptions) -> None:
    """Raise UsageError for what contradicts a table of positions."""
    if are_paths(data):
        raise UsageError(("a ", Argument("table"), f" is one file, and {len(data)} are given"), advice="name one")
    if options["segments"] is not None:
        why = ("a ", Argument("table"), " has its positions already")
        raise UsageError(why, advice=("leave ", Argument("segments"), " out"))
    if procedure.continuous:
        why = (f"{procedure.name} takes a continuous record, not a ", Argument("table"), " of positions")
        raise UsageError(why)


def _channels(
    data: Any, header: ReadingsHeader | None, procedure: PositionProcedure, options: FitOptions
) -> tuple[str, ...]:
    """Return the axes of a procedure that a log or a table has a reading of: a sensor of two axes has no column z."""
    axes = procedure.axes
    if not (procedure.known and axes):
        return axes or AXES
    if header is None:
        named = named_columns(options["columns"], AXES)
        found = tabled_channels(_path_or_rows(data, "the table", TabledRow), axes, named)
    else:
        found = tuple(axis for axis in axes if axis in {**named_columns(options["columns"], AXES), **header.columns})
    absent = [axis for axis in axes if axis not in found]
    if found and absent:
        options["say"](f"there is no {' and no '.join(absent)}: the sensor has {' and '.join(found)}")
    return found or axes


def _of_table(data: Any, sensor: SensorIdentity, procedure: PositionProcedure, options: FitOptions) -> FitPositions:
    """Return the positions that a table states, with their means."""
    if hasattr(data, "data_vars"):  # an xarray Dataset states units
        table = FrameReader(data, name="the table")
        where = {name: index for index, name in enumerate(table.names)}
        means = {name: sensor.unit for axis in AXES for name in (axis, f"u{axis}")}
        require_units(table, where, means, ("the ", Argument("unit")))
    file = str(data) if isinstance(data, str | Path) else "the table"
    free = not procedure.known
    rows = _path_or_rows(data, "the table", TabledRow)
    positions = read_positions(rows, sensor.channels, named_columns(options["columns"], AXES), unnamed=free)
    provenance = _provenance("table of positions", table=_origin(data, FileRecord))
    if free:
        lengths = np.array([[position.mean[channel] for channel in sensor.channels] for position in positions])
        found = [one.measurement for one in intervals_of_table(positions)]
        return FitPositions(found, provenance, lengths=lengths, columns=list(lengths.T))
    require_positions(positions, procedure, file=file)
    return FitPositions(placed(intervals_of_table(positions), procedure, file=file), provenance)


def _require_gravity(columns: Sequence[Array], unit: str) -> None:
    """Refuse three axes that are mostly far shorter than gravity, where their unit says how long that is."""
    usual = OF_G.get(unit)
    if usual is None or len(columns) < len(AXES):
        return
    length = float(np.nanmedian(np.linalg.norm(np.stack(columns), axis=0)))
    if length < WEIGHTLESS * usual and not any(low <= length <= high for low, high in LENGTHS.values()):
        raise EstimateError(
            f"the readings are {length:.2g} {unit} long at rest, and gravity is {usual:.3g} {unit}: gravity has been "
            "taken out of them. Record the acceleration with gravity, or state the unit that they are in"
        )


def _of_log(
    logs: Recordings,
    sensor: SensorIdentity,
    procedure: PositionProcedure,
    options: FitOptions,
    rails: Rails,
    signs: Mapping[str, float],
) -> FitPositions:
    """Return what the sensor read in the segments of a log, given or found; of one position it is the whole log.

    Names are checked before the log is read, which may be long.
    """
    given = options["segments"]
    file, judge, stated, say = logs.name, None, list[Segment](), options["say"]
    named = [Segment(name, 0, 0, None, None) for name in logs.positions if name is not None]
    if given is not None:
        if named:
            raise UsageError(option="segments", why="names positions, and the logs do (NAME=FILE): leave one out")
        file, stated = _segments(given)
    elif not named and len(procedure.positions) > 1:
        judge = _judge(procedure, sensor.channels)
    require_positions([*stated, *named], procedure, file=file)
    record, found = logs.read(sensor.channels, options["columns"], sensor.unit)
    record = with_signs(record, signs)
    origin, fewest, holds = _origin(given, SegmentsRecord), WINDOWS[-1], None
    if judge is not None:
        _require_gravity(record.of(sensor.channels), sensor.unit)
        chosen = find_still(record.of(sensor.channels), judge)
        found, fewest = chosen.segments, chosen.window
        say(chosen.in_words("" if sensor.unit == UNSTATED else f" {sensor.unit}"))
        origin = SegmentsRecord(
            found="standard deviation in a window below a threshold",
            window_rows=chosen.window,
            threshold=significant(chosen.threshold, 4),
            times_noise=chosen.multiple,
        )
    if found:
        holds = trimmed(record, sensor.channels, found, rails, fewest)
        stated, origin = [*holds.segments], _trimmed_origin(holds, origin, say)
        _require_held(procedure, holds, file)
    segments = stated or [Segment(procedure.positions[0].name, 0, len(record), None, None)]
    intervals = intervals_of(record, sensor.channels, segments, rails, file=file, soak=soak_of(procedure))
    for one in (interval.measurement for interval in intervals):
        if far := one.noted.get("left_out"):
            which = "1 sample is" if far == 1 else f"{far} samples are"
            say(f"{one.position}: {which} far off the others or missing, and left out")
    times = [interval.times for interval in intervals if interval.times is not None]
    provenance = _provenance("recorded log", times, **logs.provenance(record), segments=origin)
    measurements = placed(intervals, procedure, file=file)
    step = even_step(record.by_role[TEMPERATURE]) if TEMPERATURE in record.by_role else 0.0
    means = np.array([[one.summaries[channel].mean for channel in sensor.channels] for one in measurements])
    return FitPositions(measurements, provenance, None, step, means, record.of(sensor.channels), holds)


def _trimmed_origin(holds: Trimmed, origin: SegmentsRecord | None, say: Remark) -> SegmentsRecord | None:
    """Say what was trimmed and left out of the holds, and return where the segments come from with it."""
    for line in holds.in_words():
        say(line)
    if not (holds.left_out or holds.trimmed):
        return origin
    before = origin or SegmentsRecord(found="one log for each position")
    return before.replaced(holds=holds.holds, trimmed=holds.trimmed, left_out=holds.left_out)


def _require_held(procedure: PositionProcedure, holds: Trimmed, file: str) -> None:
    """Refuse a procedure of set positions of which one has no hold left, and any where none is left."""
    there = {segment.name for segment in holds.segments}
    reasons = [
        f"{name} ({why})"
        for name, why in holds.left_out.items()
        if not there or ((position := position_of(name)) in procedure.known and position not in there)
    ]
    if reasons:
        raise InputError(f"no hold is left in {', '.join(reasons)}: take it again", file=file)


def _of_ramp(
    logs: Recordings, sensor: SensorIdentity, procedure: Ramp, options: FitOptions, signs: Mapping[str, float]
) -> FitPositions:
    """Return the continuous record of a ramp: the whole log, or the rows of its one segment."""
    given, segment = options["segments"], None
    if given is not None:
        file, (segment, *more) = _segments(given)
        if more:
            why = (
                f"{procedure.name} takes one continuous record, and these are {1 + len(more)} segments: name the first"
            )
            raise InputError(f"{why} row and the last of the whole ramp", file=file)
    if len(logs.logs) > 1:
        raise UsageError(f"{procedure.name} takes one continuous record, and {len(logs.logs)} logs are given: name one")
    record, _ = logs.read(sensor.channels, options["columns"], sensor.unit, (TIME, TEMPERATURE))
    record = with_signs(record, signs)
    start, end = (0, len(record)) if segment is None else (segment.start, segment.end)
    if segment is not None and end > len(record):
        raise InputError(f"segment {segment.name} ends at row {end}, and the log has {len(record)}", file=record.name)
    *readings, temperature, time = (c[start:end] for c in record.of((*sensor.channels, TEMPERATURE, TIME)))
    ramp = ramp_record(time, temperature, readings, start)
    first = procedure.positions[0]
    gravity = first.gravity
    if segment is not None:
        gravity = segment.gravity or procedure.known.get(segment.name, first).gravity
    attitude = Measurement(
        first.name if segment is None else segment.name,
        gravity,
        first.tilt if gravity == first.gravity else None,
        None,
        dict.fromkeys(sensor.channels, SampleSummary(0.0, 0.0, 1, 0.0)),
    )
    read = logs.provenance(record, end - start - ramp.rows or None)
    times = [(ramp.time[0], ramp.time[-1])]
    segments = _origin(given, SegmentsRecord)
    return FitPositions([attitude], _provenance("recorded log", times, **read, segments=segments), ramp)


def _provenance(what: str, times: Sequence[tuple[float, float]] = (), **origins: Any) -> Provenance:
    """Return where a calibration came from; ``times`` are those of first and last row of each interval, s."""
    return Provenance(
        made_by=f"fit of a {what}",
        software=f"tiltcal {tiltcal.__version__}",
        started=stamp_of(min(begin for begin, _ in times)) if times else None,
        ended=stamp_of(max(end for _, end in times)) if times else None,
        **origins,
    )


def _segments(given: Any) -> tuple[str, list[Segment]]:
    """Return the name of a file of segments, for messages, and what it holds."""
    file = str(given) if isinstance(given, str | Path) else "the segments"
    return file, read_segments(_path_or_rows(given, "the segments", SegmentRow))


def _judge(procedure: PositionProcedure, channels: Sequence[str]) -> Judge:
    """Return what judges static intervals; a UsageError where readings do not tell the positions apart."""
    if not procedure.known:
        return fit_free
    gravity = {position.name: position.gravity for position in procedure.positions}
    judge = judge_of(gravity, channels) if procedure.axes else None
    if judge is None:
        raise UsageError(
            (
                "say with ",
                Argument("segments"),
                " which rows were taken in which position (or that LOG is a ",
                Argument("table"),
                " of positions): the readings alone do not tell the positions of ",
                f"{procedure.name} apart",
            )
        )
    return judge


def _serial(serial: str | None, base: str | Path | None) -> str:
    """The serial number that is named, or that of the base."""
    if serial is not None:
        require_name(serial, "the serial number")
        return serial
    if base is None or os.path.isdir(base):
        raise UsageError(("state the sensor's ", Argument("serial"), " number"))
    return read_calibration(base).sensor.serial


def _is_table(data: Any, segments: Any) -> bool:
    """Return whether a frame is one of positions."""
    if segments is not None or are_paths(data) or isinstance(data, str | Path):
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
    base: CalibrationRecord | None, model: Model | None, steps: PositionProcedure, unit: str | None, serial: str
) -> SensorIdentity:
    """Return the identity of the sensor, and the unit of its readings."""
    if base is not None:
        for what, said, known in (
            ("unit", unit, base.sensor.unit),
            ("sensor", model and model.name, base.sensor.model),
        ):
            if said not in (None, known):
                why = (f"{said} contradicts the ", Argument("base"), f", which has {known}")
                raise UsageError(option=what, why=why, advice="leave it out")
        return base.sensor
    if unit is None and model is None:
        raise UsageError(
            ("state the ", Argument("unit"), " of the readings (such as m/s2), or the ", Argument("sensor"), " model")
        )
    if model is not None and unit not in (None, model.unit) and not steps.axes:
        raise UsageError(
            f"{steps.name} takes the nominal sensitivity of {model.name}, which is per g in {model.unit} and not in "
            f"{unit}",
            advice=(f"name the model that reads {unit}, or leave ", Argument("unit"), " out"),
        )
    if model is None and not steps.axes:
        raise EstimateError(f"{steps.name} determines no sensitivity, and none is known", advice=SENSITIVITY_FROM)
    channels = tuple(model.channels) if model else steps.axes or AXES
    unit = str(model and model.unit) if unit is None else unit
    for what, text in (("the serial number", serial), ("the unit", unit)):
        require_name(text, what)
    return SensorIdentity(
        model.name if model else UNKNOWN_MODEL, serial, unit, channels, angles=None if model is None else model.angles
    )

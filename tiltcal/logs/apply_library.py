"""A folder of calibrations, applied to a log: for each row the calibration that holds at its time.

The time between two calibrations is divided into 64 steps, each with a compensation of its own. Within a step all
coefficients follow their line row by row, so that nothing jumps: offset and temperature drift exactly, the others as
:mod:`tiltcal.logs.step_change` says.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import inf
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from tiltcal.calibration.calibration import Calibration
from tiltcal.calibration.calibration_library import calibration_at
from tiltcal.calibration.interpolation import Interval
from tiltcal.calibration.summary import objections
from tiltcal.core.flags import NO_TEMPERATURE, OUTSIDE_TIME, SUSPECT, mark_columns
from tiltcal.core.model import Array, polynomial
from tiltcal.core.named_coefficients import referred, values
from tiltcal.errors import InputError, UsageError
from tiltcal.files.moments import LEAST_SECONDS, MOST_SECONDS, moment
from tiltcal.files.uncertainty import Uncertainty, length_tolerance
from tiltcal.logs.columns import TEMPERATURE, TIME, SensorColumns, named_columns
from tiltcal.logs.compensation_kernel import Kernel, LagCorrection, RoleValues
from tiltcal.logs.log import LogReader, Table
from tiltcal.logs.prepared_calibration import ApplyOptions, PreparedCalibration, prepare
from tiltcal.logs.step_change import StepChange
from tiltcal.logs.streams import sha256_of
from tiltcal.logs.text_to_numbers import no_time_yet

if TYPE_CHECKING:
    from tiltcal.calibration.calibration_library import CalibrationLibrary
    from tiltcal.calibration.interpolation import Stability
    from tiltcal.calibration.sensor_history import SensorHistory
    from tiltcal.files.calibration import CalibrationRecord

T = TypeVar("T")

STEPS = 64
"""Of the time between two calibrations, where more than offset and drift changes, or an uncertainty is asked for."""

SERIAL_NOTES = ("serial", "serial_number", "sensor_serial_number", "instrument_serial_number")
"""The attributes or metadata of a log that may state its sensor."""

_ON_LINE = ("offset", "temperature.offset")
_MOST_PIECES = 1000  # of a block, compensated one by one
_OUTSIDE = 1 << 16  # steps before the first calibration and after the last one are counted from here
_GROWTH = 8  # steps of the time outside, for each doubling of it


def prepare_library(
    library: CalibrationLibrary,
    log: LogReader,
    options: ApplyOptions,
    columns: Mapping[str, str] | str = "",
    say: Callable[[str], None] = lambda line: None,
) -> PreparedCalibration:
    """Find the calibrations of a log's sensors and make them ready.

    UsageError: the log and the options do not name a sensor of the folder, or name different ones.
    InputError: a calibration is wrong, or two contradict each other.
    """
    start = None if options.start is None else moment(options.start).timestamp()
    for problem in library.index.problems:
        say(f"note: left out: {problem}")
    found = _serials(library, log, options, say)
    leads = [lead for _, lead in found]
    parts = []
    for history in [library.history(serial) for serial, _ in found]:
        for remark in history.remarks:
            say(f"note: {remark}")
        for calibration in history.calibrations[:-1]:
            for objection in objections(calibration.record):
                say(f"note: {calibration.name}: {objection}")
        stability = library.stability(history.sensor.serial, options.stability) if options.uncertainty else None
        _say_stability(history, stability, say)
        parts.append(_prepare_sensor(history, stability, options, start, log.name, say))
    others = parts[0].roles
    named = named_columns(columns, [name for part in parts for name in part.channels], others)
    roles = others if start is not None and named.get(TIME, TIME) not in log.names else (TIME, *others)
    if leads == [""]:
        return replace(parts[0], roles=roles)
    return _bench(leads, parts, log.names, roles)


def _serials(
    library: CalibrationLibrary, log: LogReader, options: ApplyOptions, say: Callable[[str], None]
) -> list[tuple[str, str]]:
    """Return the serial number of each sensor of a log, and what the names of its columns begin with."""
    noted = next((str(log.notes[key]) for key in SERIAL_NOTES if key in log.notes), None)
    serial = options.serial
    if serial and noted and serial != noted:
        raise UsageError(f"{log.name} states the serial number {noted!r}, and --serial says {serial!r}: leave one out")
    if serial or noted:
        found = str(serial or noted)
        return [(found, f"{found}_" if f"{found}_x" in log.names or f"{found}_y" in log.names else "")]
    columns = {name[:-2] for name in log.names if name[-2:] in ("_x", "_y", "_z")}
    known = [
        serial for serial in dict.fromkeys(name[:-2] for name in log.names) if serial in columns & {*library.serials}
    ]
    if known:
        for other in sorted(columns - {*known}):
            say(f"note: {library.folder} has no calibration of {other!r}: its columns are left as they are")
        return [(serial, f"{serial}_") for serial in known]
    if len(library.serials) == 1 and not columns:
        say(f"note: {log.name} names no sensor; {library.folder} has calibrations of {library.serials[0]} alone")
        return [(library.serials[0], "")]
    listed = ", ".join(library.serials[:12]) + (" ..." if len(library.serials) > 12 else "")
    raise UsageError(
        f"{log.name} names no sensor of {library.folder}: name it with --serial; the folder has calibrations of "
        f"{listed or 'none'}"
    )


def _say_stability(history: SensorHistory, stability: Stability | None, say: Callable[[str], None]) -> None:
    if stability is None:
        return
    serial, coefficients = history.sensor.serial, history.calibrations[-1].record.coefficients
    if stability.rate:
        walks = ", ".join(
            f"{c} {1000.0 * stability.rate[f'offset.{c}'] ** 0.5 / abs(coefficients.own_sensitivity(c)):.2g}"
            for c in coefficients.channels
        )
        say(f"note: the offset of {serial} wanders by {walks} mg/√d, as stated")
    elif len(history.calibrations) == 1:
        say(
            f"note: how far {serial} wanders is unknown, because it has one calibration: the uncertainty is that of "
            "this alone (--stability)"
        )
    else:
        say(
            f"note: how far {serial} wanders is not stated (--stability): half of its change between two calibrations "
            "counts"
        )


def _prepare_sensor(
    history: SensorHistory,
    stability: Stability | None,
    options: ApplyOptions,
    start: float | None,
    log: str,
    say: Callable[[str], None],
) -> PreparedCalibration:
    calibrations = history.calibrations
    origin = {
        "calibration": ", ".join(calibration.name for calibration in calibrations),
        "sha256": ", ".join(sha256_of(calibration.path) for calibration in calibrations),
    }
    template = prepare(Calibration(calibrations[-1].record), options, say, origin=origin)
    kernel = LibraryKernel(history, stability, options, template, start, log)
    alone = ApplyOptions(options.first_order, mounting=options.mounting)
    readings = template.readings and _prepare_sensor(history, None, alone, start, log, lambda line: None)
    return replace(template, kernel=kernel, readings=readings)


class LibraryKernel:
    """The compensation of a sensor by the calibration that holds at the time of each row.

    Parameters
    ----------
    stability : Stability or None
        None where no uncertainty is asked for.
    template : PreparedCalibration
        The last calibration: each compensation gives its columns, and adds to its remarks.
    start : float or None
        When the time of the log is 0, seconds since 1970; None where its time counts from 1970.
    """

    def __init__(
        self,
        history: SensorHistory,
        stability: Stability | None,
        options: ApplyOptions,
        template: PreparedCalibration,
        start: float | None,
        log: str,
    ) -> None:
        self.columns, self._remarks = template.kernel.columns, template.remarks[""]
        records = [calibration.record for calibration in history.calibrations]
        self._length = max(length_tolerance(one.uncertainty, one.coefficients, one.limits) for one in records)
        if not options.uncertainty:
            history = _each(history, lambda record: replace(record, uncertainty=Uncertainty({}, {})))
        if options.mounting:  # it replaces that of each
            history = _mounted_as_last(history)
        self._history, self._stability, self._options = history, stability, options
        self._offset_alone = _moves_offset_alone(history)
        self._parts = 1 if not options.uncertainty and self._offset_alone else STEPS
        self._start, self._log = start, log
        channels = history.calibrations[-1].record.coefficients.channels
        rails = Calibration(history.calibrations[-1].record).limits.reading
        self._rails = {channel: rails.get(channel, (-inf, inf)) for channel in channels}
        self._dates = np.array([calibration.date.timestamp() for calibration in history.calibrations])
        self._kernels: dict[int, tuple[Kernel, float]] = {}
        self._changes: dict[int, StepChange] = {}
        self._intervals: dict[int, Interval] = {}
        self._last: float | None = None
        thermal = history.calibrations[-1].record.coefficients.thermal
        self._correct_lag = LagCorrection(0.0 if thermal is None else thermal.lag)

    def __call__(self, values: RoleValues) -> Table:
        time = self._times(values)
        steps = self._steps(time)
        values, lost = self._correct_lag(replace(values, time=time))
        table = self._compensated(values, time, steps)
        return table if lost is None else mark_columns(table, lost, SUSPECT, NO_TEMPERATURE)

    def _compensated(self, values: RoleValues, time: Array, steps: NDArray[np.int64]) -> Table:
        changes = np.diff(steps)
        if np.count_nonzero(changes) > _MOST_PIECES and (changes < 0).any():  # the rows are in no order
            order = np.argsort(steps, kind="stable")
            table = self._compensated(_taken(values, order), time[order], steps[order])
            return {name: column[np.argsort(order)] for name, column in table.items()}
        ends = [0, *(np.flatnonzero(changes) + 1).tolist(), len(steps)]
        parts = []
        for begin, end in pairwise(ends):
            rows, step = slice(begin, end), int(steps[begin])
            table = self._of_step(step, _taken(values, rows), time[rows])
            parts.append(table if 0 <= step <= _OUTSIDE else mark_columns(table, np.True_, SUSPECT, OUTSIDE_TIME))
        if len(parts) == 1:
            return parts[0]
        return {name: np.concatenate([part[name] for part in parts]) for name in self.columns}

    def _times(self, values: RoleValues) -> Array:
        """Return the time of each row, seconds since 1970.

        A row without one has that of the row before, and rows before the first time have that.
        """
        if values.time is None:
            return np.full(len(values), self._start or 0.0)
        time = np.asarray(values.time, dtype=float) + (self._start or 0.0)
        known = np.isfinite(time)
        if known.any():
            first = float(time[known.argmax()])
            if self._start is not None and first - self._start > LEAST_SECONDS:
                raise InputError(
                    "the times are dates, or count seconds since 1970: leave out --start, which is for times that "
                    "count from the beginning of the log",
                    file=self._log,
                )
            if not LEAST_SECONDS < first < MOST_SECONDS:
                raise InputError(
                    f"the time {first:g} is not a date and no count of seconds since 1970: state when the log began "
                    "with --start, such as --start 2026-05-01T12:00:00Z",
                    file=self._log,
                )
        elif self._last is None and np.isfinite(values.readings).any():
            raise InputError(no_time_yet(len(time), "which calibration they take"), file=self._log)
        else:
            first = float(self._dates[-1])  # of rows without readings
        if not known.all():
            place = np.maximum.accumulate(np.where(known, np.arange(len(time)), -1))
            time = np.where(place < 0, first if self._last is None else self._last, time[place])
        if known.any() or self._last is not None:
            self._last = float(time[-1])
        return time

    def _steps(self, time: Array) -> NDArray[np.int64]:
        """Return the number of the step in which each row lies; below 0 before the first calibration."""
        low, high = float(time.min()), float(time.max())
        dates = self._dates
        k = int(np.searchsorted(dates, low, "right")) - 1
        if 0 <= k < len(dates) - 1 and high < dates[k + 1]:  # the usual log
            share = (time - dates[k]) * (self._parts / (dates[k + 1] - dates[k]))
            return np.asarray(k * self._parts + share.astype(np.int64))
        position = np.interp(time, dates, np.arange(len(dates)) * float(self._parts))
        steps: NDArray[np.int64] = np.minimum(position.astype(np.int64), max(0, len(dates) - 1) * self._parts - 1)
        early, late = time < dates[0], time > dates[-1]
        steps[early] = -1 - self._grown(dates[0] - time[early])
        steps[late] = _OUTSIDE + self._grown(time[late] - dates[-1])
        if len(dates) == 1:  # one calibration has no step; its own moment is no time outside
            steps[~early & ~late] = _OUTSIDE
        return steps

    def _grown(self, seconds: Array) -> NDArray[np.int64]:
        """Return how far outside a row lies, in steps that grow with it; all alike without an uncertainty."""
        if self._stability is None:
            return np.ones(len(seconds), np.int64)
        return np.asarray(np.ceil(_GROWTH * np.log2(1.0 + seconds / 3600.0)), np.int64)

    def _of_step(self, step: int, values: RoleValues, time: Array) -> Table:
        if step not in self._kernels:
            middle = self._middle(step)
            record = _without_lag(self._record_at(step, middle))
            # With them stated, nothing looks for the sensor's model in each step.
            record = replace(record, limits=replace(record.limits, reading=self._rails, length=self._length))
            self._kernels[step] = prepare(Calibration(record), self._options, remarks=self._remarks).kernel, middle
        kernel, middle = self._kernels[step]
        if 0 <= step < _OUTSIDE:
            shifted = self._on_line(step // self._parts, values, time - middle)
            if not self._offset_alone:
                shifted -= self._change(step, replace(values, readings=shifted), time - middle)
            values = replace(values, readings=self._at_rail(values.readings, shifted))
        return kernel(values)

    def _record_at(self, step: int, middle: float) -> CalibrationRecord:
        if not 0 <= step < _OUTSIDE:
            return calibration_at(self._history, middle, self._stability).record
        k, part = divmod(step, self._parts)
        if k not in self._intervals:
            self._intervals[k] = self._history.interval(k)
        return self._intervals[k].at((part + 0.5) / self._parts, self._stability)

    def _middle(self, step: int) -> float:
        """Return the time for which the compensation of a step is made, seconds since 1970."""
        if 0 <= step < _OUTSIDE:
            k, part = divmod(step, self._parts)
            return float(self._dates[k] + (part + 0.5) / self._parts * (self._dates[k + 1] - self._dates[k]))
        grown = (step - _OUTSIDE) if step >= _OUTSIDE else -1 - step
        seconds = 3600.0 * (2.0 ** (grown / _GROWTH) - 1.0)
        return float(self._dates[-1] + seconds if step >= _OUTSIDE else self._dates[0] - seconds)

    def _on_line(self, k: int, values: RoleValues, seconds: Array) -> Array:
        """Return the readings less what offset and drift have changed since the middle of the step."""
        before, after = (self._history.calibrations[i].record for i in (k, k + 1))
        late = after.coefficients
        early = before.coefficients if late.thermal is None else referred(before.coefficients, late.thermal.reference)
        share = seconds / (self._dates[k + 1] - self._dates[k])
        shifted = np.empty(values.readings.shape[::-1]).T
        for i, reading in enumerate(values.readings.T):
            change: Array | float = float(late.offset[i] - early.offset[i])
            if late.thermal is not None and early.thermal is not None and values.temperature is not None:
                drifts = late.thermal.drift[i], early.thermal.drift[i]
                if not np.array_equal(*drifts):
                    dt = np.where(np.isfinite(values.temperature), values.temperature - late.thermal.reference, 0.0)
                    change = change + polynomial(drifts[0], dt) - polynomial(drifts[1], dt)
            np.multiply(share, change, out=shifted[:, i])
            np.subtract(reading, shifted[:, i], out=shifted[:, i])
        return shifted

    def _change(self, step: int, values: RoleValues, seconds: Array) -> Array:
        """Return what all but offset and drift have changed of the readings since the middle of the step."""
        k, part = divmod(step, self._parts)
        if step not in self._changes:
            shares = [(part + share) / self._parts for share in (0.0, 0.5, 1.0)]
            self._changes[step] = StepChange.of(*map(self._intervals[k].coefficients, shares))
        share = seconds * (self._parts / (self._dates[k + 1] - self._dates[k]))
        return np.asarray(self._changes[step](values.readings, values.temperature) * share[:, None])

    def _at_rail(self, readings: Array, shifted: Array) -> Array:
        """Return shifted readings, of which those stay as they are that are at the rail."""
        for i, rails in enumerate(self._rails.values()):
            if rails == (-inf, inf):
                continue
            stuck = (readings[:, i] <= rails[0]) | (readings[:, i] >= rails[1])
            if stuck.any():
                shifted[stuck, i] = readings[stuck, i]
        return shifted


def _each(history: SensorHistory, change: Callable[[CalibrationRecord], CalibrationRecord]) -> SensorHistory:
    calibrations = (replace(calibration, record=change(calibration.record)) for calibration in history.calibrations)
    return replace(history, calibrations=tuple(calibrations))


def _mounted_as_last(history: SensorHistory) -> SensorHistory:
    mounting = history.calibrations[-1].record.coefficients.mounting
    return _each(history, lambda record: replace(record, coefficients=replace(record.coefficients, mounting=mounting)))


def _moves_offset_alone(history: SensorHistory) -> bool:
    """Return whether calibrations differ in offset and drift alone, as after ``level``: rows follow these."""
    last = history.calibrations[-1].record.coefficients
    reference = None if last.thermal is None else last.thermal.reference
    kept = []
    for calibration in history.calibrations:
        coefficients = calibration.record.coefficients
        if reference is not None and coefficients.thermal is not None:
            coefficients = referred(coefficients, reference)
        known = {name: value for name, value in values(coefficients).items() if not name.startswith(_ON_LINE)}
        kept.append((known, coefficients.mounting, coefficients.axes))
    return all(calibration == kept[-1] for calibration in kept)


def _without_lag(record: CalibrationRecord) -> CalibrationRecord:
    """Return a calibration whose thermal lag is left to the temperatures, which go on from one step to the next."""
    coefficients = record.coefficients
    if coefficients.thermal is None or not coefficients.thermal.lag:
        return record
    thermal = replace(coefficients.thermal, lag=0.0)
    return replace(record, coefficients=replace(coefficients, thermal=thermal))


@dataclass(frozen=True)
class BenchKernel:
    """The compensation of several sensors whose readings stand side by side in one log.

    Attributes
    ----------
    parts : sequence of (SensorColumns, Kernel)
        Where the columns of each sensor stand among the readings, and its compensation.
    """

    parts: Sequence[tuple[SensorColumns, Kernel]]
    columns: tuple[str, ...]

    def __call__(self, values: RoleValues) -> Table:
        table = {}
        own = values.readings.T
        for number, (sensor, kernel) in enumerate(self.parts):
            part = replace(
                values,
                readings=own[list(sensor.readings)].T,
                temperature=values.temperature if sensor.thermometer is None else own[sensor.thermometer],
                count=None if values.count is None else values.count[:, number],
            )
            table.update({f"{sensor.lead}{name}": column for name, column in kernel(part).items()})
        return table


def _bench(
    leads: Sequence[str], parts: Sequence[PreparedCalibration], names: Sequence[str], roles: tuple[str, ...]
) -> PreparedCalibration:
    """Return the calibrations of several sensors as one; ``leads`` are what the names of their columns begin with."""
    kernels: list[tuple[SensorColumns, Kernel]] = []
    readings = [part.readings for part in parts if part.readings is not None]
    channels: list[str] = []
    for lead, part in zip(leads, parts, strict=True):
        first = len(channels)
        channels += [f"{lead}{channel}" for channel in part.channels]
        own = tuple(range(first, len(channels)))
        thermometer = f"{lead}{TEMPERATURE}"
        if thermometer in names:
            channels.append(thermometer)
        columns = SensorColumns(lead, own, len(channels) - 1 if thermometer in names else None)
        kernels.append((columns, part.kernel))

    def led(wanted: Callable[[PreparedCalibration], Sequence[str]]) -> tuple[str, ...]:
        return tuple(f"{lead}{name}" for lead, part in zip(leads, parts, strict=True) for name in wanted(part))

    def led_values(wanted: Callable[[PreparedCalibration], Mapping[str, T]]) -> dict[str, T]:
        return {
            f"{lead}{name}": value
            for lead, part in zip(leads, parts, strict=True)
            for name, value in wanted(part).items()
        }

    return PreparedCalibration(
        BenchKernel(kernels, led(lambda part: part.kernel.columns)),
        tuple(channels),
        led_values(lambda part: part.units),
        led(lambda part: part.angles),
        led(lambda part: part.watched),
        {
            "software": parts[0].origin["software"],
            **{key: ", ".join(part.origin[key] for part in parts) for key in ("calibration", "sha256", "serial")},
        },
        roles,
        vectors=parts[0].vectors,
        averaging=parts[0].averaging,
        sensors=tuple(columns for columns, _ in kernels),
        lagged=any(part.lagged for part in parts),
        readings=_bench(leads, readings, names, roles) if len(readings) == len(parts) else None,
        remarks=led_values(lambda part: part.remarks),
    )


def _taken(values: RoleValues, rows: slice | NDArray[np.intp]) -> RoleValues:
    """Return some of the rows."""
    if isinstance(rows, slice) and rows == slice(0, len(values)):
        return values
    return replace(values, **{name: column[rows] for name, column in vars(values).items() if column is not None})

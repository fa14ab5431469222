"""A folder of calibrations, applied to a log: for each row the calibration that holds at its time.

Between two calibrations gravity is interpolated from what both make of a row, and the angles follow from it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from math import cos, inf, isnan, nan, radians
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tiltcal.calibration.record import limits_of, stated_mounting
from tiltcal.calibration.season import CalibrationFolder, SensorHistory
from tiltcal.calibration.stated import length_tolerance
from tiltcal.calibration.wording import objections
from tiltcal.column_names import TIME
from tiltcal.core.attitude import mounting_matrix
from tiltcal.core.earth_frame import HEADING, full_circle
from tiltcal.core.flags import OUTSIDE_TIME, SUSPECT, mark_columns
from tiltcal.core.model import Array, Mounting
from tiltcal.core.tilt_angles import DIRECTIONS, tilt, tilts_of_three
from tiltcal.errors import Argument, InputError, Parts, UsageError
from tiltcal.files.moments import LEAST_SECONDS, MOST_SECONDS, moment
from tiltcal.logs.columns import named_columns
from tiltcal.logs.kernel import (
    Kernel,
    PreparedCalibration,
    PreparedSensor,
    RoleValues,
    RowRemarks,
    prepare,
    tilt_kernel,
)
from tiltcal.logs.log import LogReader, Table
from tiltcal.logs.numbers_and_times import no_time_yet
from tiltcal.logs.options import ApplyOptions, silent
from tiltcal.logs.streams import sha256_of
from tiltcal.stated_arguments import require_from_zero

FARTHEST_TURN = 5.0  # degrees by which two mountings may differ to have others between them
STEPS = 64  # of the time between two calibrations, each with an uncertainty of its own
SERIAL_NOTES = ("serial", "serial_number", "sensor_serial_number", "instrument_serial_number")
"""The attributes or metadata of a log that may state its sensor."""

_GROWTH, _DOUBLINGS = 8, 20  # steps of the time outside for each doubling of it, from an hour to 120 years


def prepare_library(library: CalibrationFolder, log: LogReader, options: ApplyOptions) -> PreparedCalibration:
    """Find the calibrations of a log's sensors and make them ready."""
    say = options["say"]
    require_from_zero("stability", options["stability"])
    start = None if options["start"] is None else moment(options["start"]).timestamp()
    for problem in library.index.problems:
        say(f"note: left out: {problem}")
    prepared: list[PreparedCalibration] = []
    sensors = []
    for serial, lead in _serials(library, log, options):
        history = library.history(serial)
        for calibration in history.calibrations[:-1]:
            for objection in objections(calibration.record):
                say(f"note: {calibration.name}: {objection}")
        if options["uncertainty"] and options["stability"] is None:
            count, suggested = len(history.calibrations), f"{history.suggested_stability():.2g}"
            shows = f"its {count} calibrations show {suggested} mg in a day, which counts"
            if count == 2:
                shows = f"its whole change between two calibrations counts, which suggests {suggested}"
            shows = "no wandering counts" if count == 1 else shows
            say(f"note: how far {serial} wanders is not stated (--stability): {shows}")
        origin = {
            "calibration": ", ".join(calibration.name for calibration in history.calibrations),
            "sha256": ", ".join(sha256_of(calibration.path) for calibration in history.calibrations),
        }
        prepared.append(prepare(history.calibrations[-1].record, options, origin=origin))
        (last,) = prepared[-1].sensors
        sensors.append(replace(last, kernel=LibraryKernel(history, options, last, start, log.name), lead=lead))
    whole = replace(prepared[0], sensors=tuple(sensors))
    named = named_columns(options["columns"], whole.channels, whole.roles)
    needs_time = start is None or named.get(TIME, TIME) in log.names
    return replace(whole, roles=(TIME, *whole.roles)) if needs_time else whole


def _serials(library: CalibrationFolder, log: LogReader, options: ApplyOptions) -> list[tuple[str, str]]:
    """Return the serial number of each sensor of a log, and what the names of its columns begin with."""
    noted = next((str(log.notes[key]) for key in SERIAL_NOTES if key in log.notes), None)
    serial, say = options["serial"], options["say"]
    if serial and noted and serial != noted:
        why = (f"{log.name} states the serial number {noted!r}, and ", Argument("serial"), f" says {serial!r}")
        raise UsageError(why, advice="leave one out")
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
    raise UsageError(
        f"{log.name} names no sensor of {library.folder}",
        advice=("name it with ", Argument("serial"), f"; the folder has calibrations of {library.listed}"),
    )


class LibraryKernel:
    """The compensation of a sensor by the calibrations before and after each row.

    Between two, gravity is interpolated from what both make of a row; the worse flag counts. Before the first and after
    the last, and of different mountings, the nearer in time is taken. An uncertainty is that of the calibration at the
    middle of a step, of which there are 64 between two. ``last`` is the last calibration, whose columns each gives;
    ``start`` is when the time of the log is 0, seconds since 1970.
    """

    def __init__(
        self, history: SensorHistory, options: ApplyOptions, last: PreparedSensor, start: float | None, log: str
    ) -> None:
        self.columns = last.added
        self._remarks = last.remarks if last.judge is None else RowRemarks()
        self._options: ApplyOptions = {**options, "say": silent}
        self._plain: ApplyOptions = {**self._options, "uncertainty": False}
        self._start, self._log = start, log
        records = [one.record for one in history.calibrations]
        if options["mounting"]:  # it replaces that of each
            mounting = stated_mounting(options["mounting"])
            records = [one.with_mounting(mounting) for one in records]
        self._length = max(map(length_tolerance, records))
        rails = limits_of(records[-1]).reading
        self._rails = {channel: rails.get(channel, (-inf, inf)) for channel in last.channels}
        dated = zip(history.calibrations, records, strict=True)
        self._history = replace(history, calibrations=tuple(replace(one, record=record) for one, record in dated))
        self._dates = np.array([calibration.date.timestamp() for calibration in history.calibrations])
        self._joined = [_joined(self._history, k) for k in range(len(records) - 1)]
        edges = _steps(self._dates) if options["uncertainty"] else self._dates
        middles = [self._dates[k : k + 2].mean() for k, joined in enumerate(self._joined) if not joined]
        self._edges = np.unique([*edges, *middles])
        self._kernels: dict[tuple[float, bool, bool], Kernel] = {}
        self._last = nan  # time of the last row before, s

    def __call__(self, values: RoleValues) -> Table:
        time = self._times(values)
        steps = np.searchsorted(self._edges, time, "right")
        order = np.argsort(steps, kind="stable")
        pieces = np.split(order, np.flatnonzero(np.diff(steps[order])) + 1)
        if len(pieces) == 1:  # the usual block of a log
            table: Table = self._of_step(int(steps[0]), values, time)
        else:
            tables = [self._of_step(int(steps[rows[0]]), _taken(values, rows), time[rows]) for rows in pieces]
            back = np.argsort(order)
            table = {name: np.concatenate([table[name] for table in tables])[back] for name in self.columns}
        return mark_columns(table, (time < self._dates[0]) | (time > self._dates[-1]), SUSPECT, OUTSIDE_TIME)

    def _of_step(self, step: int, values: RoleValues, time: Array) -> Table:
        """Return the columns of rows that lie between two edges."""
        dates = self._dates
        edges = np.array([self._edges[0] - 2.0, *self._edges, self._edges[-1] + 2.0])
        middle = float(edges[step] + edges[step + 1]) / 2.0
        k = int(np.searchsorted(dates, middle, "right")) - 1
        if not 0 <= k < len(dates) - 1:
            return self._kernel(middle)(values)
        if not self._joined[k]:
            return self._kernel(float(dates[k] if middle - dates[k] < dates[k + 1] - middle else dates[k + 1]))(values)
        share = (time - dates[k]) / (dates[k + 1] - dates[k])
        before = self._kernel(float(dates[k]), plain=True)(values)
        table = _interpolated(before, self._kernel(float(dates[k + 1]), plain=True, counts=False)(values), share)
        if self._options["uncertainty"]:
            table |= {name: u for name, u in self._kernel(middle, counts=False)(values).items() if name not in table}
        return {name: table[name] for name in self.columns}

    def _kernel(self, time: float, *, plain: bool = False, counts: bool = True) -> Kernel:
        """Return the compensation by the calibration of a time: without uncertainty, and counted for the remarks."""
        if (key := (time, plain, counts)) not in self._kernels:
            dated = [one.record for one in self._history.calibrations if one.date.timestamp() == time]
            record = dated[0] if dated else self._history.at(time, self._options["stability"])
            # With them stated, nothing looks for the sensor's model in each step.
            record = replace(record, limits=replace(record.limits, reading=self._rails, length=self._length))
            options, remarks = self._plain if plain else self._options, self._remarks if counts else RowRemarks()
            self._kernels[key] = tilt_kernel(record, options, remarks)
        return self._kernels[key]

    def _times(self, values: RoleValues) -> Array:
        """Return the time of each row, seconds since 1970.

        A row without one has that of the row before, and rows before the first time have that.
        """
        begin = self._start or 0.0
        if values.time is None:
            return np.full(len(values), begin)
        time = values.time + begin
        known = np.isfinite(time)
        if not known.any():
            if isnan(self._last) and np.isfinite(values.readings).any():
                raise InputError(no_time_yet(len(time), "which calibration they take"), file=self._log)
            return np.full(len(time), self._last)
        first = float(time[known.argmax()])
        how: Parts = ("state when the log began, such as ", Argument("start", "2026-05-01T12:00:00Z"))
        dated = LEAST_SECONDS < first < MOST_SECONDS
        if self._start is not None and first - begin > LEAST_SECONDS:
            dated, how = (
                False,
                ("it counts from the ", Argument("start"), " that is stated: leave that out where times are dates"),
            )
        if not dated:
            why = f"the time {first - begin:g} is no date and no count of seconds since 1970: "
            raise InputError((why, *how), file=self._log)
        place = np.maximum.accumulate(np.where(known, np.arange(len(time)), -1))
        time = np.where(place < 0, first if isnan(self._last) else self._last, time[place])
        self._last = float(time[-1])
        return np.asarray(time)


def _steps(dates: Array) -> Array:
    """Return the edges of the times for which an uncertainty holds: 64 between two dates, outside ever longer ones."""
    outside = 3600.0 * 2.0 ** (np.arange(_GROWTH * _DOUBLINGS) / _GROWTH)
    within = [np.linspace(first, last, STEPS, endpoint=False) for first, last in pairwise(dates)]
    return np.concatenate([dates[0] - outside[::-1], *within, dates[-1:], dates[-1] + outside])


def _joined(history: SensorHistory, k: int) -> bool:
    """Return whether gravity may be interpolated between a calibration and the next: the sensor sat in one way."""
    history.require_line(k)
    before, after = (history.calibrations[i].record.coefficients.mounting or Mounting() for i in (k, k + 1))
    return float(np.trace(mounting_matrix(before).T @ mounting_matrix(after))) >= 1.0 + 2.0 * cos(
        radians(FARTHEST_TURN)
    )


def _interpolated(before: Mapping[str, Any], after: Mapping[str, Any], share: Array) -> dict[str, Any]:
    """Return the columns at a share of the time between two calibrations, shape (n,), from those of both."""
    table = {}
    for name, column in before.items():
        if name == "flag":
            table[name] = np.maximum(column, after[name])
        elif name == "reason":
            table[name] = np.bitwise_or(column, after[name])
        elif name == HEADING:
            turn = (after[name] - column + 180.0) % 360.0 - 180.0
            table[name] = full_circle(column + share * turn, 360.0)
        else:
            table[name] = (1.0 - share) * column + share * after[name]
    components = [name for name in before if name in ("g_x", "g_y", "g_z")]
    gravity = np.stack([table[name] for name in components])
    if len(components) == 3:
        angles = np.empty((6, len(share)))
        tilts_of_three(gravity, angles)
        names = (*(f"tilt_{name[2:]}" for name in components), *DIRECTIONS)
    else:
        angles, names = np.stack([tilt(component) for component in gravity]), tuple(f"tilt_{n[2:]}" for n in components)
    for name, angle in zip(names, angles, strict=True):
        table[name] = np.where(np.isfinite(table[name]), angle, np.nan)
    return table


def _taken(values: RoleValues, rows: NDArray[np.intp]) -> RoleValues:
    """Return some of the rows."""
    return replace(values, **{name: column[rows] for name, column in vars(values).items() if column is not None})

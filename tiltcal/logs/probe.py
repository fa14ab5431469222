"""What is in a log: its table, its columns with their units, its rate, gravity and attitudes, and what to type next."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from shlex import quote
from typing import Any

import numpy as np

from tiltcal.column_guess import Guess, guess_of_columns
from tiltcal.column_names import TEMPERATURE, TIME
from tiltcal.core.model import AXES, Array
from tiltcal.core.rounding import significant
from tiltcal.dialect import Dialect
from tiltcal.logs.columns import RecordedColumns, column_names, read_columns
from tiltcal.logs.formats import log_format, open_log
from tiltcal.logs.formats.csv import CsvReader
from tiltcal.logs.log import LogReader, Progress
from tiltcal.logs.recordings import unit_of_length
from tiltcal.logs.still import different, farthest, may_be_means, mean_of, still_attitudes
from tiltcal.printable import counted
from tiltcal.units import READINGS, spelt

LOOK = 1000  # rows by which columns without names are told apart
ENOUGH = 10  # different attitudes from which on unit gravity calibrates a sensor
FEW = 1000  # rows up to which a log of no holds may be a table of means
_SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars"}


@dataclass(frozen=True)
class LogFacts:
    """What a log holds.

    ``columns`` is what each is: name, role, unit, and where the unit comes from; ``length`` that of gravity at rest
    in the unit of the readings, ``attitudes`` and ``different`` how many still ones there are; ``next`` a command.
    """

    log: str
    layout: Mapping[str, Any]
    columns: Sequence[Mapping[str, Any]]
    rows: int
    bad_rows: int
    missing: Mapping[str, int]
    rate: float | None
    remarks: Sequence[str]
    length: float | None
    attitudes: int
    different: int
    absent: str
    next: str

    def as_data(self) -> dict[str, Any]:
        """Return all as plain data."""
        return dict(vars(self))

    def __str__(self) -> str:
        return "\n".join(self._lines())

    def _lines(self) -> Iterator[str]:
        place = ", ".join(f"{key} {value}" for key, value in self.layout.items() if value not in (None, "", 0))
        yield f"{self.log}: {place}"
        for column in self.columns:
            unit = f"[{column['unit']}] by {column['unit_from']}" if column["unit"] else ""
            yield f"  {column['number']:>3}  {column['name']:<28} {column['role'] or '-':<12} {unit}".rstrip()
        rate = f", {self.rate:.4g} Hz" if self.rate else ""
        bad = f", {counted(self.bad_rows, 'row')} that cannot be parsed" if self.bad_rows else ""
        yield f"{counted(self.rows, 'row')}{rate}{bad}"
        yield from (f"  {name}: missing in {counted(count, 'row')}" for name, count in self.missing.items())
        yield from (f"  {line}" for line in self.remarks)
        if self.length is not None:
            yield f"at rest the readings are {self.length:.5g} long"
        if self.attitudes:
            absent = f"; none with {self.absent} up" if self.absent else ""
            yield f"{counted(self.attitudes, 'still attitude')}, {self.different} of them different{absent}"
        yield f"next: {self.next}"


def probe_log(path: str, progress: Progress | None = None) -> LogFacts:
    """Return what a log holds; an InputError where it cannot be read."""
    with open_log(path, skip_bad_rows=True, progress=progress) as log:
        guessed = _guess(log, path)
        named = column_names(log.names, (*AXES, TIME, TEMPERATURE), {})
        axes = {axis: named[axis] for axis in AXES if axis in named}
        if not axes and guessed is not None:
            axes = {role: log.names[k] for k, role in enumerate(guessed.roles) if role in AXES}
        where = {role: log.names.index(name) for role, name in {**named, **axes}.items()}
        record = read_columns(log, where) if where else read_columns(log, {"x": 0})
        if where and record.faulty == log.rows_read > 0:
            with open_log(path) as again:
                read_columns(again, where)  # says what is in the first of them
        readings = record.of([axis for axis in AXES if axis in where])
        means, turned = _rest(readings)
        units = {axis: spelt(log.unit(where[axis]) or "") for axis in axes}
        unit, by = _unit(units, means, readings, guessed)
        roles = {index: role for role, index in where.items()}
        columns = [
            {
                "number": number,
                "name": name,
                "role": roles.get(number - 1, ""),
                "unit": stated or (unit if roles.get(number - 1) in AXES else ""),
                "unit_from": "its header" if stated else by if roles.get(number - 1) in AXES and unit else "",
            }
            for number, name in enumerate(log.names, 1)
            for stated in [spelt(log.unit(number - 1) or "")]
        ]
        times = record.by_role.get(TIME)
        rate = None if times is None else _rate(times)
        kinds = different(means) if len(means) and len(readings) == len(AXES) else means
        absent = farthest(kinds) if 1 < len(kinds) < ENOUGH and len(readings) == len(AXES) else ""
        if len(kinds) < 2 and log.rows_read <= FEW and may_be_means(readings):
            means, turned, kinds = np.stack(readings, axis=1), (), means[:0]
        lengths = np.linalg.norm(means, axis=1) if len(means) and len(readings) == len(AXES) else np.empty(0)
        return LogFacts(
            log=path,
            layout=_layout(log),
            columns=columns,
            rows=log.rows_read,
            bad_rows=record.faulty,
            missing=_missing(record, axes),
            rate=rate,
            remarks=[*log.clock.remarks, *log.remarks],
            length=significant(float(np.median(lengths)), 5) if len(lengths) else None,
            attitudes=len(turned),
            different=len(kinds),
            absent=absent,
            next=_next(path, log, axes, unit, by, readings, len(turned), len(kinds), guessed),
        )


def _guess(log: LogReader, path: str) -> Guess | None:
    """Return what columns without names hold, by the numbers of the first rows."""
    if not isinstance(log, CsvReader) or log.dialect.has_header:
        return None
    places = [k for k, kind in enumerate(log.dialect.kinds) if kind == "number"]
    with open_log(path, skip_bad_rows=True) as again:
        first = next(again.rows(places or [0]))
    columns = [first.values[k][:LOOK] if k in places else np.empty(0) for k in range(len(log.names))]
    return guess_of_columns(log.dialect, [column[np.isfinite(column)].tolist() for column in columns])


def _rest(readings: Sequence[Array]) -> tuple[Array, Sequence[Any]]:
    """Return the means of the still attitudes of readings, (n, channels), and their rows."""
    if not readings:
        return np.empty((0, 0)), ()
    attitudes = still_attitudes(readings)
    means = [mean_of(readings, spans)[0] for spans in attitudes]
    return np.array(means).reshape(len(means), len(readings)), attitudes


def _unit(units: Mapping[str, str], means: Array, readings: Sequence[Array], guessed: Guess | None) -> tuple[str, str]:
    """Return the unit of the readings, and what shows it."""
    stated = {*units.values()} - {""}
    if len(stated) == 1 and "" not in units.values():
        unit = stated.pop()
        return (unit, "its header") if unit in READINGS else ("", "")
    if len(means) and len(readings) == len(AXES) and (unit := unit_of_length(means, readings, alone=True) or ""):
        return unit, "the length of gravity at rest"
    if guessed is not None and guessed.unit:
        return guessed.unit, "the length of gravity"
    return "", ""


def _layout(log: LogReader) -> dict[str, Any]:
    """Return where the table is, and how it is written."""
    if not isinstance(log, CsvReader):
        return {"format": log_format(log.source.path), "encoding": None}
    found: Dialect = log.dialect
    how = "labels" if found.pattern else "blanks" if found.has_blanks else _SEPARATORS[found.separator]
    how = "JSON objects" if found.pattern and found.pattern.keys else how
    return {
        "rows from line": found.first + 1,
        "names in line": None if found.named is None else found.named + 1,
        "fields by": how,
        "decimal": "comma" if found.decimal == "," else None,
        "clock in front": "yes" if found.has_clock else None,
        "encoding": log.text.encoding,
    }


def _missing(record: RecordedColumns, axes: Mapping[str, str]) -> dict[str, int]:
    counts = {name: int((~np.isfinite(record.by_role[axis])).sum()) for axis, name in axes.items()}
    return {name: count - record.faulty for name, count in counts.items() if count > record.faulty}


def _rate(times: Array) -> float | None:
    """Return the rate of times, Hz; None where they do not go on."""
    known = times[np.isfinite(times)]
    steps = np.diff(known)
    usual = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 0.0
    return significant(1.0 / usual, 6) if usual > 0.0 else None


def _next(
    path: str,
    log: LogReader,
    axes: Mapping[str, str],
    unit: str,
    by: str,
    readings: Sequence[Array],
    attitudes: int,
    kinds: int,
    guessed: Guess | None,
) -> str:
    """Return the command to type next."""
    file = quote(path)
    if not axes:
        return f"tiltcal apply CAL.yaml {file} --columns x=NAME,y=NAME -o TILT.csv, with the columns of the readings"
    meant = column_names(log.names, AXES, {})
    by_place = {axis: str(log.names.index(name) + 1) for axis, name in axes.items()}
    columns = "" if meant == axes else f" --columns {','.join(f'{axis}={k}' for axis, k in by_place.items())}"
    shown = by.startswith("its header") or (unit and not columns and kinds > 1)
    stated = "" if shown else f" --unit {unit or 'UNIT'}"
    if len(readings) < len(AXES):
        return f"tiltcal apply CAL.yaml {file}{columns} -o TILT.csv"
    if kinds < 2 and log.rows_read <= FEW and may_be_means(readings):
        return f"tiltcal fit free {file} --table{columns}{stated} --serial NAME -o NAME.yaml, if each row is a mean"
    if attitudes < 2:
        return f"tiltcal noise {file}{columns}{stated}"
    procedure = "free" if kinds >= ENOUGH else "six-face"
    return f"tiltcal fit {procedure} {file}{columns}{stated} --serial NAME -o NAME.yaml"

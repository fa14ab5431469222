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
from tiltcal.logs.streams import STANDARD
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
        place = ", ".join(f"{key} {value}" for key, value in self.layout.items() if value)
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
        named = column_names(log.names, (*AXES, TIME, TEMPERATURE), {})
        where = {role: log.names.index(name) for role, name in named.items()}
        known = where | {name: log.names.index(name) for name in log.unnamed}
        record = read_columns(log, known or _any_column(log))
        if known and record.faulty == log.rows_read > 0 and path != STANDARD:
            with open_log(path) as again:
                read_columns(again, known)  # says what is in the first of them
        guessed = _guess(log, record) if isinstance(log, CsvReader) and log.unnamed else None
        axes = {axis: named[axis] for axis in AXES if axis in named}
        if not axes and guessed is not None:
            axes = {role: log.names[k] for k, role in enumerate(guessed.roles) if role in AXES}
        readings = record.of([axis if axis in named else axes[axis] for axis in AXES if axis in axes])
        whole = len(readings) == len(AXES)
        turned = still_attitudes(readings) if readings else ()
        means = np.array([mean_of(readings, spans)[0] for spans in turned]).reshape(len(turned), len(readings))
        unit, by = _unit(
            [spelt(log.unit(log.names.index(axes[axis])) or "") for axis in axes], means, readings, guessed
        )
        roles = {name: role for role, name in {**named, **axes}.items()}
        columns = [
            {
                "number": number,
                "name": name,
                "role": roles.get(name, ""),
                "unit": stated or (unit if roles.get(name) in AXES else ""),
                "unit_from": "its header" if stated else by if roles.get(name) in AXES and unit else "",
            }
            for number, name in enumerate(log.names, 1)
            for stated in [spelt(log.unit(number - 1) or "")]
        ]
        kinds = different(means) if len(means) and whole else means
        absent = farthest(kinds) if 1 < len(kinds) < ENOUGH and whole else ""
        of_means = len(kinds) < 2 and log.rows_read <= FEW and may_be_means(readings)
        if of_means:
            means, turned, kinds = np.stack(readings, axis=1), (), means[:0]
        return LogFacts(
            log=path,
            layout=_layout(log),
            columns=columns,
            rows=log.rows_read,
            bad_rows=record.faulty,
            missing=_missing(dict(zip(axes.values(), readings, strict=True)), record.faulty),
            rate=_rate(record.by_role[TIME]) if TIME in named else None,
            remarks=[*(log.clock.remarks if TIME in named else ()), *log.remarks],
            length=float(np.median(np.linalg.norm(means, axis=1))) if len(means) and whole else None,
            attitudes=len(turned),
            different=len(kinds),
            absent=absent,
            next=_next(path, log, axes, unit, by, len(turned), len(kinds), of_means=of_means),
        )


def _any_column(log: LogReader) -> dict[str, int]:
    """Return a column by which the rows of a log without readings are counted: as times it may hold text."""
    return {TIME if log.unit(0) is None else "x": 0}


def _guess(log: CsvReader, record: RecordedColumns) -> Guess:
    """Return what columns without names hold, by the numbers of the first rows."""
    first = [record.by_role[name][:LOOK] if name in log.unnamed else np.empty(0) for name in log.names]
    return guess_of_columns(log.dialect, [column[np.isfinite(column)].tolist() for column in first])


def _unit(units: Sequence[str], means: Array, readings: Sequence[Array], guessed: Guess | None) -> tuple[str, str]:
    """Return the unit of the readings, and what shows it."""
    if len({*units}) == 1 and units[0]:
        return (units[0], "its header") if units[0] in READINGS else ("", "")
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
        "dates": "whose order of day and month nothing shows" if found.dates == "open" else None,
        "encoding": log.text.encoding,
    }


def _missing(readings: Mapping[str, Array], faulty: int) -> dict[str, int]:
    """Return the missing cells of each column but those of rows that cannot be parsed."""
    counts = {name: int((~np.isfinite(column)).sum()) - faulty for name, column in readings.items()}
    return {name: count for name, count in counts.items() if count > 0}


def _rate(times: Array) -> float | None:
    """Return the rate of times, Hz; None where they do not go on."""
    known = times[np.isfinite(times)]
    steps = np.diff(known)
    forward = steps[steps > 0.0]
    return significant(1.0 / float(np.median(forward)), 6) if len(forward) else None


def _next(
    path: str,
    log: LogReader,
    axes: Mapping[str, str],
    unit: str,
    by: str,
    attitudes: int,
    kinds: int,
    *,
    of_means: bool,
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
    if len(axes) < len(AXES):
        return f"tiltcal apply CAL.yaml {file}{columns} -o TILT.csv"
    if of_means:
        return f"tiltcal fit free {file} --table{columns}{stated} --serial NAME -o NAME.yaml, if each row is a mean"
    if attitudes < 2:
        return f"tiltcal noise {file}{columns}{stated}"
    procedure = "free" if kinds >= ENOUGH else "six-face"
    return f"tiltcal fit {procedure} {file}{columns}{stated} --serial NAME -o NAME.yaml"

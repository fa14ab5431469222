"""Which column of a log holds which reading, and the columns of a whole log as arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from tempfile import TemporaryFile, gettempdir
from typing import IO, TYPE_CHECKING

import numpy as np

from tiltcal.column_names import TEMPERATURE, TIME, best_time, meaning
from tiltcal.core.model import AXES, Array
from tiltcal.errors import Argument, InputError, UsageError, Words, parts_of
from tiltcal.printable import did_you_mean
from tiltcal.stated_arguments import named_values
from tiltcal.units import DEGREE, READINGS, TEMPERATURES, same_unit, spelt, split_unit

if TYPE_CHECKING:
    from tiltcal.logs.log import LogReader

HEADING = "heading"
_MEMORY = 256 << 20  # keep the columns in memory up to so many bytes, and in temporary files beyond


def named_columns(
    columns: Mapping[str, str] | str, channels: Sequence[str], others: Sequence[str] = ()
) -> dict[str, str]:
    """Return the column of each role that was named, by a mapping or by text such as ``x=VoutX,temperature=T``.

    A log may have ``channels`` and ``others`` besides temperature and time.
    """
    roles = tuple(dict.fromkeys((*channels, TEMPERATURE, TIME, *others)))
    named = named_values("columns", columns or "", roles, "role", f"{roles[0]}=VoutX")
    return {role: str(column) for role, column in named.items()}


def column_names(names: Sequence[str], roles: Sequence[str], named: Mapping[str, str]) -> dict[str, str]:
    """Return the column of each role that a log has: the one that was named, of its name, or that means it.

    A column means an axis as phones and loggers write it (``Acceleration x (m/s^2)``, ``ax``, ``gFx``), where no other
    column does; the best of several means the time, such as ``Time (s)`` or ``seconds_elapsed``. A number is the place
    of a column, from 1, where no column has it for its name.
    """
    bare = {split_unit(name)[0]: name for name in names} | {name: name for name in names}
    bare = {str(place): name for place, name in enumerate(names, 1)} | bare
    meant: dict[str, set[str]] = {}
    for name in names:
        short, unit = split_unit(name)
        if role := TEMPERATURE if spelt(unit or "") in TEMPERATURES and meaning(short) == TIME else meaning(short):
            meant.setdefault(role, set()).add(name)
    found = {}
    for role in roles:
        alone = meant.get(role, set()) if role not in named else set()
        if role in AXES and len(alone) > 1:  # beside the acceleration that one has, linear ones are without gravity
            alone = {name for name in alone if "linear" not in name.lower() and "user" not in name.lower()}
        if role == TIME and alone:
            alone = {best_time(alone)}
        column = bare.get(named.get(role, role))
        if column is not None or len(alone) == 1:
            found[role] = column or next(iter(alone))
    return found


@dataclass(frozen=True)
class ReadingsHeader:
    """The column of each axis that a log has, and the unit that all of them state.

    ``guessed`` are the columns of a log without names that has three of numbers, beside times; ``units`` are all that
    are stated.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    unit: str | None = None
    guessed: Mapping[str, str] = field(default_factory=dict)
    units: Sequence[str] = ()


def readings_header(log: LogReader, named: Mapping[str, str] | str) -> ReadingsHeader:
    """Return what the names of a log say of its readings."""
    roles, guessed = named_columns(named, AXES), dict[str, str]()
    if not roles and len(log.unnamed) == 3:
        guessed = roles = dict(zip(AXES, log.unnamed, strict=True))
    columns = column_names(log.names, AXES, roles)
    units = {
        spelt(log.unit(log.names.index(name)) or "") or ("g" if name.lower().startswith(("gf", "g-f")) else None)
        for name in columns.values()
    }
    stated = sorted(filter(None, units))
    unit = units.pop() if len(units) == 1 else None
    return ReadingsHeader(columns, unit if unit in READINGS else None, guessed, stated)


def locate_columns(
    log: LogReader,
    channels: Sequence[str],
    named: Mapping[str, str],
    others: Sequence[str] = (),
    *,
    option: str = "columns",
) -> dict[str, int]:
    """Return where the columns of channels and other roles stand in a log, and that of the temperature if it is there.

    A role that was not named has the column of its own name. A unit behind a column's name in the header, such as
    ``x (m/s^2)``, may be left out. ``option`` is the argument that names a column, for the InputError that lists the
    columns where one is not there.
    """
    roles = tuple(dict.fromkeys((*channels, *others, TEMPERATURE, TIME)))
    columns = column_names(log.names, roles, named)
    located: dict[str, int] = {}
    for role in roles:
        if role in columns:
            located[role] = log.names.index(columns[role])
        elif role in named or role in channels or role in others:
            why = _absent(named.get(role, role), log.names, option, f"{role}=" if option == "columns" else "")
            path = log.source.path
            hint = f"; `tiltcal probe {path}` shows what is in it" if path not in ("", "-") else ""
            raise InputError((*parts_of(why), hint), file=log.name, line=log.header_line)
    stated = {role: column for role, column in located.items() if role in (*channels, *others, *named)}
    for column in stated.values():
        if len(shared := [role for role, other in stated.items() if other == column]) > 1:
            why = f"{' and '.join(shared)} are one column, {log.names[column]!r}: name the column of each"
            raise InputError(why, file=log.name)
    if TIME not in (*channels, *others):
        located.pop(TIME, None)
    return located


def locate_readings(
    log: LogReader, channels: Sequence[str], named: Mapping[str, str], unit: str, others: Sequence[str] = ()
) -> dict[str, int]:
    """Find the columns of readings in a unit that was named, else an InputError, as :func:`locate_columns` does."""
    where = locate_columns(log, channels, named, others)
    require_units(log, where, dict.fromkeys(channels, unit), ("the ", Argument("unit")))
    return where


_ROLE_UNITS = {TEMPERATURE: "°C", HEADING: DEGREE}


def require_units(
    log: LogReader,
    where: Mapping[str, int],
    units: Mapping[str, str],
    whose: Words = "the calibration",
    stated: str | None = None,
) -> None:
    """Raise InputError for a log in which the column of a role states another unit than that of ``whose``.

    Temperatures, of one sensor too, are in °C, and headings in degrees. ``stated`` is the unit that the user states of
    readings.
    """
    for role, column in where.items():
        unit, of = units.get(role), parts_of(whose)
        if unit is None and (kind := role.rpartition("_")[2]) in _ROLE_UNITS:
            unit, of = _ROLE_UNITS[kind], (f"{kind}s",)
        for found in (log.unit(column), stated if role in units else None):
            if unit == "°C" and spelt(found or unit) in TEMPERATURES:
                continue
            if unit is not None and found is not None and not same_unit(found, unit):
                why = (f"column {log.names[column]!r} is in {found}, and ", *of, f" in {unit}: convert the readings")
                raise InputError(why, file=log.name)


def _absent(column: str, names: Sequence[str], option: str, role: str) -> Words:
    if not names:
        return "there are no columns"
    if all(name.isdigit() for name in names if name):
        why = f"there is no column {column!r}; the log has no header, and its columns are called 1 to {len(names)}: "
        return f"{why}name one, such as ", Argument(option, f"{role}{min(2, len(names))}")
    listed = ", ".join(names[:12]) + (f" and {len(names) - 12} more" if len(names) > 12 else "")
    why = f"there is no column {column!r}{did_you_mean(column, names)}; the log has {listed}. Name it with "
    return why, Argument(option, f"{role}NAME")


@dataclass(frozen=True)
class RecordedColumns:
    """Columns of a log by role, each of shape (rows,), NaN where a value is missing: readings, °C, seconds.

    ``name`` is the log as the user named it; ``faulty`` counts the rows that could not be parsed.
    """

    by_role: Mapping[str, Array]
    name: str
    faulty: int

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(next(iter(self.by_role.values())))

    def of(self, roles: Sequence[str]) -> list[Array]:
        """Return some columns."""
        return [self.by_role[role] for role in roles]


def read_columns(log: LogReader, where: Mapping[str, int], *, needs_time: bool = False) -> RecordedColumns:
    """Read columns of a log to its end, by role; beyond 256 MB they are maps of temporary files, which go with them.

    ``needs_time``, and the InputError of the log, are those of :meth:`LogReader.rows`.
    """
    blocks: list[list[Array]] = [[] for _ in where]
    rows = faulty = 0
    with ExitStack() as opened:
        files: list[IO[bytes]] = []
        warm = [where[TEMPERATURE]] if TEMPERATURE in where else []
        needed = sorted(set(where.values()))
        for block in log.rows(needed, where.get(TIME), temperatures=warm, needs_time=needs_time):
            rows, faulty = rows + len(block), faulty + len(block.faults)
            for column, kept in zip(where.values(), blocks, strict=True):
                kept.append(block.values[column])
            if files or 8 * rows * len(where) > _MEMORY:
                files = files or [opened.enter_context(TemporaryFile()) for _ in where]
                _to_files(blocks, files)
        columns = [np.asarray(np.memmap(file, dtype=np.float64, mode="r")) for file in files]  # a map outlives its file
    columns = columns or [np.concatenate([np.empty(0), *kept]) for kept in blocks]
    by_role = dict(zip(where, columns, strict=True))
    return RecordedColumns(by_role, log.name, faulty)


def read_readings(
    log: LogReader, channels: Sequence[str], columns: Mapping[str, str] | str, unit: str, others: Sequence[str] = ()
) -> RecordedColumns:
    """Read the readings of a log in a unit to its end, with temperature and time where it has them, and ``others``.

    ``columns`` names columns by role, as ``--columns`` does.
    """
    named = named_columns(columns, channels)
    needs_time = TIME in named or TIME in others
    where = locate_readings(log, channels, named, unit, (*others, TIME) if needs_time else others)
    if TIME not in where and log.has_times(TIME, where[channels[0]]):
        where[TIME] = log.names.index(TIME)
    return read_columns(log, where, needs_time=needs_time)


def _to_files(blocks: Sequence[list[Array]], files: Sequence[IO[bytes]]) -> None:
    """Move the blocks of each column behind those in its file."""
    try:
        for kept, file in zip(blocks, files, strict=True):
            file.writelines(np.ascontiguousarray(block, dtype=np.float64).data for block in kept)
            file.flush()
            kept.clear()
    except OSError as failure:
        raise UsageError(
            f"the rows of the log cannot be kept in {gettempdir()}: {failure.strerror}; make room there, or name "
            "another folder in TMPDIR"
        ) from failure

"""What columns of numbers without names may hold, by the numbers: three are as long as gravity, one counts up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from math import hypot
from statistics import median, pstdev
from typing import NamedTuple

from tiltcal.column_names import AXES, TEMPERATURE, meaning
from tiltcal.dialect import Dialect, kind_of, split, without_clock
from tiltcal.log_head import dialect_of
from tiltcal.units import READINGS, is_unit, spelt, split_unit

LENGTHS: Mapping[str, tuple[float, float]] = {
    "g": (0.9, 1.1),
    "m/s2": (9.3, 10.3),
    "mg": (930.0, 1070.0),
    "mm/s2": (9300.0, 10300.0),
}
"""The length of gravity at rest by which a unit is known that nothing states."""

RANGES = (256.0, 512.0, 1024.0, 2048.0, 4096.0, 8192.0, 16384.0, 32768.0)  # counts that are a g in converters
SAME = 0.1  # how near to one of them a length is, relative


class Guess(NamedTuple):
    """What the numbers of a line may be.

    roles: of each an axis, ``temperature`` or ``-``; none are axes where nothing shows which.
    unit: of the axes; empty where nothing shows it.
    per_g: counts to a g, where their length is about a power of two; else 0.
    by: what shows it: ``names``, ``length`` or ``number``, the mere number of columns.
    example: a line.
    """

    roles: tuple[str, ...] = ()
    unit: str = ""
    per_g: float = 0.0
    by: str = ""
    example: str = ""


def guess(lines: Sequence[str]) -> Guess:
    """Guess the meaning of the numbers of whole lines: by labels or names, by their lengths, by their number.

    The clock of a monitor in front of a line is none of them.
    """
    lines = [without_clock(line)[1] for line in lines]
    try:
        found = dialect_of(lines)
    except ValueError:
        return Guess()
    some = [line for line in lines[found.first :] if not found.no_row(line)]
    cells = [split(found.fields_of(line), found.separator) for line in some]
    rows = [row for row in cells if len(row) == len(found.names) and "number" in map(kind_of, row)]
    if not rows:
        return Guess()
    columns = [[float(row[k]) for row in rows if kind_of(row[k]) == "number"] for k in range(len(found.names))]
    return guess_of_columns(found, columns)._replace(example=some[-1].strip())


def guess_of_columns(found: Dialect, columns: Sequence[Sequence[float]]) -> Guess:
    """Guess the meaning of columns of numbers, each of some rows."""
    roles = [meaning(split_unit(name)[0]) for name in found.names] if found.has_header else [""] * len(columns)
    if {*roles} & {*AXES}:
        places = [k for k, role in enumerate(roles) if role in AXES and roles.count(role) == 1]
        stated = {found.units.get(found.names[k]) or split_unit(found.names[k])[1] or "" for k in places}
        unit = spelt(stated.pop()) if len(stated) == 1 else ""
        unit = unit if is_unit(unit) and unit in READINGS else unit_of_rows([columns[k] for k in places])
        return Guess(_shown(roles), unit, by="names")
    usable = [k for k, column in enumerate(columns) if column and not counts_up(column)]
    triples = [tuple(range(k, k + 3)) for k in usable if {k + 1, k + 2} <= {*usable}]
    units = {three: unit for three in triples if (unit := unit_of_rows([columns[k] for k in three]))}
    if units:
        three = min(units, key=lambda three: pstdev(_lengths([columns[k] for k in three])))
        return Guess(_placed(roles, three), units[three], by="length")
    for three in triples:
        length = median(_lengths([columns[k] for k in three]))
        near = [per_g for per_g in RANGES if abs(length / per_g - 1.0) < SAME]
        if near and all(float(value).is_integer() for k in three for value in columns[k]):
            return Guess(_placed(roles, three), "count", near[0], "length")
    alone = tuple(usable) if len(usable) <= len(AXES) else ()
    return Guess(_placed(roles, alone), by="number")


def counts_up(column: Sequence[float]) -> bool:
    """Return whether a column is a clock or a counter: it never goes back, and rises by about the same each time."""
    steps = [after - before for before, after in pairwise(column)] or [0.0]
    usual = median(steps)
    return min(steps) >= 0.0 and max(steps) < 20.0 * usual and sum(steps) > 5.0 * usual


def unit_of_rows(columns: Sequence[Sequence[float]]) -> str:
    """Return the unit in which the usual row of three columns is as long as gravity; empty where there is none.

    Whole numbers are counts, which say nothing.
    """
    if len(columns) != len(AXES) or any(all(float(value).is_integer() for value in column) for column in columns):
        return ""
    length = median(_lengths(columns))
    return next((unit for unit, (low, high) in LENGTHS.items() if low <= length <= high), "")


def _lengths(columns: Sequence[Sequence[float]]) -> list[float]:
    return [hypot(*row) for row in zip(*columns, strict=False)] or [0.0]


def _placed(roles: Sequence[str], places: Sequence[int]) -> tuple[str, ...]:
    axes = dict(zip(places, AXES, strict=False))
    return _shown([axes.get(k, role) for k, role in enumerate(roles)])


def _shown(roles: Sequence[str]) -> tuple[str, ...]:
    return tuple(role if role in (*AXES, TEMPERATURE) else "-" for role in roles)

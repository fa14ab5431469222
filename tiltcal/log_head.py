"""Where the table of a log begins, and how its rows are written: what the first lines of a file show.

What is found holds for the whole file. A row is fields between separators, or numbers with the texts of a pattern
around them; the likeliest of both is taken.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from tiltcal.column_names import AXES, TIME, role_of
from tiltcal.dialect import (
    BEHIND,
    COMMENTS,
    LABEL,
    MOMENT,
    WITH_COMMA,
    Dialect,
    Pattern,
    flattened,
    kind_of,
    labels_of,
    printed,
    split,
    without_clock,
    without_sum,
)
from tiltcal.printable import distinct
from tiltcal.units import is_unit

HEAD_LINES = 200  # lines in which the table must begin
SEPARATORS = (",", ";", "\t", "|", " ")  # of the fields of a row, the likeliest first; a blank stands for several
FEW_LINES = 20  # lines of which all show how rows are written, not the later half of them
OPEN_DATE = re.compile(r"(\d{1,2})[-/](\d{1,2})[-/](?:\d{4}|\d\d)(?!\d)")
_ARRAY = re.compile(r"\s*\[\s*\{")
_THOUSANDS, _WITH_POINT = re.compile(r"[-+]?\d{1,3}(?:,\d{3})+"), re.compile(r"[-+]?\d*\.\d+")
_MIXED = re.compile(r"\d[ \t]*+[,;|][ \t]*+[-+.\d]|\d[ \t]++[-+.\d]")


@dataclass(frozen=True)
class _Reading:
    """The head of a file, read with one separator and decimal mark."""

    separator: str
    decimal: str
    cells: tuple[list[str], ...]
    kinds: tuple[tuple[str, ...], ...]

    @classmethod
    def of(cls, lines: Sequence[str], separator: str) -> _Reading:
        cells = tuple(split(line, separator) for line in lines)
        flat = [cell for row in cells for cell in row]
        commas = [cell for cell in flat if cell[:1] != "," and WITH_COMMA.fullmatch(cell)]
        if separator == "," and (all(map(_THOUSANDS.fullmatch, commas)) or any(map(_WITH_POINT.fullmatch, flat))):
            commas = []  # in quotes, where a comma may stand for thousands
        decimal = "," if commas else "."
        return cls(separator, decimal, cells, tuple(tuple(kind_of(cell, decimal) for cell in row) for row in cells))

    def count(self, rows: Sequence[int]) -> tuple[int, int]:
        """Return how well this separator suits some lines, and how many fields a row then has."""
        sizes: Counter[int] = Counter()
        for row in rows:
            kinds = self.kinds[row]
            good = kinds.count("number") + kinds.count("time")
            if self.separator == " ":  # a date and its time of day are one moment, unless a blank is all there is
                good -= sum(pair == ("time", "time") for pair in pairwise(kinds))
            sizes[len(kinds)] += good - 2 * sum(map(bool, map(_MIXED.search, self._texts(row)))) if good else 0
        fields, score = max(sizes.items(), key=lambda item: item[1], default=(0, 0))
        return score, fields

    def merit(self, rows: Sequence[int]) -> tuple[int, bool, int]:
        """Return what decides between separators: the numbers, then whether names fit, then the fewer fields."""
        score, fields = self.count(rows)
        named = any(len(kinds) == fields and {"text"} == {*kinds} - {"missing"} for kinds in self.kinds)
        filled = any(self.cells[row][-1] for row in rows if len(self.cells[row]) == fields)
        return score, named, -fields + (not filled)

    def _texts(self, row: int) -> list[str]:
        return [cell for cell, kind in zip(self.cells[row], self.kinds[row], strict=True) if kind == "text"]


def dialect_of(lines: Sequence[str]) -> Dialect:
    """Return how a file is written whose first lines these are, without their ends.

    ValueError: no line names columns or holds numbers.
    """
    lines = list(lines[:HEAD_LINES])
    filled = [row for row, line in enumerate(lines) if line.strip()]
    if filled and _ARRAY.match("".join(lines[filled[0] :])):
        raise ValueError("a JSON array, which jq -c '.[]' writes as one object a line")
    later = filled[len(filled) // 2 if len(filled) > FEW_LINES else 0 :]  # the table is the last of the head
    fronts = [without_clock(lines[row])[0] for row in later]
    has_clock = sum(map(bool, fronts)) > len(fronts) / 2
    bodies = [without_clock(line)[1] if has_clock else line for line in lines]
    has_sum = sum(map(bool, map(without_sum, (bodies[row] for row in later)))) > len(later) / 2
    bodies = [without_sum(line) or line if has_sum else line for line in bodies]
    marked = Counter(mark for row in later for mark in COMMENTS if bodies[row].lstrip().startswith(mark))
    comments = tuple(mark for mark in COMMENTS if marked[mark] <= len(later) / 2)
    found = _pattern_of(bodies, later) or _table_of(bodies, later, comments)
    first = found.first
    head = tuple(lines[:first])
    if has_clock:
        clock = "clock" if any(role_of(name) == TIME for name in found.names) else TIME
        numbered = not found.has_header
        names = tuple(map(str, range(2, len(found.names) + 2))) if numbered else found.names
        found = replace(found, names=(clock, *names), kinds=("time", *found.kinds), has_clock=True)
    return replace(found, head=head, comments=comments, has_sum=has_sum)


def _pattern_of(lines: Sequence[str], later: Sequence[int]) -> Dialect | None:
    """Return the dialect of lines with labels or of JSON objects; None where most lines are none."""
    shapes: dict[tuple[str, ...], list[int]] = {}
    for row in later:
        line = lines[row].strip()
        texts, numbers = printed(line)
        keys = _keys(line)
        framed = any(map(LABEL.search, texts[:-1])) or texts[0].strip() in ("[", "(", "<", "{")
        if keys or (numbers and framed and not MOMENT.match(line)):
            shapes.setdefault(keys or tuple("".join(text.split()) for text in texts), []).append(row)
    if 2 * sum(map(len, shapes.values())) <= len(later):
        return None
    patterns = {}
    for shape, rows in shapes.items():  # of lines that differ in numbers and blanks alone: with the blanks of most
        counts = Counter(tuple(printed(lines[row])[0]) for row in rows)
        pattern = Pattern(max(counts, key=counts.__getitem__), _keys(lines[rows[0]].strip()))
        if any(pattern.cells(lines[row].strip()) is not None for row in rows):
            patterns[shape] = pattern
    if not patterns:
        return None

    def merit(shape: tuple[str, ...]) -> tuple[int, int]:
        axes = {role_of(name) for name in _names_of(patterns[shape])} & {*AXES}
        return len(axes), len(shapes[shape])

    best = max(patterns, key=merit)
    pattern, names = patterns[best], _names_of(patterns[best])
    first = next(row for row, line in enumerate(lines) if pattern.cells(line.strip()) is not None)
    others = tuple(
        patterns[shape] for shape in patterns if shape != best and (len(shapes[shape]) > 1 or len(later) < 9)
    )
    listed = tuple(distinct((name or str(place) for place, name in enumerate(names, 1)), "{} {}"))
    behind = [found[1] if (found := BEHIND.match(text)) and is_unit(found[1]) else "" for text in pattern.texts[1:]]
    if behind and not any(behind[:-1]):  # one unit behind all of them
        behind = behind[-1:] * len(behind)
    return Dialect(
        listed,
        has_header=any(names),
        kinds=("number",) * len(listed),
        units={name: unit for name, unit in zip(listed, behind, strict=False) if unit},
        pattern=pattern,
        others=others,
        first=first,
        named=None,
    )


def _keys(line: str) -> tuple[str, ...]:
    """Return the keys of a line that is a JSON object, those of objects in it behind a point."""
    if not line.startswith("{"):
        return ()
    try:
        return tuple(flattened(json.loads(line)))
    except (ValueError, RecursionError):
        return ()


def _names_of(pattern: Pattern) -> list[str]:
    return [*pattern.keys] or labels_of(pattern.texts)


def _table_of(lines: Sequence[str], later: Sequence[int], comments: tuple[str, ...]) -> Dialect:
    """Return the dialect of lines with fields between separators."""
    plain = [row for row in later if not lines[row].lstrip().startswith(comments)]
    readings = [_Reading.of(lines, separator) for separator in SEPARATORS]
    best = max(readings, key=lambda reading: reading.merit(plain))
    score, fields = best.count(plain)
    if score <= 0:  # no line has a number: the first one that is no comment names the columns of what follows
        return _without_rows(lines, comments)
    there = (kinds for row in plain if len(kinds := best.kinds[row]) == fields and {*kinds} & {"number", "time"})
    columns = [Counter(column) for column in zip(*there, strict=True)] or [Counter[str]()] * fields
    usual = [next((kind for kind, _ in column.most_common() if kind != "missing"), "missing") for column in columns]

    def is_row(row: int) -> bool:
        kinds = best.kinds[row]
        if len(kinds) != fields or lines[row].lstrip().startswith(comments):
            return False
        fits = [kind in ("missing", wanted) for kind, wanted in zip(kinds, usual, strict=True) if wanted != "text"]
        return 2 * sum(fits) > len(fits) and ("number" in kinds or "time" in kinds)

    rows = [row for row in range(len(lines)) if is_row(row)]
    start = next((row for k, row in enumerate(rows) if _goes_on(rows[k:], lines)), rows[0] if rows else plain[0])
    named, names, units = _names_above(lines, start, fields, best, comments)
    cells = [cell for cell in best.cells[start] if cell]
    if named is None and fields > 1 and cells in ([str(k + one) for k in range(len(cells))] for one in (0, 1)):
        named, names, start = start, best.cells[start], start + 1  # as programs number columns that nobody named
    elif named is not None:
        nothing = ("missing",) * fields  # a row without a value is a row
        behind = (row for row in range(named + 1, start) if lines[row].strip())
        start = next((r for r in behind if {*best.kinds[r]} & {"number", "time"} or best.kinds[r] == nothing), start)
    numbered = tuple(str(place) for place in range(1, fields + 1))
    blanks = best.separator == " " and (fields > 1 or len(names) > 1)
    return Dialect(
        tuple(names) or numbered,
        best.separator if best.separator != " " else ";" if best.decimal == "," else ",",
        best.decimal,
        has_header=named is not None,
        has_blanks=blanks,
        first=start,
        named=named,
        units=units,
        kinds=tuple(usual),
        dates=_order_of_dates(cell for row in rows for cell in best.cells[row]),
    )


def _order_of_dates(cells: Iterable[str]) -> str:
    """Return what is first in dates that begin with neither the year nor the name of a month, by those beyond 12."""
    found = [(int(date[1]), int(date[2])) for cell in cells if (date := OPEN_DATE.match(cell))]
    day, month = (any(pair[place] > 12 for pair in found) for place in (0, 1))
    return "" if not found else "open" if day == month else "day" if day else "month"


def _without_rows(lines: Sequence[str], comments: tuple[str, ...]) -> Dialect:
    named = next(
        (row for row, line in enumerate(lines) if line.strip() and not line.lstrip().startswith(comments)), None
    )
    if named is None:
        raise ValueError("no line names columns or holds numbers")
    marks = {mark: lines[named].count(mark) for mark in SEPARATORS[:-1]}
    separator = max(marks, key=lambda mark: marks[mark])
    return Dialect(tuple(split(lines[named], separator)), separator, first=named + 1, named=named)


def _goes_on(rows: Sequence[int], lines: Sequence[str]) -> bool:
    """Return whether half of the lines behind the first of these rows are rows as well, as far as five of them."""
    behind = [row for row in range(rows[0] + 1, len(lines)) if lines[row].strip()][:5]
    return 2 * len({*behind} & {*rows}) >= len(behind)


def _names_above(
    lines: Sequence[str], start: int, fields: int, reading: _Reading, comments: tuple[str, ...]
) -> tuple[int | None, list[str], dict[str, str]]:
    """Return the place of the line of names above the first row, the names, and the units in a line below them."""
    found: dict[int, list[str]] = {}
    for row in range(start - 1, max(start - 9, -1), -1):
        if not (text := lines[row].strip()):
            continue
        mark = next((mark for mark in comments if text.startswith(mark)), "")
        if (cells := _name_cells(text[len(mark) :].strip(), fields, reading)) is not None:
            found[row] = cells
        elif found and not mark:
            break
    if not found:
        above = next((row for row in range(start - 1, -1, -1) if lines[row].strip()), None)
        cells = [] if above is None else split(lines[above], reading.separator)
        if len(cells) > 1 and "text" in map(kind_of, cells) and any(map(role_of, cells)):
            return above, cells, {}  # and none of the rows has as many fields
        return None, [], {}

    def merit(row: int) -> tuple[int, int, int]:
        cells = found[row]
        known = sum(map(is_unit, filter(None, map(_bare, cells))))
        return sum(map(bool, map(role_of, cells))), len({*cells}) - 2 * known, -row

    named = max(found, key=merit)
    names = found[named]
    below = (row for row in sorted(found) if row > named)
    units = next((row for row in below if any(map(is_unit, map(_bare, found[row])))), None)
    stated = {} if units is None else zip(names, map(_bare, found[units]), strict=True)
    return named, names, {name: unit for name, unit in stated if name and is_unit(unit)} if stated else {}


def _bare(cell: str) -> str:
    """Return a unit without the brackets around it, which those in ``m/(s^2)`` are not."""
    return cell if is_unit(cell) else cell.strip("[]()")


def _name_cells(text: str, fields: int, reading: _Reading) -> list[str] | None:
    """Return the names in a line of as many as there are fields, or one more or less that is empty; None without."""
    for separator in (reading.separator, *SEPARATORS):
        cells = split(text, separator)
        if separator == " " and len(cells) != fields:
            cells = re.split(r"\t+|[ ]{2,}", text)
        if len(cells) == fields + 1 and not cells[-1]:
            cells = cells[:-1]
        if len(cells) == fields - 1 > 0 and all(not row[-1] for row in reading.cells if len(row) == fields):
            cells = [*cells, ""]
        kinds = [kind_of(cell) for cell in cells]
        texts = kinds.count("text")
        roles = sum(map(bool, map(role_of, cells)))
        alone = texts == len(kinds) - kinds.count("missing") and separator == reading.separator
        if len(cells) == fields and texts and (alone or roles > 1 or roles == fields):
            return cells
    return None

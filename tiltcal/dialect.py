"""How a log or a device writes its lines: where the table begins, what its columns are called, and the fields of a row.

One grammar serves recorded logs, ``serial-columns`` and ``probe``. A row is fields between separators, or numbers with
the texts of a pattern around them: labels (``X: 1.5 Y: 0.2``), units, the keys of a JSON object. The clock of a serial
monitor may stand in front. What is found in the first lines holds for the whole file.
"""

from __future__ import annotations

import csv
import json
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain, pairwise
from typing import TYPE_CHECKING, Any

from tiltcal.units import is_unit, split_unit

if TYPE_CHECKING:
    import polars as pl

AXES = ("x", "y", "z")
TIME, TEMPERATURE = "time", "temperature"

HEAD_LINES = 200
"""Lines in which the table must begin."""

LONGEST_PATTERN = 2000  # characters of a line with labels
LONGEST_NAME = 200  # characters of a name that means something
FEW = 20  # lines of which all show how rows are written, not the later half of them

MISSING = frozenset({"", "nan", "+nan", "-nan", "na", "n/a", "null", "none"})
"""Cells that are a missing value, in small letters."""

COMMENTS = ("#", "//", "%")
SEPARATORS = (",", ";", "\t", "|", " ")
"""Of the fields of a row, the likeliest first; a blank stands for several."""

_DIGITS = r"(?:\d++\.?\d*+|\.\d++)(?:[eE][-+]?\d++)?"
_PRINTED = re.compile(rf"(?<![\w.^²])[-+]?{_DIGITS}(?![\w.]|\s*[:=])")
_NUMBER = re.compile(rf"[-+]?(?:{_DIGITS}|inf|infinity)", re.IGNORECASE)
WITH_COMMA = re.compile(r"[-+]?\d*,\d+(?:[eE][-+]?\d+)?")
_CLOCK = r"\d{1,2}:\d\d(?::\d\d(?:[.,:]\d+)?)?(?: ?[AaPp][Mm])?"
_MOMENT = re.compile(
    rf"\d{{1,4}}[-/.](?:\d\d?|[A-Za-z]{{3}})[-/.]\d{{1,4}}(?:[T ]+\d{{1,2}}[:.][-+:.,\dZ APMUTC]*)?|{_CLOCK}"
)
_OPEN_DATE = re.compile(r"(\d{1,2})[-/](\d{1,2})[-/](?:\d{4}|\d\d)(?!\d)")
_FRONT = re.compile(rf"\s*(?:\[((?:\d{{4}}-\d\d-\d\d[T ])?{_CLOCK})\]|({_CLOCK})(?= (?:->|>)))\s*(?:->|>)?[ \t]*")
"""What monitors of serial lines print before a line: ``12:03:11.123 -> `` or ``[12:03:11.123] ``."""
_LABEL = re.compile(r"(?<![\w.])([A-Za-z_][\w./ ]*?)[ \t]*[:=]")
_BEHIND = re.compile(r"[ \t]*[(\[]?([^\s,;|()\[\]]+)")
_MIXED = re.compile(r"\d[ \t]*+[,;|][ \t]*+[-+.\d]|\d[ \t]++[-+.\d]")
_GAPS, _MARGINS = re.compile(rb"[ \t]+"), re.compile(rb"^[ \t]+|[ \t]+(?=\r?$)", re.MULTILINE)
_SWAPPED = str.maketrans(".,", ",.")
_SPARE = bytes(code for code in range(1, 32) if code not in b"\t\n\r")

_CLOCKS = (
    "time", "t", "seconds_elapsed", "timestamp", "datetime", "date time", "date/time", "utc time", "epoch", "epoc",
    "elapsed", "time since start", "elapsed time", "timestamps", "utc", "seconds", "sec", "millis", "ms", "clock",
    "header.stamp", "field.header.stamp", "unix time", "unix_time", "system time", "local time",
    "yyyy-mo-dd hh-mi-ss_sss",
)  # fmt: skip
"""Names of a time, the best first."""
_THERMOMETER = re.compile(
    r"(?:(?:imu|sensor|chip|die|internal|accel(?:erometer)?)[ _.]*)?(?:temp(?:erature)?|celsius)", re.IGNORECASE
)
_WORDS = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+")
_GLUED = re.compile(r"(?:field\.)?(?:(a|aa|acc|accel|gf|gforce)[ _.-]?([xyz])|([xyz])[ _.-]?acc)", re.IGNORECASE)
_ACCELERATION = {"a", "acc", "accel", "accelerometer", "acceleration", "accelerations", "gforce", "gf", "lacc", "aacc"}
_OTHER_QUANTITY = re.compile(
    "g|gyro?s?|gyroscope|w|omega|angular|rot|rotation|rate|m|magn?|magnetometer|magnetic|b|field|compass|vel|velocity|pos"
    "|position|euler|q|quat|quaternion|angles?|orientation|attitude|std|var|covariance|min|max|rms|sigma|bias|offset|jerk"
)
"""Words of names that are no acceleration, or none of a sample."""


def meaning(name: str) -> str:
    """Return the role that the name of a column means, without its unit: an axis, time, temperature; else nothing."""
    name = name.strip()
    if len(name) > LONGEST_NAME:
        return ""
    if name.lower() in _CLOCKS:
        return TIME
    if _THERMOMETER.fullmatch(name):
        return TEMPERATURE
    if glued := _GLUED.fullmatch(name):
        return str(glued[2] or glued[3]).lower()
    words = [word.lower() for word in _WORDS.findall(re.sub(r"^field\.|-?axis", "", name, flags=re.IGNORECASE))]
    axes = [word for word in words if word in AXES]
    rest = {word for word in words if word not in AXES and not word.isdigit()}
    if len(axes) != 1 or any(map(_OTHER_QUANTITY.fullmatch, rest)) or (rest and not rest & _ACCELERATION):
        return ""
    return str(axes[0])


def best_time(names: Iterable[str]) -> str:
    """Return the name that means a time best, of several that do."""
    return min(names, key=lambda name: (_CLOCKS.index(split_unit(name)[0].strip().lower()), name))


def kind_of(cell: str, decimal: str = ".") -> str:
    """Return what a cell holds: ``number``, ``time``, ``missing`` or ``text``."""
    text = cell.strip()
    if text.casefold() in MISSING:
        return "missing"
    if _NUMBER.fullmatch(text) or (decimal == "," and WITH_COMMA.fullmatch(text)):
        return "number"
    return "time" if _MOMENT.fullmatch(text) else "text"


@dataclass(frozen=True)
class Pattern:
    """The texts around the numbers of a row: one before each, and one behind the last; ``keys`` of a JSON object."""

    texts: tuple[str, ...]
    keys: tuple[str, ...] = ()

    @cached_property
    def _row(self) -> re.Pattern[str]:
        parts = [r"[ \t]*".join(map(re.escape, text.split())) for text in self.texts]
        cell = rf"[ \t]*([-+]?(?:{_DIGITS}|nan|inf|null|n/a|ovf)|)[ \t]*"
        return re.compile(rf"[ \t]*{cell.join(parts)}[ \t]*", re.IGNORECASE)

    def cells(self, line: str) -> list[str] | None:
        """Return the cells of a line; None where it is none of these rows."""
        if not self.keys:
            found = self._row.fullmatch(line)
            return None if found is None else list(found.groups())
        try:
            members = flattened(json.loads(line))
        except (ValueError, RecursionError):
            return None
        return None if members.keys() - {*self.keys} else [members.get(key, "") for key in self.keys]

    def at_once(self, lines: bytes, separator: bytes) -> bytes | None:
        """Return whole lines as fields, where all of them have these texts to the letter; None where one might not.

        Each text becomes a mark of its own; rows that are sound have all the marks in their order.
        """
        texts = [text.encode() for text in self.texts]
        marks = [_SPARE[place : place + 1] for place in range(len(texts))]
        if len(texts) > len(_SPARE) or lines.translate(None, _SPARE) != lines:
            return None
        lines = b"\n" + lines
        used = [(b"\n" * (not place) + text + b"\n" * (place == len(texts) - 1), mark)
                for place, (text, mark) in enumerate(zip(texts, marks, strict=True)) if text]  # fmt: skip
        for text, mark in sorted(used, key=lambda one: -len(one[0])):
            framed = (b"\n" if text.startswith(b"\n") else b"") + mark + (b"\n" if text.endswith(b"\n") else b"")
            lines = lines.replace(text, framed)
        import numpy as np

        order = np.frombuffer(b"".join(mark for text, mark in zip(texts, marks, strict=True) if text) + b"\n", np.uint8)
        codes = np.frombuffer(lines, np.uint8)[1:]
        found = codes[(codes < 32) & (codes != 9)]
        if len(found) % len(order) or not (found.reshape(-1, len(order)) == order).all():
            return None
        outer = (marks[0] if texts[0] else b"") + (marks[-1] if texts[-1] else b"")
        table = bytes.maketrans(b"".join(marks), separator * len(marks))
        return lines[1:].translate(table, outer)


def flattened(members: Any, lead: str = "") -> dict[str, str]:
    """Return the members of a JSON object by their keys, with those of an object in it behind a point, as text."""
    if isinstance(members, list):
        members = {AXES[place] if len(members) == 3 else str(place): one for place, one in enumerate(members)}
    if not isinstance(members, dict):
        raise ValueError("no object")
    flat: dict[str, str] = {}
    for key, member in members.items():
        if isinstance(member, dict | list):
            flat |= flattened(member, f"{lead}{key}.")
        else:
            flat[lead + key] = "" if member is None else member if isinstance(member, str) else json.dumps(member)
    return flat


@dataclass(frozen=True)
class Dialect:
    """How the rows of a log are written.

    names: of its columns; their numbers from 1 where the log does not name them (``has_header`` is False).
    separator, decimal: of the fields, and the decimal mark of the numbers, as they are once the row is fields.
    has_blanks: blanks are between fields in place of the separator.
    pattern: of rows that are no fields; ``others`` are further patterns of lines, which are no rows.
    has_clock: the clock of a monitor stands in front of each line, and is the first column.
    first: the number of lines before the first row; ``head`` are these lines, ``named`` is the place of the names.
    units: of columns by name, from a line of units.
    comments: the marks behind which a line is none, but for a whole row where rows begin with text.
    kinds: what most cells of each column are, see :func:`kind_of`.
    dates: whether ``day`` or ``month`` is first in dates such as 03/04/2026; ``open`` where none shows it.
    """

    names: tuple[str, ...]
    separator: str = ","
    decimal: str = "."
    has_header: bool = True
    has_blanks: bool = False
    pattern: Pattern | None = None
    others: tuple[Pattern, ...] = ()
    has_clock: bool = False
    first: int = 1
    head: tuple[str, ...] = ()
    named: int | None = 0
    units: Mapping[str, str] = field(default_factory=dict)
    comments: tuple[str, ...] = COMMENTS
    dates: str = ""
    kinds: tuple[str, ...] = ()

    @property
    def column_names(self) -> tuple[str, ...]:
        """The names of the columns; the number of one that has none."""
        return tuple(name or str(place) for place, name in enumerate(self.names, 1))

    @property
    def is_plain(self) -> bool:
        """Whether the lines of the file are fields as they stand."""
        return not (self.has_blanks or self.has_clock or self.pattern)

    def with_point(self, cell: str) -> str:
        """Return a cell with its decimal mark as a point; a point in place of a decimal comma is no longer one."""
        return cell if self.decimal == "." else cell.translate(_SWAPPED)

    def with_points(self, cells: pl.Series, *, moments: bool = False) -> pl.Series:
        """Return cells likewise; of ``moments``, which may have a point nevertheless, points stay."""
        if self.decimal == ".":
            return cells
        marks = ([","], ["."]) if moments else ([".", ","], [",", "."])
        return cells.str.replace_many(*marks)

    def fields(self, lines: bytes) -> bytes | None:
        """Return whole lines as fields between separators, at once; None where a line might be none of the rows."""
        if self.is_plain:
            return lines
        if self.has_clock or (self.has_blanks and self.pattern is not None):
            return None
        if self.pattern is not None:
            return self.pattern.at_once(lines, self.separator.encode())
        return _GAPS.sub(self.separator.encode(), _MARGINS.sub(b"", lines))

    def fields_of(self, line: str) -> str:
        """Return one line as fields; a line that is no row is a single one, in quotes."""
        if self.is_plain:
            return line
        front, rest = without_clock(line)
        cells: list[str] | None = [rest]
        if self.pattern is not None:
            cells = self.pattern.cells(rest)
        elif self.has_blanks:
            cells = rest.split()
        if cells is None or (self.has_clock and not front):
            return in_quotes(line)
        if self.pattern is not None:
            cells = [quoted(cell, self.separator) for cell in cells]
        return self.separator.join([front.replace(",", ".")] * self.has_clock + cells)

    def no_row(self, line: str) -> str:
        """Return what a line is that is no row: ``empty``, ``comment``, ``header``, ``other``; nothing if it is one."""
        text = (without_clock(line)[1] if self.has_clock else line).strip()
        if not text:
            return "empty"
        if text in self._head:
            return "header"
        if text.startswith(self.comments) and not (
            self.kinds[:1] == ("text",) and len(split(text, self.separator)) == len(self.names)
        ):
            return "comment"
        return "other" if any(other.cells(text) is not None for other in self.others) else ""

    @cached_property
    def _head(self) -> frozenset[str]:
        lines = (line for line in self.head if not self._has_numbers(line))
        texts = ((without_clock(line)[1] if self.has_clock else line).strip() for line in lines)
        return frozenset(text for text in texts if text)

    def _has_numbers(self, line: str) -> bool:
        """Return whether a line could be a row: what stood before the table may come again as one."""
        cells = split(self.fields_of(line.strip()), self.separator)
        return len(cells) == len(self.names) and "number" in map(kind_of, cells)

    def is_other_header(self, line: str) -> bool:
        """Return whether a line inside the table names columns, other ones than those of the table."""
        cells = split(line, self.separator)
        return len(cells) > 1 and {kind_of(cell) for cell in cells} == {"text"} and any(map(_means, cells))


def in_quotes(cell: str) -> str:
    """Return a cell as CSV has it where it may hold anything."""
    return '"' + cell.replace('"', '""') + '"'


def quoted(cell: str, separator: str) -> str:
    """Return a cell as CSV has it."""
    return in_quotes(cell) if separator in cell or '"' in cell else cell


def without_clock(line: str) -> tuple[str, str]:
    """Return the clock of a monitor in front of a line, empty where there is none, and what is behind it."""
    found = _FRONT.match(line)
    return (found[1] or found[2], line[found.end() :]) if found else ("", line)


def _means(cell: str) -> str:
    return meaning(split_unit(cell)[0])


def split(line: str, separator: str) -> list[str]:
    """Return the fields of a line without the blanks around them; an unfinished quote is a character."""
    if separator == " ":
        return line.split()
    if '"' in line:
        try:
            return [cell.strip() for cell in next(csv.reader([line], delimiter=separator, strict=True), [])]
        except csv.Error:
            pass
    return [cell.strip() for cell in line.split(separator)]


def printed(line: str) -> tuple[list[str], list[str]]:
    """Return the texts around the numbers of a line, one more than numbers, and the numbers."""
    numbers = list(_PRINTED.finditer(line))
    bounds = [0, *chain(*(found.span() for found in numbers)), len(line)]
    return [line[bounds[k] : bounds[k + 1]] for k in range(0, len(bounds), 2)], [found[0] for found in numbers]


def labels_of(texts: Sequence[str]) -> list[str]:
    """Return the name of each number of a pattern, empty where no label stands before it.

    Of two labels the first is that of a group (``Gyro: X: 1 Y: 2``), which holds up to the next one; three numbers
    behind a label are x, y and z.
    """
    names, group = list[str](), ""
    for text in texts[:-1]:
        found = [label.strip() for label in _LABEL.findall(text)]
        group = found[-2] if len(found) > 1 else group
        names.append(f"{group} {found[-1]}".strip() if found else "")
    starts = [place for place, name in enumerate(names) if name or not place]
    listed = list[str]()
    for start, end in zip(starts, [*starts[1:], len(names)], strict=False):
        run = range(end - start)
        listed += [f"{names[start]} {AXES[k] if len(run) == 3 else k + 1}".strip() for k in run if len(run) > 1]
        listed += [names[start]] * (len(run) == 1)
    return listed


# --- What is found in the first lines ---


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
        commas = separator != "," and any(WITH_COMMA.fullmatch(cell) for cell in flat if cell[:1] != ",")
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
        return score, named, -fields

    def _texts(self, row: int) -> list[str]:
        return [cell for cell, kind in zip(self.cells[row], self.kinds[row], strict=True) if kind == "text"]


def dialect_of(lines: Sequence[str]) -> Dialect:
    """Return how a file is written whose first lines these are, without their ends.

    ValueError: no line names columns or holds numbers.
    """
    lines = list(lines[:HEAD_LINES])
    filled = [row for row, line in enumerate(lines) if line.strip()]
    later = filled[len(filled) // 2 if len(filled) > FEW else 0 :]  # the table is the last of the head
    fronts = [without_clock(lines[row])[0] for row in later]
    has_clock = sum(map(bool, fronts)) > len(fronts) / 2
    bodies = [without_clock(line)[1] if has_clock else line for line in lines]
    marked = Counter(mark for row in later for mark in COMMENTS if bodies[row].lstrip().startswith(mark))
    comments = tuple(mark for mark in COMMENTS if marked[mark] <= len(later) / 2)
    found = _pattern_of(bodies, later) or _table_of(bodies, later, comments)
    first = found.first
    head = tuple(lines[:first])
    if has_clock:
        clock = "clock" if any(_means(name) == TIME for name in found.names) else TIME
        numbered = not found.has_header
        names = tuple(map(str, range(2, len(found.names) + 2))) if numbered else found.names
        found = replace(found, names=(clock, *names), kinds=("time", *found.kinds), has_clock=True)
    return replace(found, head=head, comments=comments)


def _pattern_of(lines: Sequence[str], later: Sequence[int]) -> Dialect | None:
    """Return the dialect of lines with labels or of JSON objects; None where most lines are none."""
    shapes: dict[tuple[str, ...], list[int]] = {}
    for row in later:
        line = lines[row].strip()
        if len(line) > LONGEST_PATTERN:
            continue
        texts, numbers = printed(line)
        keys = _keys(line)
        framed = any(map(_LABEL.search, texts[:-1])) or texts[0].strip() in ("[", "(", "<", "{")
        if keys or (numbers and framed and not _MOMENT.match(line)):
            shapes.setdefault(keys or tuple("".join(text.split()) for text in texts), []).append(row)
    if 2 * sum(map(len, shapes.values())) <= len(later):
        return None
    patterns = {shape: _common(lines, rows) for shape, rows in shapes.items()}
    patterns = {
        shape: pattern
        for shape, pattern in patterns.items()
        if any(pattern.cells(lines[row].strip()) is not None for row in shapes[shape])
    }
    if not patterns:
        return None

    def merit(shape: tuple[str, ...]) -> tuple[int, int]:
        axes = {_means(name) for name in _names_of(patterns[shape])} & {*AXES}
        return len(axes), len(shapes[shape])

    best = max(patterns, key=merit)
    pattern, names = patterns[best], _names_of(patterns[best])
    first = next(row for row, line in enumerate(lines) if pattern.cells(line.strip()) is not None)
    others = tuple(
        patterns[shape] for shape in patterns if shape != best and (len(shapes[shape]) > 1 or len(later) < 9)
    )
    listed = _distinct([name or str(place) for place, name in enumerate(names, 1)])
    behind = [found[1] if (found := _BEHIND.match(text)) and is_unit(found[1]) else "" for text in pattern.texts[1:]]
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


def _common(lines: Sequence[str], rows: Sequence[int]) -> Pattern:
    """Return the pattern of lines that differ in numbers and blanks alone: with the blanks of most of them."""
    texts = Counter(tuple(printed(lines[row])[0]) for row in rows).most_common(1)[0][0]
    return Pattern(texts, _keys(lines[rows[0]].strip()))


def _names_of(pattern: Pattern) -> list[str]:
    return [*pattern.keys] or labels_of(pattern.texts)


def _distinct(names: Sequence[str]) -> tuple[str, ...]:
    """Return names, numbered from the second of a kind on."""
    seen: Counter[str] = Counter()
    listed = []
    for name in names:
        seen[name] += 1
        listed.append(name if seen[name] == 1 else f"{name} {seen[name]}")
    return tuple(listed)


def _table_of(lines: Sequence[str], later: Sequence[int], comments: tuple[str, ...]) -> Dialect:
    """Return the dialect of lines with fields between separators."""
    plain = [row for row in later if not lines[row].lstrip().startswith(comments)]
    readings = [_Reading.of(lines, separator) for separator in SEPARATORS]
    best = max(readings, key=lambda reading: reading.merit(plain))
    score, fields = best.count(plain)
    if score <= 0:  # no line has a number: the first one that is no comment names the columns of what follows
        return _without_rows(lines, comments)
    filled = [best.kinds[row] for row in plain if len(best.kinds[row]) == fields]
    columns = [Counter(kinds[k] for kinds in filled if {*kinds} & {"number", "time"}) for k in range(fields)]
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
    found = [(int(date[1]), int(date[2])) for cell in cells if (date := _OPEN_DATE.match(cell))]
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
        if len(cells) > 1 and "text" in map(kind_of, cells) and any(map(_means, cells)):
            return above, cells, {}  # and none of the rows has as many fields
        return None, [], {}

    def merit(row: int) -> tuple[int, int, int]:
        cells = found[row]
        known = sum(map(is_unit, filter(None, (cell.strip("[]()") for cell in cells))))
        return sum(map(bool, map(_means, cells))), len({*cells}) - 2 * known, -row

    named = max(found, key=merit)
    names = found[named]
    below = (row for row in sorted(found) if row > named)
    units = next((row for row in below if any(is_unit(cell.strip("[]()")) for cell in found[row])), None)
    stated = {} if units is None else zip(names, (cell.strip("[]()") for cell in found[units]), strict=True)
    return named, names, {name: unit for name, unit in stated if name and is_unit(unit)} if stated else {}


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
        roles = sum(map(bool, map(_means, cells)))
        alone = texts == len(kinds) - kinds.count("missing") and separator == reading.separator
        if len(cells) == fields and texts and (alone or roles > 1 or roles == fields):
            return cells
    return None

"""The rows of a CSV log, character by character, as the written rule in ``docs/reference`` has them.

Slow and independent of the readers of tiltcal, which tests compare with it. Quotes must stand at the ends of fields.
"""

import re
from math import inf, nan

_NUMBER = re.compile(r"[+-]?(\d+(\.\d+)?|\.\d+)([eE][+-]?\d+)?")
_INFINITE = re.compile(r"([+-]?)(inf|infinity)", re.IGNORECASE)
_MISSING = ("", "nan", "+nan", "-nan", "na", "n/a", "null", "none")


def cells_of(text: str) -> list[list[str]]:
    """Return the fields of each row; an empty line is none."""
    rows: list[list[str]] = []
    row, cell, quoted = [], "", False
    place = 0
    while place < len(text):
        character = text[place]
        if quoted and text.startswith('""', place):
            cell += '"'
            place += 1
        elif character == '"':
            quoted = not quoted
        elif character == "," and not quoted:
            row.append(cell)
            cell = ""
        elif character == "\n" and not quoted:
            cell = cell.removesuffix("\r")
            rows += [[*row, cell]] if row or cell else []
            row, cell = [], ""
        else:
            cell += character
        place += 1
    return rows


def number_of(cell: str) -> float | None:
    """Return the number in a cell, NaN where it is missing, and None where it is none."""
    cell = cell.strip(" \t")
    if cell.lower() in _MISSING:
        return nan
    if found := _INFINITE.fullmatch(cell):
        return -inf if found[1] == "-" else inf
    return float(cell) if _NUMBER.fullmatch(cell) else None


def readings_of(text: str, fields: int, columns: list[int]) -> tuple[list[list[float]], set[int]]:
    """Return the numbers of each column and the rows that cannot be parsed, which are NaN in every column."""
    values: list[list[float]] = [[] for _ in columns]
    bad = set()
    for place, row in enumerate(cells_of(text)):
        numbers = [number_of(row[column]) for column in columns] if len(row) == fields else [None]
        wrong = None in numbers or any("\r" in cell or "\0" in cell for cell in row)
        if wrong:
            bad.add(place)
        for column, value in zip(values, [nan] * len(columns) if wrong else numbers, strict=True):
            column.append(nan if value is None else value)
    return values, bad

"""Small tables in CSV or JSON, read as strictly as YAML: an error names file, line and column."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from io import StringIO
from pathlib import Path
from typing import Any

from tiltcal.errors import InputError
from tiltcal.files.document import parse_document, read_text
from tiltcal.files.node import Node, Scalar, document_of

_NUMBER = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]+)?)([eE][-+]?[0-9]+)?")


Table = str | Path | Sequence[Mapping[str, Any]]
"""A file of CSV, or of a JSON list of objects; or such rows."""


def table_rows(table: Table, file: str | Path, keys: Mapping[str, bool]) -> Iterator[Node]:
    """Read a small table; a blank field of CSV is an absent one.

    Parameters
    ----------
    file : str or Path
        What messages call it.
    keys : mapping of str to bool
        The columns, and whether each is needed.

    Yields
    ------
    Node
        A mapping, with its line.

    Raises
    ------
    InputError
        The header has an unknown column, one twice, or lacks one; a row has another number of fields; or the text is
        neither CSV nor JSON.
    """
    required = [key for key, needed in keys.items() if needed]
    optional = [key for key, needed in keys.items() if not needed]
    if not isinstance(table, str | Path):
        rows: Iterable[Node] = document_of(list(table), str(file)).items()
    elif (text := read_text(table)).lstrip().startswith(("[", "{")):  # a CSV header begins with a name
        rows = parse_document(text, str(file), "JSON").items()
    else:
        rows = _csv_rows(text, str(file), required, optional)
    for row in rows:
        row.mapping(required=required, optional=optional)
        yield row


def _csv_rows(text: str, file: str, required: Sequence[str], optional: Sequence[str]) -> Iterator[Node]:
    rows = csv.reader(StringIO(text, newline=""), strict=True)
    try:
        header = [name.strip() for name in next(rows, [])]
        _check_header(header, file, required, optional)
        line = rows.line_num + 1
        for row in rows:
            if row:
                yield _record(header, row, file, line)
            line = rows.line_num + 1
    except csv.Error as failure:
        raise InputError(f"not CSV: {failure}", file=file, line=rows.line_num) from None


def _check_header(header: list[str], file: str, required: Sequence[str], optional: Sequence[str]) -> None:
    if not header:
        raise InputError("the file is empty", file=file)
    if len(header) == 1 and any(mark in header[0] for mark in ";\t"):
        why = f"the header {header[0]!r} is a single column: separate the columns with commas"
        raise InputError(why, file=file, line=1)
    twice = [name for name in header if header.count(name) > 1]
    if twice:
        raise InputError(f"the column {twice[0]!r} is there twice", file=file, line=1)
    Node({name: Node(Scalar("", True), file, 1, name) for name in header}, file, 1, None).mapping(
        required=required, optional=optional
    )


def _record(header: list[str], row: list[str], file: str, line: int) -> Node:
    if len(row) != len(header):
        raise InputError(f"the row has {len(row)} fields, the header {len(header)}", file=file, line=line)
    fields = {
        name: Node(Scalar(field.strip(), plain=_NUMBER.fullmatch(field.strip()) is not None), file, line, name)
        for name, field in zip(header, row, strict=True)
        if field.strip()
    }
    return Node(fields, file, line, None)

"""Small tables in CSV or JSON, read as strictly as YAML: an error names file, line and column."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from io import StringIO
from pathlib import Path
from typing import Any

from tiltcal.errors import InputError
from tiltcal.files.document import Document, document_of, parse_document, read_text
from tiltcal.files.refusal import Quoted

_NUMBER = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]+)?)([eE][-+]?[0-9]+)?")

Table = str | Path | Sequence[Mapping[str, Any]]
"""A file of CSV, or of a JSON list of objects; or such rows."""


def table_rows(table: Table, file: str | Path, keys: Mapping[str, bool]) -> Iterator[Document]:
    """Read a small table and yield its rows, each with its line; a blank field of CSV is an absent one.

    ``file`` is what messages call it; ``keys`` are the columns, and whether each is needed. An InputError where the
    header or a row does not fit them, or the text is neither CSV nor JSON.
    """
    if not isinstance(table, str | Path):
        rows: Iterable[Document] = document_of(list(table), str(file)).items()
    elif (text := read_text(table)).lstrip().startswith(("[", "{")):  # a CSV header begins with a name
        rows = parse_document(text, str(file), "JSON").items()
    else:
        rows = _csv_rows(text, str(file), keys)
    for row in rows:
        _require_columns(row, keys)
        yield row


def _require_columns(row: Document, keys: Mapping[str, bool]) -> None:
    row.require_keys(row.members(), [*sorted(keys, key=lambda name: not keys[name])])
    needed = [name for name, is_needed in keys.items() if is_needed]
    row.require_keys([name for name in needed if row.data.get(name) is not None], needed, complete=True)


def _csv_rows(text: str, file: str, keys: Mapping[str, bool]) -> Iterator[Document]:
    rows = csv.reader(StringIO(text, newline=""), strict=True)
    try:
        header = [name.strip() for name in next(rows, [])]
        _check_header(header, file, keys)
        line = rows.line_num + 1
        for row in rows:
            if row and len(row) != len(header):
                raise InputError(f"the row has {len(row)} fields, the header {len(header)}", file=file, line=line)
            if row:
                fields = {name: field.strip() for name, field in zip(header, row, strict=True) if field.strip()}
                data = {name: field if _NUMBER.fullmatch(field) else Quoted(field) for name, field in fields.items()}
                yield Document(data, {(): line}, file)
            line = rows.line_num + 1
    except csv.Error as failure:
        raise InputError(f"not CSV: {failure}", file=file, line=rows.line_num) from None


def _check_header(header: list[str], file: str, keys: Mapping[str, bool]) -> None:
    if not header:
        raise InputError("the file is empty", file=file)
    if len(header) == 1 and any(mark in header[0] for mark in ";\t"):
        why = f"the header {header[0]!r} is a single column: separate the columns with commas"
        raise InputError(why, file=file, line=1)
    twice = [name for name in header if header.count(name) > 1]
    if twice:
        raise InputError(f"the column {twice[0]!r} is there twice", file=file, line=1)
    _require_columns(Document(dict.fromkeys(header, ""), {(): 1}, file), keys)

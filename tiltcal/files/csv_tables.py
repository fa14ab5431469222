"""Small tables in CSV, read as strictly as our YAML: every cell knows its file, line and column."""

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

_NUMBER = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")


def table_records(
    table: str | Path | Sequence[Mapping[str, Any]], file: str | Path, required: Sequence[str], optional: Sequence[str]
) -> Iterable[Node]:
    """Return the rows of a small table as mappings.

    Parameters
    ----------
    table : str, Path or sequence of mapping
        A file of CSV, or of a JSON list of objects; or the rows.
    file : str or Path
        What messages call it.
    required, optional : sequence of str
        The columns that a header of CSV must and may have; the keys of other rows are for the caller to check.

    Raises
    ------
    InputError
        The text is neither CSV nor a JSON list, or its header is wrong.
    """
    if not isinstance(table, str | Path):
        return document_of(list(table), str(file)).items()
    text = read_text(table)
    if text.lstrip().startswith(("[", "{")):  # a CSV header begins with a name
        return parse_document(text, str(file)).items()
    return csv_records(text, str(file), required=required, optional=optional)


def csv_records(text: str, file: str, *, required: Sequence[str], optional: Sequence[str] = ()) -> Iterator[Node]:
    """The rows as mappings, as a JSON list of objects would give them; a blank field is an absent one.

    Parameters
    ----------
    text : str
    file : str
        As the user named it.
    required, optional : sequence of str
        The columns that the header must and may have.

    Yields
    ------
    Node

    Raises
    ------
    InputError
        The header has an unknown column, one twice, or lacks one; a row has another number of fields; or the text is
        no CSV.
    """
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

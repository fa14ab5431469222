"""The procedure file: its keys, and the shipped procedures and those of a user by name or path."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from difflib import get_close_matches
from importlib.resources import files
from pathlib import Path
from typing import Any

from tiltcal.errors import UsageError
from tiltcal.files.document import Document, document_of, read_document
from tiltcal.files.procedure import Determines, Procedure, ProcedureFile, chosen_angle, procedure_of
from tiltcal.stated_arguments import require_path


def shipped_procedures() -> dict[str, Path]:
    """Return the files of the procedures that come with tiltcal, by name."""
    folder = Path(str(files("tiltcal.procedures")))
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def find_procedure(name_or_path: str | Path, angle: float | None = None) -> Procedure:
    """Return a shipped procedure by its name, which comes first, or a user's by its path, such as ``./plane``.

    ``angle`` takes the place of the angle that the procedure leaves free, degrees.

    UsageError: no such procedure, or an angle that it cannot take.
    InputError: the file is wrong; the message names file, line and key.
    """
    require_path("PROCEDURE", name_or_path)
    shipped = shipped_procedures()
    if name_or_path in shipped:
        return read_procedure(shipped[name_or_path], angle)
    if os.path.exists(name_or_path):
        return read_procedure(name_or_path, angle)
    near = get_close_matches(str(name_or_path), shipped, n=3, cutoff=0.4)
    hint = f"did you mean {' or '.join(map(repr, near))}?" if near else f"there are {', '.join(shipped)}"
    raise UsageError(f"unknown procedure {str(name_or_path)!r}, and no such file; {hint}")


def read_procedure(path: str | Path, angle: float | None = None) -> Procedure:
    """Read and check a procedure file; ``angle`` is as in :func:`find_procedure`, and so are the errors."""
    return procedure_in(read_document(path), angle)


def procedure_from_record(
    record: Mapping[str, Any], angle: float | None = None, *, file: str | None = None, line: int | None = None
) -> Procedure:
    """Return the procedure of a journal's header, from its :attr:`Procedure.record` and the angle that was given.

    Errors name ``file`` and ``line``, where the record stands.
    """
    return procedure_in(document_of(record, file, line), angle)


def procedure_in(document: Document, angle: float | None = None) -> Procedure:
    """Return the procedure of a document; an InputError names file, line and key."""
    body = document.body("procedure")
    if "rotation" not in body.data:
        procedure = procedure_of(body.read(ProcedureFile), body, angle)
    else:
        from tiltcal.files.rotation import RotationFile, check_rotation

        file = body.read(RotationFile)
        check_rotation(file.rotation, body.child("rotation"))
        stated = {name: getattr(file, name) for name in file.__struct_fields__}
        angle = chosen_angle(file.name, None, angle)
        procedure = Procedure(determines=Determines(()), positions=(), angle=angle, **stated)
    return replace(procedure, record=document.plain())

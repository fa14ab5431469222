"""The procedure file: its keys, and the shipped procedures and those of a user by name or path."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from difflib import get_close_matches
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tiltcal.core.gravity_direction import LEVEL
from tiltcal.errors import UsageError
from tiltcal.files.declaration import Context, Converted, Either, Format, Imported, Section, entry
from tiltcal.files.document import read_document
from tiltcal.files.node import Node, document_of
from tiltcal.files.procedure import (
    IDENTIFIER,
    Determines,
    Procedure,
    chosen_angle,
)
from tiltcal.files.scalars import Text
from tiltcal.stated_arguments import require_path

if TYPE_CHECKING:
    from tiltcal.files.rotation import Rotation


def shipped_procedures() -> dict[str, Path]:
    """Return the files of the procedures that come with tiltcal, by name."""
    folder = Path(str(files("tiltcal.procedures")))
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def find_procedure(name_or_path: str | Path, angle: float | None = None) -> Procedure:
    """Return a shipped procedure by its name, or a user's by its path.

    Parameters
    ----------
    name_or_path : str or Path
        A shipped name comes first; write ``./plane`` for a file of that name.
    angle : float, optional
        In place of the angle that the procedure leaves free, degrees.

    Raises
    ------
    UsageError
        No such procedure, or an angle that it cannot take.
    InputError
        The file is wrong; the message names file, line and key.
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
    return PROCEDURE.read(read_document(path), Context(given=angle))


def procedure_from_record(
    record: Mapping[str, Any], angle: float | None = None, *, file: str | None = None, line: int | None = None
) -> Procedure:
    """Return the procedure of a journal's header, from its :attr:`Procedure.record` and the angle that was given.

    Errors name ``file`` and ``line``, where the record stands.
    """
    return PROCEDURE.read(document_of(record, file, line), Context(given=angle))


def _of_positions(found: Procedure, node: Node, context: Context) -> Procedure:
    if (found.determines.drift or found.determines.gain) and found.reference is None:
        raise node.entries()["determines"].error(
            "temperature terms need the key 'reference', the temperature that they are counted from"
        )
    if found.ramp is not None:
        _require_ramp(found, node)
    if found.determines.level:
        for item, position in zip(node.entries()["positions"].items(), found.positions, strict=True):
            if position.gravity != LEVEL:
                raise item.error("a position that renews the offset is level: tilt: {x: 0, y: 0}")
    return replace(found, angle=chosen_angle(found.name, found.angle, context.given), record=node.plain())


def _require_ramp(found: Procedure, node: Node) -> None:
    """Refuse a ramp that does not go up and down in one attitude."""
    entries = node.entries()
    if found.determines.axes or not found.determines.drift or found.determines.gain:
        raise entries["determines"].error("a ramp determines the drift of the offset alone: axes: [], drift: 3")
    for position, item in zip(found.positions, entries["positions"].items(), strict=True):
        if position.temperature is None or position.gravity != found.positions[0].gravity:
            raise item.error("the positions of a ramp have one attitude, and each a temperature at which it turns")


@dataclass(frozen=True, kw_only=True)
class RotationProcedure:
    """A procedure of a stage that turns, as it stands in a file."""

    name: str = entry(IDENTIFIER, "a letter, then letters, digits, `-`, `_`, `.`")
    title: str = entry(Text(), "what it is for, in one line")
    source: str = entry(Text(), "the document it comes from", default="")
    rotation: Rotation = entry(
        Imported("tiltcal.files.rotation", "ROTATION"), "which pairs are matched while the stage turns"
    )


def _of_rotation(found: RotationProcedure, node: Node, context: Context) -> Procedure:
    return Procedure(
        **vars(found),
        determines=Determines(()),
        positions=(),
        angle=chosen_angle(found.name, None, context.given),
        record=node.plain(),
    )


def _with_angle(key: str, found: Mapping[str, Any], context: Context) -> Context:
    """Return the context with the angle that the positions may name."""
    if key != "angle":
        return context
    return replace(context, angle=chosen_angle(found["name"], found.get("angle"), context.given))


PROCEDURE: Format[Procedure] = Either(
    "rotation",
    Converted(Section(Procedure, follow=_with_angle, kind="procedure"), _of_positions),
    Converted(Section(RotationProcedure, kind="procedure"), _of_rotation),
)
"""The procedure file."""

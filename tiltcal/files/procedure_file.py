"""The procedure file: its keys, and the shipped procedures and those of a user by name or path."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import replace
from difflib import get_close_matches
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tiltcal.core.gravity_direction import gravity_from_tilt, normalised
from tiltcal.errors import UsageError
from tiltcal.files.declaration import (
    ANY,
    FROM_ZERO,
    ByKey,
    Context,
    Converted,
    Either,
    Format,
    Imported,
    Integer,
    ListOf,
    Number,
    Section,
    Text,
    entry,
)
from tiltcal.files.document import checked_kind, read_tiltcal_file
from tiltcal.files.node import Node, document_of
from tiltcal.files.procedure import (
    IDENTIFIER,
    TEMPERATURE,
    Determines,
    Position,
    Procedure,
    Ramp,
    Soak,
    chosen_angle,
)
from tiltcal.frozen import frozen

if TYPE_CHECKING:
    from tiltcal.files.rotation import Rotation

LEVEL = (0.0, 0.0, 1.0)
"""Up in the application's frame where it is level."""

_PLACEHOLDER = re.compile(r"\{([^{}]*)\}")


def _consistent(found: Determines, node: Node, context: Context) -> Determines:
    orders = found.drift or found.gain or found.nonlinearity
    for what, asked in (("mounting", found.mounting), ("level", found.level)):
        if asked and (found.axes or orders or (found.mounting and found.level)):
            raise node.error(f"a procedure that determines the {what} determines nothing else: axes is [] there")
    if found.cross_validated and not found.drift:
        raise node.error("an order that is chosen by cross-validation needs the key 'drift', the highest order")
    if found.free and (len(found.axes) < 3 or orders or found.mounting):
        raise node.error("free positions determine the axes [x, y, z] and nothing else: unit gravity says no more")
    return found


@frozen
class SetAngle(Format[float]):
    """An angle in degrees, or ``angle`` and ``-angle`` for the one of the procedure."""

    def read(self, node: Node, context: Context = ANY) -> float:
        if not node.names("angle", "-angle"):
            return node.number()
        if context.angle is None:
            raise node.error("the procedure gives no angle; add 'angle: 30' to it, or write degrees here")
        return context.angle if node.text() == "angle" else -context.angle

    def schema(self) -> dict[str, Any]:
        return {"anyOf": [{"type": "number"}, {"enum": ["angle", "-angle"]}]}


@frozen(kw_only=True)
class PositionSection:
    """One of ``positions`` as it stands in a file."""

    name: str = entry(IDENTIFIER, "unique; a letter, then letters, digits, `-`, `_`, `.`")
    prompt: str = entry(Text(), "the operator's sentence, in which `{angle}` and `{temperature}` are filled in")
    tilt: Mapping[str, float] | None = entry(
        ByKey(SetAngle(), ("x", "y")), "degrees per axis, or `angle` and `-angle`; or else `gravity`", default=None
    )
    gravity: tuple[float, ...] | None = entry(
        ListOf(Number(), 3, 3, says="a direction has three components, found {found}"),
        "`[gx, gy, gz]`, the direction that points up in the sensor frame; it is normalised",
        default=None,
    )
    heading: float | None = entry(
        Number(),
        "how far the fixture is turned about the vertical, degrees; where headings differ, the table's own lean is "
        "estimated too and does not end up in the offset",
        default=None,
    )
    temperature: float | None = entry(TEMPERATURE, "°C", default=None)
    stage: float | None = entry(
        Number(),
        "angle of the rotary stage, degrees; no estimate uses it",
        default=None,
    )


def _position_of(section: PositionSection, node: Node, context: Context) -> Position:
    entries, tilt = node.entries(), section.tilt
    if (section.tilt is None) == (section.gravity is None):
        raise node.error("a position has either tilt: {x: degrees, y: degrees} or gravity: [gx, gy, gz]")
    known = {"angle": context.angle, "temperature": section.temperature}
    return Position(
        name=section.name,
        prompt=_filled_in(section.prompt, entries["prompt"], known),
        gravity=entries["gravity"].converted(normalised, section.gravity or ())
        if tilt is None
        else entries["tilt"].converted(gravity_from_tilt, tilt),
        tilt=tilt,
        heading=section.heading,
        temperature=section.temperature,
        stage=section.stage,
    )


def _distinct(positions: tuple[Position, ...], node: Node, context: Context) -> tuple[Position, ...]:
    names = [position.name for position in positions]
    for number, item in enumerate(node.items()):
        if names[number] in names[:number]:
            raise item.error(f"a position named {names[number]!r} is there already; names are unique")
    return positions


@frozen(kw_only=True)
class PositionsProcedure:
    """A procedure of positions as it stands in a file."""

    name: str = entry(IDENTIFIER, "a letter, then letters, digits, `-`, `_`, `.`")
    title: str = entry(Text(), "what it is for, in one line")
    source: str = entry(Text(), "the document it comes from", default="")
    determines: Determines = entry(
        Converted(Section(Determines), _consistent), "what the positions determine besides the offset"
    )
    reference: float | None = entry(TEMPERATURE, "reference temperature, °C; needed with drift or gain", default=None)
    angle: float | None = entry(
        Number(above=0.0, maximum=90, says="an angle of {found:g}° is more than 90°"),
        "the angle that positions may call `angle` or `-angle`, degrees; `--tilt` takes its place",
        default=None,
    )
    alignment: float = entry(
        FROM_ZERO,
        "with `level`: by how much at most the sensor may sit askew since its calibration, degrees about each axis; "
        "`--alignment` takes its place",
        default=0.0,
    )
    samples: int = entry(Integer(minimum=2), "samples a position", default=100)
    settle: float = entry(Number(above=0.0), "seconds over which the reading must hold still", default=2.0)
    soak: Soak = entry(
        Section(Soak),
        "at a new temperature: the window, seconds, and the largest drift in it, °C",
        default=Soak(seconds=20.0, drift=0.3),
        usual="`{seconds: 20, drift: 0.3}`",
    )
    ramp: Ramp | None = entry(
        Section(Ramp),
        "the sensor is sampled without a break, in one attitude, while the temperature goes from position to position",
        default=None,
    )
    positions: tuple[Position, ...] = entry(
        Converted(
            ListOf(
                Converted(Section(PositionSection), _position_of),
                1,
                says="the list is empty; a procedure has at least one position",
            ),
            _distinct,
        ),
        "in order",
    )


def shipped_procedures() -> dict[str, Path]:
    """Return the files of the procedures that come with tiltcal, by name."""
    folder = Path(str(files("tiltcal.procedures")))
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def find_procedure(name_or_path: str, angle: float | None = None) -> Procedure:
    """Return a shipped procedure by its name, or a user's by its path.

    Parameters
    ----------
    name_or_path : str
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
    shipped = shipped_procedures()
    if name_or_path in shipped:
        return read_procedure(shipped[name_or_path], angle)
    if os.path.exists(name_or_path):
        return read_procedure(name_or_path, angle)
    near = get_close_matches(name_or_path, shipped, n=3, cutoff=0.4)
    hint = f"did you mean {' or '.join(map(repr, near))}?" if near else f"there are {', '.join(shipped)}"
    raise UsageError(f"unknown procedure {name_or_path!r}, and no such file; {hint}")


def read_procedure(path: str | Path, angle: float | None = None) -> Procedure:
    """Read and check a procedure file.

    Parameters
    ----------
    angle : float, optional
        In place of the angle that the procedure leaves free, degrees.

    Raises
    ------
    InputError
        Anything in it is wrong; the message names file, line and key.
    UsageError
        An angle that the procedure cannot take.
    """
    return PROCEDURE.read(read_tiltcal_file(path, "procedure"), Context(given=angle))


def procedure_from_record(
    record: Mapping[str, Any], angle: float | None = None, *, file: str | None = None, line: int | None = None
) -> Procedure:
    """Return the procedure of a journal's header.

    Parameters
    ----------
    record : mapping
        :attr:`Procedure.record` of the procedure that was run.
    angle : float, optional
        As it was given then, degrees.
    file, line
        Where the record stands, for messages.

    Raises
    ------
    InputError
        Anything in it is wrong.
    UsageError
        An angle that the procedure cannot take.
    """
    return PROCEDURE.read(checked_kind(document_of(record, file, line), "procedure"), Context(given=angle))


def _of_positions(found: PositionsProcedure, node: Node, context: Context) -> Procedure:
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
    return Procedure(
        name=found.name,
        title=found.title,
        source=found.source,
        determines=found.determines,
        positions=found.positions,
        angle=chosen_angle(found.name, found.angle, context.given),
        reference=found.reference,
        samples=found.samples,
        settle=found.settle,
        soak_seconds=found.soak.seconds,
        soak_drift=found.soak.drift,
        alignment=found.alignment,
        ramp=found.ramp,
        record=node.plain(),
    )


def _require_ramp(found: PositionsProcedure, node: Node) -> None:
    """Refuse a ramp that does not go up and down in one attitude."""
    entries = node.entries()
    if found.determines.axes or not found.determines.drift or found.determines.gain:
        raise entries["determines"].error("a ramp determines the drift of the offset alone: axes: [], drift: 3")
    for position, item in zip(found.positions, entries["positions"].items(), strict=True):
        if position.temperature is None or position.gravity != found.positions[0].gravity:
            raise item.error("the positions of a ramp have one attitude, and each a temperature at which it turns")


@frozen(kw_only=True)
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
        name=found.name,
        title=found.title,
        source=found.source,
        determines=Determines(()),
        positions=(),
        angle=chosen_angle(found.name, None, context.given),
        record=node.plain(),
        rotation=found.rotation,
    )


def _with_angle(key: str, found: Mapping[str, Any], context: Context) -> Context:
    """Return the context with the angle that the positions may name."""
    if key != "angle":
        return context
    return replace(context, angle=chosen_angle(found["name"], found.get("angle"), context.given))


PROCEDURE: Format[Procedure] = Either(
    "rotation",
    Converted(Section(PositionsProcedure, follow=_with_angle, kind="procedure"), _of_positions),
    Converted(Section(RotationProcedure, kind="procedure"), _of_rotation),
)
"""The procedure file."""


def _filled_in(prompt: str, node: Node, values: Mapping[str, float | None]) -> str:
    """Return the operator's sentence with ``{angle}`` and ``{temperature}`` filled in."""

    def value_of(found: re.Match[str]) -> str:
        value = values.get(found.group(1))
        if value is None:
            known = " or ".join(f"{{{name}}}" for name, value in values.items() if value is not None)
            raise node.error(f"{found.group()} has no value here; the prompt may use {known or 'none'}")
        return f"{value:g}"

    return _PLACEHOLDER.sub(value_of, prompt)

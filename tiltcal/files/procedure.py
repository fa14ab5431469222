"""Procedures as data: the positions in order, the operator's sentence for each, and what they determine."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tiltcal.core.frames import Vector, gravity_from_tilt, normalised
from tiltcal.errors import InputError, UsageError
from tiltcal.files.document import checked_kind, read_tiltcal_file
from tiltcal.files.node import Node, document_of

if TYPE_CHECKING:
    from tiltcal.files.rotation import Rotation

ORDER_LIMIT = 6
"""The highest order of a temperature polynomial."""
ABSOLUTE_ZERO = -273.15
"""°C."""

_NAME = re.compile(r"[^\W\d_][\w.-]*")
_PLACEHOLDER = re.compile(r"\{([^{}]*)\}")


@dataclass(frozen=True)
class Determines:
    """What the positions of a procedure determine besides the offset.

    Attributes
    ----------
    axes : tuple of str
        Columns of the sensitivity matrix.
    drift, gain : int
        Orders of the temperature polynomials of offset and sensitivity; 0 where there is none.
    nonlinearity : int
        0 for a straight line, 1 for a square, 2 for a square and a cube.
    cross_validated : bool
        Whether the order of the drift is chosen by cross-validation, ``drift`` being the highest.
    mounting : bool
        Whether the positions are the application's, and show how a calibrated sensor sits in it.
    free : bool
        Whether nobody sets the positions, so that what is known of each is that gravity is 1 g. Their directions are
        proposals to the operator.
    """

    axes: tuple[str, ...]
    drift: int = 0
    gain: int = 0
    nonlinearity: int = 0
    mounting: bool = False
    cross_validated: bool = False
    free: bool = False


@dataclass(frozen=True)
class Position:
    """One position that the sensor is brought to.

    Attributes
    ----------
    name : str
        Unique in its procedure.
    prompt : str
        What the operator is asked to do.
    gravity : tuple of float
        Up in the sensor frame, a unit vector.
    tilt : mapping of str to float or None
        Per axis, degrees; None where the position is given by its direction of gravity.
    heading : float or None
        How far the fixture is turned about the vertical, degrees.
    temperature : float or None
        °C.
    stage : float or None
        Angle of the rotary stage, degrees.
    """

    name: str
    prompt: str
    gravity: Vector
    tilt: Mapping[str, float] | None = None
    heading: float | None = None
    temperature: float | None = None
    stage: float | None = None


@dataclass(frozen=True)
class Procedure:
    """What is done at the bench, in order.

    Attributes
    ----------
    name, title, source : str
    determines : Determines
    positions : tuple of Position
    angle : float or None
        The angle that positions use by name, degrees; None where the procedure leaves no angle free.
    reference : float or None
        Reference temperature, °C.
    samples : int
        Per position.
    settle : float
        Time over which a reading must hold still, seconds.
    soak_seconds, soak_drift : float
        At a position with a temperature: the window, seconds, and the largest drift in it, °C.
    record : mapping
        The procedure as plain data, before ``angle`` and the turns were put in.
    rotation : Rotation or None
        What is done while a stage turns, in place of positions; such a procedure has none, and determines no tilt.
    """

    name: str
    title: str
    source: str
    determines: Determines
    positions: tuple[Position, ...]
    angle: float | None = None
    reference: float | None = None
    samples: int = 100
    settle: float = 2.0
    soak_seconds: float = 20.0
    soak_drift: float = 0.3
    record: Mapping[str, Any] = field(default_factory=dict, compare=False)
    rotation: Rotation | None = None

    def require_positions(self) -> None:
        """Refuse a procedure of a stage that turns, where positions are needed.

        Raises
        ------
        UsageError
            With the commands that are meant for it.
        """
        if self.rotation is not None:
            raise UsageError(
                f"{self.name} has no positions, its stage turns: match the pairs of a recorded log with `tiltcal "
                f"match`, or at the bench with `tiltcal measure {self.name}`"
            )

    def with_turns(self, turns: int | None) -> Procedure:
        """This procedure with so many turns at most; None leaves it as it is.

        Raises
        ------
        UsageError
            No stage turns in it, or the number cannot be.
        """
        if turns is None:
            return self
        if self.rotation is None:
            raise UsageError(f"the procedure {self.name!r} has positions and no turns; leave --turns out")
        from tiltcal.files.rotation import require_turns

        return replace(self, rotation=replace(self.rotation, turns=require_turns(turns)))


def shipped_procedures() -> dict[str, Path]:
    """The files of the procedures that come with tiltcal, by name."""
    folder = Path(str(files("tiltcal.procedures")))
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def find_procedure(name_or_path: str, angle: float | None = None) -> Procedure:
    """A shipped procedure by its name, or a user's by its path.

    Parameters
    ----------
    name_or_path : str
        A shipped name comes first; write ``./plane`` for a file of that name.
    angle : float, optional
        In place of the angle that the procedure leaves free, degrees.

    Returns
    -------
    Procedure

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
    path : str or Path
    angle : float, optional
        In place of the angle that the procedure leaves free, degrees.

    Raises
    ------
    InputError
        Anything in it is wrong; the message names file, line and key.
    UsageError
        An angle that the procedure cannot take.
    """
    return _procedure_of(read_tiltcal_file(path, "procedure"), angle)


def procedure_from_record(
    record: Mapping[str, Any], angle: float | None = None, *, file: str | None = None, line: int | None = None
) -> Procedure:
    """The procedure that a journal's header holds.

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
    return _procedure_of(checked_kind(document_of(record, file, line), "procedure"), angle)


def _procedure_of(document: Node, angle: float | None) -> Procedure:
    if "rotation" in document.entries():
        return _turning_of(document, angle)
    top = document.mapping(
        required=("tiltcal", "kind", "name", "title", "determines", "positions"),
        optional=("source", "angle", "reference", "samples", "settle", "soak"),
    )
    name = _read_name(top["name"])
    free = _read_angle(top["angle"]) if "angle" in top else None
    chosen = _chosen_angle(name, free, angle)
    soak = top["soak"].mapping(required=("seconds", "drift")) if "soak" in top else {}
    return Procedure(
        name=name,
        title=top["title"].text(),
        source=top["source"].text() if "source" in top else "",
        determines=_read_determines(top["determines"], "reference" in top),
        positions=_read_positions(top["positions"], chosen),
        angle=chosen,
        reference=_read_temperature(top["reference"]) if "reference" in top else None,
        samples=top["samples"].integer(minimum=2) if "samples" in top else Procedure.samples,
        settle=top["settle"].number(above=0.0) if "settle" in top else Procedure.settle,
        soak_seconds=soak["seconds"].number(above=0.0) if soak else Procedure.soak_seconds,
        soak_drift=soak["drift"].number(above=0.0) if soak else Procedure.soak_drift,
        record=document.plain(),
    )


def _turning_of(document: Node, angle: float | None) -> Procedure:
    """A procedure of a stage that turns."""
    from tiltcal.files.rotation import read_rotation

    top = document.mapping(required=("tiltcal", "kind", "name", "title", "rotation"), optional=("source",))
    name = _read_name(top["name"])
    return Procedure(
        name=name,
        title=top["title"].text(),
        source=top["source"].text() if "source" in top else "",
        determines=Determines(()),
        positions=(),
        angle=_chosen_angle(name, None, angle),
        record=document.plain(),
        rotation=read_rotation(top["rotation"]),
    )


def _read_name(node: Node) -> str:
    name = node.text()
    if not _NAME.fullmatch(name):
        raise node.error(f"the name {name!r} is not a letter followed by letters, digits, '-', '_' and '.'")
    return name


def _read_angle(node: Node) -> float:
    angle = node.number(above=0.0)
    if angle > 90.0:
        raise node.error(f"an angle of {angle:g}° is more than 90°")
    return angle


def _chosen_angle(name: str, free: float | None, angle: float | None) -> float | None:
    if angle is None:
        return free
    if free is None:
        raise UsageError(f"the procedure {name!r} leaves no angle free; leave the angle out, or copy and edit it")
    if not 0.0 < angle <= 90.0:
        raise UsageError(f"an angle of {angle:g}° is not above 0° and at most 90°")
    return float(angle)


def _read_temperature(node: Node) -> float:
    return node.number(minimum=ABSOLUTE_ZERO)


def _read_determines(node: Node, has_reference: bool) -> Determines:
    section = node.mapping(
        required=("axes",), optional=("drift", "gain", "nonlinearity", "mounting", "cross_validated", "free")
    )
    axes = tuple(item.choice(("x", "y", "z")) for item in section["axes"].items())
    if len(set(axes)) < len(axes):
        raise section["axes"].error("an axis is named twice")
    drift, gain = (_read_order(section[name]) if name in section else 0 for name in ("drift", "gain"))
    if (drift or gain) and not has_reference:
        raise node.error("temperature terms need the key 'reference', the temperature that they are counted from")
    mounting = section["mounting"].flag() if "mounting" in section else False
    if mounting and (axes or drift or gain or "nonlinearity" in section):
        raise node.error("a procedure that determines the mounting determines nothing else: axes is [] there")
    bend = section["nonlinearity"].integer(minimum=0) if "nonlinearity" in section else 0
    if bend > 2:
        raise section["nonlinearity"].error("a non-linearity is 1, the square, or 2, the square and the cube")
    chosen = section["cross_validated"].flag() if "cross_validated" in section else False
    if chosen and not drift:
        raise node.error("an order that is chosen by cross-validation needs the key 'drift', the highest order")
    free = section["free"].flag() if "free" in section else False
    if free and (len(axes) < 3 or drift or gain or bend or mounting):
        raise node.error("free positions determine the axes [x, y, z] and nothing else: unit gravity says no more")
    return Determines(tuple(sorted(axes)), drift, gain, bend, mounting, chosen, free)


def _read_order(node: Node) -> int:
    order = node.integer(minimum=0)
    if order > ORDER_LIMIT:
        raise node.error(f"an order of {order} is too high; at most {ORDER_LIMIT}")
    return order


def _read_positions(node: Node, angle: float | None) -> tuple[Position, ...]:
    items = node.items()
    if not items:
        raise node.error("the list is empty; a procedure has at least one position")
    positions: dict[str, Position] = {}
    for item in items:
        position = _read_position(item, angle)
        if position.name in positions:
            raise item.error(f"a position named {position.name!r} is there already; names are unique")
        positions[position.name] = position
    return tuple(positions.values())


def _read_position(node: Node, angle: float | None) -> Position:
    section = node.mapping(required=("name", "prompt"), optional=("tilt", "gravity", "heading", "temperature", "stage"))
    if ("tilt" in section) == ("gravity" in section):
        raise node.error("a position has either tilt: {x: degrees, y: degrees} or gravity: [gx, gy, gz]")
    tilt = _read_tilt(section["tilt"], angle) if "tilt" in section else None
    temperature = _read_temperature(section["temperature"]) if "temperature" in section else None
    return Position(
        name=_read_name(section["name"]),
        prompt=_read_prompt(section["prompt"], {"angle": angle, "temperature": temperature}),
        gravity=_located(section["tilt"], gravity_from_tilt, tilt)
        if tilt is not None
        else _located(section["gravity"], normalised, section["gravity"].numbers()),
        tilt=tilt,
        heading=section["heading"].number() if "heading" in section else None,
        temperature=temperature,
        stage=section["stage"].number() if "stage" in section else None,
    )


def _located(node: Node, direction: Any, given: Mapping[str, float] | Sequence[float]) -> Vector:
    """A direction from what a position gives, with its place in any complaint."""
    try:
        vector: Vector = direction(given)
    except InputError as failure:
        raise node.error(failure.message) from None
    return vector


def _read_tilt(node: Node, angle: float | None) -> dict[str, float]:
    return {axis: _read_tilt_angle(value, angle) for axis, value in node.mapping(optional=("x", "y")).items()}


def _read_tilt_angle(node: Node, angle: float | None) -> float:
    if node.names("angle", "-angle"):
        if angle is None:
            raise node.error("the procedure gives no angle; add 'angle: 30' to it, or write degrees here")
        return angle if node.text() == "angle" else -angle
    return node.number()


def _read_prompt(node: Node, values: Mapping[str, float | None]) -> str:
    """The operator's sentence with ``{angle}`` and ``{temperature}`` filled in."""

    def value_of(found: re.Match[str]) -> str:
        value = values.get(found.group(1))
        if value is None:
            known = " or ".join(f"{{{name}}}" for name, value in values.items() if value is not None)
            raise node.error(f"{found.group()} has no value here; the prompt may use {known or 'none'}")
        return f"{value:g}"

    return _PLACEHOLDER.sub(value_of, node.text())

"""A procedure: positions in order, the operator's sentence for each, and the coefficients that they determine."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from tiltcal.core.gravity_direction import Vector, gravity_from_tilt, normalised
from tiltcal.core.model import AXES
from tiltcal.errors import UsageError
from tiltcal.files.coefficients import ORDER_LIMIT
from tiltcal.files.declaration import ANY, ByKey, Context, Converted, Format, ListOf, Section, entry
from tiltcal.files.node import Node
from tiltcal.files.scalars import FROM_ZERO, Choice, Flag, Integer, Number, Text
from tiltcal.printable import counted
from tiltcal.stated_arguments import is_number, require_whole, shown

if TYPE_CHECKING:
    from tiltcal.files.rotation import Rotation

ABSOLUTE_ZERO, HOTTEST = -273.15, 1000.0
"""Limits of a temperature, °C; no sensor is hotter, and the square of a far larger number is infinite."""
MOST_ASKEW = 10.0
"""A sensor that sits further askew has another mounting, degrees."""

_PLACEHOLDER = re.compile(r"\{([^{}]*)\}")
_NAME = re.compile(r"[^\W\d_][\w.-]*")


def _distinct_axes(axes: tuple[str, ...], node: Node, context: Context) -> tuple[str, ...]:
    if len(set(axes)) < len(axes):
        raise node.error("an axis is named twice")
    return tuple(sorted(axes))


_ORDER = Integer(0, ORDER_LIMIT, f"an order of {{found}} is too high; at most {ORDER_LIMIT}")
TEMPERATURE = Number(
    ABSOLUTE_ZERO, maximum=HOTTEST, says=f"a temperature of {{found:g}} °C is too high; at most {HOTTEST:g}"
)
"""°C, of a position."""


@dataclass(frozen=True)
class Determines:
    """What the positions of a procedure determine besides the offset."""

    axes: tuple[str, ...] = entry(
        Converted(ListOf(Choice(AXES)), _distinct_axes, more={"uniqueItems": True}),
        "the columns of the sensitivity matrix, `[]` for none",
    )
    drift: int = entry(_ORDER, "order of the temperature polynomial of the offset, up to 6", default=0)
    gain: int = entry(_ORDER, "order of the temperature polynomial of the sensitivity, up to 6", default=0)
    nonlinearity: int = entry(
        Integer(0, 2, "a nonlinearity is 1, the square, or 2, the square and the cube"),
        "1 for the square, 2 for square and cube",
        default=0,
    )
    mounting: bool = entry(
        Flag(),
        "whether the positions are the application's, with `axes: []`; `measure` takes the sensor's calibration as "
        "`--base` then",
        default=False,
    )
    level: bool = entry(
        Flag(),
        "whether the position is level and renews the offset of the sensor's calibration `--base`, with `axes: []`",
        default=False,
    )
    cross_validated: bool = entry(
        Flag(), "whether the order of the drift is chosen by cross-validation, up to that of `drift`", default=False
    )
    free: bool = entry(
        Flag(),
        "whether nobody sets the positions, with `axes: [x, y, z]`: their directions are proposals, and unit gravity "
        "alone determines",
        default=False,
    )

    @property
    def completes(self) -> bool:
        """Whether the sensor's own calibration is needed and completed."""
        return self.mounting or self.level


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


def _name(name: str, node: Node, context: Context) -> str:
    if not _NAME.fullmatch(name):
        raise node.error(f"the name {name!r} is not a letter followed by letters, digits, '-', '_' and '.'")
    return name


IDENTIFIER = Converted(Text(), _name, more={"pattern": f"^{_NAME.pattern}$"})


@dataclass(frozen=True)
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


@dataclass(frozen=True, kw_only=True)
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
    entries = node.entries()
    if (section.tilt is None) == (section.gravity is None):
        raise node.error("a position has either tilt: {x: degrees, y: degrees} or gravity: [gx, gy, gz]")
    known = {"angle": context.angle, "temperature": section.temperature}
    prompt = _filled_in(section.prompt, entries["prompt"], known)
    if section.tilt is not None:
        gravity = entries["tilt"].converted(gravity_from_tilt, section.tilt)
    else:
        gravity = entries["gravity"].converted(normalised, section.gravity or ())
    return Position(**vars(section) | {"prompt": prompt, "gravity": gravity})


def _distinct(positions: tuple[Position, ...], node: Node, context: Context) -> tuple[Position, ...]:
    names = [position.name for position in positions]
    for number, item in enumerate(node.items()):
        if names[number] in names[:number]:
            raise item.error(f"a position named {names[number]!r} is there already; names are unique")
    return positions


def _filled_in(prompt: str, node: Node, values: Mapping[str, float | None]) -> str:
    """Return the operator's sentence with ``{angle}`` and ``{temperature}`` filled in."""

    def value_of(found: re.Match[str]) -> str:
        value = values.get(found.group(1))
        if value is None:
            known = " or ".join(f"{{{name}}}" for name, value in values.items() if value is not None)
            raise node.error(f"{found.group()} has no value here; the prompt may use {known or 'none'}")
        return f"{value:g}"

    return _PLACEHOLDER.sub(value_of, prompt)


@dataclass(frozen=True, kw_only=True)
class Soak:
    """The conditions for a new temperature to count as settled."""

    seconds: float = entry(Number(above=0.0), "the window, seconds")
    drift: float = entry(Number(above=0.0), "the largest drift in it, °C")


@dataclass(frozen=True, kw_only=True)
class Ramp:
    """How the temperature changes between the positions, which are the turning points of a ramp."""

    pace: float = entry(Number(above=0.0), "of the virtual chamber, and a proposal for a real one, °C/min")
    within: float = entry(
        Number(above=0.0), "how close to its temperature a leg ends, °C; a turn need not be exact", default=1.0
    )
    interval: float = entry(Number(above=0.0), "seconds between two samples", default=5.0)
    patience: float = entry(
        Number(above=0.0), "seconds without a change of temperature after which a leg is ended as it is", default=1800.0
    )


@dataclass(frozen=True, kw_only=True)
class Procedure:
    """A procedure: the positions to measure in order, or the rotation of a stage.

    Attributes
    ----------
    angle : float or None
        The one of the file, or that which the user gives in its place.
    record : mapping
        The procedure as plain data, before the user's angle and the turns were put in.
    rotation : Rotation or None
        What is done while a stage turns, in place of positions; such a procedure has none, and determines no tilt.
    """

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
    record: Mapping[str, Any] = field(default_factory=dict, compare=False)
    rotation: Rotation | None = None

    @property
    def length(self) -> str:
        """How long it is, in its own terms, such as ``4 positions``."""
        if self.rotation is not None:
            return f"up to {self.rotation.turns} turns"
        return counted(len(self.positions), "position" if self.ramp is None else "leg")

    def require_positions(self) -> None:
        """Refuse a procedure of a stage that turns, with a UsageError that names the commands that are meant for it."""
        if self.rotation is not None:
            raise UsageError(
                f"{self.name} has no positions, its stage turns: match the pairs of a recorded log with `tiltcal "
                f"match`, or at the bench with `tiltcal measure {self.name}`"
            )

    def with_turns(self, turns: int | None) -> Procedure:
        """Return this procedure with another limit of turns; None leaves it as it is.

        Raises
        ------
        UsageError
            No stage turns in it, or the number cannot be.
        """
        if turns is None:
            return self
        if self.rotation is None:
            raise UsageError(f"the procedure {self.name!r} has positions and no turns; leave --turns out")
        require_whole("--turns", turns, 1, "turns")
        return replace(self, rotation=self.rotation.with_turns(turns))

    def with_alignment(self, alignment: float | None) -> Procedure:
        """Return this procedure for a sensor that may sit askew by another angle, degrees; None leaves it as it is.

        Raises
        ------
        UsageError
            It renews no offset, or the angle cannot be.
        """
        if alignment is None:
            return self
        if not self.determines.level:
            raise UsageError(f"{self.name} renews no offset: leave --alignment out")
        if not (is_number(alignment, 0.0) and alignment <= MOST_ASKEW):
            raise UsageError(f"--alignment {shown(alignment)}: it is between 0 and {MOST_ASKEW:g} degrees")
        return replace(self, alignment=alignment, record={**self.record, "alignment": alignment})

    @property
    def closes(self) -> bool:
        """Whether the last position is the first one again."""
        return len(self.positions) > 1 and _setting(self.positions[0]) == _setting(self.positions[-1])

    def with_closing(self, closing: bool) -> Procedure:
        """Return this procedure with its first position once more at the end, which shows what has changed meanwhile.

        One that ends where it began stays as it is, and so does every one without ``closing``.

        Raises
        ------
        UsageError
            There are no positions, or they are free.
        """
        if not closing:
            return self
        self.require_positions()
        if self.determines.free:
            raise UsageError(f"{self.name} sets no position that could be visited again: leave --closing out")
        if self.closes:
            return self
        first = self.positions[0]
        name, again = f"{first.name}-again", "Back to the first position, to show what has changed."
        entries = list(self.record["positions"])
        entries.append({**entries[0], "name": name, "prompt": f"{again} {entries[0]['prompt']}"})
        last = replace(first, name=name, prompt=f"{again} {first.prompt}")
        return replace(self, positions=(*self.positions, last), record={**self.record, "positions": entries})


def _setting(position: Position) -> tuple[object, ...]:
    """Return all that a position sets."""
    return position.gravity, position.heading, position.temperature, position.stage


def chosen_angle(name: str, free: float | None, angle: float | None) -> float | None:
    """Return the angle that a procedure leaves free, or the one that the user gives in its place, degrees.

    Raises
    ------
    UsageError
        The procedure leaves none free, or the angle is beyond 90°.
    """
    if angle is None:
        return free
    if free is None:
        raise UsageError(f"the procedure {name!r} leaves no angle free; leave the angle out, or copy and edit it")
    if not (is_number(angle) and 0.0 < angle <= 90.0):
        raise UsageError(f"an angle of {shown(angle)}° is not above 0° and at most 90°")
    return float(angle)

"""A procedure: positions in order, the operator's sentence for each, and the coefficients that they determine."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import field, replace
from typing import TYPE_CHECKING, Any

from tiltcal.core.gravity_direction import Vector
from tiltcal.core.model import AXES
from tiltcal.errors import UsageError
from tiltcal.files.coefficients import ORDER_LIMIT
from tiltcal.files.declaration import (
    Choice,
    Context,
    Converted,
    Flag,
    Integer,
    ListOf,
    Number,
    Text,
    entry,
)
from tiltcal.files.node import Node
from tiltcal.frozen import frozen

if TYPE_CHECKING:
    from tiltcal.files.rotation import Rotation

ABSOLUTE_ZERO, HOTTEST = -273.15, 1000.0
"""Limits of a temperature, °C; no sensor is hotter, and the square of a far larger number is infinite."""
MOST_ASKEW = 10.0
"""A sensor that sits further askew has another mounting, degrees."""

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


@frozen
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


@frozen
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


@frozen(kw_only=True)
class Soak:
    """The conditions for a new temperature to count as settled."""

    seconds: float = entry(Number(above=0.0), "the window, seconds")
    drift: float = entry(Number(above=0.0), "the largest drift in it, °C")


@frozen(kw_only=True)
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


@frozen
class Procedure:
    """A procedure: the positions to measure in order, or the rotation of a stage.

    Attributes
    ----------
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
    alignment : float
        By how much at most the sensor may sit askew since its calibration, degrees about each axis.
    record : mapping
        The procedure as plain data, before ``angle`` and the turns were put in.
    ramp : Ramp or None
        Of a continuous record: its positions are one attitude, and the temperatures at which it turns.
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
    alignment: float = 0.0
    ramp: Ramp | None = None
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
        if not 0.0 <= alignment <= MOST_ASKEW:
            raise UsageError(f"--alignment {alignment:g}: it is between 0 and {MOST_ASKEW:g} degrees")
        return replace(self, alignment=alignment, record={**self.record, "alignment": alignment})

    @property
    def closes(self) -> bool:
        """Whether the last position is the first one again."""
        return len(self.positions) > 1 and _stands(self.positions[0]) == _stands(self.positions[-1])

    def with_closing(self) -> Procedure:
        """Return this procedure with its first position once more at the end, which shows what has changed meanwhile.

        One that ends where it began stays as it is.

        Raises
        ------
        UsageError
            There are no positions, or nobody sets them.
        """
        self.require_positions()
        if self.determines.free:
            raise UsageError(f"{self.name} sets no position that could be visited again: leave --closing out")
        if self.closes:
            return self
        first = self.positions[0]
        name, again = f"{first.name}-again", "Back to the first position, to show what has changed."
        entries = list(self.record["positions"])
        entries.append({**entries[0], "name": name, "prompt": f"{again} {entries[0]['prompt']}"})
        closing = replace(first, name=name, prompt=f"{again} {first.prompt}")
        return replace(self, positions=(*self.positions, closing), record={**self.record, "positions": entries})


def _stands(position: Position) -> tuple[object, ...]:
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
    if not 0.0 < angle <= 90.0:
        raise UsageError(f"an angle of {angle:g}° is not above 0° and at most 90°")
    return float(angle)

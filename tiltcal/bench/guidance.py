"""What guides whoever sets a position: the attitude to set, the present one, their difference, and whether it will do.

The session puts it beside the values of each reading that it shows and of each review; the terminal and the page say it
in the same words. Without a calibration a present angle is by the coefficients of the data sheet, corrected by what
the positions before have shown. With one it is calibrated, and nobody is told that it is near enough: a table that is
set by the sensor that is judged or renewed would show no error.

One or two axes have a tilt each, an arcsine. Three have a direction: its angle from the one that is asked for does not
grow with the error of the axis that points up.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import asin, atan2, degrees, hypot, inf, radians, sin, sqrt
from typing import NamedTuple

import numpy as np

from tiltcal.core.attitude import Orientation, Vector
from tiltcal.core.compensation import CLIP_LIMIT, Compensation
from tiltcal.core.model import AXES
from tiltcal.core.plausibility import UNKNOWN_OFFSET, ExpectedReadings
from tiltcal.drivers.model import Model

TOLERANCE = 2.0
"""Standard deviations within which a reading is the expected one: 3° at least, for each has 1.5° of the operator."""

VAGUE = 0.2
"""Nothing is called ok where the tolerance is above this, g: of a part whose offset is unknown before two positions."""

COARSE, JIGS = 3.0, 5.0
"""A calibrated sensor within this, degrees, or within so many jigs if that is more, is in the position meant."""

LENGTH = 0.2  # three axes whose reading differs from 1 g by more than this have no direction yet, g
SHARE = 0.25  # a side that is off by less than this share of the tolerance is not said to be too high or too low
COLUMNS = ("", "set", "now", "difference", "reading", "noise", "n")  # of a review; a reading has no last two
UNCALIBRATED = "angles are not calibrated yet"  # what an operator is told beside present angles
CALIBRATED = "calibrated angles: set the table by its own scale, not by this number"
OWN_FRAME = "calibrated angles, in the sensor's own frame"
UNKNOWN = "not known yet"


class AxisTilt(NamedTuple):
    """The tilt of one axis, degrees: to set, None where nothing predicts the reading, and present, None beyond 1 g."""

    target: float | None
    present: float | None


class Difference(NamedTuple):
    """How far a sensor is from what is asked for, degrees: of an axis, present minus target, or of a direction.

    ``angle`` is None beyond 1 g; ``fits`` is whether it is within the tolerance, None where nothing can be said.
    """

    angle: float | None
    tolerance: float
    fits: bool | None

    @property
    def share(self) -> float | None:
        """The share of the tolerance that it is."""
        return None if self.angle is None else abs(self.angle) / self.tolerance


@dataclass(frozen=True)
class SensorGuidance:
    """What guides whoever sets one sensor: nothing where the scale of a part is not known.

    ``tilts`` are by channel, and so are ``differences``; of three axes there is one, of the direction, by an empty
    name. ``up`` is the present direction that points up in the frame of the fixture, None where it is not known;
    ``sides`` are how far two sides of the fixture are too high, degrees, by names such as ``+Y``.
    """

    tilts: Mapping[str, AxisTilt] = field(default_factory=dict)
    differences: Mapping[str, Difference] = field(default_factory=dict)
    up: Vector | None = None
    sides: Mapping[str, float] = field(default_factory=dict)
    calibrated: bool = False
    unknown: bool = False

    @property
    def fits(self) -> bool | None:
        """Whether the sensor is set as asked; None where nothing can be said."""
        return whether_all(one.fits for one in self.differences.values())

    @property
    def ok(self) -> bool | None:
        """Whether the operator is told that it is: never by a calibrated angle."""
        return None if self.calibrated else self.fits

    @property
    def off(self) -> dict[str, float] | None:
        """The angle of three axes from the direction asked for, and how far two sides are too high, degrees."""
        off = self.differences.get("")
        if off is None or off.angle is None:
            return None
        return {name: round(angle, 3) + 0.0 for name, angle in {"angle": off.angle, **self.sides}.items()}

    def in_words(self) -> list[str]:
        """Return what an operator reads of it, an axis or the direction each, such as ``x  +29.71° (-0.29) ok``."""
        if self.unknown:
            return [f"direction {UNKNOWN}"]
        if (off := self.differences.get("")) is None:
            return [_axis_in_words(channel, tilt, self._of(channel)) for channel, tilt in self.tilts.items()]
        little = inf if self.calibrated else SHARE * off.tolerance
        done = ("" if abs(high) < little else " lower" if high > 0.0 else " raise" for high in self.sides.values())
        sides = ", ".join(f"{side} {high:+.2f}°{do}" for (side, high), do in zip(self.sides.items(), done, strict=True))
        return [f"{off.angle:.2f}° off: {sides}{' ok' if self.ok else ''}"]

    def _of(self, channel: str) -> Difference | None:
        one = self.differences.get(channel)
        return one if one is None or not self.calibrated else one._replace(fits=None)


def whether_all(judged: Iterable[bool | None]) -> bool | None:
    """Return whether all are true; None where nothing can be said."""
    every = list(judged)
    return False if False in every else None if None in every or not every else True


def note_on(guides: Sequence[SensorGuidance]) -> str:
    """Return what the operator has to be told of the angles that are shown."""
    if not any(guide.calibrated for guide in guides):
        return UNCALIBRATED
    offs = [off for guide in guides for off in guide.differences.values()]
    if not offs:
        return OWN_FRAME
    away = [f"more than {off.tolerance:g}° away, is this the position? " for off in offs if off.fits is False]
    return "".join(away[:1]) + CALIBRATED


def guidance(
    model: Model, orientation: Orientation, values: Sequence[float], gravity: Vector, expected: ExpectedReadings | None
) -> SensorGuidance:
    """Return the guidance of a sensor without a calibration: readings in its unit, gravity in the fixture's frame.

    Without ``expected`` readings there are no targets, and nothing at all of a part whose scale is not known.
    """
    if not model.scaled:
        return SensorGuidance()
    sines = [(value - model.offset) / model.sensitivity for value in values]
    if expected is None:
        return _guidance(model.channels, sines, orientation, gravity)
    seen = orientation.seen(gravity)
    means, deviations = expected.in_g(seen)
    wanted = [seen[AXES.index(channel)] for channel in model.channels]
    present = [target + sine - mean for target, sine, mean in zip(wanted, sines, means, strict=True)]
    reach = [TOLERANCE * deviation for deviation in deviations]
    return _guidance(model.channels, present, orientation, gravity, wanted, reach)


def calibrated_guidance(
    compensation: Compensation,
    orientation: Orientation,
    readings: Sequence[float],
    temperature: float | None,
    gravity: Vector,
    tolerance: float | None,
) -> SensorGuidance:
    """Return the guidance of a calibrated sensor, whose ``readings`` are those of its calibration's channels.

    Without a ``tolerance``, degrees, there are no targets: the angles are those of the sensor in its own frame.
    """
    element = None if temperature is None else np.array([temperature])
    sines = compensation(np.array([readings]), element).gravity[0].tolist()
    seen = orientation.seen(gravity)
    wanted = None if tolerance is None else [seen[AXES.index(axis)] for axis in compensation.axes]
    guide = _guidance(compensation.axes, sines, orientation, gravity, wanted, tolerance=tolerance, clip=CLIP_LIMIT)
    return replace(guide, calibrated=True)


def tilt_guidance(sines: Mapping[str, float], orientation: Orientation, gravity: Vector) -> SensorGuidance:
    """Return the guidance of a reference by the sines of the tilts that it reads."""
    seen = orientation.seen(gravity)
    wanted = [seen[AXES.index(channel)] for channel in sines]
    return _guidance(tuple(sines), list(sines.values()), orientation, gravity, wanted, tolerance=COARSE)


def _guidance(
    names: Sequence[str],
    sines: Sequence[float],
    orientation: Orientation,
    gravity: Vector,
    wanted: Sequence[float] | None = None,
    reach: Sequence[float] = (),
    tolerance: float | None = None,
    clip: float = 1.0,
) -> SensorGuidance:
    """Return the guidance of components of gravity, g; ``reach`` are their tolerances, g, or one is in degrees."""
    tilts, up = {}, None
    differences: dict[str, Difference] = {}
    if len(names) == len(AXES):
        length = hypot(*sines)
        unknown = not abs(length - 1.0) <= LENGTH or max(reach, default=0.0) > TOLERANCE * UNKNOWN_OFFSET
        read = {} if unknown else {name: sine / length for name, sine in zip(names, sines, strict=True)}
        aims = {} if wanted is None else dict(zip(names, wanted, strict=True))
        tilts = {name: AxisTilt(*(_angle(one[name]) if one else None for one in (aims, read))) for name in names}
        if unknown:
            return SensorGuidance(tilts, unknown=True)
        up = _of_fixture(orientation, read)
        if wanted is not None:
            differences[""] = _of_direction(orientation, gravity, up, reach, tolerance)
    else:
        for number, (name, sine) in enumerate(zip(names, sines, strict=True)):
            aim = None if wanted is None else wanted[number]
            tilts[name], off = _of_axis(sine, aim, reach[number] if reach else 0.0, tolerance, clip)
            differences |= {} if off is None else {name: off}
        up = _present_gravity(orientation, tilts, gravity)
    sides = {} if up is None or wanted is None else too_high(gravity, up)
    return SensorGuidance(tilts, differences, up, sides)


def _of_axis(
    sine: float, wanted: float | None, reach: float, tolerance: float | None, clip: float
) -> tuple[AxisTilt, Difference | None]:
    """Return the tilt of one axis, and how far it is from the one that is wanted."""
    near = wanted is not None and abs(sine - wanted) <= reach
    present = _angle(sine) if near or abs(sine) <= clip else None
    if wanted is None:
        return AxisTilt(None, present), None
    target = _angle(wanted)
    off = None if present is None else present - target
    if tolerance is not None:
        return AxisTilt(target, present), Difference(off, tolerance, off is not None and abs(off) <= tolerance)
    # On the side of the difference: near ±90° an arcsine has much more room on the one side than on the other.
    side = 1.0 if (off or -wanted) > 0.0 else -1.0
    room = abs(_angle(wanted + side * reach) - target)
    return AxisTilt(target, present), Difference(off, room, near if reach <= VAGUE else None)


def _of_direction(
    orientation: Orientation, gravity: Vector, up: Vector, reach: Sequence[float], tolerance: float | None
) -> Difference:
    """Return how far a direction is from gravity, by tolerances of the sensor's three components, g, or in degrees."""
    angle, spread = hypot(*too_high(gravity, up).values()), 0.0
    if tolerance is None:
        for _, side in level_sides(gravity):
            parts = zip(orientation.seen(side), reach, strict=True)
            spread = max(spread, hypot(*(part * one for part, one in parts)))
        tolerance = _angle(spread)
    return Difference(angle, tolerance, angle <= tolerance if spread <= VAGUE else None)


def _angle(sine: float) -> float:
    """Return the tilt of a component of gravity, degrees; ±90 where it is beyond 1 g."""
    return degrees(asin(max(-1.0, min(1.0, sine))))


def _axis_in_words(channel: str, tilt: AxisTilt, off: Difference | None) -> str:
    words = "beyond 90°" if tilt.present is None else f"{tilt.present:+7.2f}°"
    words += "" if off is None or off.angle is None else f" ({off.angle:+.2f})"
    return f"{channel} {words}{' ok' if off is not None and off.fits else ''}".strip()


def _present_gravity(orientation: Orientation, tilts: Mapping[str, AxisTilt], gravity: Vector) -> Vector | None:
    """Return the direction that points up by the present angles of one or two axes, in the fixture's frame.

    An axis that the sensor does not measure is as the position asks for; None where an angle is not known.
    """
    up = {name: sin(radians(tilt.present)) for name, tilt in tilts.items() if tilt.present is not None}
    if not up or len(up) < len(tilts):
        return None
    others = {axis: one for axis, one in zip(AXES, orientation.seen(gravity), strict=True) if axis not in up}
    rest, asked = sqrt(max(0.0, 1.0 - sum(sine * sine for sine in up.values()))), hypot(*others.values())
    up |= {axis: rest * one / asked if asked else rest / sqrt(len(others)) for axis, one in others.items()}
    x, y, z = _of_fixture(orientation, up)
    length = hypot(x, y, z)
    return x / length, y / length, z / length


def _of_fixture(orientation: Orientation, seen: Mapping[str, float]) -> Vector:
    """Return a vector of a sensor's frame, by axis, in that of the fixture."""
    columns = zip(*orientation.matrix, strict=True)
    x, y, z = (sum(seen[axis] * one for axis, one in zip(AXES, column, strict=True)) for column in columns)
    return x, y, z


def level_sides(gravity: Vector) -> list[tuple[str, Vector]]:
    """Return the two sides of the fixture that are nearest to level in an attitude, each direction made level."""
    first, second = sorted(sorted(range(3), key=lambda axis: abs(gravity[axis]))[:2])
    up = np.array(gravity)
    level = np.eye(3)[first] - gravity[first] * up
    across = np.cross(up, level)  # the other direction that is level
    sides = [side / np.linalg.norm(side) for side in (level, across * np.sign(across[second]))]
    return [(f"+{AXES[axis].upper()}", tuple(side.tolist())) for axis, side in zip((first, second), sides, strict=True)]


def too_high(gravity: Vector, up: Vector) -> dict[str, float]:
    """Return how far two sides of the fixture are too high, degrees: the components of the angle between directions."""
    cosine = sum(one * other for one, other in zip(gravity, up, strict=True))
    parts = {name: sum(one * other for one, other in zip(side, up, strict=True)) for name, side in level_sides(gravity)}
    across = hypot(*parts.values())
    angle = degrees(atan2(across, cosine))
    return {
        name: angle * part / across if across else angle if number == 0 else 0.0
        for number, (name, part) in enumerate(parts.items())
    }

"""What guides whoever sets a position: the angle to set, the present one, their difference, and whether that will do.

The session puts it beside the values of each reading that it shows and of each review; the terminal and the page say it
in the same words. A present angle is uncalibrated: it is by the coefficients of the data sheet, corrected by what the
positions before have shown.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import asin, degrees, hypot, radians, sin, sqrt
from typing import Any, TypedDict

from tiltcal.core.attitude import Orientation, Vector
from tiltcal.core.model import AXES
from tiltcal.core.plausibility import ExpectedReadings
from tiltcal.drivers.model import Model

TOLERANCE = 2.0
"""Standard deviations within which a reading is the expected one: 3° at least, for each has 1.5° of the operator."""

VAGUE = 0.2
"""Nothing is called ok where the tolerance is above this, g: of a part whose offset is unknown before two positions."""

COLUMNS = ("", "set", "now", "difference", "reading", "noise", "n")  # of a review; a reading has no last two
UNCALIBRATED = "angles are not calibrated yet"  # what an operator is told beside present angles


class AxisGuidance(TypedDict):
    """The tilt of one axis of a sensor, degrees.

    ``target`` and ``tolerance`` are None where nothing predicts the reading, ``present`` where it is beyond 1 g, and
    ``difference``, present minus target, where one of both is. ``ok`` is None where nothing can be said.
    """

    target: float | None
    present: float | None
    difference: float | None
    tolerance: float | None
    ok: bool | None


def guidance(
    model: Model, orientation: Orientation, values: Sequence[float], gravity: Vector, expected: ExpectedReadings | None
) -> dict[str, AxisGuidance]:
    """Return the guidance of each channel of a sensor: readings in its unit, gravity in the frame of the fixture.

    Without ``expected`` readings there are no targets, and nothing at all of a part whose scale is not known.
    """
    if not model.scaled:
        return {}
    seen = orientation.seen(gravity)
    sines = [(value - model.offset) / model.sensitivity for value in values]
    if expected is None:
        return {channel: _axis(sine) for channel, sine in zip(model.channels, sines, strict=True)}
    wanted = [seen[AXES.index(channel)] for channel in model.channels]
    facts = zip(model.channels, wanted, sines, *expected.in_g(seen), strict=True)
    return {
        channel: _axis(target + sine - mean, target, TOLERANCE * deviation)
        for channel, target, sine, mean, deviation in facts
    }


def _axis(sine: float, wanted: float | None = None, within: float = 0.0) -> AxisGuidance:
    """Return the guidance of one axis from components of gravity, g."""
    if wanted is None:
        present = _angle(sine) if abs(sine) <= 1.0 else None
        return AxisGuidance(target=None, present=present, difference=None, tolerance=None, ok=None)
    is_near, target = abs(sine - wanted) <= within, _angle(wanted)
    present = _angle(sine) if is_near or abs(sine) <= 1.0 else None
    return AxisGuidance(
        target=target,
        present=present,
        difference=None if present is None else present - target,
        tolerance=max(abs(_angle(wanted + by) - target) for by in (within, -within)),
        ok=is_near if within <= VAGUE else None,
    )


def _angle(sine: float) -> float:
    """Return the tilt of a component of gravity, degrees; ±90 where it is beyond 1 g."""
    return degrees(asin(max(-1.0, min(1.0, sine))))


def in_words(channel: str, axis: AxisGuidance) -> str:
    """Return present angle and difference of an axis, and whether that is ok, such as ``x  +29.71° (-0.29) ok``."""
    words = "beyond 90°" if axis["present"] is None else f"{axis['present']:+7.2f}°"
    words += "" if axis["difference"] is None else f" ({axis['difference']:+.2f})"
    return f"{channel} {words}{' ok' if axis['ok'] else ''}".strip()


def rows_of(readings: Mapping[str, Any], sensors: Mapping[str, Any]) -> Iterator[tuple[list[str], bool | None]]:
    """Yield the cells of each channel and thermometer below :data:`COLUMNS`, and whether it is as asked.

    ``readings`` are those that a session shows, or the means of its review; ``sensors`` are as it begins with them.
    """
    for serial, reading in readings.items():
        for channel, value in reading["values"].items():
            axis: AxisGuidance | None = reading["guidance"].get(channel)
            tilts = [None] * 3 if axis is None else [axis["target"], axis["present"], axis["difference"]]
            cells = ["" if tilt is None else f"{tilt:+.2f}°" for tilt in tilts]
            cells += [f"{value:.6g} {sensors[serial]['unit']}"]
            cells += [f"{reading['std'][channel]:.2g}", str(reading["n"])] if "std" in reading else []
            yield [f"{serial} {channel}", *cells], axis and axis["ok"]
        if reading["temperature"] is not None:
            yield [f"{serial} T", "", "", "", f"{reading['temperature']:.2f} °C"], None


def present_gravity(orientation: Orientation, axes: Mapping[str, AxisGuidance], gravity: Vector) -> Vector | None:
    """Return the direction that points up by the present angles of a sensor, a unit vector in the fixture's frame.

    An axis that the sensor does not measure is as the position asks for; None where an angle is not known or all are 0.
    """
    angles = {channel: axis["present"] for channel, axis in axes.items()}
    up = {channel: sin(radians(angle)) for channel, angle in angles.items() if angle is not None}
    if not up or len(up) < len(angles):
        return None
    others = {axis: one for axis, one in zip(AXES, orientation.seen(gravity), strict=True) if axis not in up}
    rest, asked = sqrt(max(0.0, 1.0 - sum(sine * sine for sine in up.values()))), hypot(*others.values())
    up |= {axis: rest * one / asked if asked else rest / sqrt(len(others)) for axis, one in others.items()}
    columns = zip(*orientation.matrix, strict=True)
    x, y, z = (sum(up[axis] * one for axis, one in zip(AXES, column, strict=True)) for column in columns)
    length = hypot(x, y, z)
    return (x / length, y / length, z / length) if length else None

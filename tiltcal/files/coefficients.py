"""The coefficients of the measurement model as they stand in a calibration file and in a twin file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import degrees, radians
from typing import Annotated

import numpy as np
from msgspec import Meta

from tiltcal.core.model import AXES, Array, Coefficients, Mounting, Thermal
from tiltcal.core.rounding import significant
from tiltcal.files.document import Document
from tiltcal.files.record import ByAxis, Finite, Range, Record, about

ORDER_LIMIT = 6

LARGEST_ANGLES = {"roll": 180.0, "pitch": 90.0, "yaw": 180.0}
"""The largest size of each angle of a mounting, degrees."""

ANGLES = tuple(LARGEST_ANGLES)

_SINGULAR = 1e-9
"""Smallest over largest singular value below which a sensitivity matrix has no inverse worth its name."""
_ANGLE_DIGITS = 12

STEEP = 0.1
"""Least slope of a bent characteristic relative to the straight one."""

Bend = ByAxis[Annotated[tuple[Finite, ...], Meta(max_length=2)]]
"""The shares of the square and the cube for all channels."""
Polynomials = ByAxis[Annotated[tuple[Finite, ...], Meta(max_length=ORDER_LIMIT)]]
"""Coefficients of dT, dT², ... for some of the channels."""


class ThermalSection(Record, kw_only=True):
    """``calibration.temperature`` as it stands in a file."""

    reference: Annotated[Finite, about("reference temperature, °C")]
    range: Annotated[Range | None, about("`[low, high]`, the temperatures that were measured, °C")] = None
    offset: Annotated[Polynomials, about("per channel the coefficients of dT, dT², …, unit/°C, unit/°C², …")] = {}
    sensitivity: Annotated[Polynomials, about("per channel the coefficients of dT, dT², …, 1/°C, 1/°C², …")] = {}
    lag: Annotated[Finite, about("of the sensing element behind the thermometer, s; negative if ahead")] = 0.0


class MountingSection(Record, kw_only=True):
    """``calibration.mounting`` as it stands in a file."""

    always_written = ANGLES

    roll: Annotated[float, Meta(ge=-180, le=180), about("degrees, -180 to 180")] = 0.0
    pitch: Annotated[float, Meta(ge=-90, le=90), about("degrees, -90 to 90")] = 0.0
    yaw: Annotated[float, Meta(ge=-180, le=180), about("degrees, -180 to 180")] = 0.0


class CoefficientsSection(Record, kw_only=True):
    """The section ``calibration`` as it stands in a file."""

    offset: Annotated[ByAxis[Finite], about("per channel, unit, at the reference temperature")]
    sensitivity: Annotated[
        ByAxis[ByAxis[Finite]],
        about("row = channel, column = axis, unit/g; as many columns as channels, or x, y, z for two; not singular"),
    ]
    nonlinearity: Annotated[Bend | None, about("n₂ or n₂, n₃: reads S_ii (a + n₂a² + n₃a³), not S_ii a")] = None
    temperature: Annotated[ThermalSection | None, about("absent where it was not measured")] = None
    mounting: Annotated[MountingSection | None, about("how the sensor sits in its application")] = None


def coefficients_of(section: CoefficientsSection, place: Document, channels: tuple[str, ...]) -> Coefficients:
    """Return the coefficients of a section; an InputError where they contradict the channels or cannot be inverted."""
    thermal, mounting, bent = section.temperature, section.mounting, section.nonlinearity
    place.require_keys(section.offset, channels, "offset", complete=True)
    axes, sensitivity = _matrix(section.sensitivity, place, channels)
    if bent is not None:
        place.require_keys(bent, channels, "nonlinearity", complete=True)
    if thermal is not None:
        for key in ("offset", "sensitivity"):
            if curves := getattr(thermal, key):
                place.require_keys(curves, channels, "temperature", key, complete=True)
        place.require_order(thermal.range, "temperature", "range")
    found = Coefficients(channels, axes, np.array([section.offset[channel] for channel in channels]), sensitivity)
    if thermal is not None:
        drift, gain = _padded(thermal.offset, channels), _padded(thermal.sensitivity, channels)
        found = replace(found, thermal=Thermal(thermal.reference, thermal.range, drift, gain, thermal.lag))
    if mounting is not None:
        found = replace(found, mounting=Mounting(*(radians(getattr(mounting, name)) for name in ANGLES)))
    return found if bent is None else replace(found, nonlinearity=_nonlinearity(bent, place, channels, axes))


def coefficients_section(coefficients: Coefficients) -> CoefficientsSection:
    """Return the section of a file."""
    channels, axes, thermal = coefficients.channels, coefficients.axes, coefficients.thermal
    bent, mounting = coefficients.nonlinearity, coefficients.mounting
    rows = zip(channels, coefficients.sensitivity.tolist(), strict=True)
    section = CoefficientsSection(
        offset=dict(zip(channels, coefficients.offset.tolist(), strict=True)),
        sensitivity={channel: dict(zip(axes, row, strict=True)) for channel, row in rows},
        nonlinearity=None if bent is None else _by_channel(channels, bent),
    )
    if thermal is not None:
        warm = ThermalSection(
            reference=float(thermal.reference),
            range=thermal.range and (float(thermal.range[0]), float(thermal.range[1])),
            offset=_by_channel(channels, thermal.drift),
            sensitivity=_by_channel(channels, thermal.gain),
            lag=float(thermal.lag),
        )
        section = section.replaced(temperature=warm)
    if mounting is not None:
        angles = {name: in_degrees(getattr(mounting, name)) for name in ANGLES}
        section = section.replaced(mounting=MountingSection(**angles))
    return section


def in_degrees(angle: float) -> float:
    """Return an angle in radians as degrees, with 12 digits so that 60 does not become 59.99999999999999."""
    return significant(degrees(angle), _ANGLE_DIGITS)


def require_equal_columns(rows: Mapping[str, Mapping[str, float]], place: Document) -> None:
    """Refuse a sensitivity at a place whose rows have other columns than the first one."""
    first = next(iter(rows))
    for channel, row in rows.items():
        if set(row) != set(rows[first]):
            raise place.error(
                f"row {channel} has columns [{', '.join(row)}] and row {first} [{', '.join(rows[first])}]; "
                f"every row has the same columns",
                *("sensitivity", channel),
            )


def _matrix(
    rows: Mapping[str, Mapping[str, float]], place: Document, channels: Sequence[str]
) -> tuple[tuple[str, ...], Array]:
    """Return the columns of a matrix, in the order x, y, z, and the matrix."""
    place.require_keys(rows, channels, "sensitivity", complete=True)
    require_equal_columns(rows, place)
    axes = tuple(axis for axis in AXES if axis in rows[channels[0]])
    # The columns that are inverted: of two channels x and y, where unit gravity gives z; that of a single channel.
    inverted = {1: channels, 2: ("x", "y")}.get(len(channels), axes) if len(axes) > len(channels) else axes
    if len(inverted) != len(channels) or not set(inverted) <= set(axes):
        raise place.error(
            f"{len(axes)} columns [{', '.join(axes)}] do not go with {len(channels)} channels [{', '.join(channels)}]: "
            f"there are as many columns as channels; of two channels x, y and z; of one its own and others",
            "sensitivity",
        )
    matrix = np.array([[rows[channel][axis] for axis in axes] for channel in channels])
    values = np.linalg.svd(matrix[:, [axes.index(axis) for axis in inverted]], compute_uv=False)
    if not values[-1] >= _SINGULAR * values[0] or values[0] == 0.0:
        why = "the matrix is singular: its rows do not separate the axes; measure the sensitivity again"
        raise place.error(why, "sensitivity")
    for channel, row in zip(channels, matrix, strict=True):
        if channel in axes and row[axes.index(channel)] == 0.0:
            why = f"{channel} does not sense axis {channel}: call each channel by the axis it senses most"
            raise place.error(why, "sensitivity")
    return axes, matrix


def _padded(curves: Mapping[str, Sequence[float]], channels: Sequence[str]) -> Array:
    """Return the polynomials of all channels as a table, with zeros up to the longest."""
    order = max((len(numbers) for numbers in curves.values()), default=0)
    table = np.zeros((len(channels), order))
    for row, channel in zip(table, channels, strict=True):
        numbers = curves.get(channel, ())
        row[: len(numbers)] = numbers
    return table


def _by_channel(channels: Sequence[str], table: Array) -> dict[str, tuple[float, ...]]:
    """Return the rows of a table by channel; empty where it has no columns."""
    return {channel: tuple(row) for channel, row in zip(channels, table.tolist(), strict=True) if row}


def _nonlinearity(
    curves: Mapping[str, Sequence[float]], place: Document, channels: Sequence[str], axes: Sequence[str]
) -> Array:
    """Return the shares of the square and the cube by channel; refuse a reading that has several angles."""
    table = _padded(curves, channels)
    if any(channel not in axes for channel in channels):
        raise place.error("a nonlinearity needs every channel's sensitivity to its own axis", "nonlinearity")
    for channel, row in zip(channels, table, strict=True):
        # The derivative 1 + 2 n2 a + 3 n3 a² is smallest at an end of the range or at its own turning point.
        square, cube = np.pad(row, (0, 2 - len(row)))
        turning = -square / (3.0 * cube) if cube else 1.0
        places = [-1.0, 1.0, *([turning] if abs(turning) < 1.0 else [])]
        if min(1.0 + 2.0 * square * a + 3.0 * cube * a * a for a in places) < STEEP:
            raise place.error(
                f"the nonlinearity of {channel} is so large that one reading has several angles", "nonlinearity"
            )
    return table

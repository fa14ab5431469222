"""The coefficients of the measurement model as they stand in a calibration file and in a twin file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import degrees, radians

import numpy as np

from tiltcal.core.model import AXES, Array, Coefficients, Mounting, Thermal
from tiltcal.core.rounding import significant
from tiltcal.files.declaration import ByChannel, Context, Converted, ListOf, Section, entry
from tiltcal.files.node import Node
from tiltcal.files.scalars import Number, Range

ORDER_LIMIT = 6
CHANNELS = ByChannel(Number())
"""A number for some channels of a sensor."""

LARGEST_ANGLES = {"roll": 180.0, "pitch": 90.0, "yaw": 180.0}
"""The largest size of each angle of a mounting, degrees."""

ANGLES = tuple(LARGEST_ANGLES)

_SINGULAR = 1e-9
"""Smallest over largest singular value below which a sensitivity matrix has no inverse worth its name."""
_ANGLE_DIGITS = 12

NONLINEAR_TERMS = 2
"""The square and the cube."""

STEEP = 0.1
"""Least slope of a bent characteristic relative to the straight one."""


def _equal_columns(
    rows: Mapping[str, Mapping[str, float]], node: Node, context: Context
) -> Mapping[str, Mapping[str, float]]:
    first = next(iter(rows))
    for channel, row in rows.items():
        if set(row) != set(rows[first]):
            raise node.entries()[channel].error(
                f"row {channel} has columns [{', '.join(row)}] and row {first} [{', '.join(rows[first])}]; "
                f"every row has the same columns"
            )
    return rows


ROWS = Converted(ByChannel(ByChannel(Number()), of="channels", complete=True), _equal_columns)
"""A sensitivity matrix: a row for each channel, and the same columns in every row."""


def polynomials(item: Number = Number(), *, complete: bool = False) -> ByChannel[tuple[float, ...]]:  # noqa: B008
    """Return the declaration of coefficients of dT, dT², ... for some of the channels, or where complete for all."""
    says = f"a polynomial has at most {ORDER_LIMIT} coefficients, found {{found}}"
    return ByChannel(ListOf(item, most=ORDER_LIMIT, says=says), of="channels", complete=complete)


@dataclass(frozen=True, kw_only=True)
class ThermalSection:
    """``calibration.temperature`` as it stands in a file."""

    reference: float = entry(Number(), "reference temperature, °C")
    range: tuple[float, float] | None = entry(
        Range(), "`[low, high]`, the temperatures that were measured, °C", default=None
    )
    offset: Mapping[str, tuple[float, ...]] = entry(
        polynomials(complete=True), "per channel the coefficients of dT, dT², …, unit/°C, unit/°C², …", default={}
    )
    sensitivity: Mapping[str, tuple[float, ...]] = entry(
        polynomials(complete=True), "per channel the coefficients of dT, dT², …, 1/°C, 1/°C², …", default={}
    )
    lag: float = entry(
        Number(),
        "by how much the sensing element is later than the thermometer, s; negative where it is earlier",
        default=0.0,
    )


def _angle(name: str) -> Number:
    largest = LARGEST_ANGLES[name]
    return Number(minimum=-largest, maximum=largest, says=f"{{found}} is too large; it must be at most {largest:g}")


@dataclass(frozen=True, kw_only=True)
class MountingSection:
    """``calibration.mounting`` as it stands in a file."""

    roll: float = entry(_angle("roll"), "degrees, -180 to 180", default=0.0, kept=True)
    pitch: float = entry(_angle("pitch"), "degrees, -90 to 90", default=0.0, kept=True)
    yaw: float = entry(_angle("yaw"), "degrees, -180 to 180", default=0.0, kept=True)


@dataclass(frozen=True, kw_only=True)
class CoefficientsSection:
    """The section ``calibration`` as it stands in a file."""

    offset: Mapping[str, float] = entry(
        ByChannel(Number(), of="channels", complete=True), "per channel, unit, at the reference temperature"
    )
    sensitivity: Mapping[str, Mapping[str, float]] = entry(
        ROWS,
        "row = channel, column = axis, unit/g; as many columns as channels, or x, y, z for two channels; a singular "
        "matrix is an error",
    )
    nonlinearity: Mapping[str, tuple[float, ...]] | None = entry(
        polynomials(complete=True),
        "per channel one or two numbers n₂, n₃: a channel whose straight part would be S_ii a reads "
        "S_ii (a + n₂a² + n₃a³)",
        default=None,
    )
    temperature: ThermalSection | None = entry(
        Section(ThermalSection), "absent where it was not measured", default=None
    )
    mounting: MountingSection | None = entry(
        Section(MountingSection), "how the sensor sits in its application", default=None
    )


def _coefficients_of(section: CoefficientsSection, node: Node, context: Context) -> Coefficients:
    channels, entries = tuple(context.channels), node.entries()
    axes, sensitivity = _matrix(section.sensitivity, entries["sensitivity"], channels)
    thermal, mounting, bent = section.temperature, section.mounting, section.nonlinearity
    return Coefficients(
        channels=channels,
        axes=axes,
        offset=np.array([section.offset[channel] for channel in channels]),
        sensitivity=sensitivity,
        thermal=None
        if thermal is None
        else Thermal(
            reference=thermal.reference,
            range=thermal.range,
            drift=_padded(thermal.offset, channels),
            gain=_padded(thermal.sensitivity, channels),
            lag=thermal.lag,
        ),
        mounting=None
        if mounting is None
        else Mounting(radians(mounting.roll), radians(mounting.pitch), radians(mounting.yaw)),
        nonlinearity=None if bent is None else _nonlinearity(bent, entries["nonlinearity"], channels, axes),
    )


def _section_of(coefficients: Coefficients) -> CoefficientsSection:
    channels, axes, thermal = coefficients.channels, coefficients.axes, coefficients.thermal
    bent, mounting = coefficients.nonlinearity, coefficients.mounting
    rows = zip(channels, coefficients.sensitivity.tolist(), strict=True)
    return CoefficientsSection(
        offset=dict(zip(channels, coefficients.offset.tolist(), strict=True)),
        sensitivity={channel: dict(zip(axes, row, strict=True)) for channel, row in rows},
        nonlinearity=None if bent is None else _by_channel(channels, bent),
        temperature=None
        if thermal is None
        else ThermalSection(
            reference=float(thermal.reference),
            range=thermal.range and (float(thermal.range[0]), float(thermal.range[1])),
            offset=_by_channel(channels, thermal.drift),
            sensitivity=_by_channel(channels, thermal.gain),
            lag=float(thermal.lag),
        ),
        mounting=None
        if mounting is None
        else MountingSection(**{name: in_degrees(getattr(mounting, name)) for name in ANGLES}),
    )


COEFFICIENTS = Converted(Section(CoefficientsSection), _coefficients_of, _section_of)
"""The section ``calibration``; reading refuses a matrix that cannot be inverted."""


def in_degrees(angle: float) -> float:
    """Return an angle in radians as degrees, with 12 digits so that 60 does not become 59.99999999999999."""
    return significant(degrees(angle), _ANGLE_DIGITS)


def _matrix(
    rows: Mapping[str, Mapping[str, float]], node: Node, channels: Sequence[str]
) -> tuple[tuple[str, ...], Array]:
    """Return the columns of a matrix, in the order x, y, z, and the matrix."""
    axes = tuple(axis for axis in AXES if axis in rows[channels[0]])
    square = _square_columns(node, channels, axes)
    matrix = np.array([[rows[channel][axis] for axis in axes] for channel in channels])
    values = np.linalg.svd(matrix[:, square], compute_uv=False)
    if not values[-1] >= _SINGULAR * values[0] or values[0] == 0.0:
        raise node.error("the matrix is singular: its rows do not separate the axes; measure the sensitivity again")
    return axes, matrix


def _square_columns(node: Node, channels: Sequence[str], axes: Sequence[str]) -> list[int]:
    """Return the columns that are inverted: all, x and y where unit gravity gives z, or that of a single channel."""
    if len(axes) == len(channels):
        return list(range(len(axes)))
    if len(channels) == 2 and len(axes) == 3:
        return [0, 1]
    if len(channels) == 1 and channels[0] in axes:
        return [axes.index(channels[0])]
    raise node.error(
        f"{len(axes)} columns [{', '.join(axes)}] do not go with {len(channels)} channels [{', '.join(channels)}]: "
        f"there are as many columns as channels; for two channels the columns x, y and z; for one its own and others"
    )


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
    curves: Mapping[str, Sequence[float]], node: Node, channels: Sequence[str], axes: Sequence[str]
) -> Array:
    """Return the shares of the square and the cube by channel; refuse a reading that has several angles."""
    table = _padded(curves, channels)
    if table.shape[1] > NONLINEAR_TERMS:
        raise node.error(f"a nonlinearity has at most {NONLINEAR_TERMS} terms, the square and the cube")
    if any(channel not in axes for channel in channels):
        raise node.error("a nonlinearity needs every channel's sensitivity to its own axis")
    for channel, row in zip(channels, table, strict=True):
        # The derivative 1 + 2 n2 a + 3 n3 a² is smallest at an end of the range or at its own turning point.
        square, cube = np.pad(row, (0, NONLINEAR_TERMS - len(row)))
        turning = -square / (3.0 * cube) if cube else 1.0
        places = [-1.0, 1.0, *([turning] if abs(turning) < 1.0 else [])]
        if min(1.0 + 2.0 * square * a + 3.0 * cube * a * a for a in places) < STEEP:
            raise node.error(f"the nonlinearity of {channel} is so large that one reading has several angles")
    return table

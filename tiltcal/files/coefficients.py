"""The coefficients of the measurement model as they stand in a calibration file and in a twin file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import degrees, radians
from typing import Any

import numpy as np

from tiltcal.core.model import AXES, Array, Coefficients, Mounting, Thermal
from tiltcal.core.rounding import significant
from tiltcal.files.node import Node

ORDER_LIMIT = 6
ANGLES = ("roll", "pitch", "yaw")

_SINGULAR = 1e-9
"""Smallest over largest singular value below which a sensitivity matrix has no inverse worth its name."""
_ANGLE_DIGITS = 12

NONLINEAR_TERMS = 2
"""The square and the cube."""

STEEP = 0.1
"""Least slope of a bent characteristic relative to the straight one."""


def read_coefficients(node: Node, channels: Sequence[str]) -> Coefficients:
    """The ``calibration`` section of a calibration file.

    Parameters
    ----------
    node : Node
    channels : sequence of str
        The sensor's, in order.

    Returns
    -------
    Coefficients

    Raises
    ------
    InputError
        A key or value is wrong, or the sensitivity matrix cannot be inverted.
    """
    section = node.mapping(required=("offset", "sensitivity"), optional=("nonlinearity", "temperature", "mounting"))
    offset = read_per_channel(section["offset"], channels)
    axes, sensitivity = _read_matrix(section["sensitivity"], channels)
    return Coefficients(
        channels=tuple(channels),
        axes=axes,
        offset=np.array([offset[channel] for channel in channels]),
        sensitivity=sensitivity,
        thermal=_read_thermal(section["temperature"], channels) if "temperature" in section else None,
        mounting=_read_mounting(section["mounting"]) if "mounting" in section else None,
        nonlinearity=_read_nonlinearity(section["nonlinearity"], channels, axes) if "nonlinearity" in section else None,
    )


def write_coefficients(coefficients: Coefficients) -> dict[str, Any]:
    """The ``calibration`` section for coefficients, as plain data in the order of the file."""
    section: dict[str, Any] = {
        "offset": _by_name(coefficients.channels, coefficients.offset.tolist()),
        "sensitivity": {
            channel: _by_name(coefficients.axes, row)
            for channel, row in zip(coefficients.channels, coefficients.sensitivity.tolist(), strict=True)
        },
    }
    if coefficients.nonlinearity is not None:
        section["nonlinearity"] = _by_name(coefficients.channels, coefficients.nonlinearity.tolist())
    if coefficients.thermal is not None:
        section["temperature"] = _write_thermal(coefficients.thermal, coefficients.channels)
    if coefficients.mounting is not None:
        mounting = coefficients.mounting
        section["mounting"] = {name: in_degrees(getattr(mounting, name)) for name in ANGLES}
    return section


def read_per_channel(node: Node, channels: Sequence[str], minimum: float | None = None) -> dict[str, float]:
    """One number for each channel."""
    return {name: value.number(minimum=minimum) for name, value in node.mapping(required=channels).items()}


def read_rows(node: Node, channels: Sequence[str], minimum: float | None = None) -> dict[str, dict[str, float]]:
    """A sensitivity matrix: a row for each channel, and the same columns in every row."""
    rows = {
        channel: {axis: value.number(minimum=minimum) for axis, value in row.mapping(optional=AXES).items()}
        for channel, row in node.mapping(required=channels).items()
    }
    first = channels[0]
    for channel in channels:
        if set(rows[channel]) != set(rows[first]):
            raise node.entries()[channel].error(
                f"row {channel} has columns [{', '.join(rows[channel])}] and row {first} [{', '.join(rows[first])}]; "
                f"every row has the same columns"
            )
    return rows


def read_polynomials(node: Node, channels: Sequence[str], minimum: float | None = None) -> dict[str, list[float]]:
    """Coefficients of dT, dT², ... for some of the channels."""
    polynomials = {}
    for channel, value in node.mapping(optional=channels).items():
        numbers = [item.number(minimum=minimum) for item in value.items()]
        if len(numbers) > ORDER_LIMIT:
            raise value.error(f"a polynomial has at most {ORDER_LIMIT} coefficients, found {len(numbers)}")
        polynomials[channel] = numbers
    return polynomials


def in_degrees(angle: float) -> float:
    """An angle in radians as it is written: in degrees, with 12 digits so that 60 does not become 59.99999999999999."""
    return significant(degrees(angle), _ANGLE_DIGITS)


def _read_matrix(node: Node, channels: Sequence[str]) -> tuple[tuple[str, ...], Array]:
    """The columns that are there, in the order x, y, z, and the matrix."""
    rows = read_rows(node, channels)
    axes = tuple(axis for axis in AXES if axis in rows[channels[0]])
    square = _square_columns(node, channels, axes)
    matrix = np.array([[rows[channel][axis] for axis in axes] for channel in channels])
    values = np.linalg.svd(matrix[:, square], compute_uv=False)
    if not values[-1] >= _SINGULAR * values[0] or values[0] == 0.0:
        raise node.error("the matrix is singular: its rows do not tell the axes apart; measure the sensitivity again")
    return axes, matrix


def _square_columns(node: Node, channels: Sequence[str], axes: Sequence[str]) -> list[int]:
    """The columns that are inverted: all, x and y where z comes from unit gravity, or that of a single channel."""
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


def _read_thermal(node: Node, channels: Sequence[str]) -> Thermal:
    section = node.mapping(required=("reference",), optional=("range", "offset", "sensitivity"))
    return Thermal(
        reference=section["reference"].number(),
        range=section["range"].interval() if "range" in section else None,
        drift=_padded(section.get("offset"), channels),
        gain=_padded(section.get("sensitivity"), channels),
    )


def _padded(node: Node | None, channels: Sequence[str]) -> Array:
    """Polynomials of all channels with zeros up to the longest."""
    polynomials = {} if node is None else read_polynomials(node, channels)
    order = max((len(numbers) for numbers in polynomials.values()), default=0)
    table = np.zeros((len(channels), order))
    for row, channel in zip(table, channels, strict=True):
        numbers = polynomials.get(channel, [])
        row[: len(numbers)] = numbers
    return table


def _write_thermal(thermal: Thermal, channels: Sequence[str]) -> dict[str, Any]:
    section: dict[str, Any] = {"reference": float(thermal.reference)}
    if thermal.range is not None:
        section["range"] = [float(bound) for bound in thermal.range]
    for name, table in (("offset", thermal.drift), ("sensitivity", thermal.gain)):
        if table.shape[1]:
            section[name] = _by_name(channels, table.tolist())
    return section


def _read_nonlinearity(node: Node, channels: Sequence[str], axes: Sequence[str]) -> Array:
    """Shares of the square and the cube of each channel's own acceleration; a reading must have one angle."""
    table = _padded(node, channels)
    if table.shape[1] > NONLINEAR_TERMS:
        raise node.error(f"a non-linearity has at most {NONLINEAR_TERMS} terms, the square and the cube")
    if any(channel not in axes for channel in channels):
        raise node.error("a non-linearity needs every channel's sensitivity to its own axis")
    for channel, row in zip(channels, table, strict=True):
        # The derivative 1 + 2 n2 a + 3 n3 a² is smallest at an end of the range or at its own turning point.
        square, cube = np.pad(row, (0, NONLINEAR_TERMS - len(row)))
        turning = -square / (3.0 * cube) if cube else 1.0
        places = [-1.0, 1.0, *([turning] if abs(turning) < 1.0 else [])]
        if min(1.0 + 2.0 * square * a + 3.0 * cube * a * a for a in places) < STEEP:
            raise node.error(f"the non-linearity of {channel} is so large that one reading has several angles")
    return table


def _read_mounting(node: Node) -> Mounting:
    return Mounting(**{name: radians(value.number()) for name, value in node.mapping(optional=ANGLES).items()})


def _by_name(names: Sequence[str], values: Sequence[Any]) -> Mapping[str, Any]:
    return dict(zip(names, values, strict=True))

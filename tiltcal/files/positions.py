"""A table of positions: the mean readings of a sensor in each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tiltcal.core.gravity_direction import Vector
from tiltcal.core.model import AXES
from tiltcal.errors import InputError
from tiltcal.files.csv_tables import Table, table_rows
from tiltcal.files.document import Document
from tiltcal.files.procedure import Temperature
from tiltcal.files.record import AboveZero, FromOne, Number, Text, about, keys_of
from tiltcal.files.segments import Direction


@dataclass(frozen=True)
class TabledPosition:
    """One row of a table of positions.

    Up is a unit vector in the sensor frame, None where the position's name gives it; means and their standard
    uncertainties are by channel, in the sensor's unit; what the table does not state is None.
    """

    name: str
    gravity: Vector | None
    mean: dict[str, float]
    u: dict[str, float] | None
    n: int | None
    temperature: float | None
    line: int | None


class TabledRow(Direction, kw_only=True):
    """One row of a table of positions, as it stands in its file."""

    position: Annotated[Text, about("its name")]
    x: Annotated[Number | None, about("mean reading, unit; needed where the sensor has the channel")] = None
    y: Annotated[Number | None, about("likewise")] = None
    z: Annotated[Number | None, about("likewise")] = None
    ux: Annotated[
        AboveZero | None,
        about(
            "standard uncertainty of the mean, unit; in every row or in none, where rounding to the last digit counts"
        ),
    ] = None
    uy: Annotated[AboveZero | None, about("likewise")] = None
    uz: Annotated[AboveZero | None, about("likewise")] = None
    n: Annotated[FromOne | None, about("number of samples behind the means")] = None
    temperature: Annotated[Temperature | None, about("°C")] = None


def read_positions(table: Table, channels: Sequence[str]) -> list[TabledPosition]:
    """Read and check a table of positions, in the order of the file.

    ``table`` is CSV with the columns ``position``, a mean for each channel (``x``, ...), and optionally a direction
    (``gx``, ``gy``, ``gz``), standard uncertainties of the means (``ux``, ...), ``n`` and ``temperature``; or a JSON
    list of objects with these keys; or such rows. An InputError names file, line and column.
    """
    absent = [f"{lead}{axis}" for axis in AXES if axis not in channels for lead in ("", "u")]
    keys = {key: needed or key in channels for key, needed in keys_of(TabledRow).items() if key not in absent}
    path = table if isinstance(table, str | Path) else "the table"
    positions = [_position(row, channels) for row in table_rows(table, path, keys)]
    if not positions:
        raise InputError("the table has no position", file=path)
    stated = [position for position in positions if position.u is not None]
    if stated and len(stated) < len(positions):
        silent = next(position for position in positions if position.u is None)
        raise InputError(
            f"{silent.name} has no uncertainty, and {stated[0].name} has one: give it for every position, or for none",
            file=path,
            line=silent.line,
        )
    return positions


def tabled_channels(table: Table, axes: Sequence[str]) -> tuple[str, ...]:
    """Return those of some axes that a table has a reading of."""
    path = table if isinstance(table, str | Path) else "the table"
    rows = [row.read(TabledRow) for row in table_rows(table, path, keys_of(TabledRow))]
    return tuple(axis for axis in axes if any(getattr(row, axis) is not None for row in rows))


def _position(node: Document, channels: Sequence[str]) -> TabledPosition:
    row = node.read(TabledRow)
    return TabledPosition(
        row.position,
        row.vector(node),
        {channel: getattr(row, channel) for channel in channels},
        _uncertainty(row, node, channels),
        row.n,
        row.temperature,
        node.line,
    )


def _uncertainty(row: TabledRow, node: Document, channels: Sequence[str]) -> dict[str, float] | None:
    u = {channel: getattr(row, f"u{channel}") for channel in channels}
    missing = [f"u{channel}" for channel, value in u.items() if value is None]
    if len(missing) == len(channels):
        return None
    if missing:
        raise node.error(f"{', '.join(missing)} is missing; give the uncertainty of every mean, or of none")
    return u

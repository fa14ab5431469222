"""A table of positions: what a sensor read on average in each, worked out elsewhere."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tiltcal.core.frames import Vector
from tiltcal.errors import InputError
from tiltcal.files.csv_tables import table_records
from tiltcal.files.node import Node
from tiltcal.files.procedure import ABSOLUTE_ZERO
from tiltcal.files.segments import DIRECTION, direction_of


@dataclass(frozen=True)
class TabledPosition:
    """One row of a table of positions.

    Attributes
    ----------
    name : str
        Of the position.
    gravity : tuple of float or None
        Up in the sensor frame, a unit vector; None where the procedure says it by the position's name.
    mean : dict of str to float
        Per channel, in the sensor's unit.
    u : dict of str to float or None
        Standard uncertainty of each mean, same unit; None where the table does not say it.
    n : int or None
        Number of samples behind the mean; None where the table does not say it.
    temperature : float or None
        °C.
    line : int or None
        Where the row stands in its file.
    """

    name: str
    gravity: Vector | None
    mean: dict[str, float]
    u: dict[str, float] | None
    n: int | None
    temperature: float | None
    line: int | None


def read_positions(table: str | Path | Sequence[Mapping[str, Any]], channels: Sequence[str]) -> list[TabledPosition]:
    """Read and check a table of positions.

    Parameters
    ----------
    table : str, Path or sequence of mapping
        CSV with the columns ``position``, a mean for each channel (``x``, ...), and optionally a direction (``gx``,
        ``gy``, ``gz``), standard uncertainties of the means (``ux``, ...), ``n`` and ``temperature``; or a JSON list of
        objects with these keys; or such rows.
    channels : sequence of str

    Returns
    -------
    list of TabledPosition
        In the order of the file.

    Raises
    ------
    InputError
        Anything in it is wrong; the message names file, line and column.
    """
    required = ("position", *channels)
    optional = (*DIRECTION, *(f"u{channel}" for channel in channels), "n", "temperature")
    path = table if isinstance(table, str | Path) else "the table"
    records = table_records(table, path, required, optional)
    positions = [_position(record, channels, required, optional) for record in records]
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


def _position(
    record: Node, channels: Sequence[str], required: Sequence[str], optional: Sequence[str]
) -> TabledPosition:
    section = record.mapping(required=required, optional=optional)
    return TabledPosition(
        section["position"].text(),
        direction_of(record, section),
        {channel: section[channel].number() for channel in channels},
        _uncertainty(record, section, channels),
        section["n"].integer(minimum=1) if "n" in section else None,
        section["temperature"].number(minimum=ABSOLUTE_ZERO) if "temperature" in section else None,
        record.line,
    )


def _uncertainty(record: Node, section: dict[str, Node], channels: Sequence[str]) -> dict[str, float] | None:
    given = [channel for channel in channels if f"u{channel}" in section]
    if not given:
        return None
    if len(given) < len(channels):
        missing = ", ".join(f"u{channel}" for channel in channels if channel not in given)
        raise record.error(f"{missing} is missing; give the uncertainty of every mean, or of none")
    return {channel: section[f"u{channel}"].number(above=0.0) for channel in channels}

"""Compensated rows on their way out as NetCDF: the log as it is, and variables with what was made of it.

The log's file is copied, byte for byte, and the new variables are put into the copy: all that it holds stays as it was,
attributes, packing, groups and all. What is added says what it is as the CF conventions want it.

Roll and pitch have no ``standard_name``: those of CF are a platform's, with its bow and its starboard side, and which
way the sensor's x axis looks on it nobody has said.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from typing import Any, BinaryIO

import numpy as np

from tiltcal.core.compensation import (
    CLIPPED,
    FLAGS,
    NO_TEMPERATURE,
    NOT_A_NUMBER,
    RAIL,
    TEMPERATURE_RANGE,
    TILT_RANGE,
)
from tiltcal.logs.csv_writer import Table
from tiltcal.logs.netcdf_log import NetcdfLog, SlicedBlock

_MEANINGS = {
    CLIPPED: "arcsine_argument_beyond_1",
    TEMPERATURE_RANGE: "temperature_outside_calibrated_range",
    RAIL: "reading_at_rail",
    TILT_RANGE: "tilt_outside_calibrated_range",
    NO_TEMPERATURE: "temperature_missing",
    NOT_A_NUMBER: "not_a_number",
}
_JUDGEMENTS: Mapping[str, Mapping[str, Any]] = {
    "flag": {
        "long_name": "quality flag of QARTOD",
        "standard_name": "quality_flag",
        "flag_values": np.array([*FLAGS], np.uint8),
        "flag_meanings": " ".join(FLAGS.values()),
    },
    "reason": {
        "long_name": "reasons for the quality flag",
        "standard_name": "status_flag",
        "flag_masks": np.array([*_MEANINGS], np.uint8),
        "flag_meanings": " ".join(_MEANINGS.values()),
    },
}
_STANDARD, _EXPANDED = "u_", "U95_"
_CHUNK = 1 << 16
"""Rows."""


def write_netcdf(
    sink: BinaryIO,
    source: BinaryIO,
    log: NetcdfLog,
    columns: Sequence[int],
    added: Sequence[str],
    blocks: Iterable[tuple[SlicedBlock, Table]],
    origin: Mapping[str, str],
    moment: datetime,
) -> None:
    """Write a NetCDF log with variables behind its own.

    Parameters
    ----------
    sink : BinaryIO
        Can be read as well.
    source : BinaryIO
        The log's bytes.
    log : NetcdfLog
    columns : sequence of int
        Where its readings stand.
    added : sequence of str
        Names of the new variables.
    blocks : iterable of (SlicedBlock, mapping)
    origin : mapping of str to str
        What they were made with.
    moment : datetime
        For the file's history.
    """
    import h5netcdf

    shutil.copyfileobj(source, sink, 1 << 20)
    sink.flush()
    dimension = log.dimension(columns)
    like = log.said_of(log.names[columns[0]])
    with h5netcdf.File(sink, "r+", decode_vlen_strings=True) as file:
        rows = file.dimensions[dimension].size
        variables = {}
        for name in added:
            whole = name in _JUDGEMENTS
            variable = file.create_variable(
                name,
                (dimension,),
                "u1" if whole else "f8",
                chunks=(min(rows, _CHUNK),),
                compression="gzip",
                compression_opts=1,
                shuffle=True,
                fillvalue=None if whole else np.nan,
            )
            for key, value in _said_of(name, added, like).items():
                variable.attrs[key] = value
            variables[name] = variable
        for block, table in blocks:
            for name, values in table.items():
                variables[name][block.rows] = np.asarray(values)
        file.attrs["history"] = _history(file.attrs.get("history"), origin, moment)


def _said_of(name: str, added: Sequence[str], like: Mapping[str, Any]) -> dict[str, Any]:
    """The attributes of a new variable; ``like`` are those of a reading, whose unit a pair's sum has."""
    place = {key: like[key] for key in ("coordinates",) if key in like}
    if name in _JUDGEMENTS:
        return {**_JUDGEMENTS[name], **place}
    beside = [one for one in ("flag", "reason", _STANDARD + name, _EXPANDED + name) if one in added]
    unit = _unit(name, like)
    return {
        "long_name": _long_name(name),
        **({} if unit is None else {"units": unit}),
        **({} if name.startswith((_STANDARD, _EXPANDED)) else {"ancillary_variables": " ".join(beside)}),
        **place,
    }


def _unit(name: str, like: Mapping[str, Any]) -> Any:
    if name.startswith(("matched_", "gradient")):
        return like.get("units")
    return "1" if name.startswith("g_") else "degree"


def _long_name(name: str) -> str:
    if name.startswith(_STANDARD):
        return f"standard uncertainty of {name.removeprefix(_STANDARD)}"
    if name.startswith(_EXPANDED):
        return f"half width of the 95 % interval of {name.removeprefix(_EXPANDED)}"
    kind, _, of = name.partition("_")
    return {
        "g": f"share of gravity along {of}, up",
        "tilt": f"tilt of the {of} axis, positive where it points up",
        "pitch": "pitch, positive where the x axis points up",
        "roll": "roll, positive where the y axis points up",
        "inclination": "inclination of the z axis from the vertical",
        "matched": f"matched sum of the pair {of}",
        "gradient": "gradient signal" if not of else f"{of} component of the gradient signal at twice the turning",
    }.get(kind, name)


def _history(before: Any, origin: Mapping[str, str], moment: datetime) -> str:
    made = ", ".join(f"{key} {value}" for key, value in origin.items() if key != "software")
    line = f"{moment:%Y-%m-%dT%H:%M:%SZ} {origin['software']} apply: {made}"
    return line if before is None else f"{before}\n{line}"

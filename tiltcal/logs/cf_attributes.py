"""The attributes of a column by the CF conventions: units, and what flags mean.

Source: NetCDF Climate and Forecast conventions 1.11, sections 3.1 (units), 3.5 (flags) and 4.4 (time).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tiltcal.core.flags import FLAGS, REASONS
from tiltcal.core.model import Array
from tiltcal.errors import InputError
from tiltcal.units import DEGREE, seconds_in

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
        "flag_masks": np.array([*REASONS], np.uint16),
        "flag_meanings": " ".join("_".join(re.findall(r"\w+", why.replace("the ", ""))) for why in REASONS.values()),
    },
}
_UNCERTAINTIES = {
    "u_random_": "standard uncertainty of {}, random",
    "u_common_": "standard uncertainty of {}, common to all rows",
    "u_": "standard uncertainty of {}",
    "U95_": "half width of the 95 % interval of {}",
}

_LONG_NAMES = {
    "g": "share of gravity along {}, up",
    "tilt": "tilt of the {} axis, positive where it points up",
    "pitch": "pitch, positive where the x axis points up",
    "roll": "roll, positive where the y axis points up",
    "inclination": "inclination of the z axis from the vertical",
    "heading": "heading of the x axis, clockwise from north",
    "v": "velocity, component {}",
    "matched": "matched sum of the pair {}",
}
COUNT = "count"
_SINCE = re.compile(r"\s+since\s+", re.IGNORECASE)
_SINGLE_DIGIT = re.compile(r"(?<![\d.])(\d)(?!\d)")
_ZONE = re.compile(r"\.?\s*(?:Z|UTC|GMT)?$|\.?\s+(?=[+-]\d)")


def in_seconds(time: Array, unit: str | None, file: str | None = None) -> Array:
    """Return a time as seconds since 1970 where its unit names a moment, such as ``days since 2026-05-01``.

    Without one it is in seconds since the moment that it counts from, and without a unit in seconds.
    """
    name, *since = _SINCE.split((unit or "").strip(), maxsplit=1)
    length = seconds_in(name) if name not in ("", "1") else 1.0
    if length is None:
        why = f"the time is in {unit!r}, and {name!r} is no unit of time: convert it, such as to"
        raise InputError(f"{why} 'seconds since 1970-01-01'", file=file)
    seconds = time * length if length >= 1.0 else time / round(1.0 / length)
    return np.asarray(seconds + _epoch(since[0].strip(), unit, file) if since else seconds)


def _epoch(text: str, unit: str | None, file: str | None) -> float:
    """Return the moment from which a time counts, seconds since 1970; CF needs no zeros in front of its numbers."""
    from tiltcal.files.moments import moment

    year, _, rest = text.partition("-")
    padded = _ZONE.sub("", _SINGLE_DIGIT.sub(r"0\1", rest))
    try:
        return moment(f"{year:0>4}-{padded}").timestamp()
    except InputError:
        raise InputError(
            f"the time is in {unit!r}, and {text!r} is no moment: write it as 2026-05-01 12:00:00", file=file
        ) from None


def is_judgement(name: str) -> bool:
    """Return whether a column holds flags or reasons, which are whole numbers."""
    return name.rpartition("_")[2] in _JUDGEMENTS


def describe(
    name: str, added: Sequence[str], like: Mapping[str, Any], units: Mapping[str, str | None] | None = None
) -> dict[str, Any]:
    """Return the attributes of one of the ``added`` columns.

    ``like`` are those of a reading, whose unit the matched sum of a pair has; ``units`` are those of columns that have
    the unit of another column of the log.
    """
    sensor = next((one[:-4] for one in added if one.endswith("_flag") and name.startswith(one[:-4])), "")
    name, whose = name.removeprefix(sensor), f", of {sensor.removesuffix('_')}" if sensor else ""
    attributes: dict[str, Any] = {"coordinates": like["coordinates"]} if "coordinates" in like else {}
    if name in _JUDGEMENTS:
        return {**attributes, **_JUDGEMENTS[name], "long_name": _JUDGEMENTS[name]["long_name"] + whose}
    if name == COUNT:
        return attributes | {"long_name": "number of rows of which each row is the mean", "units": "1"}
    lead = next((lead for lead in _UNCERTAINTIES if name.startswith(lead)), "")
    quantity = name.removeprefix(lead)
    kind, _, of = quantity.partition("_")
    unit: str | None = "1" if kind == "g" else DEGREE
    if (units and quantity in units) or kind in ("matched", "gradient"):
        unit = (units or {}).get(quantity, like.get("units"))
    if unit is not None:
        attributes["units"] = unit
    if lead:
        return attributes | {"long_name": _UNCERTAINTIES[lead].format(quantity) + whose}
    beside = [sensor + column for column in ("flag", "reason", *(f"{one}{quantity}" for one in _UNCERTAINTIES))]
    attributes["ancillary_variables"] = " ".join(column for column in beside if column in added)
    if kind == "gradient" and of:
        return attributes | {"long_name": f"{of} component of the gradient signal at twice the turning"}
    return attributes | {"long_name": _LONG_NAMES.get(kind, "gradient signal").format(of) + whose}

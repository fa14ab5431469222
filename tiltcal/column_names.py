"""What the name of a column means: an axis of an accelerometer, a time, a temperature."""

from __future__ import annotations

import re
from collections.abc import Iterable

from tiltcal.units import split_unit

AXES = ("x", "y", "z")
TIME, TEMPERATURE = "time", "temperature"

LONGEST_NAME = 200  # characters of a name that means something

_CLOCKS = (
    "time", "t", "seconds_elapsed", "timestamp", "datetime", "date time", "date/time", "utc time", "epoch", "epoc",
    "elapsed", "time since start", "elapsed time", "timestamps", "utc", "seconds", "sec", "millis", "ms", "clock",
    "header.stamp", "field.header.stamp", "unix time", "unix_time", "system time", "local time",
    "yyyy-mo-dd hh-mi-ss_sss",
)  # fmt: skip
"""Names of a time, the best first."""
_THERMOMETER = re.compile(
    r"(?:(?:imu|sensor|chip|die|internal|accel(?:erometer)?)[ _.]*)?(?:temp(?:erature)?|celsius)", re.IGNORECASE
)
_WORDS = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+")
_GLUED = re.compile(r"(?:field\.)?(?:(a|aa|acc|accel|gf|gforce)[ _.-]?([xyz])|([xyz])[ _.-]?acc)", re.IGNORECASE)
_ACCELERATION = {"a", "acc", "accel", "accelerometer", "acceleration", "accelerations", "gforce", "gf", "lacc", "aacc"}
_OTHER_QUANTITY = re.compile(
    "g|gyro?s?|gyroscope|w|omega|angular|rot|rotation|rate|m|magn?|magnetometer|magnetic|b|field|compass|vel|velocity|pos"
    "|position|euler|q|quat|quaternion|angles?|orientation|attitude|std|var|covariance|min|max|rms|sigma|bias|offset|jerk"
)
"""Words of names that are no acceleration, or none of a sample."""


def meaning(name: str) -> str:
    """Return the role that the name of a column means, without its unit: an axis, time, temperature; else nothing."""
    name = name.strip()
    if len(name) > LONGEST_NAME:
        return ""
    if name.lower() in _CLOCKS:
        return TIME
    if _THERMOMETER.fullmatch(name):
        return TEMPERATURE
    if glued := _GLUED.fullmatch(name):
        return str(glued[2] or glued[3]).lower()
    words = [word.lower() for word in _WORDS.findall(re.sub(r"^field\.|-?axis", "", name, flags=re.IGNORECASE))]
    axes = [word for word in words if word in AXES]
    rest = {word for word in words if word not in AXES and not word.isdigit()}
    if len(axes) != 1 or any(map(_OTHER_QUANTITY.fullmatch, rest)) or (rest and not rest & _ACCELERATION):
        return ""
    return str(axes[0])


def best_time(names: Iterable[str]) -> str:
    """Return the name that means a time best, of several that do."""
    return min(names, key=lambda name: (_CLOCKS.index(split_unit(name)[0].strip().lower()), name))


def role_of(cell: str) -> str:
    """Return the role that a cell of a header means, which may have a unit behind the name."""
    return meaning(split_unit(cell)[0])

"""What the name of a column means: an axis of an accelerometer, a time, a temperature."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable

from tiltcal.units import split_unit

AXES = ("x", "y", "z")
TIME, TEMPERATURE = "time", "temperature"

_CLOCKS = (
    "time", "t", "seconds_elapsed", "timestamp", "datetime", "date time", "date/time", "utc time", "epoch", "epoc",
    "elapsed", "time since start", "elapsed time", "timestamps", "utc", "seconds", "sec", "millis", "ms", "clock",
    "header.stamp", "field.header.stamp", "unix time", "unix_time", "system time", "local time",
    "yyyy-mo-dd hh-mi-ss_sss", "zeit", "temps", "tiempo", "tempo", "tijd", "x_value",
)  # fmt: skip
"""Names of a time, the best first."""
_THERMOMETER = re.compile(
    r"(?:(?:imu|sensor|chip|die|internal|accel(?:erometer)?)[ _.]*)?(?:temp(?:erature)?|celsius)", re.IGNORECASE
)
_WORDS = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+")
_GLUED = re.compile(r"(?:field\.)?(?:(a|aa|acc|accel|gf|gforce)[ _.-]?([xyz])|([xyz])[ _.-]?a(?:cc)?)", re.IGNORECASE)
_PLACE = re.compile(r"\[([012])\]$")  # of an axis in an array
_ACCELERATION = {
    "a", "acc", "accel", "accelerometer", "acceleration", "accelerations", "gforce", "gf", "lacc", "aacc",
    "beschleunigung", "aceleracion", "aceleracao", "accelerazione", "versnelling",
}  # fmt: skip
_SAYS_NOTHING = {"value", "values", "raw", "data", "reading", "smooth"}
_OTHER_QUANTITY = re.compile(
    "g|gyro?s?|gyroscope|w|omega|angular|rot|rotation|rate|m|magn?|magnetometer|magnetic|b|field|compass|vel|velocity|pos"
    "|position|euler|q|quat|quaternion|angles?|orientation|attitude|std|var|covariance|min|max|rms|sigma|bias|offset|jerk"
)
"""Words of names that are no acceleration, or none of a sample."""


def meaning(name: str) -> str:
    """Return the role that the name of a column means, without its unit: an axis, time, temperature; else nothing."""
    name = name.strip()
    if name.lower() in _CLOCKS:
        return TIME
    if _THERMOMETER.fullmatch(name):
        return TEMPERATURE
    if glued := _GLUED.fullmatch(name):
        return str(glued[2] or glued[3]).lower()
    plain = unicodedata.normalize("NFKD", re.sub(r"^field\.|-?axis", "", name, flags=re.IGNORECASE))
    words = [word.lower() for word in _WORDS.findall("".join(c for c in plain if not unicodedata.combining(c)))]
    axes = [word for word in words if word in AXES]
    rest = {word for word in words if word not in AXES and not word.isdigit()} - _SAYS_NOTHING
    if any(map(_OTHER_QUANTITY.fullmatch, rest)):
        return ""
    *before, last = re.split(r"[ _.:/]+", name)
    if before and (glued := _GLUED.fullmatch(last)):  # imu_ax, MPU6050 ax
        return str(glued[2] or glued[3]).lower()
    if rest & _ACCELERATION and not axes and (place := _PLACE.search(name)):
        return AXES[int(place[1])]
    return str(axes[0]) if len(axes) == 1 and (not rest or rest & _ACCELERATION) else ""


def best_time(names: Iterable[str]) -> str:
    """Return the name that means a time best, of several that do."""
    return min(names, key=lambda name: (_CLOCKS.index(split_unit(name)[0].strip().lower()), name))


def role_of(cell: str) -> str:
    """Return the role that a cell of a header means, which may have a unit behind the name."""
    return meaning(split_unit(cell)[0])

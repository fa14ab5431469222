"""The units of readings, times and temperatures: how files spell them, and what they are in the unit used inside.

One table serves headers of logs, attributes of NetCDF and lines of sensors. A time is in seconds inside, a temperature
in °C; a reading keeps its unit, of which :data:`READINGS` has the spellings. What 1 g or 1 rad is in it stands in
:mod:`tiltcal.drivers.model`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

DEGREE = "degree"


def _spellings(table: str) -> dict[str, tuple[str, ...]]:
    """Return the units of a table and the other spellings of each, in small letters."""
    rows = (line.split(" | ") for line in table.strip().splitlines())
    return {name.strip(): tuple(other.strip() for other in others) for name, *others in rows}


READINGS = _spellings("""
count | counts | lsb | digit | digits | raw | adc
V | v | volt | volts
mV | mv | millivolt | millivolts
g | g_n | g0 | gn | gs | g-force | standard_gravity
mg | mgn | milli-g
m/s2 | m s-2 | m s^-2 | m s**-2 | m/s^2 | m/s² | m/s**2 | m/(s^2) | m/s/s | m.s-2 | m·s⁻² | m s⁻² | ms-2 | ms^-2 | meter second-2
mm/s2 | mm/s^2 | mm/s² | mm s-2 | mm s^-2
degree | degrees | deg | ° | arc_degree | arc_degrees | degree_true | degrees_true
rad | radian | radians
mrad | milliradian | milliradians
arcmin | ′ | arc_minute | arcminute | arcminutes
arcsec | ″ | arc_second | arcsecond | arcseconds
mm/m | mm m-1 | ‰
% | percent | per cent
""")  # noqa: E501
"""Units that a reading of tilt or acceleration may have."""

_OTHERS = _spellings("""
deg/s | °/s | dps | deg s-1 | deg s^-1
rad/s | rad s-1 | rad s^-1
uT | µt | μt | microtesla
nT
gauss
mgauss
Pa
hPa | mbar
kPa
Hz
lux | lx
""")
"""Units of what stands beside the readings of a log."""

CONVENTIONS = "inclination", "euler"
"""What readings that are angles mean: each channel the arcsine of its component of gravity, or pitch and roll."""

TEMPERATURES: Mapping[str, tuple[float, float]] = {"°C": (1.0, 0.0), "°F": (5.0 / 9.0, 32.0), "K": (1.0, 273.15)}
"""Of each unit of temperature: °C in one of its degrees, and its reading at 0 °C."""

_WARMTHS = _spellings("""
°C | c | degc | deg_c | deg c | ° c | celsius | degree_c | degrees_c | degree_celsius | degrees_celsius | ℃
°F | f | degf | deg_f | deg f | ° f | fahrenheit | degree_f | degrees_f | degree_fahrenheit | degrees_fahrenheit | ℉
K | k | kelvin | degk | deg_k | degree_kelvin | degrees_kelvin
""")

_SECONDS = {
    name: seconds
    for seconds, names in {
        1e-9: "ns nsec nanosec nanosecond nanoseconds",
        1e-6: "us µs μs usec microsec microsecond microseconds",
        1e-3: "ms msec millis millisec millisecond milliseconds",
        1.0: "s sec secs second seconds",
        60.0: "min mins minute minutes",
        3600.0: "h hr hrs hour hours",
        86400.0: "d day days",
    }.items()
    for name in names.split()
}
"""Seconds of a unit of time, by its spellings."""

_SPELT = {
    other.casefold(): name
    for table in (READINGS, _OTHERS, _WARMTHS)
    for name, others in table.items()
    for other in (name, *others)
}
_LONGEST = 200  # characters of a name that states a unit
_DIMENSIONLESS = ("", "1")  # units that fit every count and ratio, and say nothing
_BEHIND = re.compile(r"(.*\S)\s*[(\[]([^\[\]]+)[)\]]\s*(?:\[[^\[\]]*\])?")  # x (m/s^2), x [V], time (s)[utc]
_LISTED = re.compile(r"(.*?\S),\s*([^\s,()]+)(?:\s*\(.*\))?")  # X Accel, g (LGR S/N: 1000)
_IN = re.compile(r"(.*\S)\s+in\s+(\S+)\s*")  # time since start in ms
_SUFFIX = re.compile(r"((?:.*[ _.])?(?:time|timestamp|t|elapsed|epoch?|clock|ticks?|stamp)[a-z]*)[ _.]([a-zµμ]+)", re.I)
_OF_WARMTH = re.compile(r"((?:.*[ _.])?(?:temp(?:erature)?|t))[ _.]?((?:deg|°)?[ _]?[CFK])", re.I)


def spelt(unit: str) -> str:
    """Return a unit as this program spells it."""
    text = unit.strip()
    return _SPELT.get(text.casefold(), text)


def same_unit(one: str, other: str) -> bool:
    """Return whether two spellings of units mean the same, or one of them means nothing."""
    return one in _DIMENSIONLESS or other in _DIMENSIONLESS or spelt(one) == spelt(other)


def seconds_in(unit: str) -> float | None:
    """Return how many seconds a unit of time has; None where it is no unit of time."""
    return _SECONDS.get(unit.strip().casefold())


def is_unit(text: str) -> bool:
    """Return whether a text is a unit that a column of a log may have."""
    return spelt(text) in {*_SPELT.values()} or seconds_in(text) is not None


def split_unit(name: str) -> tuple[str, str | None]:
    """Return the name of a column without the unit that it states, and this unit, as it is spelt there.

    A unit stands in brackets (``x (m/s^2)``, ``x [V]``), behind a comma or ``in``, or, of times and temperatures, as
    the last word of a name (``time_us``, ``temp_F``).
    """
    name = name.strip()
    for pattern in (_BEHIND, _LISTED, _IN, _SUFFIX, _OF_WARMTH) if len(name) < _LONGEST else ():
        if (found := pattern.fullmatch(name)) and is_unit(found[2]):
            return found[1], found[2]
    return name, None

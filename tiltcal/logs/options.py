"""The options of ``apply`` and of ``fit``: of the command, the library and the reference."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import date, timedelta
from functools import partial
from pathlib import Path
from typing import Annotated, Any, TypedDict

from tiltcal.errors import Argument, UsageError, listed
from tiltcal.options import Option
from tiltcal.stated_arguments import (
    is_number,
    require_boolean,
    require_convention,
    require_from_zero,
    require_text_or_none,
    require_whole,
    shown,
)

LOCAL_GRAVITY = (9.7, 9.9)  # gravity on the ground is between these, m/s²
_DURATION = re.compile(r"(\d+\.?\d*|\.\d+) *(ms|s|min|h|d)?", re.ASCII)
_SECONDS = {"ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}

_MEANS, _SEASON, _EARTH, _FURTHER = "Means", "Calibrations over time", "Heading and velocity", "Further options"
_UNCERTAINTIES = "Uncertainties of the bench"
_flag = partial(Option, metavar="", default=False, check=require_boolean)
_size = partial(Option, check=require_from_zero)

_whole_rows = partial(require_whole, least=1, what="rows")

Remark = Callable[[str], None]


def silent(line: str) -> None:
    """Say nothing."""


class ApplyOptions(TypedDict, total=False):
    """How a calibration is applied."""

    columns: Annotated[
        Mapping[str, str] | str,
        Option("Columns: x=VoutX,temperature=T; numbers without a header.", "ROLE=NAME,…", default=""),
    ]
    uncertainty: Annotated[bool, _flag("Add u_tilt_x (standard uncertainty) and U95_tilt_x (95 % interval) of angles.")]
    skip_bad_rows: Annotated[bool, _flag("Keep rows that cannot be parsed, with flag 9.")]
    average: Annotated[
        int | None, Option("Average readings of each N rows first; adds count.", "N", _MEANS, check=_whole_rows)
    ]
    every: Annotated[
        str | float | timedelta | None, Option("Average readings of each TIME first: 10s, 5min, 1h.", "TIME", _MEANS)
    ]
    serial: Annotated[
        str | None,
        Option("The sensor, where no name (S_x) in the log says it.", "S", _SEASON, check=require_text_or_none),
    ]
    start: Annotated[str | date | None, Option("When the log's time is 0, such as 2026-05-01T12:00Z.", "TIME", _SEASON)]
    stability: Annotated[float | None, _size("Wander of the offset in a day, mg [as its changes show].", "MG", _SEASON)]
    magnetometer: Annotated[
        Sequence[str] | str, Option("Columns of the field: adds heading, from north.", "MX,MY,MZ", _EARTH, default=())
    ]
    velocity: Annotated[
        Sequence[str] | str,
        Option("Columns of a velocity: adds v_east, v_north, v_up by the heading.", "U,V,W", _EARTH, default=()),
    ]
    declination: Annotated[float | None, Option("Magnetic north east of true north; added to headings.", "DEG", _EARTH)]
    magnetometer_noise: Annotated[float | None, _size("Standard uncertainty of a component [0].", "UNIT", _EARTH)]
    mounting: Annotated[
        Mapping[str, float] | str,
        Option("How the sensor sits, exactly: roll, then pitch=, then yaw=.", "roll=DEG,…", _FURTHER, default=""),
    ]
    reading_noise: Annotated[
        float | None, _size("Standard uncertainty of a reading [that of a sample].", "UNIT", _FURTHER)
    ]
    first_order: Annotated[bool, _flag("Use Cross-axis Compensation, eq. 6, not the matrix.", group=_FURTHER)]
    unit: Annotated[
        str | None, Option("Of the readings of a frame; it must be the calibration's.", check=require_text_or_none)
    ]
    say: Annotated[Remark, Option("Called with each remark about what had to be assumed.", default=silent)]


def require_consistent(options: ApplyOptions) -> None:
    """Raise UsageError for options that contradict each other or need another."""
    for name, needed in (
        ("stability", ("uncertainty",)),
        ("reading_noise", ("uncertainty",)),
        ("magnetometer_noise", ("magnetometer", "uncertainty")),
    ):
        if options[name] is not None and not all(options[other] for other in needed):  # type: ignore[literal-required]
            raise UsageError(option=name, why=("needs ", *listed(needed)))
    declination = options["declination"]
    if declination is not None and not (options["magnetometer"] or options["velocity"]):
        raise UsageError(option="declination", why=("needs ", Argument("magnetometer"), " or ", Argument("velocity")))
    if declination is not None and not (is_number(declination) and abs(declination) <= 180.0):
        raise UsageError(option="declination", why=f"is between -180 and 180 degrees, not {shown(declination)}")


@dataclass(frozen=True)
class GroupSize:
    """The size of a group of rows that becomes one mean: so many rows of the log, or so many seconds."""

    rows: int | None = None
    seconds: float | None = None

    @classmethod
    def of(cls, rows: int | None, every: str | float | timedelta | None) -> GroupSize | None:
        """Return what ``--average`` and ``--every`` state; None where neither is given."""
        if rows is not None and every is not None:
            why = (*listed(("average", "every")), " each say what belongs into a mean")
            raise UsageError(why, advice="give one of them")
        if every is None:
            return None if rows is None else cls(rows=rows)
        text = str(every.total_seconds() if isinstance(every, timedelta) else every).strip()
        match = _DURATION.fullmatch(text)
        seconds = float(match[1]) * _SECONDS[match[2] or "s"] if match else 0.0
        if not (seconds > 0.0 and is_number(seconds)):
            raise UsageError(option="every", why=f"takes a time such as 10s, 500ms, 5min or 1h, not {every}")
        return cls(seconds=seconds)


def vectors(options: ApplyOptions) -> dict[str, tuple[str, ...]]:
    """Return the three columns of each vector that is asked for, by role."""
    named = {}
    for role, names, example in (
        ("magnetometer", options["magnetometer"], "mx,my,mz"),
        ("velocity", options["velocity"], "u,v,w"),
    ):
        listed = names.split(",") if isinstance(names, str) else names
        columns = tuple(str(name).strip() for name in listed) if isinstance(listed, Iterable) else ()
        if names and (len(set(columns)) != 3 or not all(columns)):
            why = f"names three columns, along x, y and z, such as {example}; not {names!r}"
            raise UsageError(option=role, why=why)
        named[role] = columns
    return {role: columns for role, columns in named.items() if columns and any(columns)}


def _require_local_gravity(option: str, gravity: Any) -> None:
    low, high = LOCAL_GRAVITY
    if gravity is not None and not (is_number(gravity, low) and gravity <= high):
        why = f"is between {low:g} and {high:g} m/s² on the ground, not {shown(gravity)}"
        raise UsageError(option=option, why=why)


def _uncertainty(of: str, metavar: str = "DEGREES", name: str = "") -> Option:
    return _size(f"Standard uncertainty of {of}.", metavar, _UNCERTAINTIES, name=name)


class FitOptions(TypedDict, total=False):
    """What is stated of recorded data from which a sensor is calibrated."""

    segments: Annotated[
        Any,
        Option(
            "The rows of each position: CSV or JSON with position, start, end (exclusive), and gx, gy, gz if it is not "
            "one of the procedure. Without it the static intervals are found, and named for the positions.",
            "PATH",
        ),
    ]
    table: Annotated[
        bool | None,
        Option(
            "The data are a table of means: position, x, y, z, and optionally gx, gy, gz, ux, uy, uz (the standard "
            "uncertainties of the means), n, temperature; for free three numbers a line, without names, will do.",
            "",
            check=lambda name, value: None if value is None else require_boolean(name, value),
        ),
    ]
    columns: Annotated[
        Mapping[str, str] | str,
        Option(
            "The column of each reading [x, y, z, temperature, or what means them], or its number; x=-NAME turns the "
            "sign of one that reads -1 g up.",
            "x=NAME,…",
            default="",
        ),
    ]
    skip_bad_rows: Annotated[bool, _flag("Count rows of a log that cannot be parsed as missing.")]
    unit: Annotated[str | None, Option("The unit of the readings, such as m/s2, V or count [the model's].", "UNIT")]
    serial: Annotated[str | None, Option("The sensor's serial number [that of the base].", "S")]
    sensor: Annotated[str | None, Option("The model of the sensor, if it is one of `tiltcal devices`.", "MODEL")]
    tilt: Annotated[float | None, Option("The angle of a procedure with a free angle, degrees.", "DEGREES")]
    base: Annotated[
        str | Path | None,
        Option(
            "The calibration that mounting and level complete, and whose sensitivity other procedures use; or a folder "
            "with SERIAL.yaml of each.",
            "CAL",
        ),
    ]
    gravity: Annotated[
        float | None,
        Option(
            "Local gravity, 9.7 to 9.9 m/s²: adds sensitivity per m/s², and for readings in m/s2 the scale error.",
            "M/S2",
            check=_require_local_gravity,
        ),
    ]
    angles: Annotated[
        str | None,
        Option(
            "Of readings that are angles: inclination (each axis by itself) or euler (pitch and roll).",
            "CONVENTION",
            check=require_convention,
        ),
    ]
    jig: Annotated[float | None, _uncertainty("a set angle, degrees [from the residuals]")]
    thermometer: Annotated[
        float | None, _uncertainty("a temperature, °C [that of the step of the model's own thermometer]", "CELSIUS")
    ]
    table_lean: Annotated[float | None, _uncertainty("the lean of the table, degrees; all positions share it")]
    heading: Annotated[float | None, _uncertainty("a heading, degrees", name="heading-uncertainty")]
    alignment: Annotated[
        float | None,
        Option(
            "With level: by how much at most the sensor may sit askew since its calibration, about each axis, degrees "
            "[2]; 0 if it was not unplugged. Of a sensor that prints angles: the standard uncertainty of its lean "
            "[0.5].",
            "DEGREES",
            _UNCERTAINTIES,
        ),
    ]
    say: Annotated[Remark, Option("Called with each line of what is found on the way.", default=silent)]

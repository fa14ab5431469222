"""The options of a session at the bench and of its plan: of the commands, the library and the reference."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, TypedDict

from tiltcal.errors import Argument
from tiltcal.files.defaults import Defaults
from tiltcal.options import Option
from tiltcal.stated_arguments import (
    require_above_zero,
    require_boolean,
    require_convention,
    require_from_zero,
    require_path,
    require_whole,
)

_SENSOR, _RESULT, _POSITIONS, _KNOWN = "Sensor", "Result", "Positions", "Known of the bench"


def unheard(line: str) -> None:
    """Drop a remark."""


def _require_path_or_none(option: str, value: object) -> None:
    if value is not None:
        require_path(Argument(option), value)


def _u(of: str, name: str = "") -> Option:
    return Option(f"Standard uncertainty of {of}.", "DEGREES", _KNOWN, check=require_from_zero, name=name)


_file = partial(Option, check=_require_path_or_none)
_flag = partial(Option, metavar="", group=_POSITIONS, default=False, check=require_boolean)
_Path = str | Path | None
_Tilt = Annotated[float | None, Option("The angle of a procedure with a free angle.", "DEGREES", _POSITIONS)]
_whole_samples = partial(require_whole, least=2, what="samples")
_Samples = Annotated[
    int | None, Option("Samples per position, in place of the procedure's.", "N", _POSITIONS, check=_whole_samples)
]
_Defaults = Annotated[
    Callable[[], Defaults] | None, Option("Gives what a tiltcal.toml states, to a new session; the command passes it.")
]
_Lean = Annotated[float | None, _u("the lean of the table that all positions share")]


class MeasureOptions(TypedDict, total=False):
    """What is stated of a session."""

    sensor: Annotated[str | None, Option("The sensor's model; `tiltcal devices` lists them.", "MODEL", _SENSOR)]
    address: Annotated[
        str | None, Option("Its address, such as spi:///dev/spidev0.0; sim: is its virtual twin.", "ADDRESS", _SENSOR)
    ]
    serial: Annotated[str | None, Option("Its serial number, for the calibration file.", "S", _SENSOR)]
    bench: Annotated[
        object, Option("A bench file: measure its sensors together, in place of the above.", "FILE", _SENSOR)
    ]
    python: Annotated[
        str | None, Option("Modules of python: addresses in a bench file or a journal, to import.", "MODULES", _SENSOR)
    ]
    base: Annotated[
        _Path,
        _file(
            "The calibration file of the sensor, or a folder with SERIAL.yaml of each: mounting and level complete it, "
            "and procedures that determine no sensitivity use its own. A file names model and serial number as well.",
            "CAL",
            _SENSOR,
        ),
    ]
    output: Annotated[_Path, _file("The calibration file; with --bench a folder.", "PATH", _RESULT, short="-o")]
    journal: Annotated[_Path, _file("The journal of the session [beside the calibration file].", "PATH", _RESULT)]
    tilt: _Tilt
    samples: _Samples
    settle: Annotated[
        float | None,
        Option(
            "How long a reading must be still before it is sampled.", "SECONDS", _POSITIONS, check=require_above_zero
        ),
    ]
    closing: Annotated[bool, _flag("Visit the first position again at the end, to show what changed meanwhile.")]
    turns: Annotated[int | None, Option("The most turns of a stage, in place of the procedure's.", "N", _POSITIONS)]
    resume: Annotated[
        _Path, _file("Continue an interrupted session with the options that it began with.", "JOURNAL", _POSITIONS)
    ]
    operator: Annotated[
        object,
        Option(
            "Who sets the positions [terminal]: a person at the terminal or at a page in a browser, a program that "
            "reads and writes JSON Lines, or the virtual jig.",
            "terminal|web|json|sim",
            _POSITIONS,
        ),
    ]
    dry_run: Annotated[
        bool, _flag("Only send the table and the chamber of the bench file through all positions, without a sensor.")
    ]
    plain: Annotated[bool, _flag("Plain lines: no live reading, no single keys.")]
    hands_free: Annotated[bool, _flag("With --operator web: take the next position as soon as it is set and still.")]
    listen: Annotated[
        str | None,
        Option("With --operator web: serve the page to other machines too; prints a token.", "HOST:PORT", _POSITIONS),
    ]
    jig: Annotated[float | None, _u("a set angle; without it, it is estimated from the residuals")]
    table_lean: _Lean
    heading: Annotated[float | None, _u("a heading", name="heading-uncertainty")]
    angles: Annotated[
        str | None,
        Option(
            "Of a sensor that prints angles: inclination (each axis by itself) or euler (pitch and roll).",
            "CONVENTION",
            _KNOWN,
            check=require_convention,
        ),
    ]
    alignment: Annotated[
        float | None,
        Option(
            "With level: by how much at most the sensor may sit askew since its calibration, about each axis [2]; 0 if "
            "it was not unplugged. Of a sensor that prints angles: the standard uncertainty of its lean [0.5].",
            "DEGREES",
            _KNOWN,
        ),
    ]
    typical_temperature: Annotated[bool, _flag("Use the mean temperature curves of the data sheet.", group=_KNOWN)]
    defaults: _Defaults
    remark: Annotated[Callable[[str], None], Option("Gets each remark, a line of text.", default=unheard)]
    result: Annotated[
        Callable[[str], None] | None,
        Option("Gets the coefficients of each calibration, lines of text; not with the operator json."),
    ]


class PlanOptions(TypedDict, total=False):
    """What is stated of a session that is predicted."""

    sensor: Annotated[str | None, Option("The sensor's model [that of the base].", "MODEL", _SENSOR)]
    bench: Annotated[_Path, _file("The bench file: its jig, its table's lean, its reference.", "FILE", _KNOWN)]
    address: Annotated[
        str | None, Option("Its address, if an option of it changes the model, as counts_per_g.", "ADDRESS", _SENSOR)
    ]
    base: Annotated[
        _Path,
        _file("Its calibration, for level and for procedures that determine no sensitivity.", "CAL", _SENSOR),
    ]
    tilt: _Tilt
    samples: _Samples
    closing: Annotated[bool, _flag("Visit the first position again at the end.")]
    jig: Annotated[float | None, _u("a set angle")]
    thermometer: Annotated[
        float | None,
        Option("Standard uncertainty of a temperature.", "CELSIUS", _KNOWN, check=require_from_zero),
    ]
    table_lean: _Lean
    alignment: Annotated[
        float | None,
        Option("As measure has it, of a sensor that prints angles [0.5].", "DEGREES", _KNOWN, check=require_from_zero),
    ]
    noise: Annotated[
        float | None,
        Option(
            "Standard deviation of one sample, in the sensor's unit [that of the model].",
            "UNIT",
            _KNOWN,
            check=require_from_zero,
        ),
    ]
    defaults: _Defaults

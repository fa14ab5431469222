"""A procedure as it stands in its file: the sections of the YAML, with their types and what they mean."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from tiltcal.core.pair.model import FEWEST_TURNS
from tiltcal.files.coefficients import ORDER_LIMIT
from tiltcal.files.record import AboveZero, Axis, FromZero, Identifier, Number, Record, Text, about, one_of
from tiltcal.stated_arguments import LEAST, MOST

ABSOLUTE_ZERO, HOTTEST = -273.15, 1000.0
"""Limits of a temperature, °C; no sensor is hotter, and the square of a far larger number is infinite."""
Temperature = Annotated[float, Meta(ge=ABSOLUTE_ZERO, le=HOTTEST)]  # °C, of a position
Order = Annotated[int, Meta(ge=0, le=ORDER_LIMIT)]

FEWEST_WHOLE_TURNS = int(FEWEST_TURNS)
Turns = Annotated[int, Meta(ge=FEWEST_WHOLE_TURNS, le=int(MOST))]
Angle = Annotated[float, Meta(ge=LEAST, le=90.0)]


class Determines(Record):
    """What the positions of a procedure determine besides the offset."""

    axes: Annotated[
        tuple[Axis, ...],
        Meta(extra_json_schema={"uniqueItems": True}),
        about("the columns of the sensitivity matrix, `[]` for none"),
    ]
    drift: Annotated[Order, about("order of the temperature polynomial of the offset, up to 6")] = 0
    gain: Annotated[Order, about("order of the temperature polynomial of the sensitivity, up to 6")] = 0
    nonlinearity: Annotated[int, Meta(ge=0, le=2), about("1 for the square, 2 for square and cube")] = 0
    mounting: Annotated[bool, about("positions of the application, of a sensor with a `--base`; `axes: []`")] = False
    level: Annotated[bool, about("the position is level and renews the offset of the `--base`; `axes: []`")] = False
    cross_validated: Annotated[bool, about("the order of the drift is cross-validated, up to `drift`")] = False
    free: Annotated[bool, about("nobody sets the positions: unit gravity determines; `axes: [x, y, z]`")] = False


class PositionSection(Record):
    """One of ``positions`` as it stands in a file."""

    name: Annotated[Identifier, about("unique; a letter, then letters, digits, `-`, `_`, `.`")]
    prompt: Annotated[Text, about("the operator's sentence, in which `{angle}` and `{temperature}` are filled in")]
    tilt: Annotated[
        Mapping[Annotated[str, one_of("x", "y")], Number | Literal["angle", "-angle"]] | None,
        about("degrees per axis, or `angle` and `-angle`; or else `gravity`"),
    ] = None
    gravity: Annotated[tuple[Number, Number, Number] | None, about("`[gx, gy, gz]`, up in the sensor frame")] = None
    heading: Annotated[Number | None, about("degrees about the vertical; several show the table's own lean")] = None
    temperature: Annotated[Temperature | None, about("°C")] = None
    stage: Annotated[Number | None, about("angle of the rotary stage, degrees; no estimate uses it")] = None


class Soak(Record):
    """The conditions for a new temperature to count as settled."""

    seconds: Annotated[AboveZero, about("the window, seconds")]
    drift: Annotated[AboveZero, about("the largest drift of the temperature in it, or in that of the thermometer, °C")]
    thermometer: Annotated[AboveZero | None, about("the window of a thermometer that may be late, seconds")] = None


USUAL_SOAK = "`{seconds: 20, drift: 0.06, thermometer: 360}`"


class RampSection(Record):
    """How the temperature changes between the positions, which are the turning points of a ramp."""

    pace: Annotated[AboveZero, about("of the virtual chamber, and a proposal for a real one, °C/min")]
    within: Annotated[AboveZero, about("how close to its temperature a leg ends, °C; a turn need not be exact")] = 1.0
    interval: Annotated[AboveZero, about("seconds between two samples")] = 5.0
    patience: Annotated[AboveZero, about("seconds without a change of temperature that end a leg as it is")] = 1800.0


class PairSelection(Record):
    """One of ``rotation.pairs`` as it stands in a file."""

    pair: Annotated[tuple[Text, Text], about("two channels opposite each other; the second is trimmed to the first")]
    orthogonal: Annotated[Text, about("a channel a quarter turn away")]


class RotationSection(Record):
    """The pairs that are matched while a stage turns, and when it ends."""

    phase: Annotated[Text, about("the channel of the stage angle, degrees")]
    selected: Annotated[
        tuple[PairSelection, ...], Meta(min_length=1, max_length=2), about("`{pair: [one, other], orthogonal: third}`")
    ] = msgspec.field(name="pairs")
    prompt: Annotated[Text, about("the operator's sentence")] = "Let the stage turn steadily, with its axis inclined."
    turns: Annotated[Turns, about("the most that are made; `--turns` takes its place")] = 100
    converged: Annotated[AboveZero | None, about("relative uncertainty of p and q that ends it after 5 turns")] = None
    patience: Annotated[AboveZero, about("seconds in which the stage must begin to turn")] = 60.0


class NamedProcedure(Record):
    """What a procedure file says of itself."""

    name: Annotated[Identifier, about("a letter, then letters, digits, `-`, `_`, `.`")]
    title: Annotated[Text, about("what it is for, in one line")]
    source: Annotated[Text, about("the document it comes from")] = ""


class RotationFile(NamedProcedure, kw_only=True):
    """The procedure file of a stage that turns."""

    rotation: Annotated[RotationSection, about("which pairs are matched while the stage turns")]


class ProcedureFile(NamedProcedure, kw_only=True):
    """The procedure file of positions."""

    determines: Annotated[Determines, about("what the positions determine besides the offset")]
    reference: Annotated[Temperature | None, about("reference temperature, °C; needed with drift or gain")] = None
    angle: Annotated[Angle | None, about("that positions call `angle`, degrees; `--tilt` takes its place")] = None
    alignment: Annotated[FromZero, about("with `level`: how askew it may sit, degrees, or `--alignment`")] = 0.0
    samples: Annotated[int, Meta(ge=2, le=int(MOST)), about("samples a position")] = 100
    settle: Annotated[AboveZero, about("seconds over which the reading must hold still")] = 2.0
    soak: Annotated[Soak, about("at a new temperature", usual=USUAL_SOAK)] = Soak(20.0, 0.06, 360.0)
    compares: Annotated[bool, about("whether a reference on the plate says the angles, and nobody states any")] = False
    ramp: Annotated[RampSection | None, about("the temperature goes from position to position, in one attitude")] = None
    positions: Annotated[tuple[PositionSection, ...], Meta(min_length=1), about("in order")]

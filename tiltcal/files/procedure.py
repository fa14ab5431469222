"""The kinds of procedure, which a procedure file gives: what a session, a log or a plan goes through.

::

    Procedure
    ├── Rotation                     a stage turns, and pairs of channels are matched
    └── PositionProcedure            the sensor is brought to one position after the other
        ├── Positions                that are set: sensitivity, offset and their drift
        ├── FreePositions            that nobody sets: unit gravity determines the three axes
        ├── Ramp                     at which the temperature turns: the drift of the offset in one attitude
        ├── VerifyingPositions       that are set, and judged by a calibration
        └── Completion               of a sensor with a calibration
            ├── MountingCompletion   how it sits in its application
            └── LevelCompletion      its offset anew

What depends on the kind stands in one function of each layer: how it is asked for in :mod:`tiltcal.bench.measure`, how
it is calibrated in :mod:`tiltcal.calibration.calibrate`, what it will give in :mod:`tiltcal.calibration.prediction`.
Here stand how long it takes, and which options it has.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from difflib import get_close_matches
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar, Self

from tiltcal.core.attitude import LEVEL, Vector, gravity_from_tilt, normalised
from tiltcal.core.model import AXES
from tiltcal.core.pair.model import Pair
from tiltcal.errors import Argument, UsageError
from tiltcal.files.document import Document, read_document
from tiltcal.files.procedure_file import (
    FEWEST_WHOLE_TURNS,
    Determines,
    PositionSection,
    ProcedureFile,
    RampSection,
    RotationFile,
    Soak,
)
from tiltcal.files.record import file_data
from tiltcal.printable import counted
from tiltcal.stated_arguments import is_number, require_path, require_whole, shown

MOST_ASKEW = 10.0  # a sensor that sits further askew has another mounting, degrees

_PLACEHOLDER = re.compile(r"\{([^{}]*)\}")


@dataclass(frozen=True)
class Position:
    """A position that the sensor is brought to; angles are degrees."""

    name: str
    prompt: str  # the operator's sentence
    gravity: Vector  # up in the sensor frame, a unit vector
    tilt: Mapping[str, float] | None = None  # per axis; None where the direction is given
    heading: float | None = None
    temperature: float | None = None  # °C
    stage: float | None = None


@dataclass(frozen=True, kw_only=True)
class Procedure:
    """What all kinds have; ``record`` is the file as plain data, before the user's angle and turns were put in."""

    name: str
    title: str
    source: str
    record: Mapping[str, Any]
    positions: tuple[Position, ...] = ()

    needs_base: ClassVar[bool] = False  # whether the sensor's own calibration is completed
    renews: ClassVar[bool] = False  # whether the offset alone of the sensor's own calibration is measured anew
    free: ClassVar[bool] = False  # whether nobody sets the positions
    continuous: ClassVar[bool] = False  # whether all that is read on the way from position to position counts
    agrees: ClassVar[bool] = True  # whether positions have to agree before anything is written
    one_file: ClassVar[bool] = False  # whether all devices of a session give one calibration file together
    takes_reference: ClassVar[bool] = False  # whether a reference on the plate may say the angles

    @property
    def compares(self) -> bool:
        """Whether a reference has to say the angles."""
        return False

    @property
    def takes_base(self) -> bool:
        """Whether the sensor's own calibration is of use."""
        return False

    @property
    def why_not_again(self) -> str:
        """Why no position can be taken again; empty where it can."""
        return ""

    @property
    def length(self) -> str:
        """How long it is, in its own terms, such as ``4 positions``."""
        raise NotImplementedError

    def in_positions(self) -> PositionProcedure:
        """Return it where the sensor is brought to positions; a UsageError names what else there is for a stage."""
        raise NotImplementedError

    def in_turns(self) -> Rotation:
        """Return it where a stage turns; a UsageError where none does."""
        raise UsageError(f"{self.name} lets no stage turn")

    @property
    def without_typical(self) -> str:
        """Why it takes no mean temperature curves of a data sheet; empty where it does."""
        raise NotImplementedError

    def require_usable(self, **stated: object) -> None:
        """Refuse options that say nothing of this kind, by name, with a UsageError."""

    def with_turns(self, turns: int | None) -> Self:
        """Return it with another limit of turns; None leaves it. A UsageError where no stage turns."""
        if turns is None:
            return self
        advice = ("leave ", Argument("turns"), " out")
        raise UsageError(f"the procedure {self.name!r} has positions and no turns", advice=advice)

    def with_alignment(self, alignment: float | None) -> Self:
        """Return it for a sensor that may sit askew by another angle, degrees; None leaves it."""
        if alignment is None:
            return self
        raise UsageError(f"{self.name} renews no offset", advice=("leave ", Argument("alignment"), " out"))


@dataclass(frozen=True, kw_only=True)
class Rotation(Procedure):
    """The pairs that are matched while a stage turns, and when it ends."""

    phase: str  # the channel of the stage angle, degrees
    pairs: tuple[Pair, ...]
    prompt: str
    turns: int
    converged: float | None
    patience: float

    agrees = False
    one_file = True
    without_typical = "a pair has no temperature terms"

    @property
    def channels(self) -> tuple[str, ...]:
        """The channels of all pairs, each once."""
        return tuple(dict.fromkeys(channel for pair in self.pairs for channel in pair.channels))

    @property
    def length(self) -> str:
        return f"up to {self.turns} turns"

    def in_positions(self) -> PositionProcedure:
        raise UsageError(
            f"{self.name} has no positions, its stage turns: match the pairs of a recorded log with `tiltcal match`, "
            f"or at the bench with `tiltcal measure {self.name}`"
        )

    def in_turns(self) -> Rotation:
        return self

    def require_usable(self, **stated: object) -> None:
        for option, value in stated.items():
            if value is not None:
                advice = ("leave ", Argument(option), " out; ", Argument("turns"), " limits its length")
                raise UsageError("a rotation has no positions", advice=advice)

    def with_turns(self, turns: int | None) -> Self:
        require_whole("turns", turns, FEWEST_WHOLE_TURNS, "turns")
        return self if turns is None else replace(self, turns=int(turns))


@dataclass(frozen=True, kw_only=True)
class PositionProcedure(Procedure):
    """Positions in order, how they are sampled, and what they determine besides the offset."""

    angle: float | None  # that was free, degrees
    samples: int
    settle: float  # seconds over which the reading must hold still
    soak: Soak
    axes: tuple[str, ...] = ()  # the columns of the sensitivity
    drift: int = 0  # order of the temperature polynomial of the offset, or the highest one
    gain: int = 0  # of the sensitivity
    nonlinearity: int = 0
    reference: float | None = None  # °C
    alignment: float = 0.0  # how askew a sensor sits, degrees, of one that prints angles its lean; 0 where not stated

    @property
    def takes_base(self) -> bool:
        return not self.axes

    @property
    def known(self) -> Mapping[str, Position]:
        """The positions whose names state a direction; none where nobody sets them."""
        return {position.name: position for position in self.positions}

    @property
    def thermal(self) -> bool:
        """Whether it determines temperature terms."""
        return bool(self.drift or self.gain)

    @property
    def without_typical(self) -> str:
        return "it has no temperature terms, or measures them" if self.thermal or self.needs_base else ""

    @property
    def length(self) -> str:
        return counted(len(self.positions), "position")

    def in_positions(self) -> PositionProcedure:
        return self

    def with_alignment(self, alignment: float | None) -> Self:
        if alignment is None:
            return self
        if not is_number(alignment, 0.0) or alignment > MOST_ASKEW or (self.axes and not alignment):
            why = f"is {'above' if self.axes else 'between'} 0 and {MOST_ASKEW:g} degrees, not {shown(alignment)}"
            raise UsageError(option="alignment", why=why.replace("above 0 and", "above 0 and at most"))
        return replace(self, alignment=alignment, record={**self.record, "alignment": alignment})

    def least_seconds(self, samples: int, interval: float, settle: float, done: int) -> float:
        """Return how long the positions behind those done must hold still and are sampled, an interval apart, seconds.

        Setting and changing temperatures come on top.
        """
        temperatures = [position.temperature for position in self.positions]
        soak = max(self.soak.seconds, self.soak.thermometer or 0.0) * settle / self.settle
        changes = list(pairwise([None, *temperatures]))[done:]
        windows = [settle if new is None or new == before else soak for before, new in changes]
        return sum(windows) + len(windows) * samples * interval

    @property
    def closes(self) -> bool:
        """Whether the last position is the first one again."""
        settings = [(one.gravity, one.heading, one.temperature, one.stage) for one in self.positions]
        return len(settings) > 1 and settings[0] == settings[-1]

    def with_closing(self) -> Self:
        """Return it with its first position once more at the end, unless it ends where it began."""
        if self.closes:
            return self
        first = self.positions[0]
        name, again = f"{first.name}-again", "Back to the first position, to show what has changed."
        entries = list(self.record["positions"])
        entries.append({**entries[0], "name": name, "prompt": f"{again} {entries[0]['prompt']}"})
        last = replace(first, name=name, prompt=f"{again} {first.prompt}")
        return replace(self, positions=(*self.positions, last), record={**self.record, "positions": entries})

    def verifying(self) -> VerifyingPositions:
        """Return its positions, to judge a calibration by; a UsageError where it sets none."""
        raise UsageError(f"{self.name} sets no positions to verify with: name another procedure")

    def _open(self) -> UsageError:
        advice = ("leave ", Argument("closing"), " out")
        return UsageError(f"{self.name} sets no position that could be visited again", advice=advice)


@dataclass(frozen=True, kw_only=True)
class Positions(PositionProcedure):
    """Positions that are set, or that a reference reads where the procedure ``compares``.

    Where ``cross_validated``, the data choose the order of the drift.
    """

    cross_validated: bool = False
    compares: bool = False

    takes_reference = True

    @property
    def why_not_again(self) -> str:
        order = "the order of a sweep's temperatures shows hysteresis: no position can be taken again out of it"
        return f"{order}; go back, or quit and begin anew" if self.cross_validated else ""

    def verifying(self) -> VerifyingPositions:
        sampled = {field.name: getattr(self, field.name) for field in fields(PositionProcedure)}
        return VerifyingPositions(**sampled | {"drift": 0, "gain": 0, "nonlinearity": 0})


class VerifyingPositions(PositionProcedure):
    """Positions that are set, and judged by a calibration."""

    agrees = False
    takes_reference = True

    def verifying(self) -> VerifyingPositions:
        return self


class FreePositions(PositionProcedure):
    """Positions that nobody sets."""

    free = True

    @property
    def known(self) -> Mapping[str, Position]:
        return {}

    def require_usable(self, **stated: object) -> None:
        if stated.get("jig") is not None:
            advice = ("leave ", Argument("jig"), " out, or name a procedure whose positions are set")
            raise UsageError("free positions use no jig", advice=advice)

    def with_closing(self) -> Self:
        raise self._open()


@dataclass(frozen=True, kw_only=True)
class Ramp(PositionProcedure):
    """Positions at which the temperature turns, in one attitude: all that is read on the way counts."""

    reference: float  # °C
    pace: float  # of the temperature, °C/min
    within: float  # how close to its temperature a leg ends, °C
    interval: float  # between two samples, seconds
    patience: float  # without a change that end a leg, seconds

    agrees = False
    continuous = True

    @property
    def turns(self) -> list[float]:
        """The temperatures at which it turns, °C."""
        return [position.temperature for position in self.positions if position.temperature is not None]

    @property
    def why_not_again(self) -> str:
        return "a ramp is one continuous record: no leg can be taken again; quit, and begin anew"

    @property
    def length(self) -> str:
        return counted(len(self.positions), "leg")

    def least_seconds(self, samples: int, interval: float, settle: float, done: int) -> float:
        """Return the time of the legs behind those done at the pace, seconds."""
        ways = pairwise([self.reference, *self.turns])
        return 60.0 * sum(abs(end - start) for start, end in list(ways)[done:]) / self.pace

    def with_closing(self) -> Self:
        raise self._open()


class Completion(PositionProcedure):
    """Positions of a sensor that has a calibration, which they complete."""

    needs_base = True


class MountingCompletion(Completion):
    """Positions of the application, which show how the sensor sits in it."""


@dataclass(frozen=True, kw_only=True)
class LevelCompletion(Completion):
    """Level positions, which renew the offset; the sensor may sit askew by ``alignment`` since, degrees."""

    renews = True


def _procedure_of(file: ProcedureFile, document: Document, given: float | None) -> PositionProcedure:
    """Return the procedure of a file of positions, with an angle that the user gives instead of the file's, degrees."""
    asked = file.determines
    _check_determines(asked, document.at("determines"))
    angle = _chosen_angle(file.name, file.angle, given)
    if (asked.drift or asked.gain) and file.reference is None:
        why = "temperature terms need the key 'reference', the temperature that they are counted from"
        raise document.error(why, "determines")
    if file.ramp is not None and (asked.axes or not asked.drift or asked.gain):
        raise document.error("a ramp determines the drift of the offset alone: axes: [], drift: 3", "determines")
    same = ("name", "title", "source", "samples", "settle", "soak", "reference", "alignment")
    stated: dict[str, Any] = {key: getattr(file, key) for key in same}
    stated |= {"angle": angle, "positions": _positions_of(file, document, angle)}
    stated["record"] = file_data("procedure", file, whole=True)
    if asked.level:
        return LevelCompletion(**stated)
    if asked.mounting:
        return MountingCompletion(**stated)
    if asked.free:
        return FreePositions(**stated, axes=AXES)
    if file.ramp is not None:
        ramp = {name: getattr(file.ramp, name) for name in RampSection.__struct_fields__}
        return Ramp(**stated, drift=asked.drift, **ramp)
    orders = {key: getattr(asked, key) for key in ("drift", "gain", "nonlinearity", "cross_validated")}
    return Positions(**stated, **orders, axes=tuple(sorted(asked.axes)), compares=file.compares)


def _positions_of(file: ProcedureFile, document: Document, angle: float | None) -> tuple[Position, ...]:
    """Return the positions of a file, whose names are unique and whose settings fit what they determine."""
    places = [document.at("positions", number) for number in range(len(file.positions))]
    positions = tuple(_position_of(one, place, angle) for one, place in zip(file.positions, places, strict=True))
    names = [position.name for position in positions]
    for number, name in enumerate(names):
        if name in names[:number]:
            raise places[number].error(f"a position named {name!r} is there already; names are unique")
    for place, position in zip(places, positions, strict=True):
        if file.determines.level and position.gravity != LEVEL:
            raise place.error("a position that renews the offset is level: tilt: {x: 0, y: 0}")
        if file.ramp is not None and (position.temperature is None or position.gravity != positions[0].gravity):
            raise place.error("the positions of a ramp have one attitude, and each a temperature at which it turns")
    return positions


def _check_determines(asked: Determines, place: Document) -> None:
    orders = asked.drift or asked.gain or asked.nonlinearity
    if len(set(asked.axes)) < len(asked.axes):
        raise place.error("an axis is named twice", "axes")
    for what in ("mounting", "level"):
        if getattr(asked, what) and (asked.axes or orders or (asked.mounting and asked.level)):
            raise place.error(f"a procedure that determines the {what} determines nothing else: axes is [] there")
    if asked.cross_validated and not asked.drift:
        raise place.error("an order that is chosen by cross-validation needs the key 'drift', the highest order")
    if asked.free and (len(asked.axes) < 3 or orders or asked.mounting):
        raise place.error("free positions determine the axes [x, y, z] and nothing else: unit gravity says no more")


def _position_of(section: PositionSection, place: Document, angle: float | None) -> Position:
    if (section.tilt is None) == (section.gravity is None):
        raise place.error("a position has either tilt: {x: degrees, y: degrees} or gravity: [gx, gy, gz]")
    tilt = None
    if section.tilt is not None:
        if angle is None and (free := [axis for axis, stated in section.tilt.items() if isinstance(stated, str)]):
            why = "the procedure gives no angle; add 'angle: 30' to it, or write degrees here"
            raise place.error(why, "tilt", free[0])
        words = {"angle": angle or 0.0, "-angle": -(angle or 0.0)}
        tilt = {axis: words[one] if isinstance(one, str) else one for axis, one in section.tilt.items()}
    prompt = _filled_in(section.prompt, place, {"angle": angle, "temperature": section.temperature})
    with place.locating("gravity" if tilt is None else "tilt"):
        gravity = normalised(section.gravity or ()) if tilt is None else gravity_from_tilt(tilt)
    return Position(section.name, prompt, gravity, tilt, section.heading, section.temperature, section.stage)


def _filled_in(prompt: str, place: Document, values: Mapping[str, float | None]) -> str:
    """Return the operator's sentence with ``{angle}`` and ``{temperature}`` filled in."""

    def value_of(found: re.Match[str]) -> str:
        value = values.get(found.group(1))
        if value is None:
            known = " or ".join(f"{{{name}}}" for name, value in values.items() if value is not None)
            raise place.error(f"{found.group()} has no value here; the prompt may use {known or 'none'}", "prompt")
        return f"{value:g}"

    return _PLACEHOLDER.sub(value_of, prompt)


def _chosen_angle(name: str, free: float | None, angle: float | None) -> float | None:
    """Return the angle that a procedure leaves free, or the one that the user gives in its place, degrees."""
    if angle is None:
        return free
    if free is None:
        raise UsageError(f"the procedure {name!r} leaves no angle free; leave the angle out, or copy and edit it")
    if not (is_number(angle) and 0.0 < angle <= 90.0):
        raise UsageError(f"an angle of {shown(angle)}° is not above 0° and at most 90°")
    return float(angle)


def shipped_procedures() -> dict[str, Path]:
    """Return the files of the procedures that come with tiltcal, by name."""
    folder = Path(str(files("tiltcal.procedures")))
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def find_procedure(name_or_path: str | Path, angle: float | None = None) -> Procedure:
    """Return a shipped procedure by its name, which comes first, or a user's by its path, such as ``./plane``.

    ``angle`` takes the place of the angle that the procedure leaves free, degrees; a UsageError where it takes none.
    """
    require_path(Argument("procedure"), name_or_path)
    shipped = shipped_procedures()
    if name_or_path in shipped or os.path.exists(name_or_path):
        return read_procedure(shipped.get(str(name_or_path), Path(name_or_path)), angle)
    near = get_close_matches(str(name_or_path), shipped, n=3, cutoff=0.4)
    hint = f"did you mean {' or '.join(map(repr, near))}?" if near else f"there are {', '.join(shipped)}"
    raise UsageError(f"unknown procedure {str(name_or_path)!r}, and no such file; {hint}")


def read_procedure(path: str | Path, angle: float | None = None) -> Procedure:
    """Read and check a procedure file; ``angle`` is as in :func:`find_procedure`, and so are the errors."""
    return procedure_in(read_document(path), angle)


def procedure_in(document: Document, angle: float | None = None) -> Procedure:
    """Return the procedure of a document; an InputError names file, line and key."""
    body = document.body("procedure")
    if "rotation" not in body.data:
        return _procedure_of(body.read(ProcedureFile), body, angle)
    file, place = body.read(RotationFile), body.at("rotation", "pairs")
    turning = file.rotation
    pairs = tuple(Pair(*one.pair, one.orthogonal) for one in turning.selected)
    for number, pair in enumerate(pairs):
        if len({*pair.channels, turning.phase}) < len(pair.channels) + 1:
            raise place.error("pair, orthogonal and phase are four different channels", number)
    if len({pair.name for pair in pairs}) < len(pairs):
        raise place.error("the same pair is there twice")
    _chosen_angle(file.name, None, angle)
    same = {key: getattr(turning, key) for key in ("phase", "prompt", "turns", "converged", "patience")}
    record = file_data("procedure", file, whole=True)
    return Rotation(name=file.name, title=file.title, source=file.source, record=record, pairs=pairs, **same)

"""A procedure and its file: positions in order, or the pairs that are matched while a stage turns.

Each position has the operator's sentence; together they determine coefficients. The shipped procedures and those of a
user are read by name or path.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from difflib import get_close_matches
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import Any

from tiltcal.core.attitude import LEVEL, Vector, gravity_from_tilt, normalised
from tiltcal.errors import Argument, UsageError
from tiltcal.files.document import Document, read_document
from tiltcal.files.procedure_file import (
    FEWEST_WHOLE_TURNS,
    Determines,
    PositionSection,
    ProcedureFile,
    Rotation,
    RotationFile,
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


class Procedure(ProcedureFile, kw_only=True):
    """A procedure with its angle filled in: its positions in order, or the rotation of a stage, which has none.

    ``record`` is the file as plain data, with its defaults, before the user's angle and turns were put in.
    """

    determines: Determines = Determines(())
    positions: tuple[Position, ...] = ()  # type: ignore[assignment]
    rotation: Rotation | None = None
    record: Mapping[str, Any] = {}

    @property
    def length(self) -> str:
        """How long it is, in its own terms, such as ``4 positions``."""
        if self.rotation is not None:
            return f"up to {self.rotation.turns} turns"
        return counted(len(self.positions), "position" if self.ramp is None else "leg")

    def least_seconds(self, samples: int, interval: float, settle: float, done: int = 0) -> float:
        """Return how long the positions behind those done must hold still and are sampled, an interval apart, seconds.

        Setting and changing temperatures come on top; of a ramp it is the time at its pace.
        """
        temperatures = [position.temperature for position in self.positions]
        if self.ramp is not None:
            met = [one or 0.0 for one in (temperatures[0] if self.reference is None else self.reference, *temperatures)]
            return 60.0 * sum(abs(end - start) for start, end in list(pairwise(met))[done:]) / self.ramp.pace
        soak = max(self.soak.seconds, self.soak.thermometer or 0.0) * settle / self.settle
        changes = list(pairwise([None, *temperatures]))[done:]
        windows = [settle if new is None or new == before else soak for before, new in changes]
        return sum(windows) + len(windows) * samples * interval

    def require_positions(self) -> None:
        """Refuse a procedure of a stage that turns, with a UsageError that names the commands that are meant for it."""
        if self.rotation is not None:
            raise UsageError(
                f"{self.name} has no positions, its stage turns: match the pairs of a recorded log with `tiltcal "
                f"match`, or at the bench with `tiltcal measure {self.name}`"
            )

    def with_turns(self, turns: int | None) -> Procedure:
        """Return this procedure with another limit of turns; None leaves it. A UsageError where no stage turns."""
        if turns is None:
            return self
        if self.rotation is None:
            advice = ("leave ", Argument("turns"), " out")
            raise UsageError(f"the procedure {self.name!r} has positions and no turns", advice=advice)
        require_whole("turns", turns, FEWEST_WHOLE_TURNS, "turns")
        return self.replaced(rotation=self.rotation.replaced(turns=int(turns)))

    def with_alignment(self, alignment: float | None) -> Procedure:
        """Return this procedure for a sensor that may sit askew by another angle, degrees; None leaves it."""
        if alignment is None:
            return self
        if not self.determines.level:
            raise UsageError(f"{self.name} renews no offset", advice=("leave ", Argument("alignment"), " out"))
        if not (is_number(alignment, 0.0) and alignment <= MOST_ASKEW):
            why = f"is between 0 and {MOST_ASKEW:g} degrees, not {shown(alignment)}"
            raise UsageError(option="alignment", why=why)
        return self.replaced(alignment=alignment, record={**self.record, "alignment": alignment})

    @property
    def closes(self) -> bool:
        """Whether the last position is the first one again."""
        settings = [(one.gravity, one.heading, one.temperature, one.stage) for one in self.positions]
        return len(settings) > 1 and settings[0] == settings[-1]

    def with_closing(self, closing: bool) -> Procedure:
        """Return this procedure with its first position once more at the end, unless it ends where it began."""
        if not closing:
            return self
        self.require_positions()
        if self.determines.free:
            advice = ("leave ", Argument("closing"), " out")
            raise UsageError(f"{self.name} sets no position that could be visited again", advice=advice)
        if self.closes:
            return self
        first = self.positions[0]
        name, again = f"{first.name}-again", "Back to the first position, to show what has changed."
        entries = list(self.record["positions"])
        entries.append({**entries[0], "name": name, "prompt": f"{again} {entries[0]['prompt']}"})
        last = replace(first, name=name, prompt=f"{again} {first.prompt}")
        return self.replaced(positions=(*self.positions, last), record={**self.record, "positions": entries})


def _procedure_of(file: ProcedureFile, document: Document, given: float | None) -> Procedure:
    """Return the procedure of a file, with an angle that the user gives in place of the file's, degrees."""
    _check_determines(file.determines, document.at("determines"))
    angle = _chosen_angle(file.name, file.angle, given)
    places = [document.at("positions", number) for number in range(len(file.positions))]
    positions = tuple(_position_of(one, place, angle) for one, place in zip(file.positions, places, strict=True))
    names = [position.name for position in positions]
    for number, name in enumerate(names):
        if name in names[:number]:
            raise places[number].error(f"a position named {name!r} is there already; names are unique")
    determines = file.determines.replaced(axes=tuple(sorted(file.determines.axes)))
    if (determines.drift or determines.gain) and file.reference is None:
        why = "temperature terms need the key 'reference', the temperature that they are counted from"
        raise document.error(why, "determines")
    if file.ramp is not None and (determines.axes or not determines.drift or determines.gain):
        raise document.error("a ramp determines the drift of the offset alone: axes: [], drift: 3", "determines")
    for place, position in zip(places, positions, strict=True):
        if determines.level and position.gravity != LEVEL:
            raise place.error("a position that renews the offset is level: tilt: {x: 0, y: 0}")
        if file.ramp is not None and (position.temperature is None or position.gravity != positions[0].gravity):
            raise place.error("the positions of a ramp have one attitude, and each a temperature at which it turns")
    keys = {name: getattr(file, name) for name in file.__struct_fields__}
    keys |= {"determines": determines, "angle": angle, "positions": positions}
    return Procedure(record=file_data("procedure", file, whole=True), **keys)


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
        file = body.read(ProcedureFile)
        return _procedure_of(file, body, angle)
    turning, place = body.read(RotationFile), body.at("rotation", "pairs")
    pairs = turning.rotation.pairs
    for number, pair in enumerate(pairs):
        if len({*pair.channels, turning.rotation.phase}) < len(pair.channels) + 1:
            raise place.error("pair, orthogonal and phase are four different channels", number)
    if len({pair.name for pair in pairs}) < len(pairs):
        raise place.error("the same pair is there twice")
    stated = {name: getattr(turning, name) for name in turning.__struct_fields__}
    angle = _chosen_angle(turning.name, None, angle)
    return Procedure(angle=angle, record=file_data("procedure", turning, whole=True), **stated)

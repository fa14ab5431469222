"""The operator of a bench whose table and chamber move by themselves.

It answers the questions of a session by moving the machines of the bench file, and passes on to another operator what
no machine does: an axis that the table does not have, a heading, a temperature without a chamber. What was read back
is the angle that was set. It is read back again before a position counts. A machine that does not get where it was
sent, or does not stay there, has its position refused and is opened anew; after a few times the session stops.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from math import asin, atan2, cos, degrees, hypot, radians, sin
from typing import Any

from tiltcal.bench.drives import Angles, Drive
from tiltcal.bench.messages import (
    Accepted,
    Look,
    Moved,
    PositionQuestion,
    Question,
    Refused,
    Review,
    SessionEvent,
    Waiting,
)
from tiltcal.bench.operators import Operator
from tiltcal.core.attitude import Vector
from tiltcal.drivers.bus.clock import SECOND, Clock
from tiltcal.errors import HardwareError, InputError, Stopped, UsageError
from tiltcal.files.machine import TILTS, Machine
from tiltcal.files.procedure import Position, Procedure

ATTEMPTS, REFUSALS = 3, 10
"""Failures of the machines in a row, and refusals of one position that they set, after which a session stops."""

POLL, CHAMBER_POLL = 0.2, 10.0  # seconds between two looks at where a table is, and a chamber
TIMEOUT, CHAMBER_TIMEOUT = 120.0, 4 * 3600.0  # seconds to get there where the bench file states none
STILL = 0.25  # a table that has moved by less than this share of its tolerance between two looks is at rest
DIGITS = 6  # decimals of an angle
TEMPERATURE = "temperature"
OTHER = {"x": "y", "y": "x"}


def angles_of(gravity: Sequence[float], carrier: str) -> dict[str, float]:
    """Return the angles of a table with two tilts, of which one carries the other, degrees."""
    carrying, carried, z = *(gravity[TILTS.index(axis)] for axis in (carrier, OTHER[carrier])), gravity[2]
    inner = atan2(carried + 0.0, z) if hypot(carried, z) > 1e-9 else 0.0  # straight up it has no angle
    angles = {carrier: asin(max(-1.0, min(carrying, 1.0))), OTHER[carrier]: inner}
    return {axis: round(degrees(angle), DIGITS) + 0.0 for axis, angle in angles.items()}


def gravity_of(angles: Angles, carrier: str) -> Vector:
    """Return up in the frame of a fixture on a table with two tilts, g."""
    outer, inner = radians(angles[carrier]), radians(angles[OTHER[carrier]])
    carrying, carried, z = sin(outer), cos(outer) * sin(inner), cos(outer) * cos(inner)
    return (carrying, carried, z) if carrier == "x" else (carried, carrying, z)


def wanted(asked: Position | PositionQuestion, carrier: str) -> dict[str, float]:
    """Return what a position says of each axis, degrees or °C."""
    others = {"stage": asked.stage, TEMPERATURE: asked.temperature}
    stated = {axis: n for axis, n in others.items() if n is not None}
    return {**angles_of(asked.gravity, carrier), "heading": asked.heading or 0.0, **stated}


def require_reachable(machines: Mapping[str, Machine], positions: Sequence[Position]) -> None:
    """Refuse positions that are beyond the limits of a machine, with the way on which it approaches them."""
    for name, machine in machines.items():
        for position in positions:
            targets = wanted(position, machine.carrier)
            for axis, (low, high) in machine.limits.items():
                for back in (0.0, machine.approach):
                    if not low <= (angle := targets.get(axis, low + back) - back) <= high:
                        way = f"{position.name} takes {axis} of the {name} to {angle:g}"
                        advice = "name a procedure that stays within them, such as plane"
                        raise UsageError(f"{way}, and its limits are {low:g} and {high:g}", advice=advice)


def carrier_of(machines: Iterable[Machine]) -> str:
    """Return the tilt that carries the other on the table; nothing where no machine tilts."""
    return next((machine.carrier for machine in machines if set(TILTS) & set(machine.limits)), "")


def in_words(angles: Angles) -> str:
    """Return where a machine is, such as ``x 30.02°, y 0°``."""
    return ", ".join(f"{n:.6g} °C" if axis == TEMPERATURE else f"{axis} {n:.6g}°" for axis, n in angles.items())


class Mover:
    """One machine: moves it, waits until it is there, and says whether it still is.

    ``open_drive`` opens it when it is first needed, and again after a failure.
    """

    def __init__(self, name: str, machine: Machine, clock: Clock, open_drive: Callable[[], Drive]) -> None:
        self.machine = machine
        self._name, self._clock, self._open = name, clock, open_drive
        self._drive: Drive | None = None
        self._targets: Angles = {}
        self._at: dict[str, float] = {}
        chamber = TEMPERATURE in machine.limits
        self._poll = CHAMBER_POLL if chamber else POLL
        self._timeout = machine.timeout or (CHAMBER_TIMEOUT if chamber else TIMEOUT)
        # A chamber swings about its temperature; whether the sensors have it is judged by their readings.
        self._still = machine.tolerance if chamber else STILL * machine.tolerance

    def move(self, targets: Angles, waits: Callable[[str, Angles], None]) -> dict[str, float]:
        """Go to some angles from the side that the machine says, and return what is read back there.

        ``waits`` gets, again and again, why it takes so long, with where the machine is.

        HardwareError: it does not get there in its time, or does not answer.
        """
        with self._driving() as drive:
            if targets != self._targets or not self._is_there(drive):
                self._targets = {}
                if self.machine.approach:
                    beside = {axis: angle - self.machine.approach for axis, angle in targets.items()}
                    self._go(drive, beside, abs(self.machine.approach), waits)
                self._at = self._go(drive, targets, self.machine.tolerance, waits)
                self._targets = dict(targets)
        return self._at

    def send(self, targets: Angles) -> None:
        """Send the machine on its way, and do not wait."""
        with self._driving() as drive:
            drive.set(targets)

    def require_there(self) -> None:
        """Refuse a machine that does not answer, or is no longer where it was."""
        with self._driving() as drive:
            if not self._is_there(drive):
                raise HardwareError(f"it was at {in_words(self._at)}, and is at {in_words(drive.read()[0])}")

    def close(self) -> None:
        """Release the machine; it is opened anew, with what is sent first, when it is needed again."""
        drive, self._drive, self._targets = self._drive, None, {}
        if drive is not None:
            drive.close()

    def _is_there(self, drive: Drive) -> bool:
        at, _ = drive.read()
        held = self._targets if TEMPERATURE in at else self._at
        return all(abs(at[axis] - held[axis]) <= self.machine.tolerance for axis in self._targets)

    def _go(
        self, drive: Drive, targets: Angles, tolerance: float, waits: Callable[[str, Angles], None]
    ) -> dict[str, float]:
        drive.set(targets)
        end_ns = self._clock.now_ns() + self._timeout * SECOND
        before: Angles = {}
        while self._clock.now_ns() <= end_ns:
            self._clock.sleep(self._poll)
            at, at_rest = drive.read()
            near = all(abs(at[axis] - angle) <= tolerance for axis, angle in targets.items())
            if near and at_rest and before and all(abs(at[axis] - before[axis]) <= self._still for axis in targets):
                return at
            waits(f"the {self._name} is at {in_words(at)} on the way to {in_words(targets)}", at)
            before = at
        raise HardwareError(f"it is at {in_words(at)} after {self._timeout:g} s, and was sent to {in_words(targets)}")

    @contextmanager
    def _driving(self) -> Iterator[Drive]:
        """Yield the drive; after a failure the machine is stopped, and opened anew when it is needed again."""
        try:
            if self._drive is None:
                self._drive = self._open()
            yield self._drive
        except (HardwareError, KeyboardInterrupt) as error:
            drive, self._drive, self._targets = self._drive, None, {}
            if drive is not None:
                with suppress(HardwareError):  # what cannot be reached cannot be stopped
                    drive.stop()
                drive.close()
            if isinstance(error, HardwareError):
                raise HardwareError(f"{self._name}: {error}") from None
            raise


class Machines:
    """The operator that moves the machines of a bench; ``person`` is the one who is asked for all else.

    The temperature of the chamber is answered where no device of the bench is a ``thermometer``.
    """

    def __init__(
        self, person: Operator, movers: Sequence[Mover], steps: Procedure, clock: Clock, *, thermometer: bool
    ) -> None:
        self._person, self._movers, self._clock = person, list(movers), clock
        self._ramps, self._thermometer = steps.continuous, thermometer
        self.watches, self.most_attempts = person.watches, person.most_attempts
        self.speaks_unasked = person.speaks_unasked
        self._contradicting: set[str] = set()
        """The positions for which the person is asked, though the machines set them."""
        self._refound = False
        self._limits = {axis: limits for mover in movers for axis, limits in mover.machine.limits.items()}
        self._carrier = carrier_of(mover.machine for mover in movers)
        self._failures = 0
        self._asked: PositionQuestion | None = None
        self._asked_by_hand = False
        left = [self._left_to_hand(position) for position in steps.positions]
        nothing = self._carrier and not any(one.get(TEMPERATURE) is not None or any(one.values()) for one in left)
        self._by_hand = left[0] if nothing else None  # what was last set by hand

    def probe(self) -> None:
        """Read back where every machine is; a HardwareError where one does not answer."""
        for mover in self._movers:
            mover.require_there()

    def close(self) -> None:
        """Release the machines."""
        for mover in self._movers:
            mover.close()

    def to_take_again(self, wrong: Sequence[str], taken: Sequence[str]) -> Sequence[str]:
        """Return all positions from the first wrong one on, which a lost step falsifies, after a reference run.

        That is done once; then, and where a table has no reference run, the wrong ones alone, of which the person is
        asked.
        """
        refinding = [mover for mover in self._movers if mover.machine.start]
        if self._refound or not refinding:
            self._contradicting |= {*wrong}
            return wrong
        self._refound = True
        for mover in refinding:
            mover.close()
        return taken[min(map(taken.index, wrong)) :]

    def ask(self, question: Question) -> object:
        """Return the answer to a question; to a position it is what was read back."""
        try:
            if isinstance(question, Review):
                self.probe()
            if isinstance(question, PositionQuestion):
                return self._position(question)
        except HardwareError as error:
            self._failures += 1
            if self._failures >= ATTEMPTS:
                raise Stopped(f"{question.subject} failed {ATTEMPTS} times in a row: {error}") from None
            raise
        if not isinstance(question, Review):
            return self._person.ask(question)
        said = self._person.ask(question) if self._asked_by_hand else {"answer": "accept"}
        if said != {"answer": "accept"}:
            self._by_hand = None
        return said

    def tell(self, event: SessionEvent) -> None:
        """Pass an event on; what was set by hand and is refused is asked for again."""
        self._person.tell(event)
        if isinstance(event, Accepted):
            self._failures = 0
        if self._asked_by_hand and isinstance(event, Refused):
            self._by_hand = None

    def _position(self, question: PositionQuestion) -> object:
        """Move every machine, have the rest done by hand, and return what was read back."""
        targets = {axis: n for axis, n in wanted(question, self._carrier or "x").items() if axis in self._limits}
        reached = self._moved(targets, question.position)
        if reached and question is not self._asked:
            self._asked = question
            self._person.tell(Moved(question.position, f"{question.position}: {in_words(reached)}"))
        left = self._left_to_hand(question)
        self._asked_by_hand = left != self._by_hand or question.position in self._contradicting
        self.most_attempts = self._person.most_attempts if self._asked_by_hand else REFUSALS
        if not self._asked_by_hand:
            return {"answer": "ready", **self._as_set(question, reached)}
        self._by_hand, said = None, self._person.ask(question)
        if not isinstance(said, Mapping) or said.get("answer") != "ready":
            return said
        if said.get("position", question.position) != question.position:
            raise InputError("machines take the positions in the procedure's order: set this one")
        self._by_hand = left
        # Whoever sets something by hand may have opened the door of the chamber.
        answer = self._as_set(question, self._moved(targets, question.position))
        if "tilt" in answer and "tilt" in said:
            answer["tilt"] = {**answer["tilt"], **said["tilt"]}
        return {**said, **answer}

    def _moved(self, targets: Angles, position: str) -> dict[str, float]:
        """Move every machine to its part of some targets, and return what is read back; of a ramp only send it."""
        reached: dict[str, float] = {}
        for mover in self._movers:
            mine = {axis: targets[axis] for axis in mover.machine.limits if axis in targets}
            if self._ramps and TEMPERATURE in mine:
                mover.send(mine)
            elif mine:
                reached |= mover.move(mine, self._waits(position))
        return reached

    def _as_set(self, question: PositionQuestion, reached: Angles) -> dict[str, Any]:
        """Return what was read back as an answer has it."""
        answer: dict[str, Any] = {}
        if TEMPERATURE in reached and not self._thermometer:
            answer[TEMPERATURE] = round(reached[TEMPERATURE], DIGITS)
        if not self._carrier:
            return answer
        gravity = gravity_of({**angles_of(question.gravity, self._carrier), **reached}, self._carrier)
        if question.tilt is None or gravity[2] <= 0.0:
            return {**answer, "gravity": list(gravity)}
        tilt = {axis: round(degrees(asin(gravity[place])), DIGITS) for place, axis in enumerate(TILTS)}
        return {**answer, "tilt": {axis: tilt[axis] for axis in TILTS if axis in self._limits}}

    def _left_to_hand(self, asked: Position | PositionQuestion) -> dict[str, float]:
        """Return what no machine does."""
        return {axis: n for axis, n in wanted(asked, self._carrier or "x").items() if axis not in self._limits}

    def _waits(self, position: str) -> Callable[[str, Angles], None]:
        """Return what tells the person why it takes so long, with an event once a minute."""
        began_ns, minutes = self._clock.now_ns(), 0

        def waits(why: str, at: Angles) -> None:
            nonlocal minutes
            if self._person.watches:
                self._person.tell(Look(position, why, {}))
            seconds = round((self._clock.now_ns() - began_ns) / SECOND)
            if seconds // 60 > minutes:
                minutes, temperature = seconds // 60, at.get(TEMPERATURE)
                self._person.tell(Waiting(position, seconds, why, temperature))

        return waits

"""The operator of a bench whose table and chamber move by themselves.

It answers the questions of a session by moving the machines of the bench file, and passes on to another operator what
no machine does: an axis that the table does not have, a heading, a temperature without a chamber. What was read back
is the angle that was set. It is read back again before a position counts. A machine that does not get where it was
sent, or does not stay there, has its position refused and is opened anew; after a few times the session stops.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from math import asin, atan2, cos, degrees, hypot, radians, sin
from typing import Any, NoReturn, TypeVar

from tiltcal.bench.drives import Angles, Drive
from tiltcal.bench.operators import TIP, Message, Operator
from tiltcal.core.attitude import Vector
from tiltcal.drivers.bus.clock import Clock
from tiltcal.errors import HardwareError, Stopped, UsageError
from tiltcal.files.machine import TILTS, Machine
from tiltcal.files.procedure import Position, Procedure

T = TypeVar("T")

ATTEMPTS, REFUSALS = 3, 10
"""Failures of the machines in a row, and refusals of one position that they set, after which a session stops."""

TEMPERATURE = "temperature"

POLL, CHAMBER_POLL = 0.2, 10.0
"""Seconds between two looks at where a table is, and a chamber."""

TIMEOUT, CHAMBER_TIMEOUT = 120.0, 4 * 3600.0
"""Seconds to get there where the bench file states none."""

STILL = 0.25
"""A table that has moved by less than this share of its tolerance between two looks is at rest."""

WAITING = 60.0
"""Seconds between two events while a machine moves."""

DIGITS = 6
"""Decimals of an angle that was read back, degrees."""

UPRIGHT = 1e-9
"""Of gravity across the carrying axis: below it the other axis has no angle, g."""


def angles_of(gravity: Sequence[float], carrier: str) -> dict[str, float]:
    """Return the angles of a table with two tilts, of which one carries the other, degrees."""
    x, y, z = gravity
    carrying, carried = (x, y) if carrier == "x" else (y, x)
    inner = atan2(carried + 0.0, z) if hypot(carried, z) > UPRIGHT else 0.0
    outer = asin(max(-1.0, min(carrying, 1.0)))
    return {carrier: degrees(outer) + 0.0, "xy".replace(carrier, ""): degrees(inner) + 0.0}


def gravity_of(angles: Angles, carrier: str) -> Vector:
    """Return up in the frame of a fixture on a table with two tilts, g; an angle that is left out is 0."""
    outer, inner = (radians(angles.get(axis, 0.0)) for axis in (carrier, "xy".replace(carrier, "")))
    carrying, carried, z = sin(outer), cos(outer) * sin(inner), cos(outer) * cos(inner)
    return (carrying, carried, z) if carrier == "x" else (carried, carrying, z)


def _targets(machine: Machine | None, asked: Mapping[str, Any]) -> dict[str, float]:
    """Return where a machine goes for a position, by those of its axes of which the position says something."""
    if machine is None:
        return {}
    wanted = {**angles_of(asked["gravity"], machine.carrier), "heading": asked.get("heading") or 0.0}
    wanted |= {axis: asked[axis] for axis in ("stage", TEMPERATURE) if asked.get(axis) is not None}
    return {axis: wanted[axis] for axis in machine.limits if axis in wanted}


def require_reachable(machines: Mapping[str, Machine | None], positions: Sequence[Position]) -> None:
    """Refuse positions that are beyond the limits of a machine, with the way on which it approaches them."""
    for position in positions:
        asked = {key: getattr(position, key) for key in ("gravity", "heading", "stage", TEMPERATURE)}
        for name, machine in machines.items():
            for axis, target in _targets(machine, asked).items():
                low, high = machine.limits[axis] if machine else (0.0, 0.0)
                for angle in (target, target - (machine.approach if machine else 0.0)):
                    if not low <= angle <= high:
                        raise UsageError(
                            f"{position.name} takes {axis} of the {name} to {angle:g}, and its limits are {low:g} and "
                            f"{high:g}"
                        )


class Mover:
    """One machine: moves it, waits until it is there, and says whether it still is.

    ``open_drive`` opens it when it is first needed, and again after a failure. ``waits`` gets, again and again, why it
    takes so long, with where the machine is.
    """

    def __init__(self, name: str, machine: Machine, clock: Clock, open_drive: Callable[[], Drive]) -> None:
        self.name, self.machine = name, machine
        self.at: dict[str, float] = {}
        self._clock, self._open = clock, open_drive
        self._drive: Drive | None = None
        self._targets: Angles = {}
        chamber = TEMPERATURE in machine.limits
        self._poll = CHAMBER_POLL if chamber else POLL
        self._timeout = machine.timeout or (CHAMBER_TIMEOUT if chamber else TIMEOUT)
        # A chamber swings about its temperature; whether the sensors have it is judged by their readings.
        self._still = machine.tolerance if chamber else STILL * machine.tolerance

    def move(self, targets: Angles, waits: Callable[[str, Angles], None]) -> dict[str, float]:
        """Go to some angles from the side that the machine says, and return what is read back there.

        HardwareError: it does not get there in its time, or does not answer.
        """
        if targets != self._targets or not self._is_there():
            self._targets = {}
            if self.machine.approach:
                beside = {axis: angle - self.machine.approach for axis, angle in targets.items()}
                self._go(beside, abs(self.machine.approach), waits)
            self.at = self._go(targets, self.machine.tolerance, waits)
            self._targets = dict(targets)
        return self.at

    def send(self, targets: Angles) -> None:
        """Send the machine on its way, and do not wait."""
        self._tried(lambda drive: drive.set(targets))
        self._targets = {}

    def require_there(self) -> None:
        """Refuse a machine that is no longer where it was; a HardwareError says where it is."""
        if self._targets and not self._is_there():
            self._fail(f"it has moved: it was at {in_words(self.at)}, and is at {in_words(self.read()[0])}")

    def _is_there(self) -> bool:
        at, _ = self.read()
        held = self._targets if TEMPERATURE in at else self.at
        return all(abs(at[axis] - angle) <= self.machine.tolerance for axis, angle in held.items())

    def read(self) -> tuple[dict[str, float], bool]:
        """Return where it is, and whether it is at rest."""
        return self._tried(lambda drive: drive.read())

    def close(self) -> None:
        """Release the machine."""
        if self._drive is not None:
            self._drive.close()
            self._drive = None

    def _go(self, targets: Angles, tolerance: float, waits: Callable[[str, Angles], None]) -> dict[str, float]:
        self._tried(lambda drive: drive.set(targets))
        end_ns = self._clock.now_ns() + self._timeout * 1e9
        before: dict[str, float] = {}
        try:
            while True:
                self._clock.sleep(self._poll)
                at, at_rest = self.read()
                near = all(abs(at[axis] - angle) <= tolerance for axis, angle in targets.items())
                still = all(abs(at[axis] - before.get(axis, 1e9)) <= self._still for axis in targets)
                if near and still and at_rest:
                    return at
                if self._clock.now_ns() > end_ns:
                    self._fail(
                        f"it is at {in_words(at)} after {self._timeout:g} s, and was sent to {in_words(targets)}"
                    )
                waits(f"the {self.name} is at {in_words(at)} on the way to {in_words(targets)}", at)
                before = at
        except KeyboardInterrupt:
            self._release()
            raise

    def _tried(self, act: Callable[[Drive], T]) -> T:
        try:
            if self._drive is None:
                self._drive = self._open()
            return act(self._drive)
        except HardwareError as error:
            self._fail(str(error))

    def _fail(self, why: str) -> NoReturn:
        """Stop the machine, so that it is opened anew, and raise a HardwareError."""
        self._release()
        raise HardwareError(f"{self.name}: {why}")

    def _release(self) -> None:
        drive, self._drive, self._targets = self._drive, None, {}
        if drive is not None:
            with suppress(HardwareError):  # what cannot be reached cannot be stopped
                drive.stop()
            drive.close()


def in_words(angles: Angles) -> str:
    """Return where a machine is, such as ``x 30.02°, y 0°``."""
    return ", ".join(
        f"{value:.6g} °C" if axis == TEMPERATURE else f"{axis} {value:.6g}°" for axis, value in angles.items()
    )


class Machines:
    """The operator that moves the machines of a bench; ``person`` is the one who is asked for all else.

    The temperature of the chamber is answered where no device of the bench is a thermometer.
    """

    def __init__(
        self, person: Operator, movers: Sequence[Mover], steps: Procedure, clock: Clock, *, thermometer: bool
    ) -> None:
        self._person, self._movers, self._clock = person, list(movers), clock
        self._ramps, self._thermometer = steps.ramp is not None, thermometer
        self.watches, self.most_attempts = person.watches, person.most_attempts
        self._failures = 0
        self._table = next((one.machine for one in movers if set(TILTS) & set(one.machine.limits)), None)
        self._carrier = "x" if self._table is None else self._table.carrier
        self._by_hand: tuple[object, ...] | None = None
        """What was last set by hand."""
        self._asked: Message = {}
        self._asked_by_hand = False
        nothing = (0.0, 0.0, 0.0, None, None)
        if self._table is not None and all(self._left_to_hand(_asked(one)) == nothing for one in steps.positions):
            self._by_hand = nothing

    def probe(self) -> None:
        """Read back where every machine is; a HardwareError where one does not answer."""
        for mover in self._movers:
            mover.read()

    def close(self) -> None:
        """Release the machines."""
        for mover in self._movers:
            mover.close()

    def ask(self, question: Message) -> object:
        """Return the answer to a question; to a position it is what was read back."""
        try:
            match question["ask"]:
                case "position" if question["position"] == TIP:
                    self._require_there()
                    return self._position(self._within_limits(question))
                case "position":
                    return self._position(question)
                case "review":
                    self._require_there()
                    return self._person.ask(question) if self._asked_by_hand else {"answer": "accept"}
        except HardwareError as error:
            self._failures += 1
            if self._failures >= ATTEMPTS:
                raise Stopped(f"{question['position']} failed {ATTEMPTS} times in a row: {error}") from None
            raise
        return self._person.ask(question)

    def tell(self, event: Message) -> None:
        """Pass an event on; what was set by hand and is refused is asked for again."""
        self._person.tell(event)
        if event["event"] == "accepted":
            self._failures = 0
        if self._asked_by_hand and event["event"] == "refused":
            self._by_hand = None

    def _require_there(self) -> None:
        for mover in self._movers:
            mover.require_there()

    def _position(self, question: Message) -> object:
        """Move every machine, have the rest done by hand, and return what was read back."""
        reached: dict[str, float] = {}
        for mover in self._movers:
            targets = _targets(mover.machine, question)
            if self._ramps and TEMPERATURE in targets:
                mover.send({TEMPERATURE: targets.pop(TEMPERATURE)})
            if targets:
                reached |= mover.move(targets, self._waits(question["position"]))
        if reached and question is not self._asked:
            self._asked = question
            self._person.tell({"event": "moved", "position": question["position"], "why": f"at {in_words(reached)}"})
        answer: Mapping[str, Any] = {"answer": "ready"}
        left = self._left_to_hand(question)
        self._asked_by_hand = left != self._by_hand
        self.most_attempts = self._person.most_attempts if self._asked_by_hand else REFUSALS
        if self._asked_by_hand:
            said = self._person.ask(question)
            if not isinstance(said, Mapping) or said.get("answer") != "ready":
                return said
            self._by_hand, answer = left, said
        own = self._as_set(question, reached)
        if "tilt" in own and "gravity" not in answer:
            answer = {**answer, "tilt": {**own["tilt"], **(answer.get("tilt") or {})}}
        elif "tilt" in answer or "gravity" in answer:
            own = {key: own[key] for key in own if key == TEMPERATURE}
        return {**own, **answer}

    def _as_set(self, question: Message, reached: Angles) -> dict[str, Any]:
        """Return what was read back as an answer has it."""
        answer: dict[str, Any] = {}
        if TEMPERATURE in reached and not self._thermometer:
            answer[TEMPERATURE] = round(reached[TEMPERATURE], DIGITS)
        if self._table is None:
            return answer
        gravity = gravity_of({**angles_of(question["gravity"], self._carrier), **reached}, self._carrier)
        if question["tilt"] is None or gravity[2] <= 0.0:
            return {**answer, "gravity": list(gravity)}
        tilt = {axis: round(degrees(asin(g)), DIGITS) for axis, g in zip(TILTS, gravity[:2], strict=True)}
        return {**answer, "tilt": {axis: tilt[axis] for axis in TILTS if axis in self._table.limits}}

    def _left_to_hand(self, asked: Message) -> tuple[object, ...]:
        """Return what no machine does: two angles, heading, angle of the stage, temperature."""
        wanted: dict[str, object] = {
            **angles_of(asked["gravity"], self._carrier),
            "heading": asked.get("heading") or 0.0,
        }
        wanted |= {axis: asked.get(axis) for axis in ("stage", TEMPERATURE)}
        for axis in (axis for mover in self._movers for axis in mover.machine.limits):
            wanted[axis] = None if axis in ("stage", TEMPERATURE) else 0.0
        return tuple(wanted[axis] for axis in (*TILTS, "heading", "stage", TEMPERATURE))

    def _within_limits(self, question: Message) -> Message:
        """Return a question of a tip that goes only so far as the table can."""
        angles = angles_of(question["gravity"], self._carrier)
        if self._table is not None:
            room = abs(self._table.approach)
            for axis in set(TILTS) & set(self._table.limits):
                low, high = self._table.limits[axis]
                angles[axis] = max(low + room, min(angles[axis], high - room))
        return {**question, "gravity": gravity_of(angles, self._carrier)}

    def _waits(self, position: str) -> Callable[[str, Angles], None]:
        """Return what tells the person why it takes so long, with an event once a minute."""
        began_ns = self._clock.now_ns()
        told = [WAITING]

        def waits(why: str, at: Angles) -> None:
            if self._person.watches:
                self._person.tell({"event": "look", "position": position, "why": why, "readings": {}})
            seconds = (self._clock.now_ns() - began_ns) / 1e9
            if seconds >= told[0]:
                told[0] = (seconds // WAITING + 1) * WAITING
                event = {"event": "waiting", "position": position, "seconds": round(seconds), "why": why}
                self._person.tell({**event, TEMPERATURE: at.get(TEMPERATURE)})

        return waits


def _asked(position: Position) -> dict[str, Any]:
    return {key: getattr(position, key) for key in ("gravity", "heading", "stage", TEMPERATURE)}

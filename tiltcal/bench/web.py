"""A person at a page in a browser, who is shown what the session does and answers from two metres away.

The page shows :class:`~tiltcal.bench.page_server.PageState` and nothing else; what somebody presses arrives there, and
counts for the question it names alone. With free hands a position is taken as soon as the readings show that it is set.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from math import atan2, cos, degrees, hypot, sin, sqrt
from typing import TYPE_CHECKING, Any

from tiltcal.bench import messages
from tiltcal.bench.guidance import COLUMNS, UNCALIBRATED, level_sides, note_on, whether_all
from tiltcal.bench.operators import LOOK, Operator, in_words
from tiltcal.bench.page_server import PageServer, PageState
from tiltcal.bench.page_token import PageToken
from tiltcal.core.attitude import Vector
from tiltcal.errors import Stopped

if TYPE_CHECKING:
    from tiltcal.bench.session import Session

LIVE_PAUSE = 0.25  # seconds between live readings: a bubble is followed by eye, and a night's journal stays small
PATIENCE = 0.5  # seconds of one wait for an answer; Ctrl-C is seen between two on every system
STILL_FOR = 1.5  # seconds of readings by which the page calls a sensor still
MOVING = 0.3  # a change from the first to the second half of these readings above this is a movement, degrees; ours

MOVED = 5.0
"""Free hands take a position only where its reading is farther than this from that of the position before, degrees."""

PACE = 0.05  # seconds between two readings that the page draws while the session samples

REACH = 40.0
"""A part of the sphere counts as met where a free position is nearer than this, degrees: twelve even ones meet all."""

SPHERE = [
    (sqrt(1.0 - z * z) * cos(2.4 * k), sqrt(1.0 - z * z) * sin(2.4 * k), z)
    for k, z in enumerate((2 * k + 1) / 300 - 1.0 for k in range(300))
]
"""Directions that are spread evenly, by the golden angle of 2.4 radians."""

LOGGED = 40  # events that the page lists
SOUNDS = ("sampled", "refused", "done")  # what the page sounds at


def open_web(
    stack: ExitStack, say: Callable[[str], None], session: Session, *,
    listen: str | None = None, hands_free: bool = False,
) -> WebOperator:  # fmt: skip
    """Return the operator of a page that is served until the end of the stack; ``say`` takes where it is."""
    state, token = PageState(), PageToken(session.files.journal)
    stack.callback(lambda: token.forget() if session.finished else None)
    server = PageServer(state, token.value, listen)
    stack.callback(server.close)
    stack.callback(lambda: state.show(**_end(finished=session.finished)))
    say(f"the page of this session: {server.url}")
    if listen is not None:
        say(f"its token, which the page asks for: {token.value}")
    return WebOperator(state, server.reports, hands_free=hands_free)


class WebOperator(Operator):
    """Asks the person at the page; ``reports`` are the pages that it may open, by their path."""

    watches = True

    def __init__(
        self, state: PageState, reports: dict[str, bytes], *,
        hands_free: bool = False, clock: Callable[[], float] = time.monotonic,
    ) -> None:  # fmt: skip
        self._state, self._reports, self._hands_free, self._clock = state, reports, hands_free, clock
        self._asked: messages.Question | None = None  # the question that is shown; None where it is to be shown again
        self._target: Vector | None = None  # what the last position that was asked for has point up
        self._taken = ""  # the position that free hands have taken
        self._begin = messages.Begin(title="", positions=[], attitudes={}, headings=False, accepted=[], sensors={})
        self._readings: deque[tuple[float, dict[str, Vector]]] = deque()
        """Times, s, and directions by serial number, as the sensors read them."""
        self._before: dict[str, Vector] = {}
        """Those of the position that was accepted last; none where somebody has to look at the next one."""
        self._met: dict[str, Vector] = {}  # the directions that the first sensor read, by position
        self._guide: dict[str, Any] | None = None
        self._sounds = dict.fromkeys(SOUNDS, 0)
        self._log: list[dict[str, str]] = []
        state.show(
            title="tiltcal", hands_free=hands_free, positions=[], accepted=[], now="", step="", prompt="",
            conditions=[], doing="", refused="", soak=None, samples=None, remaining=None, guide=None, table=None,
            sphere=None, results=[], live={}, log=[], sounds={}, read_ms=0, ended=False,
        )  # fmt: skip

    def ask(self, question: messages.Question) -> object:
        """Return the answer of the page; to a position that nobody answers for a moment, ask for a reading to show."""
        begins = question != self._asked
        if begins:
            self._asked = question
            self._show_question(question)
        answer: dict[str, object] | None
        if free := self._free_answer(question):
            answer = self._state.withdraw() or {"answer": free}
        elif isinstance(question, messages.Poll):
            answer = self._state.wait(0.0)
        elif isinstance(question, messages.PositionQuestion | messages.AfterwardsQuestion):
            answer = self._state.wait(0.0 if begins else LIVE_PAUSE)
        else:
            while (answer := self._state.wait(PATIENCE)) is None:
                pass
        if answer is None:
            return None if isinstance(question, messages.Poll) else {"answer": LOOK}
        self._asked = None
        by_itself = isinstance(question, messages.PositionQuestion) and answer == {"answer": free}
        self._taken = question.subject if by_itself else ""
        self._state.show(refused="", doing="")
        if answer.get("answer") in ("redo", "back"):
            self._before = {}
        if answer.get("answer") == "quit":
            declined = isinstance(question, messages.WriteQuestion)
            raise Stopped("not written: the operator declined" if declined else "stopped by the operator")
        return answer

    def tell(self, event: messages.SessionEvent) -> None:
        """Show an event, and list it where it has words."""
        match event:
            case messages.Begin():
                self._begin, self._before, self._target = event, {}, None
                self._met = {}
                title = "  ".join(filter(None, (event.title, event.length)))
                self._state.show(title=title, positions=event.positions, accepted=event.accepted)
            case messages.Progress():
                # A person, or a table that asks nobody, sets the position now.
                self._target = self._begin.attitudes.get(event.position)
                self._guide = None
                self._readings.clear()
                name, step = event.position, self._step(event.position)
                self._state.show(sphere=self._sphere(event.accepted))
                self._state.show(accepted=event.accepted, now=name, step=step, prompt=name, remaining=event.left)
            case messages.Look():
                self._show_reading(event)
            case messages.Refused():
                self._before, self._taken = {}, ""
                self._state.show(refused=event.why, doing="", samples=None, soak=None, **self._sound("refused"))
            case messages.Accepted():
                measured = event.by_serial(self._begin.sensors).items()
                self._before = {serial: self._direction(serial, one.mean) for serial, one in measured}
                self._met[event.position] = next(iter(self._before.values()))
                self._state.show(table=None, refused="", doing=f"accepted {event.position}")
            case messages.Done():
                self._state.show(**self._sound("done"))
            case messages.Results():
                self._state.show(results=event.results)
            case messages.Live():
                self._state.show(live=event.tilts, **_moment())
            case messages.Report():
                self._reports[f"/report/{event.sensor}"] = event.page
        if lines := in_words(event):
            listed = ({"kind": event.kind, "text": line.strip()} for line in lines)
            self._log = [*self._log, *listed][-LOGGED:]
            self._state.show(log=self._log)

    def _show_question(self, question: messages.Question) -> None:
        """Show what is asked, in place of what was asked before."""
        positions = self._begin.positions
        fields: dict[str, object] = {"conditions": [], "samples": None, "soak": None}
        match question:
            case messages.PositionQuestion():
                self._target = question.up
                fields |= {"prompt": question.prompt, "conditions": list(_conditions(question))}
            case messages.Review():
                means = question.readings
                fields |= {"table": self._table(means), "guide": self._guided(means)}
                fields |= {"doing": "sampled: does it count?", **self._sound("sampled")}
            case messages.RotationQuestion():
                pairs = [f"{' and '.join(pair.pair)}, orthogonal {pair.orthogonal}" for pair in question.pairs]
                fields |= {"step": f"up to {question.turns} turns", "conditions": pairs, "prompt": question.prompt}
            case messages.StopAndKeep():
                fields |= {"accepted": positions, "step": "stop and keep", "prompt": question.why, "doing": ""}
            case messages.WriteQuestion() | messages.AfterwardsQuestion():
                written = ", ".join(question.files) if isinstance(question, messages.WriteQuestion) else ""
                prompt = question.prompt if isinstance(question, messages.AfterwardsQuestion) else f"Write {written}?"
                fields |= {"accepted": positions, "step": "everything is measured", "prompt": prompt, "doing": ""}
                fields |= {"table": None, "guide": None, "remaining": None}
        self._state.show(**fields)
        self._state.ask(question.as_data())

    def _step(self, position: str) -> str:
        """Return which position of how many it is."""
        positions = self._begin.positions
        place = f"{positions.index(position) + 1} of {len(positions)}   " if position in positions else ""
        return place + position

    def _show_reading(self, look: messages.Look) -> None:
        """Show readings, how far they are from the position, and why the session waits."""
        now, readings = self._clock(), look.readings
        if look.why and self._readings and now - self._readings[-1][0] < PACE:
            return  # a virtual session takes a hundred samples at once
        directions = {serial: self._direction(serial, one.values) for serial, one in readings.items()}
        self._readings.append((now, directions))
        while now - self._readings[0][0] > STILL_FOR:
            self._readings.popleft()
        self._guide = self._guided(readings)
        samples, seconds = look.samples, look.seconds
        free = self._hands_free and not look.why
        waits = self._waits_for(self._asked) if free and isinstance(self._asked, messages.PositionQuestion) else ""
        doing = "" if samples else look.why or (waits and f"hands-free: {waits}")
        self._state.show(
            guide=self._guide, table=self._table(readings), doing=doing, samples=samples, soak=seconds, **_moment()
        )

    def _guided(self, readings: messages.Readings) -> dict[str, object] | None:
        """Return what the page draws of readings and the position that is set; None where there is no position.

        Where nothing predicts a reading, as of attitudes that nobody sets, there is no target.
        """
        if self._target is None:
            return None
        guides = {serial: reading.guidance for serial, reading in readings.items()}
        offs = {(serial, name): off for serial, one in guides.items() for name, off in one.differences.items()}
        shares = {which: off.share for which, off in offs.items() if off.share is not None}
        worst = max(shares, key=lambda which: shares[which], default=None)
        sensors = []
        for serial, one in guides.items():
            share = max((part for (whose, _), part in shares.items() if whose == serial), default=None)
            off = max(one.differences.items(), key=lambda item: item[1].share or 0.0, default=None)
            said = "" if off is None or off[1].angle is None else f"{off[0]} {off[1].angle:+.1f}°".strip()
            drawn = {"present": one.up, "sides": list(one.sides.values()), "share": share, "ok": one.ok}
            sensors.append({"name": serial, "said": said, **drawn})
        note = note_on(list(guides.values()))
        aimed = any(tilt.target is not None for one in guides.values() for tilt in one.tilts.values())
        return {
            "target": self._target if aimed else None,
            "sides": [name for name, _ in level_sides(self._target)],
            "sensors": sensors,
            "worst": None if worst is None else {"axis": worst[1], **offs[worst]._asdict()},
            "fits": whether_all(one.fits for one in guides.values()),
            "ok": whether_all(one.ok for one in guides.values()),
            "note": "" if note == UNCALIBRATED else note,
            "still": self._stillness(),
        }

    def _direction(self, serial: str, values: Mapping[str, float]) -> Vector:
        """Return the direction that a sensor reads by its nominal coefficients; a z that it has not is positive."""
        sensor = self._begin.sensors[serial]
        sines = {name: (value - sensor.offset) / sensor.sensitivity for name, value in values.items()}
        x, y = (sines.get(axis, 0.0) for axis in "xy")
        return x, y, sines.get("z", sqrt(max(1.0 - x * x - y * y, 0.0)))

    def _sphere(self, accepted: Sequence[str]) -> dict[str, object]:
        """Return the directions that are met and those that are missing; of free positions the share of the sphere."""
        if not self._begin.free:
            dots = [[at, name in accepted] for name, at in self._begin.attitudes.items()]
            return {"dots": dots, "share": None}
        met = [one for name, one in self._met.items() if name in accepted]
        near = sum(any(_apart(one, point) < REACH for one in met) for point in SPHERE)
        # Of those that were accepted before the session was resumed no reading is at hand.
        share = near / len(SPHERE) if len(met) == len(accepted) else None
        return {"dots": [[[part / hypot(*one) for part in one], True] for one in met], "share": share}

    def _stillness(self) -> float:
        """Return 1 where the last readings stand still, and less the more they move."""
        rows = [directions for _, directions in self._readings]
        if len(rows) < 4 or self._readings[-1][0] - self._readings[0][0] < 0.6 * STILL_FOR:
            return 0.0
        if not rows[-1] or any(row.keys() != rows[-1].keys() for row in rows):  # a sensor failed meanwhile
            return 0.0
        halves = rows[: len(rows) // 2], rows[len(rows) // 2 :]
        moved = (
            _apart(*([sum(column) for column in zip(*(row[serial] for row in half), strict=True)] for half in halves))
            for serial in rows[-1]
        )
        return min(1.0, MOVING / max(*moved, 1e-9))

    def _free_answer(self, question: messages.Question) -> str:
        """Return the answer that free hands give to a question; nothing where a person has to."""
        if not self._hands_free:
            return ""
        if isinstance(question, messages.Review) and question.position == self._taken:
            return "accept" if all(one.guidance.fits for one in question.readings.values()) else ""
        asked = isinstance(question, messages.PositionQuestion) and self._readings and not self._waits_for(question)
        return "ready" if asked else ""

    def _waits_for(self, question: messages.PositionQuestion) -> str:
        """Return why free hands do not take a position yet; empty where it is as expected, another one, and still."""
        guide, now = self._guide, self._readings[-1][1]
        for stated, what in (
            (question.temperature is not None, "a temperature"),
            (question.stage is not None, "an angle of the stage"),
            (self._begin.headings, "a heading"),
            (not self._before, "the first position, and one after a refusal or a step back,"),
        ):
            if stated:
                return f"{what} asks a person: press Measure"
        if guide is None or guide["fits"] is None:
            return "nothing predicts this reading: press Measure when it is set"
        if not guide["fits"]:
            return "waits until the reading is within the tolerance"
        if not all(_apart(now[serial], self._before[serial]) > MOVED for serial in now):
            return "reads as the position before: a sensor that cannot see the turn asks a person: press Measure"
        return "" if guide["still"] >= 1.0 else "waits until it stands still"

    def _table(self, readings: messages.Readings) -> dict[str, object]:
        """Return the table of readings, or of the means of a review."""
        rows = list(messages.rows_of(readings, self._begin.sensors))
        width = max((len(cells) for cells, _ in rows), default=1)
        calibrated = any(one.guidance.calibrated for one in readings.values())
        head = ["calibrated" if calibrated else "not calibrated yet", *COLUMNS[1:width]]
        filled = [place for place in range(width) if any("".join(cells[place : place + 1]) for cells, _ in rows)]
        return {
            "head": [head[place] for place in filled],
            "rows": [{"cells": ["".join(cells[at : at + 1]) for at in filled], "ok": ok} for cells, ok in rows],
        }

    def _sound(self, name: str) -> dict[str, dict[str, int]]:
        """Return the field of the state that has the page sound once."""
        self._sounds = {**self._sounds, name: self._sounds[name] + 1}
        return {"sounds": self._sounds}


def _end(*, finished: bool) -> dict[str, object]:
    """Return what the page shows at the end: nothing that only a running session gives."""
    said = "Finished. You may close this page." if finished else "Stopped. The terminal says how to go on."
    empty = dict.fromkeys(("guide", "table", "samples", "soak", "remaining"))
    return {"step": "the session has ended", "prompt": said, "conditions": [], "doing": "", "live": {}, **empty}


def _conditions(question: messages.PositionQuestion) -> Iterator[str]:
    """Yield what a position asks for besides its attitude."""
    if question.temperature is not None:
        yield f"at {question.temperature:g} °C"
    if question.stage is not None:
        yield f"stage at {question.stage:g}°"
    if question.heading:
        yield f"heading {question.heading:g}°"


def _apart(first: Sequence[float], second: Sequence[float]) -> float:
    """Return the angle between two directions of any length, degrees."""
    (a, b, c), (x, y, z) = first, second
    across = hypot(b * z - c * y, c * x - a * z, a * y - b * x)
    return degrees(atan2(across, a * x + b * y + c * z))


def _moment() -> dict[str, int]:
    """Return the field of the state that says when its readings were taken, ms since 1970."""
    return {"read_ms": time.time_ns() // 1_000_000}

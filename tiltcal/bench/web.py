"""A person at a page in a browser, who is shown what the session does and answers from two metres away.

The page shows :class:`~tiltcal.bench.page_server.PageState` and nothing else; what somebody presses arrives there, and
counts for the question it names alone. With free hands a position is taken as soon as the readings show that it is set.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from math import acos, degrees, isfinite, sqrt
from typing import Any

from tiltcal.bench.guidance import AxisGuidance, present_gravity
from tiltcal.bench.operators import LOOK, Message, Operator, in_words
from tiltcal.bench.page_server import PageServer, PageState
from tiltcal.core.attitude import Vector, gravity_from_tilt, normalised, orientation
from tiltcal.core.detection import TEMPERATURES
from tiltcal.errors import InputError, Stopped

LIVE_PAUSE = 0.25
"""Seconds between live readings: a bubble is followed by eye, and a night's journal stays small."""

PATIENCE = 0.5
"""Seconds of one wait for an answer; Ctrl-C is seen between two on every system."""

STILL_FOR = 1.5
"""Seconds of readings by which the page calls a sensor still."""

MOVING = 0.3
"""A change from the first to the second half of these readings above this is a movement, degrees."""

MOVED = 5.0
"""Free hands take a position only where its reading is farther than this from that of the position before, degrees."""

CLOSE = 10.0
"""And only where a reading is expected to within this, degrees: the sensors of a jig are known better."""

STEEP = 45.0
"""The tilt of an axis, degrees, above which two axes beside it show the attitude better."""

PACE = 0.05
"""Seconds between two readings that the page draws while the session samples."""

LOGGED = 40
"""Events that the page lists."""

SHOWN = ("accepted", "refused", "lost", "held", "resumed", "turn", "done")
"""Events that the page lists, by their words."""


def open_web(
    stack: ExitStack, say: Callable[[str], None], *, listen: str | None = None, hands_free: bool = False
) -> WebOperator:
    """Return the operator of a page that is served until the end of the stack; ``say`` takes where it is."""
    state = PageState()
    server = PageServer(state, listen)
    stack.callback(server.close)
    say(f"the page of this session: {server.url}")
    if server.token is not None:
        say(f"its token, which the page asks for: {server.token}")
    return WebOperator(state, server.reports, hands_free=hands_free)


class WebOperator(Operator):
    """Asks the person at the page; ``reports`` are the pages that it may open, by their path."""

    watches = True

    def __init__(
        self,
        state: PageState,
        reports: dict[str, bytes],
        *,
        hands_free: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._state, self._reports, self._hands_free, self._clock = state, reports, hands_free, clock
        self._asked: Message | None = None
        """The question that is shown; None where it is to be shown again."""
        self._typed: dict[str, Any] = {}
        self._target: Message = {}
        """The last position that was asked for."""
        self._taken = ""
        """The position that free hands have taken."""
        self._begin: Message = {"positions": [], "sensors": {}, "attitudes": {}, "headings": False}
        self._readings: deque[tuple[float, dict[str, Vector]]] = deque()
        """Times, s, and directions by serial number, as the sensors read them."""
        self._before: dict[str, Vector] = {}
        """Those of the position that was accepted last; none where somebody has to look at the next one."""
        self._guide: dict[str, Any] | None = None
        self._sounds = {"sampled": 0, "refused": 0, "done": 0}
        self._log: list[dict[str, str]] = []
        state.show(
            title="tiltcal", hands_free=hands_free, positions=[], at=0, step="", prompt="", conditions=[], doing="",
            refused="", soak=None, samples=None, remaining=None, guide=None, table=None, results=[], live={}, log=[],
            sounds={}, read_ms=0, ended=False,
        )  # fmt: skip

    def ask(self, question: Message) -> object:
        """Return the answer of the page; to a position that nobody answers for a moment, ask for a reading to show."""
        kind = question["ask"]
        begins = question != self._asked
        if begins:
            self._typed = {}
            self._show_question(question)
        if free := self._free_answer(question):
            self._asked = None
            self._state.withdraw()
            return {"answer": free}
        if kind == "poll":
            answer = self._state.wait(0.0)
        elif kind in ("position", "afterwards"):
            answer = self._state.wait(0.0 if begins else LIVE_PAUSE)
        else:
            while (answer := self._state.wait(PATIENCE)) is None:
                pass
        if answer is None:
            return None if kind == "poll" else {"answer": LOOK}
        if answer.get("answer") == "set":
            self._set(answer, question)
            return {"answer": LOOK}
        self._asked, self._taken = None, ""
        self._state.show(refused="", doing="")
        if answer.get("answer") in ("redo", "back"):
            self._before = {}
        if answer.get("answer") == "quit":
            raise Stopped("not written: the operator declined" if kind == "write" else "stopped by the operator")
        return {**self._typed, **answer}

    def tell(self, event: Message) -> None:
        """Show an event."""
        match event["event"]:
            case "begin":
                self._begin, self._before, self._target = event, {}, {}
                title = "  ".join(filter(None, (event["title"], event["length"])))
                self._state.show(title=title, positions=event["positions"], at=len(event["accepted"]))
            case "progress":
                self._state.show(at=len(event["accepted"]), remaining=event["seconds"])
            case "look":
                self._show_reading(event)
            case "live":
                self._state.show(live=event["tilts"], read_ms=time.time_ns() // 1_000_000)
            case "report":
                self._reports[f"/report/{event['sensor']}"] = event["page"]
            case "results":
                self._state.show(results=event["results"])
            case kind if kind in SHOWN:
                self._show_event(event)

    def _show_question(self, question: Message) -> None:
        """Show what is asked, in place of what was asked before."""
        self._asked = question
        kind, name, positions = question["ask"], question.get("position", ""), self._begin["positions"]
        fields: dict[str, Any] = {"conditions": [], "samples": None, "soak": None}
        if name in positions:
            fields["step"] = f"{positions.index(name) + 1} of {len(positions)}   {name}"
        match kind:
            case "position":
                if question is not self._target:
                    self._target, self._guide = question, None
                    self._readings.clear()
                fields |= {"prompt": question["prompt"], "conditions": list(_conditions(question, self._typed))}
            case "review":
                self._sound("sampled")
                guide = self._guided({name: {"guidance": axes} for name, axes in question["guidance"].items()})
                fields |= {"table": self._review(question), "doing": "sampled: does it count?", "guide": guide}
            case "write":
                files = ", ".join(question["files"])
                fields |= {"at": len(positions), "step": "everything is measured", "prompt": f"Write {files}?"}
                fields |= {"table": None, "guide": None, "remaining": None}
            case "rotation":
                pairs = [f"{' and '.join(pair['pair'])}, orthogonal {pair['orthogonal']}" for pair in question["pairs"]]
                step = f"up to {question['turns']} turns"
                fields |= {"step": step, "prompt": question["prompt"], "conditions": pairs}
            case "afterwards":
                fields |= {"at": len(positions), "step": "done", "prompt": question["prompt"], "remaining": None}
                fields |= {"doing": "", "table": None, "guide": None}
        self._state.show(**fields)
        self._state.ask({**question, **({"typed": self._typed} if self._typed else {})})

    def _set(self, answer: Mapping[str, Any], question: Message) -> None:
        """Keep an angle, a direction or a temperature that was typed; an InputError where it is none."""
        temperature, tilt, gravity = answer.get("temperature"), answer.get("tilt"), answer.get("gravity")
        self._asked = None  # the question is to be shown again, with another number
        typed = dict(self._typed)
        if temperature is not None:
            typed["temperature"] = _number(temperature, *TEMPERATURES)
        if isinstance(tilt, Mapping) and question["tilt"]:
            typed["tilt"] = {axis: _number(tilt[axis], -90.0, 90.0) for axis in question["tilt"] if axis in tilt}
            gravity_from_tilt({**question["tilt"], **typed["tilt"]})
        if isinstance(gravity, list) and len(gravity) == 3:
            typed["gravity"] = list(normalised([_number(component, -10.0, 10.0) for component in gravity]))
        self._typed = typed
        self._show_question(question)

    def _show_reading(self, look: Message) -> None:
        """Show readings, how far they are from the position, and why the session waits."""
        now, readings = self._clock(), look["readings"]
        if look["why"] and self._readings and now - self._readings[-1][0] < PACE:
            return  # a virtual session takes a hundred samples at once
        self._readings.append(
            (now, {serial: self._direction(serial, one["values"]) for serial, one in readings.items()})
        )
        while now - self._readings[0][0] > STILL_FOR:
            self._readings.popleft()
        self._guide = self._guided(readings)
        doing = "" if "samples" in look else look["why"]
        self._state.show(
            guide=self._guide, table=self._live(readings), doing=doing, samples=look.get("samples"),
            soak=look.get("seconds"), read_ms=time.time_ns() // 1_000_000,
        )  # fmt: skip

    def _guided(self, readings: Mapping[str, Any]) -> dict[str, Any] | None:
        """Return what the page draws of readings and the position that is set; None where there is no position.

        Where nothing predicts a reading, as of attitudes that nobody sets, there is no target.
        """
        if "gravity" not in self._target:
            return None
        target = normalised(self._target["gravity"])
        sensors: list[dict[str, Any]] = []
        worst: dict[str, Any] | None = None
        for serial, reading in readings.items():
            axes: Mapping[str, AxisGuidance] = reading["guidance"]
            present = present_gravity(orientation(self._begin["sensors"][serial]["axes"]), axes, target)
            farthest = max(_shares(axes), key=lambda one: one["share"], default=None)
            share = None if farthest is None else farthest["share"]
            sensors.append({"serial": serial, "present": present, "ok": _fits(axes), "share": share})
            if farthest is not None and (worst is None or share > worst["share"]):
                worst = farthest
        oks = [one["ok"] for one in sensors]
        aimed = all(axis["target"] is not None for one in readings.values() for axis in one["guidance"].values())
        return {
            "target": target if aimed else None,
            "sensors": sensors,
            "worst": worst,
            "ok": None if not oks or None in oks else all(oks),
            "still": self._stillness(),
        }

    def _direction(self, serial: str, values: Mapping[str, float]) -> Vector:
        """Return the direction that a sensor reads by its nominal coefficients; a z that it has not is positive."""
        sensor = self._begin["sensors"][serial]
        sines = {name: (value - sensor["offset"]) / sensor["sensitivity"] for name, value in values.items()}
        x, y = sines.get("x", 0.0), sines.get("y", 0.0)
        direction = x, y, sines.get("z", sqrt(max(1.0 - x * x - y * y, 0.0)))
        return normalised(direction) if any(direction) else (0.0, 0.0, 1.0)

    def _stillness(self) -> float:
        """Return 1 where the last readings stand still, and less the more they move."""
        times = [at for at, _ in self._readings]
        if len(times) < 4 or times[-1] - times[0] < 0.6 * STILL_FOR:
            return 0.0
        half = len(times) // 2
        rows = [directions for _, directions in self._readings]
        serials = [serial for serial in rows[-1] if all(serial in row for row in rows)]
        turns = (
            _apart(*(_mean([row[serial] for row in part]) for part in (rows[:half], rows[half:]))) for serial in serials
        )
        return min(1.0, MOVING / max(max(turns, default=180.0), 1e-9))

    def _free_answer(self, question: Message) -> str:
        """Return the answer that free hands give to a question; nothing where a person has to."""
        if not self._hands_free:
            return ""
        name = question.get("position", "")
        if question["ask"] == "review" and name == self._taken:
            self._taken = ""
            return "accept" if all(_fits(axes) for axes in question["guidance"].values()) else ""
        if question["ask"] != "position" or not self._readings or not self._is_shown(question):
            return ""
        self._taken = name
        return "ready"

    def _is_shown(self, question: Message) -> bool:
        """Return whether the readings alone show that a position is set: as expected, new, like no other, and still."""
        guide, now = self._guide, self._readings[-1][1]
        stated = question["temperature"] is None and "stage" not in question and not self._begin["headings"]
        if not stated or self._typed or question["position"] not in self._begin["attitudes"]:
            return False
        if guide is None or guide["ok"] is not True or guide["worst"]["tolerance"] > CLOSE or guide["still"] < 1.0:
            return False
        if not self._before or any(_apart(now[serial], self._before[serial]) <= MOVED for serial in now):
            return False
        return not any(self._looks_alike(question, gravity) for gravity in self._begin["attitudes"].values())

    def _looks_alike(self, question: Message, gravity: Vector) -> bool:
        """Return whether a sensor reads another attitude as it reads the position."""
        if _apart(gravity, question["gravity"]) <= MOVED:
            return False
        for sensor in self._begin["sensors"].values():
            seen = [orientation(sensor["axes"]).seen(one) for one in (gravity, normalised(question["gravity"]))]
            channels = ["xyz".index(channel) for channel in sensor["channels"]]
            if all(abs(seen[0][place] - seen[1][place]) < 0.1 for place in channels):
                return True
        return False

    def _live(self, readings: Mapping[str, Any]) -> dict[str, Any]:
        """Return the table of readings while a position is set."""
        rows = []
        for serial, reading in readings.items():
            unit = self._begin["sensors"][serial]["unit"]
            for channel, value in reading["values"].items():
                axis = reading["guidance"].get(channel)
                rows.append(_row(f"{serial} {channel}", axis, [f"{value:.6g} {unit}"]))
        return {"head": ["not calibrated yet", "set", "now", "difference", "reading"], "rows": rows}

    def _review(self, review: Message) -> dict[str, Any]:
        """Return the table of a review: expected and measured side by side."""
        rows = []
        for serial, values in review["sensors"].items():
            unit, expected = self._begin["sensors"][serial]["unit"], review["expected"].get(serial, {})
            for channel, mean in values["mean"].items():
                wanted = f"{expected[channel]:.6g}" if expected else "unknown"
                noise = f"{values['std'][channel]:.2g}"
                cells = [wanted, f"{mean:.6g} {unit}", noise, str(values["n"])]
                rows.append(_row(f"{serial} {channel}", review["guidance"].get(serial, {}).get(channel), cells))
            if values["temperature"] is not None:
                rows.append(_row(f"{serial} T", None, ["", f"{values['temperature']:.2f} °C", "", ""]))
        return {"head": ["", "set", "now", "difference", "expected", "measured", "noise", "n"], "rows": rows}

    def _show_event(self, event: Message) -> None:
        """List an event by its words, with its sound."""
        match event["event"]:
            case "refused":
                self._before, self._taken = {}, ""
                self._sound("refused")
                self._state.show(refused=event["why"], doing="", samples=None, soak=None)
            case "accepted" if "mean" in event:
                sensors = event.get("sensors") or {next(iter(self._begin["sensors"])): event}
                self._before = {serial: self._direction(serial, values["mean"]) for serial, values in sensors.items()}
                self._state.show(table=None, refused="", doing=f"accepted {event['position']}")
            case "done":
                self._sound("done")
        self._log = [*self._log, *({"kind": event["event"], "text": line.strip()} for line in in_words(event))][
            -LOGGED:
        ]
        self._state.show(log=self._log)

    def _sound(self, name: str) -> None:
        self._sounds = {**self._sounds, name: self._sounds[name] + 1}
        self._state.show(sounds=self._sounds)


def _fits(axes: Mapping[str, AxisGuidance]) -> bool | None:
    """Return whether a sensor is set as asked; None where nothing can be said.

    Of an axis that stands steep, whose reading hardly changes with its angle, the right side up is enough.
    """
    if not axes or any(axis["ok"] is False for axis in axes.values()):
        return False if axes else None
    fits = [axis["ok"] or _stands_right(axis) for axis in axes.values()]
    return True if all(fits) and any(axis["ok"] for axis in axes.values()) else None


def _shares(axes: Mapping[str, AxisGuidance]) -> Iterator[dict[str, Any]]:
    """Yield the axes that show how far a sensor is off, each with the share of its tolerance that this is."""
    for channel, axis in axes.items():
        difference, tolerance = axis["difference"], axis["tolerance"]
        steep = abs(axis["target"] or 0.0) > STEEP
        if difference is not None and tolerance and (not steep or axis["ok"] is False or len(axes) == 1):
            yield {
                "axis": channel,
                "difference": difference,
                "tolerance": tolerance,
                "share": abs(difference) / tolerance,
            }


def _stands_right(axis: AxisGuidance) -> bool:
    """Return whether an axis is steep, and so is its reading, on the same side."""
    target, present = axis["target"], axis["present"]
    return (
        target is not None and present is not None and min(abs(target), abs(present)) > STEEP and target * present > 0
    )


def _row(name: str, axis: AxisGuidance | None, cells: Sequence[str]) -> dict[str, Any]:
    """Return a row of a table: the tilts of an axis, what else there is, and whether it is ok."""
    tilts = [None] * 3 if axis is None else [axis["target"], axis["present"], axis["difference"]]
    said = ["" if tilt is None else f"{tilt:+.2f}°" for tilt in tilts]
    return {"cells": [name, *said, *cells], "ok": None if axis is None else axis["ok"]}


def _conditions(question: Message, typed: Mapping[str, Any]) -> Iterator[str]:
    """Yield what a position asks for besides its attitude, and what was typed."""
    if question["temperature"] is not None:
        yield f"at {question['temperature']:g} °C"
    if "stage" in question:
        yield f"stage at {question['stage']:g}°"
    if question["heading"]:
        yield f"heading {question['heading']:g}°"
    for axis, angle in typed.get("tilt", {}).items():
        yield f"{axis} set to {angle:g}°"
    if "gravity" in typed:
        yield "set to " + ", ".join(f"{component:.4g}" for component in typed["gravity"])
    if "temperature" in typed:
        yield f"{typed['temperature']:g} °C as typed"


def _number(value: object, low: float, high: float) -> float:
    """Return a number that was typed; an InputError where it is none, or out of range."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
        raise InputError("type a number")
    if not low <= value <= high:
        raise InputError(f"{value:g} is not between {low:g} and {high:g}")
    return float(value)


def _apart(first: Sequence[float], second: Sequence[float]) -> float:
    """Return the angle between two directions of length 1, degrees."""
    return degrees(acos(max(-1.0, min(1.0, sum(a * b for a, b in zip(first, second, strict=True))))))


def _mean(directions: Sequence[Vector]) -> Vector:
    return normalised([sum(column) for column in zip(*directions, strict=True)])

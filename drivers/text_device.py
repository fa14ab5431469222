"""A device that prints its readings as text, described by its manual: what it is asked, and a pattern of its answer.

The pattern is a regular expression with a named group for each reading (``x``, ``y``, ``z`` and ``temperature``). It is
searched in whole messages, each of which ends with :attr:`TextDevice.ends`, and may reach over several of them. What
is left of these messages holds no number, and touches none: then a character that was lost or damaged is no reading.
The group ``checksum`` holds the check sum of the group ``checked``, in hexadecimal or as one byte.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, cached_property, partial, reduce
from importlib import import_module
from itertools import product
from math import isfinite
from operator import xor
from typing import Any

from tiltcal.column_names import TEMPERATURE
from tiltcal.drivers.bus import Link
from tiltcal.drivers.bus.clock import SECOND, Clock
from tiltcal.drivers.columns import CHUNK, LONGEST, UNUSABLE, Scale, channels_of, model_of_numbers
from tiltcal.drivers.model import Model, Reading, Sensor
from tiltcal.drivers.virtual import HeldPose, StreamingPart, Truth
from tiltcal.errors import BusError

ENCODING = "latin-1"
"""Of what is sent and of what comes: a character is a byte."""

LINE_ENDS = {"lf": "\n", "cr": "\r", "crlf": "\r\n"}
CHECKED, CHECKSUM = "checked", "checksum"
CHECKSUMS: Mapping[str, Callable[[bytes], int]] = {"xor": partial(reduce, xor), "sum": sum}
_MARKS = {"point": ".", "comma": ","}
DECIMALS = tuple(_MARKS)
DEGREES = ("deg", "°")

TRIES = 3  # questions until damaged answers are a failure
_ANY_END = r"[\r\n]+"
_NUMBER = re.compile(r"([+-]?) *([0-9]+(?:\.([0-9]*))?|\.([0-9]+))(?:[eE]([+-]?[0-9]{1,3}))?")
_LEFT_OVER = re.compile(r"(?<![\w.])[-+]?(?:\d+[.,]?\d*|[.,]\d+)(?![\w.])")
_TOUCHES = re.compile(r"[\w.,+-]")
_FORMS = [
    f"{{:{sign}{width}.{places}f}}"
    for places in (3, 2, 1, 0, 4, 5, 6)
    for width in ("07", "", "06", "08", "09", "7", "8", "9")
    for sign in ("+", "")
]
_INTRICATE = "the virtual part can make no answer of this pattern: write it simpler"
_CATEGORIES = {"CATEGORY_SPACE": " ", "CATEGORY_DIGIT": "0", "CATEGORY_WORD": "a", "CATEGORY_NOT_SPACE": "a"}


@dataclass(frozen=True, kw_only=True)
class TextDevice:
    """The facts of a device that prints its readings.

    ask: what is sent before each reading; empty where it speaks by itself.
    answer: the pattern of its answer.
    ends: what ends a message, as its characters or a word of :data:`LINE_ENDS`; empty is any line end.
    decimal: ``point`` or ``comma``; checksum: one of :data:`CHECKSUMS`, or empty.
    timeout: seconds in which an answer comes; line: options of its serial line.
    interval: shortest time between two new readings, s.
    """

    name: str
    title: str
    scale: Scale
    answer: str
    ask: str = ""
    ends: str = ""
    decimal: str = "point"
    checksum: str = ""
    timeout: float = 2.0
    line: Mapping[str, str]
    interval: float = 0.0

    @cached_property
    def pattern(self) -> re.Pattern[str]:
        """The pattern of an answer."""
        return re.compile(self.answer)

    @cached_property
    def tree(self) -> Any:
        """The pattern as Python parses it."""
        return import_module("re._parser").parse(self.answer)

    @cached_property
    def end(self) -> re.Pattern[str]:
        """The pattern of what ends a message."""
        return re.compile(re.escape(LINE_ENDS.get(self.ends, self.ends)) or _ANY_END)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The readings, and the temperature, in the order of the pattern."""
        return tuple(name for name in self.pattern.groupindex if name not in (CHECKED, CHECKSUM))

    def numbers(self, match: re.Match[str]) -> tuple[dict[str, float], float]:
        """Return the readings of a match, and the step with which they are written; a ValueError says what is wrong."""
        numbers, places = {}, []
        for name in self.names:
            number, place = number_of(name, match[name], self.decimal)
            # Degrees from 0 to 360 have a step at level.
            turned = self.scale.unit in DEGREES and name != TEMPERATURE and number > 180.0
            numbers[name] = number - 360.0 * turned
            places += [place] * (name != TEMPERATURE)
        if self.checksum and (stated := match[CHECKSUM]) != (right := self.summed(match[CHECKED], stated)):
            raise ValueError(f"the check sum is {stated!r}, and that of {match[CHECKED]!r} is {right!r}")
        return numbers, float(f"1e{min(places, default=0)}")

    def summed(self, checked: str, stated: str) -> str:
        """Return the check sum of a text, written as ``stated`` is."""
        total = CHECKSUMS[self.checksum](checked.encode(ENCODING))
        if len(stated) == 1:
            return chr(total % 256)
        digits = f"{total % 16 ** len(stated):0{len(stated)}X}"
        return digits if stated.upper() == stated else digits.lower()

    def model(self) -> Model:
        """Return the sensor model of the device."""
        return model_of_numbers(
            self.scale,
            channels_of(self.names),
            TEMPERATURE in self.names,
            name=self.name,
            title=self.title,
            addresses=("serial:///dev/ttyUSB0",),
            line=self.line,
            interval=self.interval,
            driver=partial(TextSensor, self),
            twin=partial(virtual_text_device, self),
            not_modelled=("settings, errors and noise of the real device, which its file does not state",),
        )


def number_of(name: str, text: str | None, decimal: str = "point") -> tuple[float, int]:
    """Return the number in a group of an answer and the power of ten of its last digit; a ValueError if it is none."""
    shown = (text or "").strip()
    written = _NUMBER.fullmatch(shown if decimal == "point" else shown.translate(str.maketrans(".,", ",.")))
    if not written or not isfinite(number := float(written[0].replace(" ", ""))):
        raise ValueError(f"{name} is {shown!r}, no number with a decimal {decimal}")
    return number, int(written[5] or 0) - len(written[3] or written[4] or "")


def shown(text: str) -> str:
    """Return the last characters of a text for a message, quoted and escaped."""
    return repr(text[-120:])


class TextSensor(Sensor):
    """The driver of a device by its manual.

    heard: what came since it was asked, or since a reading began; found: the match in it.
    why: what is wrong with the last answer that was no reading; empty where it is one.
    """

    def __init__(self, device: TextDevice, link: Link, clock: Clock) -> None:
        self.device, self._link, self._clock = device, link, clock
        self.channels = channels_of(device.names)
        self.heard, self.why = "", ""
        self.found: re.Match[str] | None = None
        self._text, self._whole = "", bool(device.ask)
        self._used = self._damaged = 0
        self._failed = False

    def read(self) -> Reading:
        """Return the answer to a question, or the next one; a device that gives none is a BusError.

        A question with a damaged answer is asked again.
        """
        left = TRIES if self.device.ask else 1
        while True:
            left -= 1
            try:
                return self._read()
            except BusError:
                if not (left and self.heard):
                    raise

    def _read(self) -> Reading:
        asked = self._failed and bool(self.device.ask)
        if asked:
            # So that a late answer counts for no other question.
            self._clock.sleep(self.device.timeout)
        for _ in range(1 + asked):
            self._failed = True
            reading = self._answer()
        self._failed = False
        return reading

    def probe(self) -> Mapping[str, str]:
        """Return what was sent, what came, what of it the pattern matches and what not, and the reading."""
        said = super().probe()
        match, sent = self.found, {"sent": shown(self.device.ask)} if self.device.ask else {}
        left = self.heard.partition("" if match is None else match[0])
        beside = " and ".join(shown(text) for text in left[::2] if text) or "nothing"
        matched = {"came": shown(self.heard), "match": shown(left[1]), "beside it": beside}
        return {**sent, **matched, **said, "unit": self.device.scale.unit}

    def discard(self) -> None:
        """Discard what has arrived."""
        self._begin()
        self._link.exchange(b"", 0)

    def link_statistics(self) -> Mapping[str, int]:
        """Return the counts of used answers, and of those that do not match, or have a wrong check sum."""
        return {"answers": self._used, "damaged": self._damaged}

    def _begin(self) -> None:
        self._text, self._whole = "", bool(self.device.ask)

    def _answer(self) -> Reading:
        device, self.heard, self.found, self.why = self.device, "", None, ""
        out, began_ns, damaged = device.ask.encode(ENCODING), self._clock.now_ns(), self._damaged
        if out:
            self._begin()
        while True:
            if (reading := self._found()) is not None:
                self._used += 1
                return reading
            if (
                len(self._text) > LONGEST
                or self._damaged - damaged >= UNUSABLE
                or (device.ask and self._clock.now_ns() - began_ns > 2 * SECOND * device.timeout)
            ):
                self._begin()
                raise BusError(self._unlike())
            try:
                arrived = self._link.exchange(out, CHUNK).decode(ENCODING)
            except BusError as error:
                # What comes after it does not continue this message.
                self._begin()
                raise BusError(f"{error}; {self._unlike()}") if self.heard else error from error
            out = b""
            self._text += arrived
            self.heard += arrived

    def _unlike(self) -> str:
        """Count what came as damaged; return what it was, and how far the pattern matches it."""
        self._damaged += not self.why
        if self.why:
            return f"no sound answer came, only {shown(self.heard)}: {self.why}"
        answer, matched, rest = self.device.answer, "nothing of it", self.device.answer
        for pattern in _beginnings(answer):
            if (part := pattern.search(self.heard)) and part[0]:
                matched, rest = f"only {shown(part[0])} of it", answer[len(pattern.pattern) :]
                break
        end = shown(self.device.ends) if self.device.ends else "a line end"
        needed = f"next it needs {rest!r}" if rest else f"{end} that ends it is missing"
        came = f"no answer came, only {shown(self.heard)}" if self.heard else "nothing came"
        return f"{came}: the pattern matches {matched}, and {needed}; is the baud rate right?"

    def _found(self) -> Reading | None:
        """Return the reading of the last whole answer that has arrived, of one that was asked; else of the first."""
        reading = None
        while (reading is None or self.device.ask) and (one := self._next()) is not None:
            reading = one
        return reading

    def _next(self) -> Reading | None:
        """Return the reading of the next whole answer that is sound."""
        device, end = self.device, self.device.end
        if not self._whole:
            if (first := end.search(self._text)) is None:
                return None
            self._text, self._whole = self._text[first.end() :], True
        while (match := device.pattern.search(self._text)) is not None:
            last = [found.end() for found in end.finditer(self._text)]
            begin = max((place for place in last if place <= match.start()), default=0)
            stop = next((place for place in last if place >= match.end()), None)
            if stop is None:
                return None
            self.found, left = match, (self._text[begin : match.start()], self._text[match.end() : stop])
            try:
                self._require_sound(match, left)
                numbers, step = device.numbers(match)
            except ValueError as error:
                self.why = str(error)
                self._damaged += 1
                self._text = self._text[next(place for place in last if place > match.start()) :]
                continue
            self.why, self._text = "", self._text[stop:]
            return Reading(tuple(numbers[name] for name in self.channels), numbers.get(TEMPERATURE), step)
        return None

    def _require_sound(self, match: re.Match[str], left: tuple[str, str]) -> None:
        """Refuse a match beside which a number stands, or that a number of it goes on beyond."""
        edges = [match.span(name) for name in self.device.names]
        touches = (any(first == match.start() for first, _ in edges) and _TOUCHES.match(left[0][-1:])) or (
            any(last == match.end() for _, last in edges) and _TOUCHES.match(left[1][:1])
        )
        if touches or any(_LEFT_OVER.search(text) for text in left):
            raise ValueError(f"{left[0]!r} before and {left[1]!r} behind {match[0]!r} do not belong to the pattern")


# --- The virtual part ---


def answer_with(device: TextDevice, numbers: Mapping[str, float]) -> str:
    """Return an answer with these numbers, each in the first form that its group takes.

    ValueError: the pattern is too intricate for an answer to be made of it.
    """
    names = {number: name for name, number in device.pattern.groupindex.items()}

    def written(name: str, group: Any) -> str:
        """Return a number as its group has it; without a sign it counts to 360."""
        group, number = import_module("re._compiler").compile(group), numbers[name]
        for turned, form in product((0.0, 360.0), _FORMS):
            text = form.format(number + turned * (number < 0.0)).replace(".", _MARKS[device.decimal])
            if group.fullmatch(text):
                return text
        raise ValueError(_INTRICATE)

    def shortest(tree: Any) -> str:
        """Return the shortest text of a parsed pattern."""
        text = ""
        for operation, value in tree:
            match str(operation), value:
                case "LITERAL", code:
                    text += chr(code)
                case "IN", [(kind, of), *_]:
                    text += _CATEGORIES.get(str(of), "") or chr(of[0] if str(kind) == "RANGE" else of or ord(" "))
                case "ANY" | "NOT_LITERAL", _:
                    text += " "
                case "MAX_REPEAT" | "MIN_REPEAT" | "POSSESSIVE_REPEAT", (least, _, item):
                    text += shortest(item) * least
                case "SUBPATTERN", (number, _, _, item):
                    text += written(names[number], item) if names.get(number) in device.names else shortest(item)
                case "BRANCH", (_, [first, *_]):
                    text += shortest(first)
        return text

    text = shortest(device.tree)
    if (match := device.pattern.search(text)) is None or not all(map(match.group, device.names)):
        raise ValueError(_INTRICATE)
    if device.checksum:
        first, last = match.span(CHECKSUM)
        text = text[:first] + device.summed(match[CHECKED], match[CHECKSUM]) + text[last:]
    ends = LINE_ENDS.get(device.ends, device.ends) or "\r\n"
    return text if device.end.search(text, match.end() - 1) else text + ends


def virtual_text_device(device: TextDevice, truth: Truth, fixture: HeldPose, clock: Clock) -> StreamingPart:
    """Return a device that answers, or prints, at most ten times a second; it takes any question for its own."""

    def message(number: int) -> bytes:
        numbers = {TEMPERATURE: fixture.temperature() + truth.thermometer_error}
        for name in channels_of(device.names):
            numbers[name] = truth.sample(name, fixture, clock, number)
        return answer_with(device, numbers).encode(ENCODING)

    baudrate = int(device.line.get("baudrate", 9600))
    return StreamingPart(truth, fixture, clock, message, period=max(device.interval, 0.1), baudrate=baudrate)


@cache
def _beginnings(answer: str) -> list[re.Pattern[str]]:
    """Return all beginnings of a pattern that are patterns, the longest first."""
    found = []
    for length in range(len(answer), 0, -1):
        with suppress(re.error):
            found.append(re.compile(answer[:length]))
    return found

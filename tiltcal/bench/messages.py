"""The questions that a session asks its operator, and the events that it tells: what a program gets as JSON Lines.

A question is an object with ``ask``, an event one with ``event``. The answer to a question is an object with one of its
words as ``answer``; beside ``ready`` stands what was really reached: ``{"answer": "ready", "tilt": {"y": 30.02}}``.
While a stage turns, ``stop`` and ``quit`` may come unasked; of a Python object from its method ``poll``.

``redo`` asks for the same position again; ``back`` withdraws the one that was accepted last, ``again`` the one that it
names, also unasked while a reading settles; it is asked for anew. Of positions with one temperature, heading and stage
the order is free: ``ready`` may name the one that was set, ``again`` one to ask for. ``quit`` stops and keeps all.
A person is asked for a review of each position and before the files are written too, and sees every reading. Before
that the positions are judged: one that contradicts the others is refused and asked for again.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import ClassVar, dataclass_transform

import msgspec
from msgspec import Struct

from tiltcal.bench.guidance import UNKNOWN, AxisTilt, SensorGuidance
from tiltcal.core.attitude import Vector

ByName = Mapping[str, float]  # by channel, or by pair


@dataclass_transform(frozen_default=True)
class Message(Struct, frozen=True, omit_defaults=True):
    """A question or an event; ``heard`` is whether a program gets it."""

    heard: ClassVar[bool] = False

    @property
    def kind(self) -> str:
        """What it asks, or what has happened, in a word."""
        return str(self.__struct_config__.tag)

    def as_data(self) -> dict[str, object]:
        """Return the message as a program gets it."""
        return dict(msgspec.to_builtins(self))


class Question(Message, tag_field="ask"):
    """A question; ``words`` are the answers that it takes, ``usual`` is the one of an operator that leaves it open."""

    words: ClassVar[tuple[str, ...]] = ()
    usual: ClassVar[str] = ""

    @property
    def subject(self) -> str:
        """The position that it is about, or what else."""
        return str(getattr(self, "position", self.kind))


class PositionQuestion(Question, kw_only=True, tag="position"):
    """To bring the sensors into a position; angles are degrees, the temperature °C."""

    heard: ClassVar[bool] = True
    words: ClassVar[tuple[str, ...]] = ("ready", "redo", "back", "again", "quit")
    usual: ClassVar[str] = "ready"

    position: str
    tilt: Mapping[str, float] | None
    gravity: Sequence[float]
    heading: float
    temperature: float | None
    stage: float | None = None
    prompt: str

    @property
    def up(self) -> Vector:
        """The direction that is to point up, in the frame of the fixture."""
        x, y, z = self.gravity
        return x, y, z


class StagePair(Struct, frozen=True):
    """A pair of channels, and the one a quarter turn away."""

    pair: tuple[str, str]
    orthogonal: str


class RotationQuestion(Question, tag="rotation"):
    """To let the stage turn."""

    heard: ClassVar[bool] = True
    words: ClassVar[tuple[str, ...]] = ("ready", "quit")
    usual: ClassVar[str] = "ready"

    pairs: Sequence[StagePair]
    turns: int
    prompt: str


class Poll(Question, tag="poll"):
    """Whether the stage that turns is to be stopped; nobody has to answer."""

    words: ClassVar[tuple[str, ...]] = ("stop", "quit")

    @property
    def subject(self) -> str:
        """The stage."""
        return "rotation"


class Settling(Question, tag="settling"):
    """Whether an accepted position is to be taken again, while a reading settles; nobody has to answer."""

    words: ClassVar[tuple[str, ...]] = ("again",)

    position: str


class ShownReading(Struct, frozen=True):
    """A reading of a sensor, or of a review the means with their scatter; the temperature is in °C."""

    values: ByName
    temperature: float | None
    guidance: SensorGuidance
    std: ByName = {}
    n: int = 0


Readings = Mapping[str, ShownReading]
"""By serial number."""


class Review(Question, tag="review"):
    """Whether a position counts."""

    words: ClassVar[tuple[str, ...]] = ("accept", "redo", "back", "again", "quit")
    usual: ClassVar[str] = "accept"

    position: str
    readings: Readings


class WriteQuestion(Question, tag="write"):
    """Whether the files are to be written."""

    words: ClassVar[tuple[str, ...]] = ("yes", "back", "again", "quit")
    usual: ClassVar[str] = "yes"

    files: Sequence[str]


class StopAndKeep(Question, tag="stop"):
    """Whether to stop, where positions contradict each other for good."""

    words: ClassVar[tuple[str, ...]] = ("back", "again", "quit")
    usual: ClassVar[str] = "quit"

    position: str
    why: str


class AfterwardsQuestion(Question, tag="afterwards"):
    """What follows at the page, where everything is written."""

    words: ClassVar[tuple[str, ...]] = ("verify", "report", "finish")

    verify: bool
    prompt: str


class SessionEvent(Message, tag_field="event"):
    """What has happened."""


class Heard(SessionEvent):
    """An event that a program gets as well."""

    heard: ClassVar[bool] = True


class ShownSensor(Struct, frozen=True):
    """What the readings of a sensor are, for its operator."""

    unit: str
    offset: float
    sensitivity: float


class Begin(SessionEvent, kw_only=True, tag="begin"):
    """A session begins, or goes on."""

    title: str
    length: str = ""
    positions: Sequence[str]
    attitudes: Mapping[str, Vector]
    headings: bool
    accepted: Sequence[str]
    sensors: Mapping[str, ShownSensor]
    free: bool = False  # whether nobody sets the attitudes


class Progress(SessionEvent, tag="progress"):
    """What is accepted, what comes next, and in words how long the rest takes."""

    position: str
    accepted: Sequence[str]
    left: str


class Look(SessionEvent, tag="look"):
    """Readings to be seen; why it waits, the seconds that it does at least, or the samples taken and wanted."""

    position: str
    why: str
    readings: Readings
    seconds: float | None = None
    samples: tuple[int, int] | None = None


class Moved(SessionEvent, tag="moved"):
    """Machines have reached a position."""

    position: str
    why: str


class Waiting(Heard, tag="waiting"):
    """It takes long, once a minute: the seconds since the answer, why, and the temperature, °C."""

    position: str
    seconds: int
    why: str
    temperature: float | None


class Measured(Struct, frozen=True, omit_defaults=True):
    """What one sensor measured in an accepted position, in its unit.

    ``off`` is of three axes the ``angle`` between the direction read and the one asked for, and how far two sides are
    too high, degrees.
    """

    mean: ByName
    std: ByName
    n: int
    temperature: float | None = None
    left_out: int = 0
    off: ByName | None = None


class Accepted(Heard, tag="accepted"):
    """A position counts; what was measured is that of the first sensor, of several ``sensors`` hold that of each."""

    position: str
    mean: ByName
    std: ByName
    n: int
    temperature: float | None = None
    left_out: int = 0
    off: ByName | None = None
    reference: ByName | None = None
    sensors: Mapping[str, Measured] = {}

    def by_serial(self, serials: Iterable[str]) -> Mapping[str, Measured]:
        """Return what each sensor measured, by serial number."""
        alone = Measured(self.mean, self.std, self.n, self.temperature, self.left_out)
        return self.sensors or {next(iter(serials)): alone}


class Matched(Heard, tag="accepted"):
    """A rotation counts: the coefficients of each pair."""

    position: str
    turns: float
    p: ByName
    q: ByName
    u_p: ByName
    u_q: ByName
    suppression: Mapping[str, Mapping[str, float]]


class TurnMade(Heard, tag="turn"):
    """The stage has made a turn: the coefficients of each pair so far, and why others are unknown."""

    turn: int
    of: int
    p: ByName
    q: ByName
    u_p: ByName
    u_q: ByName
    unknown: Mapping[str, str] = {}
    left_out: int = 0


class Refused(Heard, tag="refused"):
    """A position or an answer does not count; the same question follows."""

    position: str
    why: str


class Lost(Heard, tag="lost"):
    """One of several sensors is given up."""

    sensor: str
    why: str


class Held(Heard, tag="held"):
    """Samples of a stage do not count from here on."""

    why: str


class Resumed(Heard, tag="resumed"):
    """They count again."""


class Done(Heard, tag="done"):
    """Everything is written."""

    calibrations: Sequence[str]
    journal: str


class Results(SessionEvent, tag="results"):
    """What the page shows of each calibration that was written."""

    results: Sequence[Mapping[str, object]]


class Live(SessionEvent, tag="live"):
    """The calibrated tilts: name, value and half-width of each, by serial number."""

    tilts: Mapping[str, Sequence[tuple[str, str, str]]]


class Report(SessionEvent, tag="report"):
    """A report was written."""

    sensor: str
    page: bytes


def rows_of(readings: Readings, sensors: Mapping[str, ShownSensor]) -> Iterator[tuple[list[str], bool | None]]:
    """Yield the cells of each direction, channel and thermometer below :data:`COLUMNS`, and whether it is as asked.

    ``readings`` are those that a session shows, or the means of its review; ``sensors`` are as it begins with them.
    """
    for serial, reading in readings.items():
        guide = reading.guidance
        if guide.unknown:
            yield [f"{serial} direction", "", UNKNOWN], None
        elif (off := guide.differences.get("")) is not None:
            yield [f"{serial} direction", "", "", f"{off.angle:.2f}°"], guide.ok
        for channel, value in reading.values.items():
            tilt, of = guide.tilts.get(channel, AxisTilt(None, None)), guide.differences.get(channel)
            angles = (tilt.target, tilt.present, None if of is None else of.angle)
            cells = ["" if angle is None else f"{angle:+.2f}°" for angle in angles]
            cells += [f"{value:.6g} {sensors[serial].unit}"]
            cells += [f"{reading.std[channel]:.2g}", str(reading.n)] if reading.n else []
            yield [f"{serial} {channel}", *cells], None if of is None or guide.calibrated else of.fits
        if reading.temperature is not None:
            yield [f"{serial} T", "", "", "", f"{reading.temperature:.2f} °C"], None

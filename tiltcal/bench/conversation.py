"""The conversation of a session with its operator: every answer goes to the journal at once, every event to both."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tiltcal.bench import messages
from tiltcal.bench.devices import Recorder, SensorSet
from tiltcal.bench.guidance import SensorGuidance, tilt_guidance
from tiltcal.bench.operators import LOOK, Operator, understood
from tiltcal.core.attitude import Vector
from tiltcal.drivers.bus.clock import SECOND
from tiltcal.errors import HardwareError, InputError, Stopped
from tiltcal.files.procedure import Position
from tiltcal.files.record import plain
from tiltcal.journal.lines import ANSWER, OperatorAnswer
from tiltcal.journal.playback import Sample
from tiltcal.journal.reference import sines
from tiltcal.journal.session import RecordedSession

if TYPE_CHECKING:
    from tiltcal.bench.checks import Expectations

MINUTE_NS = 60_000_000_000  # time between two events while a chamber soaks or a reading settles, ns


class Conversation:
    """Asks the operator of a session, and tells it what happens; ``sensors`` give the readings that it is shown."""

    sensors: SensorSet
    expectations: Expectations

    def __init__(self, operator: Operator, recorder: Recorder, recorded: RecordedSession) -> None:
        self._operator, self._recorder, self._recorded = operator, recorder, recorded
        self._answered_ns = self._minutes = 0
        self._chosen = ""
        self._attempts = ("", 0)  # the position of the last failed attempt, and how many failed in a row

    def ask(self, question: messages.Question) -> OperatorAnswer:
        """Return the answer to a question, which goes to the journal; ask again where it cannot be understood.

        Stopped: the operator quits.
        """
        while True:
            if (answer := self._heard(question, question.kind)) is None:
                self._show_reading(question)
            elif (
                answer.answer != "again"
                or not isinstance(question, messages.Review)
                or answer.position == question.position
            ):
                break
        if isinstance(question, messages.PositionQuestion):
            self._answered_ns, self._minutes = self._recorder.now_ns(), 0
            if answer.answer == "redo":
                self._count_attempt(question.position, "the program answered redo")
        return answer

    def poll(self, question: messages.Poll | messages.Settling, to: str) -> OperatorAnswer | None:
        """Return what the operator says without having to; None where that is nothing."""
        speaks = isinstance(question, messages.Poll) or self._operator.speaks_unasked
        return self._heard(question, to) if speaks else None

    def _heard(self, question: messages.Question, to: str) -> OperatorAnswer | None:
        """Return the answer of the operator, None where there is none yet; one that is not understood is refused."""
        while True:
            try:
                said = self._operator.ask(question)
                if said == {"answer": LOOK} or (
                    said is None and isinstance(question, messages.Poll | messages.Settling)
                ):
                    return None
                answer = understood(said, question.words)
                self._recorded.require_possible(answer, question.subject)
            except InputError as error:
                self.refuse(question.subject, str(error))
                continue
            if answer.answer == "quit":
                raise Stopped("the operator program answered quit")
            self.note(answer.replaced(to=to))
            return answer

    def note(self, answer: OperatorAnswer, *, chooses: bool = True) -> None:
        """Write an answer into the journal; ``again`` and ``back`` withdraw a position at once, and choose it."""
        self._recorder.record(ANSWER, plain(answer))
        if answer.answer == "back":
            self._chosen = self._recorded.accepted[-1].position.name
        elif answer.position:
            self._chosen = answer.position if chooses else ""
        self._recorded.withdraw(answer)

    @property
    def next(self) -> Position:
        """The position that is taken next: the one that the operator chose, else the first one that is open."""
        choosable = self._recorded.choosable
        return next((position for position in choosable if position.name == self._chosen), choosable[0])

    def tell(self, event: messages.SessionEvent) -> None:
        """Tell the operator what has happened."""
        self._operator.tell(event)
        if isinstance(event, messages.Accepted | messages.Matched | messages.TurnMade):
            self._attempts = ("", 0)

    def refuse(self, position: str, why: str) -> None:
        """Tell the operator that an answer, or what was set, is refused; it is asked for again."""
        self.tell(messages.Refused(position, why))
        self._count_attempt(position, why)

    def _count_attempt(self, position: str, why: str) -> None:
        """Count a failed attempt; raise Stopped at the operator's limit."""
        before, count = self._attempts
        count = count + 1 if position == before else 1
        self._attempts = (position, count)
        if count == self._operator.most_attempts:
            raise Stopped(f"{position} failed {count} times in a row, the last time because {why}")

    def _show_reading(self, question: messages.Question) -> None:
        """Take a reading that only the operator looks at."""
        why, readings = "", dict[str, messages.ShownReading]()
        up = question.up if isinstance(question, messages.PositionQuestion) else None
        try:
            readings = self._shown(self.sensors.read(fresh=True), up)
        except HardwareError as error:
            why = f"no reading: {error}"
        self.tell(messages.Look("" if up is None else question.subject, why, readings))

    def look(
        self, position: Position, sample: Sample, why: str, *, seconds: float | None = None,
        samples: tuple[int, int] | None = None,
    ) -> None:  # fmt: skip
        """Show readings while the session waits or samples, and once a minute why it takes so long.

        Beside them stand the seconds that it waits at least, or the samples taken and wanted.
        """
        if self._operator.watches:
            self.tell(messages.Look(position.name, why, self._shown(sample, position.gravity), seconds, samples))
        minutes = (self._recorder.now_ns() - self._answered_ns) // MINUTE_NS
        if minutes > self._minutes:
            self._minutes = minutes
            temperature = next((one.temperature for one in sample.values() if one.temperature is not None), None)
            passed = round((self._recorder.now_ns() - self._answered_ns) / SECOND)
            self.tell(messages.Waiting(position.name, passed, why, temperature))

    def _shown(self, sample: Sample, up: Vector | None) -> dict[str, messages.ShownReading]:
        """Return readings as the operator gets them, with guidance where a direction up is asked for."""
        return {
            serial: messages.ShownReading(
                dict(zip(self.sensors.models[serial].channels, reading.values, strict=True)),
                reading.temperature,
                SensorGuidance()
                if up is None
                else self.expectations.guidance(serial, reading.values, up, reading.temperature),
            )
            for serial, reading in sample.items()
        } | self.shown_reference(sample, up)

    def shown_reference(self, sample: Sample, up: Vector | None) -> dict[str, messages.ShownReading]:
        """Return the reading of the reference as the operator gets it, by its name; empty where there is none."""
        device, reading = self._recorded.setup.reference, sample.reference
        if device is None or reading is None:
            return {}
        guide = SensorGuidance() if up is None else tilt_guidance(sines(device, reading), device.orientation, up)
        values = dict(zip(device.wired.channels, reading.values, strict=True))
        return {device.serial: messages.ShownReading(values, None, guide)}

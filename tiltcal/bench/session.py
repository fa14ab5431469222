"""One session at the bench: ask, wait until still, sample, check, review; every input goes to the journal at once.

The calibration is made of the journal alone, at the end of a session as in a replay. A session that is resumed takes
the accepted positions from its journal and asks for the next one; the one in progress is taken again.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

from tiltcal.bench.checks import Expectations, PositionResult, ReadingSpans, at_rail, far_off, require_few, result_of
from tiltcal.bench.devices import VirtualBench, probe_devices
from tiltcal.bench.journal import RecordedSession, positions_of
from tiltcal.bench.operators import LOOK, TIP, WORDS, Operator, as_set, understood
from tiltcal.bench.playback import RecordedSample
from tiltcal.bench.sensors import Recorder, Sample, SensorSet, connected
from tiltcal.bench.settle import NEAR, Timed, Unsettled, Window, movement, wait_until_still
from tiltcal.bench.setup import SessionFiles, Setup
from tiltcal.core.attitude import Vector, normalised
from tiltcal.core.samples import ReadingStep
from tiltcal.drivers.bus.clock import session_clock
from tiltcal.drivers.model import Reading
from tiltcal.errors import HardwareError, InputError, Stopped
from tiltcal.files.journal import ANSWER, POSITION, RESUMED, Journal, JournalWriter, OperatorAnswer
from tiltcal.files.moments import moment_after, stamp
from tiltcal.files.procedure import Position
from tiltcal.files.record import plain

NUDGED = 0.002  # a change while sampling above this is a sensor that was touched, g (0.1° near level)
NUDGED_SIGMAS = 6.0
"""And it must be this many standard uncertainties: a refusal costs the operator time, a look while settling none."""

TIPPED = (0.2, 0.2, -0.2)
"""What a tip by hand adds to gravity, g: of any attitude it changes all components, of level by 14° in all."""

MINUTE_NS = 60_000_000_000  # time between two events while a chamber soaks or a reading settles, ns


class Session:
    """A setup being carried out; ``journal`` is what was captured before an interruption.

    ``accepted`` are the positions so far, ``recorded`` what the journal holds, ``leg`` the samples of a ramp's leg from
    before an interruption. The journal is ``captured`` where it has a begin, and ``finished`` where it has its end.
    """

    sensors: SensorSet
    recorder: Recorder
    writer: JournalWriter
    _operator: Operator
    _expectations: Expectations

    def __init__(self, setup: Setup, files: SessionFiles, journal: Journal | None = None) -> None:
        self.setup = setup
        self.files = files
        self.journal = journal
        self.clock = session_clock(setup.began, virtual=setup.simulated)
        self.accepted: list[PositionResult] = []
        self.recorded: RecordedSession | None = None
        self.leg: list[RecordedSample] = []
        self.captured = journal is not None
        self.finished = journal is not None and journal.end is not None
        self._virtual = VirtualBench(self.clock, setup.devices)
        self._spans = ReadingSpans(setup.sensors)
        self._steps = {device.serial: ReadingStep() for device in setup.sensors}
        """What the readings have shown of the steps that no model states."""
        self._probed: dict[str, Reading] = {}
        self._tipped = self._interrupted = False
        self._answered_ns = self._minutes = 0
        self._begun_ns = 0
        self._durations: dict[bool, list[int]] = {False: [], True: []}
        """How long positions took, ns: those without, and with a new temperature."""
        self._attempts = ("", 0)
        """The position that was last asked for in vain, and how often in a row."""
        self._soaked: float | None = None
        """The temperature that the sensors have, °C; None on the way."""

    def probe(self) -> None:
        """Check before the operator starts that every device answers; a journal that has its end needs none.

        HardwareError: a device that does not answer.
        """
        if self.finished:
            return
        clock = session_clock(self.setup.began, virtual=self.setup.simulated)
        devices = self.setup.devices
        probed = probe_devices(devices, VirtualBench(clock, devices), clock, read=True)
        self._probed = {device.serial: reading for device, reading in zip(self.setup.sensors, probed, strict=False)}

    def open(self, stack: ExitStack, operator: Operator) -> None:
        """Open the journal and the devices until the end of the stack, and tell the operator what begins."""
        setup, self._operator = self.setup, operator
        if self.journal is None:
            self.writer = JournalWriter.create(self.files.journal, setup.header())
        else:
            self.recorded = positions_of(self.journal)
            self.writer = JournalWriter.resume(self.journal)
        self.captured = True
        stack.callback(self.writer.close)
        recorded = self.recorded
        self.recorder = Recorder(self.clock, self.writer, 0 if recorded is None else recorded.playback.now_ns)
        if recorded is not None:
            self._take_over(recorded)
        opened = connected(setup.sensors, setup.thermometer, self.recorder, self._virtual)
        self.sensors = stack.enter_context(opened)
        self._spans.add(self._probed)
        self.sensors.listeners.append(self._spans.add)
        self.sensors.give_up({} if recorded is None else recorded.lost)
        self._begun_ns = self.recorder.now_ns()
        self.tell(
            "begin",
            title=setup.steps.title,
            length="" if setup.steps.rotation is not None else setup.steps.length,
            positions=[position.name for position in setup.steps.positions],
            attitudes={position.name: position.gravity for position in setup.steps.positions},
            headings=any(position.heading for position in setup.steps.positions),
            accepted=[result.position.name for result in self.accepted],
            sensors={
                sensor.serial: {
                    "model": model.name,
                    "axes": sensor.orientation.names,
                    "channels": model.channels,
                    "unit": model.unit,
                    "offset": model.offset,
                    "sensitivity": model.sensitivity,
                }
                for sensor, model in zip(self.sensors.sensors, self.sensors.models, strict=True)
            },
        )

    def _take_over(self, recorded: RecordedSession) -> None:
        """Take what was measured before the interruption; the virtual jig has taken the positions, too."""
        self.accepted, self.leg, self._tipped = recorded.accepted, recorded.leg, recorded.tipped
        self._spans = recorded.spans
        for result in self.accepted:
            self._hold(replace(result.position, temperature=result.asked))
        if self.leg:
            (reading, *_) = self.leg[-1].readings.values()
            position = self.setup.steps.positions[len(self.accepted)]
            self._hold(replace(position, temperature=reading.temperature))
        self._soaked = self.accepted[-1].asked if self.accepted else None
        self._interrupted = self._soaked is not None
        self.clock.seek(recorded.playback.now_ns)
        self.recorder.record(RESUMED)

    def attempt(self, position: Position) -> str:
        """Ask for a position, measure it, have it judged; return the last answer."""
        answer = self.ask_for(position)
        if answer.answer != "ready":
            return answer.answer
        actual = as_set(position, answer)
        if actual != position:
            self._hold(actual)
        window = self._window(position, answer.temperature)
        wait_until_still(
            self.sensors, self.recorder, window, lambda sample, why, left: self.look(actual, sample, why, seconds=left)
        )
        self._soaked = position.temperature
        first = self.recorder.line + 1
        samples, without = self._sampled(actual, thermometers=answer.temperature is None)
        last = self.recorder.line
        self.sensors.succeeded()
        result = self._result(position, actual, samples, len(without), answer.temperature)
        self._expectations.require(result)
        if len(self.accepted) == len(self.setup.steps.positions) - 1:
            self.tip(position)
        verdict = self.ask(
            {
                "ask": "review",
                "position": position.name,
                "sensors": result.values(),
                "expected": self._expectations.expected(result),
                "guidance": self._expectations.guidance_of(result),
            }
        )
        if verdict.answer == "accept":
            self.accept(result, {"lines": [first, last], **({"without": without} if without else {})})
        return verdict.answer

    def ask_for(self, position: Position, to: str = "position") -> OperatorAnswer:
        """Ask for a position; ``to`` is the question in the journal."""
        self._expectations = Expectations(self.setup, self.sensors.sensors, self.accepted)
        if position.temperature != self._soaked:
            self._soaked = None
        self._hold(position)
        names = [result.position.name for result in self.accepted]
        self.tell("progress", position=position.name, accepted=names, seconds=self._seconds_left())
        question = {
            "ask": "position",
            "position": position.name,
            "tilt": position.tilt,
            "gravity": [round(component, 9) + 0.0 for component in position.gravity],
            "heading": position.heading or 0,
            "temperature": position.temperature,
            **({} if position.stage is None else {"stage": position.stage}),
            "prompt": position.prompt,
        }
        answer = self.ask(question, to)
        self._answered_ns, self._minutes = self.recorder.now_ns(), 0
        if answer.answer == "redo" and to == "position":
            self._count_attempt(position.name, "the program answered redo")
        return answer

    def _seconds_left(self) -> float:
        """Return how long the positions that remain will take: as long as those before, or as their windows state."""
        settings = self.setup.settings
        sampling = settings.samples * max(model.interval for model in self.sensors.models)
        seconds, before = 0.0, self.accepted[-1].asked if self.accepted else None
        for position in self.setup.steps.positions[len(self.accepted) :]:
            soaks = position.temperature is not None and position.temperature != before
            taken, before = self._durations[soaks], position.temperature
            window = self._soaking(None) if soaks else Window(settings.settle)
            seconds += sum(taken) / len(taken) / 1e9 if taken else sampling + window.shortest
        return seconds

    def ask(self, question: Mapping[str, Any], to: str = "") -> OperatorAnswer:
        """Return the answer to a question, which goes to the journal; ask again where it cannot be understood.

        Stopped: the operator quits.
        """
        while (answer := self._heard(question, to or question["ask"])) is None:
            self._show_reading(question)
        return answer

    def poll(self, to: str) -> OperatorAnswer | None:
        """Return what the operator said without being asked; None where that is nothing."""
        return self._heard({"ask": "poll"}, to)

    def _heard(self, question: Mapping[str, Any], to: str) -> OperatorAnswer | None:
        """Return the answer of the operator, None where there is none yet; one that is not understood is refused."""
        while True:
            try:
                said = self._operator.ask(question)
                if said == {"answer": LOOK} or (said is None and question["ask"] == "poll"):
                    return None
                answer = understood(said, WORDS[question["ask"]])
            except InputError as error:
                self.refuse(question.get("position", "rotation"), str(error))
                continue
            if answer.answer == "quit":
                raise Stopped("the operator program answered quit")
            self.recorder.record(ANSWER, plain(answer.replaced(to=to)))
            return answer

    def tell(self, event: str, **fields: Any) -> None:
        """Tell the operator what has happened."""
        self._operator.tell({"event": event, **fields})
        if event in ("accepted", "turn"):
            self._attempts = ("", 0)

    def refuse(self, position: str, why: str) -> None:
        """Tell the operator that an answer, or what was set, is refused; it is asked for again."""
        self.tell("refused", position=position, why=why)
        self._count_attempt(position, why)

    def _count_attempt(self, position: str, why: str) -> None:
        """Count that a position was asked for in vain; Stopped where that is too often for its operator."""
        before, count = self._attempts
        count = count + 1 if position == before else 1
        self._attempts = (position, count)
        if count == self._operator.most_attempts:
            raise Stopped(f"{position} was asked for {count} times in a row in vain, the last time because {why}")

    def accept(self, result: PositionResult, samples: Mapping[str, Any]) -> None:
        """Note an accepted position and the lines of its samples, and wait until it is on the disk."""
        values = result.values()
        self.recorder.record(POSITION, {"position": result.position.name, **samples, "sensors": values})
        self.recorder.secure()
        soaked = result.asked is not None and (not self.accepted or self.accepted[-1].asked != result.asked)
        self._durations[soaked].append(self.recorder.now_ns() - self._begun_ns)
        self._begun_ns = self.recorder.now_ns()
        self.accepted.append(result)
        stated = {
            serial: {key: value for key, value in one.items() if value is not None} for serial, one in values.items()
        }
        event = {"position": result.position.name, **next(iter(stated.values()))}
        self.tell("accepted", **event, **({"sensors": stated} if len(self.setup.sensors) > 1 else {}))

    def _show_reading(self, question: Mapping[str, Any]) -> None:
        """Take a reading that only the operator looks at."""
        why, readings = "", {}
        try:
            readings = self._shown(self.sensors.read(fresh=True), question.get("gravity"))
        except HardwareError as error:
            why = f"no reading: {error}"
        self.tell("look", position=question.get("position", ""), why=why, readings=readings)

    def look(self, position: Position, sample: Sample, why: str, **progress: object) -> None:
        """Show readings while the session waits or samples, and once a minute why it takes so long.

        ``progress`` are the ``seconds`` that it waits at least, or the ``samples`` taken and wanted.
        """
        if self._operator.watches:
            readings = self._shown(sample, position.gravity)
            self.tell("look", position=position.name, why=why, readings=readings, **progress)
        minutes = (self.recorder.now_ns() - self._answered_ns) // MINUTE_NS
        if minutes > self._minutes:
            self._minutes = minutes
            temperature = next((one.temperature for one in sample if one.temperature is not None), None)
            seconds = round((self.recorder.now_ns() - self._answered_ns) / 1e9)
            self.tell("waiting", position=position.name, seconds=seconds, why=why, temperature=temperature)

    def _shown(self, sample: Sample, gravity: Vector | None) -> dict[str, dict[str, Any]]:
        """Return readings as the operator gets them, by serial number, with guidance where gravity is asked for."""
        return {
            sensor.serial: {
                "values": dict(zip(model.channels, reading.values, strict=True)),
                "temperature": reading.temperature,
                "guidance": {} if gravity is None else self._expectations.guidance(sensor, reading.values, gravity),
            }
            for sensor, model, reading in zip(self.sensors.sensors, self.sensors.models, sample, strict=True)
        }

    def now(self) -> str:
        """Return the time of the last event as a stamp."""
        return stamp(moment_after(self.setup.began, self.recorder.now_ns()))

    def _hold(self, position: Position) -> None:
        """Bring the virtual jig, where there is one, into a position."""
        if self.setup.simulated:
            ramp = self.setup.steps.ramp
            self._virtual.fixture.move(position.gravity, position.temperature, 0.0 if ramp is None else ramp.pace)

    def _window(self, position: Position, typed: float | None) -> Window:
        """Return the time over which the readings, and a temperature that is new, must hold still."""
        soaked = self._soaked
        if self._interrupted and soaked is not None and not self._still_at(soaked, typed):
            soaked = None
        self._interrupted = False
        if position.temperature is None or position.temperature == soaked:
            return Window(self.setup.settings.settle)
        self._soaked = None
        # A temperature that the operator types counts, because the thermometer may be far off.
        return self._soaking(position.temperature if typed is None else None)

    def _soaking(self, target: float | None) -> Window:
        """Return the time over which a new temperature must hold."""
        settings, soak = self.setup.settings, self.setup.steps.soak
        late = None if soak.thermometer is None else soak.thermometer * settings.soak / soak.seconds
        return Window(settings.soak, soak.drift, target, late)

    def _still_at(self, soaked: float, typed: float | None) -> bool:
        """Return whether the thermometers still read, after an interruption, about what they read before it."""
        if typed is not None:
            return True
        for serial, reading in self.sensors.by_serial(self.sensors.read(fresh=True)).items():
            before = self.accepted[-1].measurements[serial].temperature
            if (
                reading.temperature is not None
                and abs(reading.temperature - (soaked if before is None else before)) > NEAR
            ):
                return False
        return True

    def _sampled(self, position: Position, *, thermometers: bool) -> tuple[list[Timed], list[int]]:
        """Return the samples of a position, and the numbers of those far off; Unsettled where too many are."""
        sensors, wanted = self.sensors, self.setup.settings.samples
        interval = max(model.interval for model in sensors.models)
        samples: dict[int, Timed] = {}
        without: list[int] = []
        while len(samples) < wanted:
            sample = sensors.read()
            samples[len(samples) + len(without)] = (self.recorder.now_ns() / 1e9, sample)
            self.look(position, sample, f"sample {len(samples)} of {wanted}", samples=[len(samples), wanted])
            self.clock.sleep(interval)
            if len(samples) == wanted:
                numbers = list(samples)
                wrong = far_off(list(samples.values()), sensors.models, thermometers=thermometers)
                without += [numbers[place] for place in wrong]
                if wrong:
                    require_few(len(without), wanted, next(iter(wrong.values())))
                samples = {number: timed for number, timed in samples.items() if number not in without}
        return list(samples.values()), sorted(without)

    def _result(
        self, asked: Position, actual: Position, samples: list[Timed], left_out: int, typed: float | None
    ) -> PositionResult:
        """Return what the samples of a position give; Unsettled where they moved, or are at a rail."""
        sensors, models = self.sensors.sensors, self.sensors.models
        moved = movement(samples, models, still=NUDGED, sigmas=NUDGED_SIGMAS) if len(samples) > 2 else None
        if moved:
            raise Unsettled(f"moved while it was sampled: {moved}")
        for _, sample in samples:
            for reading, model in zip(sample, models, strict=True):
                if why := at_rail(reading, model):
                    raise Unsettled(why)
        readings = [self.sensors.by_serial(sample) for _, sample in samples]
        result = result_of(
            sensors, actual, asked, readings, self.now(), typed=typed, left_out=left_out, steps=self._steps
        )
        return result.with_steps(self._steps)

    def tip(self, position: Position) -> None:
        """Have the sensors tipped once where a channel that no position tilts has shown no more than two values."""
        if self._tipped or not (quiet := self._spans.quiet_channels(self.setup.steps.positions)):
            return
        names = ", ".join(f"{channel} of {serial}" for serial, channels in quiet.items() for channel in channels)
        gravity = normalised([component + by for component, by in zip(position.gravity, TIPPED, strict=True)])
        prompt = f"{names}: no change was seen. Tip it by hand, some 10° about each axis, and answer while it is."
        tip = replace(position, name=TIP, gravity=gravity, tilt=None, prompt=prompt)
        if self.ask_for(tip, TIP).answer == "ready":
            self.sensors.read(fresh=True)
        self._tipped = True

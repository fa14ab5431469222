"""One session at the bench: ask, wait until still, sample, check, review; every input goes to the journal at once.

The calibration is made of the journal alone, at the end of a session as in a replay. A session that is resumed takes
the accepted positions from its journal and asks for the next one; the one in progress is taken again.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from math import nan
from pathlib import Path
from typing import Any

from tiltcal.bench.checks import (
    Expectations,
    PositionResult,
    at_rail,
    far_off,
    require_few,
    require_no_turns,
    result_of,
)
from tiltcal.bench.devices import RECOVERY, Recorder, Sample, SensorSet, VirtualBench, connected, probe_devices
from tiltcal.bench.guidance import SensorGuidance
from tiltcal.bench.journal import RecordedSession, positions_of
from tiltcal.bench.operators import LOOK, UNASKED, WORDS, Operator, as_set, understood
from tiltcal.bench.playback import RecordedSample
from tiltcal.bench.reference import guidance_of, require_steady, set_by
from tiltcal.bench.settle import NEAR, Timed, Unsettled, Window, movement, wait_until_still
from tiltcal.bench.setup import SessionFiles, Setup
from tiltcal.core.attitude import Vector
from tiltcal.drivers.bus.clock import session_clock
from tiltcal.errors import HardwareError, InputError, SensorError, Stopped, UsageError
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.journal import ANSWER, POSITION, RESUMED, Journal, JournalWriter, OperatorAnswer, read_journal
from tiltcal.files.moments import moment_after, stamp
from tiltcal.files.procedure import Position, Ramp
from tiltcal.files.record import plain

NUDGED = 0.002  # a change while sampling above this is a sensor that was touched, g (0.1° near level)
NUDGED_SIGMAS = 6.0
"""And it must be this many standard uncertainties: a refusal costs the operator time, a look while settling none."""

CHANGE = 0.5  # °C; a ramp's temperature that changes by less within the patience of the procedure has stopped
MINUTE_NS = 60_000_000_000  # time between two events while a chamber soaks or a reading settles, ns


class Session:
    """A setup being carried out, with its journal at ``path``; ``journal`` is what was captured before an interruption.

    ``output`` takes the place of where the setup says that calibrations go.
    ``recorded`` is what the journal holds from before, of a new session nothing; ``accepted`` are the positions so far,
    ``leg`` the samples of a ramp's leg. The journal is ``captured`` where it has a begin, and ``finished`` where it has
    its end.
    """

    sensors: SensorSet
    recorded: RecordedSession
    recorder: Recorder
    writer: JournalWriter
    accepted: list[PositionResult]
    leg: list[RecordedSample]
    _operator: Operator
    _expectations: Expectations
    _soaked: float | None
    """The temperature that the sensors have, °C; None on the way."""

    def __init__(self, setup: Setup, path: Path, journal: Journal | None = None, output: Path | None = None) -> None:
        self.setup = setup
        self.files = SessionFiles(setup, path, output)
        self.journal = journal
        self.judged: Mapping[str, CalibrationRecord] = {}
        """By serial number the calibrations that a verification judges, by which its operator sees the angles."""
        self.clock = session_clock(setup.began, virtual=setup.simulated)
        self.captured = journal is not None
        self.finished = journal is not None and journal.end is not None
        self._virtual = VirtualBench(self.clock, setup.devices)
        self._answered_ns = self._minutes = 0
        self._chosen, self._alike = "", list[str]()
        self._attempts = ("", 0)
        """The position that was last asked for in vain, and how often in a row."""

    def probe(self) -> None:
        """Check before the operator starts that every device answers; a journal that has its end needs none.

        HardwareError: a device that does not answer.
        """
        if self.finished:
            return
        probe_devices(self.setup.devices, session_clock(self.setup.began, virtual=self.setup.simulated))

    def open(self, stack: ExitStack, operator: Operator) -> None:
        """Open the journal and the devices until the end of the stack, and tell the operator what begins."""
        setup, self._operator = self.setup, operator
        if self.journal is None:
            self.writer = JournalWriter.create(self.files.journal, setup.header())
            self.recorded = positions_of(read_journal(self.files.journal))
        else:
            self.recorded = positions_of(self.journal)
            self.writer = JournalWriter.resume(self.journal)
        self.captured = True
        stack.callback(self.writer.close)
        self.recorder = Recorder(self.clock, self.writer, self.recorded.playback.now_ns)
        self._go_on()
        opened = connected(setup.sensors, setup.beside, self.recorder, self._virtual)
        self.sensors = stack.enter_context(opened)
        self.sensors.give_up(self.recorded.lost)
        self.tell(
            "begin",
            title=setup.steps.title,
            length=setup.steps.length if setup.steps.positions else "",
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
                for sensor, model in (
                    *zip(self.sensors.sensors, self.sensors.models.values(), strict=True),
                    *([] if setup.reference is None else [(setup.reference, setup.reference.wired)]),
                )
            },
        )

    def _go_on(self) -> None:
        """Go on from what the journal holds; the virtual jig has taken its positions, too."""
        self.accepted, self.leg = self.recorded.accepted, self.recorded.leg
        last = self.recorded.last
        withdrawn = [] if last is None or any(result is last for result in self.accepted) else [last]
        for result in (*self.accepted, *withdrawn):
            self._hold(replace(result.position, temperature=result.asked))
        if self.leg:
            (reading, *_) = self.leg[-1].readings.values()
            self._hold(replace(self.recorded.open[0], temperature=reading.temperature))
        self._soaked = None if last is None else last.asked
        self._interrupted = self._soaked is not None
        if self.journal is not None:
            self.clock.seek(self.recorder.now_ns())
            self.recorder.record(RESUMED)

    def attempt(self, position: Position) -> None:
        """Ask for a position, measure it, and have it reviewed."""
        if isinstance(ramp := self.setup.steps, Ramp):
            self._take_leg(ramp, position)
            return
        answer = self.ask_for(position)
        if answer.answer != "ready":
            return
        asked, position = position, self._named(answer, position)
        actual = as_set(position, answer)
        if actual != asked:
            self._hold(actual)
        window = self._window(position, answer.temperature)

        def settling(sample: Sample, why: str, left: float) -> None:
            self.look(actual, sample, why, seconds=left)
            if self._operator.speaks_unasked:
                self._heard({"ask": "settling", "position": position.name}, "settling")

        wait_until_still(self.sensors, self.recorder, window, settling)
        self._soaked = position.temperature
        first = self.recorder.line + 1
        samples, without = self._sampled(actual, thermometers=answer.temperature is None)
        last = self.recorder.line
        self.sensors.succeeded()
        if self.setup.reference is not None:
            require_steady(self.setup.reference, samples)
            actual = set_by(self.setup.reference, actual, [sample for _, sample in samples])
            if self.accepted and actual.tilt == self.accepted[-1].position.tilt is not None:
                before = self.accepted[-1].position.name
                raise Unsettled(f"the reference reads to the last digit what it read in {before}: is it still read?")
        result = self._result(position, actual, samples, len(without), answer.temperature)
        self._expectations.require(result)
        verdict = self.ask(
            {
                "ask": "review",
                "position": position.name,
                "readings": {
                    serial: {
                        **one,
                        "values": one["mean"],
                        "guidance": self._expectations.guidance(
                            serial, [*one["mean"].values()], actual.gravity, one["temperature"]
                        ),
                    }
                    for serial, one in result.values().items()
                }
                | self._shown_reference(samples[-1][1], position.gravity),
            }
        )
        if verdict.answer == "accept":
            self.accept(result, {"lines": [first, last], **({"without": without} if without else {})})

    def _named(self, answer: OperatorAnswer, position: Position) -> Position:
        """Return the open position that an answer names in place of the one that was asked for."""
        return next((one for one in self.recorded.open if one.name == answer.position), position)

    def ask_for(self, position: Position) -> OperatorAnswer:
        """Ask for a position."""
        self._expectations = Expectations(
            self.setup, self.sensors.sensors, self.accepted, self.judged, self.recorded.choosable, self._alike
        )
        if position.temperature != self._soaked:
            self._soaked = None
        self._hold(position)
        names = [result.position.name for result in self.accepted]
        settings, interval = self.setup.settings, self.sensors.interval
        left = self.setup.steps.in_positions().least_seconds(
            settings.samples, interval, settings.settle, done=len(names)
        )
        self.tell("progress", position=position.name, accepted=names, seconds=left)
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
        answer = self.ask(question)
        self._answered_ns, self._minutes = self.recorder.now_ns(), 0
        if answer.answer == "redo":
            self._count_attempt(position.name, "the program answered redo")
        return answer

    def ask(self, question: Mapping[str, Any]) -> OperatorAnswer:
        """Return the answer to a question, which goes to the journal; ask again where it cannot be understood.

        Stopped: the operator quits.
        """
        while True:
            if (answer := self._heard(question, question["ask"])) is None:
                self._show_reading(question)
            elif answer.answer != "again" or question["ask"] != "review" or answer.position == question["position"]:
                return answer

    def poll(self, to: str) -> OperatorAnswer | None:
        """Return what the operator said without being asked; None where that is nothing."""
        return self._heard({"ask": "poll"}, to)

    def _heard(self, question: Mapping[str, Any], to: str) -> OperatorAnswer | None:
        """Return the answer of the operator, None where there is none yet; one that is not understood is refused."""
        while True:
            try:
                said = self._operator.ask(question)
                if said == {"answer": LOOK} or (said is None and question["ask"] in UNASKED):
                    return None
                answer = understood(said, WORDS[question["ask"]])
                self.recorded.require_possible(answer, question)
            except InputError as error:
                other = question["ask"] if self.setup.steps.positions else "rotation"
                self.refuse(question.get("position", other), str(error))
                continue
            if answer.answer == "quit":
                raise Stopped("the operator program answered quit")
            self.note(answer.replaced(to=to))
            return answer

    def note(self, answer: OperatorAnswer) -> None:
        """Write an answer into the journal; ``again`` and ``back`` withdraw a position at once."""
        self.recorder.record(ANSWER, plain(answer))
        if answer.answer == "back":
            self._chosen = self.accepted[-1].position.name
        elif answer.position:
            self._chosen = answer.position if answer.to in WORDS else ""
        self.recorded.withdraw(answer)

    @property
    def next(self) -> Position:
        """The position that is taken next: the one that the operator chose, else the first one that is open."""
        choosable = self.recorded.choosable
        return next((position for position in choosable if position.name == self._chosen), choosable[0])

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
        self.recorded.accept(result)
        stated = {
            serial: {key: value for key, value in one.items() if value is not None} for serial, one in values.items()
        }
        event = {"position": result.position.name, **next(iter(stated.values()))}
        if self.setup.reference is not None:
            event["reference"] = result.position.tilt
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
            temperature = next((one.temperature for one in sample.values() if one.temperature is not None), None)
            seconds = round((self.recorder.now_ns() - self._answered_ns) / 1e9)
            self.tell("waiting", position=position.name, seconds=seconds, why=why, temperature=temperature)

    def _shown(self, sample: Sample, gravity: Vector | None) -> dict[str, dict[str, Any]]:
        """Return readings as the operator gets them, by serial number, with guidance where gravity is asked for."""
        return {
            serial: {
                "values": dict(zip(self.sensors.models[serial].channels, reading.values, strict=True)),
                "temperature": reading.temperature,
                "guidance": SensorGuidance()
                if gravity is None
                else self._expectations.guidance(serial, reading.values, gravity, reading.temperature),
            }
            for serial, reading in sample.items()
        } | self._shown_reference(sample, gravity)

    def _shown_reference(self, sample: Sample, gravity: Vector | None) -> dict[str, dict[str, Any]]:
        """Return the reading of the reference as the operator gets it, by its name; empty where there is none."""
        device, reading = self.setup.reference, sample.reference
        if device is None or reading is None:
            return {}
        guide = SensorGuidance() if gravity is None else guidance_of(device, reading, gravity)
        values = dict(zip(device.wired.channels, reading.values, strict=True))
        return {device.serial: {"values": values, "temperature": None, "guidance": guide}}

    def now(self) -> str:
        """Return the time of the last event as a stamp."""
        return stamp(moment_after(self.setup.began, self.recorder.now_ns()))

    def _hold(self, position: Position) -> None:
        """Bring the virtual jig, where there is one, into a position."""
        if self.setup.simulated:
            pace = ramp.pace if isinstance(ramp := self.setup.steps, Ramp) else 0.0
            self._virtual.fixture.move(position.gravity, position.temperature, pace)

    def _window(self, position: Position, typed: float | None) -> Window:
        """Return the time over which the readings, and a temperature that is new, must hold still."""
        soaked = self._soaked
        if self._interrupted and soaked is not None and not self._still_at(soaked, typed):
            soaked = None
        self._interrupted = False
        if position.temperature is None or position.temperature == soaked:
            return Window(self.setup.settings.settle)
        self._soaked = None
        settings, soak = self.setup.settings, self.setup.steps.in_positions().soak
        late = None if soak.thermometer is None else soak.thermometer * settings.soak / soak.seconds
        # A temperature that the operator types counts, because the thermometer may be far off.
        return Window(settings.soak, soak.drift, position.temperature if typed is None else None, late)

    def _still_at(self, soaked: float, typed: float | None) -> bool:
        """Return whether the thermometers still read, after an interruption, about what they read before it."""
        if typed is not None:
            return True
        for serial, reading in self.sensors.read(fresh=True).items():
            before = None if self.recorded.last is None else self.recorded.last.measurements[serial].temperature
            if (
                reading.temperature is not None
                and abs(reading.temperature - (soaked if before is None else before)) > NEAR
            ):
                return False
        return True

    def _sampled(self, position: Position, *, thermometers: bool) -> tuple[list[Timed], list[int]]:
        """Return the samples of a position, and the numbers of those far off; Unsettled where too many are."""
        sensors, wanted = self.sensors, self.setup.settings.samples
        samples: dict[int, Timed] = {}
        without: list[int] = []
        while len(samples) < wanted:
            sample = sensors.read()
            samples[len(samples) + len(without)] = (self.recorder.now_ns() / 1e9, sample)
            self.look(position, sample, f"sample {len(samples)} of {wanted}", samples=[len(samples), wanted])
            self.clock.sleep(sensors.interval)
            if len(samples) == wanted:
                numbers = list(samples)
                wrong = far_off([one for _, one in samples.values()], sensors.models, thermometers=thermometers)
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
            for serial, model in models.items():
                if why := at_rail(sample[serial], model):
                    raise Unsettled(why)
        readings = [sample for _, sample in samples]
        require_no_turns(readings, models)
        result = result_of(
            sensors, actual, asked, readings, self.now(), typed=typed, left_out=left_out,
            takes=self.recorded.takes(asked.name), steps=self.recorded.steps,
        )  # fmt: skip
        return result.with_steps(self.recorded.steps)

    def _take_leg(self, ramp: Ramp, position: Position) -> None:
        """Ask for a turning point of a ramp, and sample without a break until it is reached.

        The operator answers at once: what counts is the way there.
        """
        answer = self.ask_for(position)
        if answer.answer != "ready":
            raise Unsettled(ramp.once)
        # A temperature that is typed is that of one moment; the thermometer is read all the time.
        actual = replace(as_set(position, answer), temperature=position.temperature)
        if self.accepted and actual.gravity != self.accepted[0].position.gravity:
            raise Unsettled("a ramp has one attitude: leave the sensor as it lies")
        first = self.leg[0].line if self.leg else self.recorder.line + 1
        samples = [*(one.readings for one in self.leg), *self._sampled_on_the_way(ramp, position)]
        last = self.recorder.line
        for sensor in self.sensors.sensors:
            railed = [why for sample in samples if (why := at_rail(sample[sensor.serial], sensor.wired))]
            if railed:
                require_few(len(railed), len(samples), railed[-1])
        result = result_of(self.sensors.sensors, actual, position, samples, self.now())
        self.leg = []
        self.accept(result, {"lines": [first, last]})

    def _sampled_on_the_way(self, ramp: Ramp, position: Position) -> list[Sample]:
        """Sample until the temperature of a position is reached, or changes no more; SensorError as in a position."""
        samples: list[Sample] = []
        wanted, since, before = position.temperature or 0.0, 0, nan
        while True:
            try:
                samples.append(self.sensors.read(fresh=True))
            except SensorError as error:
                self.sensors.failed(error, needed=True)
                self.clock.sleep(RECOVERY)
                continue
            self.sensors.succeeded()
            now_ns, temperature = self.recorder.now_ns(), next(iter(samples[-1].values())).temperature
            if temperature is None:
                raise UsageError(
                    "a ramp needs a thermometer that is read: the sensor reports no temperature, and the bench has none"
                )
            if abs(temperature - wanted) <= ramp.within and len(samples) > 1:
                return samples
            if not abs(temperature - before) < CHANGE:
                since, before = now_ns, temperature
            elif now_ns - since > ramp.patience * 1e9:
                return samples
            self.look(position, samples[-1], f"at {temperature:.1f} °C, on the way to {wanted:g} °C")
            self.clock.sleep(ramp.interval)

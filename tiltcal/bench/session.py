"""One session at the bench: ask, wait until still, sample, check, review; every input goes to the journal at once.

The calibration is made of the journal alone, at the end of a session as in a replay. A session that is resumed takes
the accepted positions from its journal and asks for the next one; the one in progress is taken again.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from tiltcal.bench import messages
from tiltcal.bench.checks import Expectations, far_off, require_few, require_no_turns
from tiltcal.bench.conversation import Conversation
from tiltcal.bench.devices import Recorder, SensorSet, VirtualBench, connected, probe_devices
from tiltcal.bench.guidance import SensorGuidance
from tiltcal.bench.operators import Operator
from tiltcal.bench.reference import require_steady
from tiltcal.bench.settle import NEAR, Unsettled, Window, movement, row_of, wait_until_still
from tiltcal.drivers.bus.clock import SECOND, session_clock
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.procedure import Position, Ramp
from tiltcal.files.record import plain
from tiltcal.journal.header import Setup
from tiltcal.journal.lines import POSITION, RESUMED, Journal, JournalWriter, OperatorAnswer
from tiltcal.journal.outputs import SessionFiles
from tiltcal.journal.playback import Sample
from tiltcal.journal.positions import PositionResult, as_set, at_rail, result_of
from tiltcal.journal.reference import set_by
from tiltcal.journal.session import RecordedSession
from tiltcal.printable import in_minutes

NUDGED = 0.002  # a change while sampling above this is a sensor that was touched, g (0.1° near level)
NUDGED_SIGMAS = 6.0
"""And it must be this many standard uncertainties: a refusal costs the operator time, a look while settling none."""


class Session:
    """A setup being carried out, with its journal at ``path``, which held ``before`` what an interruption left.

    ``output`` takes the place of where the setup says that calibrations go. ``recorded`` is what the journal holds,
    which is ``captured`` where it has a begin, and ``finished`` where it has its end.
    """

    sensors: SensorSet
    recorded: RecordedSession
    recorder: Recorder
    writer: JournalWriter
    talk: Conversation
    _soaked: float | None  # the temperature that the sensors have, °C; None on the way

    def __init__(
        self, setup: Setup, path: Path, before: RecordedSession | None = None, output: Path | None = None
    ) -> None:
        self.setup = setup
        self.files = SessionFiles(setup, path, output)
        self.before = before
        if before is not None:
            self.recorded = before
        self.judged: Mapping[str, CalibrationRecord] = {}
        """By serial number the calibrations that a verification judges, by which its operator sees the angles."""
        self.clock = session_clock(setup.began, virtual=setup.simulated)
        self.captured = before is not None
        self.finished = before is not None and before.journal.ended
        self._virtual = VirtualBench(self.clock, setup.devices)
        self._alike: list[str] = []
        self._asked = ("", 0)  # the position that is asked for, and since when, ns
        self._moves: list[float] = []  # how long each position of this run took the person and the move, seconds

    def probe(self) -> None:
        """Check before the operator starts that every device answers; a journal that has its end needs none.

        HardwareError: a device that does not answer.
        """
        if self.finished:
            return
        probe_devices(self.setup.devices, session_clock(self.setup.began, virtual=self.setup.simulated))

    def open(self, stack: ExitStack, operator: Operator) -> None:
        """Open the journal and the devices until the end of the stack, and tell the operator what begins."""
        setup = self.setup
        if self.before is None:
            self.writer = JournalWriter.create(self.files.journal, plain(setup))
            self.recorded = RecordedSession(Journal(self.files.journal), setup)
        else:
            self.writer = JournalWriter.resume(self.recorded.journal)
        self.captured = True
        stack.callback(self.writer.close)
        self.recorder = Recorder(self.clock, self.writer, self.recorded.playback.now_ns)
        self._go_on()
        opened = connected(setup.sensors, setup.beside, self.recorder, self._virtual)
        self.sensors = stack.enter_context(opened)
        self.talk = Conversation(operator, self.recorder, self.recorded)
        self.talk.sensors = self.sensors
        self.sensors.give_up(self.recorded.lost)
        seen = [*self.sensors.sensors, *filter(None, (setup.reference,))]
        self.talk.tell(
            messages.Begin(
                title=setup.steps.title,
                length=setup.steps.length if setup.steps.positions else "",
                positions=[position.name for position in setup.steps.positions],
                attitudes={position.name: position.gravity for position in setup.steps.positions},
                free=setup.steps.free,
                headings=any(position.heading for position in setup.steps.positions),
                accepted=[result.position.name for result in self.recorded.accepted],
                sensors={
                    one.serial: messages.ShownSensor(one.wired.unit, one.wired.offset, one.wired.sensitivity)
                    for one in seen
                },
            )
        )

    def _go_on(self) -> None:
        """Go on from what the journal holds; the virtual jig has taken its positions, too."""
        last = self.recorded.last
        withdrawn = [] if last is None or any(result is last for result in self.recorded.accepted) else [last]
        for result in (*self.recorded.accepted, *withdrawn):
            self._hold(replace(result.position, temperature=result.asked))
        if self.recorded.leg:
            (reading, *_) = self.recorded.leg[-1].values()
            self._hold(replace(self.recorded.open[0], temperature=reading.temperature))
        self._soaked = None if last is None else last.asked
        self._interrupted = self._soaked is not None
        if self.before is not None:
            self.clock.seek(self.recorder.now_ns())
            self.recorder.record(RESUMED)

    def attempt(self, position: Position) -> None:
        """Ask for a position, measure it, and have it reviewed."""
        answer = self.ask_for(position)
        if answer.answer != "ready":
            return
        asked, position = position, next((one for one in self.recorded.open if one.name == answer.position), position)
        actual = as_set(position, answer)
        if actual != asked:
            self._hold(actual)
        window = self._window(position, answer.temperature)

        def settling(sample: Sample, why: str, left: float) -> None:
            self.talk.look(actual, sample, why, seconds=left)
            self.talk.poll(messages.Settling(position.name), "settling")

        wait_until_still(self.sensors, self.recorder, window, settling)
        self._soaked = position.temperature
        first = self.recorder.line + 1
        samples, without = self._sampled(actual, thermometers=answer.temperature is None)
        last = self.recorder.line
        self.sensors.succeeded()
        if self.setup.reference is not None:
            require_steady(self.setup.reference, samples)
            actual = set_by(self.setup.reference, actual, samples)
            if self.recorded.accepted and actual.tilt == self.recorded.accepted[-1].position.tilt is not None:
                before = self.recorded.accepted[-1].position.name
                raise Unsettled(f"the reference reads to the last digit what it read in {before}: is it still read?")
        result = self._result(position, actual, samples, len(without), answer.temperature)
        self.talk.expectations.require(result)
        readings = {
            serial: messages.ShownReading(
                one["mean"],
                one["temperature"],
                self.talk.expectations.guidance(serial, [*one["mean"].values()], actual.gravity, one["temperature"]),
                one["std"],
                one["n"],
            )
            for serial, one in result.values().items()
        }
        verdict = self.talk.ask(
            messages.Review(position.name, readings | self.talk.shown_reference(samples[-1], position.gravity))
        )
        if verdict.answer == "accept":
            guides = {serial: reading.guidance for serial, reading in readings.items()}
            self.accept(result, {"lines": [first, last], **({"without": without} if without else {})}, guides)

    def ask_for(self, position: Position) -> OperatorAnswer:
        """Ask for a position."""
        self.talk.expectations = Expectations(
            self.setup, self.sensors.sensors, self.recorded.accepted, self.judged, self.recorded.choosable, self._alike
        )
        if position.temperature != self._soaked:
            self._soaked = None
        self._hold(position)
        names = [result.position.name for result in self.recorded.accepted]
        if position.name != self._asked[0]:
            self._asked = (position.name, self.recorder.now_ns())
        self.talk.tell(messages.Progress(position.name, names, self._left()))
        return self.talk.ask(
            messages.PositionQuestion(
                position=position.name,
                tilt=position.tilt,
                gravity=[round(component, 9) + 0.0 for component in position.gravity],
                heading=position.heading or 0,
                temperature=position.temperature,
                stage=position.stage,
                prompt=position.prompt,
            )
        )

    def _left(self) -> str:
        """Return in words how long the rest takes, by the positions of this run; before the first what it must."""
        done = len(self.recorded.accepted)
        still = self._least(done) + (median(self._moves) if self._moves else 0.0) * (
            len(self.setup.steps.positions) - done
        )
        return f"{'about' if self._moves else 'at least'} {in_minutes(still)} left"

    def _least(self, done: int) -> float:
        """Return how long the positions behind so many must hold still and are sampled, seconds."""
        steps, settings = self.setup.steps.in_positions(), self.setup.settings
        return steps.least_seconds(settings.samples, self.sensors.interval, settings.settle, done=done)

    def accept(
        self, result: PositionResult, samples: Mapping[str, Any], guides: Mapping[str, SensorGuidance] | None = None
    ) -> None:
        """Note an accepted position and the lines of its samples, and wait until it is on the disk."""
        values = result.values()
        self.recorder.record(POSITION, {"position": result.position.name, **samples, "sensors": values})
        self.recorder.secure()
        done = len(self.recorded.accepted)
        took = (self.recorder.now_ns() - self._asked[1]) / SECOND
        self._moves.append(max(0.0, took - self._least(done) + self._least(done + 1)))
        self.recorded.accept(result)
        offs = {serial: guide.off for serial, guide in (guides or {}).items()}
        sensors = {serial: messages.Measured(**one, off=offs.get(serial)) for serial, one in values.items()}
        several = sensors if len(self.setup.sensors) > 1 else {}
        reference = None if self.setup.reference is None else result.position.tilt
        serial, first = next(iter(values.items()))
        off = offs.get(serial)
        self.talk.tell(
            messages.Accepted(position=result.position.name, **first, off=off, reference=reference, sensors=several)
        )

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

    def _sampled(self, position: Position, *, thermometers: bool) -> tuple[list[Sample], list[int]]:
        """Return the samples of a position, and the numbers of those far off; Unsettled where too many are."""
        sensors, wanted = self.sensors, self.setup.settings.samples
        samples: dict[int, Sample] = {}
        without: list[int] = []
        while len(samples) < wanted:
            sample = sensors.read()
            sample.now_ns = self.recorder.now_ns()
            samples[len(samples) + len(without)] = sample
            self.talk.look(position, sample, f"sample {len(samples)} of {wanted}", samples=(len(samples), wanted))
            self.clock.sleep(sensors.interval)
            if len(samples) == wanted:
                numbers = list(samples)
                wrong = far_off([*samples.values()], sensors.models, thermometers=thermometers)
                without += [numbers[place] for place in wrong]
                if wrong:
                    require_few(len(without), wanted, next(iter(wrong.values())))
                samples = {number: one for number, one in samples.items() if number not in without}
        return list(samples.values()), sorted(without)

    def _result(
        self, asked: Position, actual: Position, samples: list[Sample], left_out: int, typed: float | None
    ) -> PositionResult:
        """Return what the samples of a position give; Unsettled where they moved, or are at a rail."""
        sensors, models = self.sensors.sensors, self.sensors.models
        rows = np.array([row_of(sample, models) for sample in samples])
        moved = movement(rows, models, still=NUDGED, sigmas=NUDGED_SIGMAS) if len(samples) > 2 else None
        if moved:
            raise Unsettled(f"moved while it was sampled: {moved}")
        for sample in samples:
            for serial, model in models.items():
                if why := at_rail(sample[serial], model):
                    raise Unsettled(why)
        require_no_turns(samples, models)
        result = result_of(
            sensors, actual, asked, samples, self.setup.stamp_after(self.recorder.now_ns()), typed=typed,
            left_out=left_out, takes=self.recorded.takes(asked.name), steps=self.recorded.reading_steps,
        )  # fmt: skip
        return result.with_steps(self.recorded.reading_steps)

"""The runner of positions: takes the sensors through a procedure, one position after the other.

Per position: instruct, wait until still, sample, compare with what is expected, accept or refuse. Every reading and
every answer comes from the event log, so a session that is replayed runs exactly as it ran.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from tiltcal.bench.event_log import EventLog, RecordedClock, SessionState
from tiltcal.bench.operators.operator import OperatorAnswer, PositionOperator
from tiltcal.bench.position_result import PositionResult
from tiltcal.bench.sample_checks import (
    ReadingSpans,
    far_off,
    require_few,
    require_not_stuck,
    require_off_rails,
    require_plausible_temperature,
)
from tiltcal.bench.sensor_set import RECOVERY, ConnectedSensor, Sample, SensorSet
from tiltcal.bench.session_plan import SessionPlan
from tiltcal.bench.settle import Timed, Unsettled, Window, movement, wait_until_still
from tiltcal.calibration import level
from tiltcal.calibration.measurement import Measurement, missing_temperature
from tiltcal.core.attitude import normalised
from tiltcal.core.detection import TILTED
from tiltcal.core.plausibility import ExpectedReadings
from tiltcal.core.quantisation import ReadingStep
from tiltcal.core.ramp.record import RampRecord
from tiltcal.core.samples import summarise
from tiltcal.drivers.model import Reading
from tiltcal.drivers.virtual import Fixture
from tiltcal.errors import HardwareError, InputError, JournalError, SensorError
from tiltcal.files.moments import moment_after, stamp
from tiltcal.files.procedure import Position

NUDGED = 0.002
"""A change while sampling above this is a sensor that was touched, g (0.1° near level)."""

NUDGED_SIGMAS = 6.0
"""And it must be this many standard uncertainties: a refusal costs the operator time, a look while settling none."""

TIP = "tip"
"""The question whether a reading follows, and the position that is asked for."""

TIPPED = (0.2, 0.2, -0.2)
"""What a tip by hand adds to gravity, g: of any attitude it changes all components, of level by 14° in all."""

FIRST = "this is the first position: there is none before it to go back to"


class PositionRunner:
    """Carries out the positions of a plan.

    Parameters
    ----------
    spans : ReadingSpans
        What was read before.
    fixture : Fixture or None
        The virtual jig, where the sensors are virtual.

    Attributes
    ----------
    unseen : mapping of str to sequence of str
        By serial number, the channels that did not follow when the operator was asked to tip the sensors.
    """

    def __init__(
        self,
        plan: SessionPlan,
        sensors: SensorSet,
        operator: PositionOperator,
        log: EventLog,
        clock: RecordedClock,
        spans: ReadingSpans,
        fixture: Fixture | None = None,
    ) -> None:
        self._plan = plan
        self._procedure = plan.procedure
        self._settings = plan.settings
        self._sensors = sensors
        self._operator = operator
        self._log = log
        self._clock = clock
        self._fixture = fixture
        self._steps = {sensor.serial: ReadingStep() for sensor in sensors.sensors}
        """What the readings have shown of the steps that no model states."""
        self._spans = spans
        sensors.listen(spans.add)
        self._tipped = False
        self.unseen: Mapping[str, Sequence[str]] = {}
        self._answered_ns = 0
        self._soaked: tuple[float, int] | None = None
        """The temperature that the sensors have, and the interruptions before they took it; None on the way."""

    @property
    def records(self) -> Mapping[str, RampRecord]:
        """The continuous record of each sensor, by serial number, where the procedure is a ramp."""
        return {}

    def run(self) -> list[PositionResult]:
        """Return every position of the procedure, accepted, in its order.

        Stopped: the operator quit.
        HardwareError: the hardware failed several times in a row, and no other sensor remains.
        JournalError: the journal does not fit, or a replay ends before the procedure does.
        """
        positions = self._procedure.positions
        accepted: list[PositionResult] = []
        models = {sensor.serial: sensor.model for sensor in self._sensors.sensors}
        self._operator.begin(self._procedure, models)
        while len(accepted) < len(positions):
            position = positions[len(accepted)]
            try:
                verdict = self._attempt(position, accepted)
            except JournalError:
                raise
            except (Unsettled, InputError, HardwareError) as error:
                self._refuse(position, error)
                continue
            if isinstance(verdict, PositionResult):
                accepted.append(verdict)
            elif verdict == "back" and accepted:
                accepted.pop()
            elif verdict == "back":
                self._refuse(position, InputError(FIRST))
        return [result.with_steps(self._steps) for result in accepted]

    def _attempt(self, position: Position, accepted: Sequence[PositionResult]) -> PositionResult | str:
        """Ask for a position, measure it, have it judged; return it, or the answer ``redo`` or ``back``."""
        log, operator = self._log, self._operator
        answer = self._asked(position, len(accepted) + 1)
        if answer.word != "ready":
            return answer.word
        actual = answer.as_set(position)
        if actual != position:
            self._hold(actual)
        look = partial(self._look, position)
        self._settle(position, answer.temperature, look)
        held, left_out = self._sampled(look, thermometers=answer.temperature is None)
        self._sensors.succeeded()
        expectations = self._expectations(accepted)
        result = self._result(actual, held, left_out, answer.temperature, expectations)
        result = replace(result, asked=position.temperature)
        self._check(result, accepted, expectations)
        if len(accepted) == len(self._procedure.positions) - 1:
            self._tip(position)
        verdict = log.ask("review", operator.review, result)
        if verdict.word != "accept":
            return verdict.word
        log.position(result.record())
        log.report(operator.accepted, result)
        return result

    def _asked(self, position: Position, number: int, question: str = "position") -> OperatorAnswer:
        """Ask for a position; the readings that the operator looks at meanwhile are taken again in a replay."""
        if self._soaked is not None and position.temperature != self._soaked[0]:
            self._soaked = None
        self._hold(position)
        while self._log.plays_live_reading():
            with suppress(HardwareError):
                self._sensors.read(fresh=True)
        answer = self._log.ask(question, self._operator.position, position, number, self._live)
        self._answered_ns = self._log.now_ns()
        return answer

    def _refuse(self, position: Position, error: Exception) -> None:
        log, sensors = self._log, self._sensors
        if isinstance(error, SensorError):
            sensors.failed(error, live=log.state is SessionState.LIVE)
        log.report(self._operator.refused, position, str(error))
        if isinstance(error, SensorError) and error.serial in sensors.lost:
            log.report(self._operator.lost, error.serial, sensors.lost[error.serial])
        if isinstance(error, HardwareError):
            self._clock.sleep(RECOVERY)

    def _hold(self, position: Position) -> None:
        if self._fixture is not None:
            self._fixture.move(position.gravity, position.temperature)

    def _live(self) -> Mapping[str, Reading]:
        """Take a reading that only the operator looks at."""
        self._log.live_reading()
        return self._sensors.by_serial(self._sensors.read(fresh=True))

    def _look(self, position: Position, sample: Sample, why: str) -> None:
        seconds = (self._log.now_ns() - self._answered_ns) / 1e9
        self._log.report(self._operator.look, position, self._sensors.by_serial(sample), why, seconds)

    def _settle(self, position: Position, typed: float | None, look: Callable[[Sample, str], None]) -> None:
        """Wait until the readings hold still, and the temperature too, where the sensors do not have it already."""
        reached = None if position.temperature is None else (position.temperature, self._log.interruptions)
        if reached is None or reached == self._soaked:
            window = Window(self._settings.settle)
        else:
            # A temperature that the operator types counts, because the thermometer may be far off.
            target = position.temperature if typed is None else None
            soak, seconds = self._procedure.soak, self._settings.soak
            late = None if soak.thermometer is None else soak.thermometer * seconds / soak.seconds
            window = Window(seconds, soak.drift, target, late)
            self._soaked = None
        wait_until_still(self._sensors, self._clock, window, look)
        self._soaked = reached

    def _sampled(self, look: Callable[[Sample, str], None], *, thermometers: bool) -> tuple[list[Timed], int]:
        """Return the samples of a position, and how many far off were taken again; Unsettled where too many."""
        held: list[Timed] = []
        left_out, wanted = 0, self._settings.samples
        while True:
            while len(held) < wanted:
                sample = self._sensors.read()
                held.append((self._clock.now_ns() / 1e9, sample))
                look(sample, f"sample {len(held)} of {wanted}")
                self._clock.sleep(max(model.interval for model in self._sensors.models))
            wrong = far_off(held, self._sensors.models, thermometers=thermometers)
            if not wrong:
                return held, left_out
            left_out += len(wrong)
            require_few(left_out, wanted, next(iter(wrong.values())))
            held = [reading for number, reading in enumerate(held) if number not in wrong]

    def _result(
        self,
        position: Position,
        held: Sequence[Timed],
        left_out: int,
        typed: float | None,
        expectations: Mapping[str, ExpectedReadings],
    ) -> PositionResult:
        """Return what the samples of a position give; Unsettled where they moved, or are at a rail."""
        moved = movement(held, self._sensors.models, still=NUDGED, sigmas=NUDGED_SIGMAS) if len(held) > 2 else None
        if moved:
            raise Unsettled(f"moved while it was sampled: {moved}")
        measurements, expected = {}, {}
        when = {"time": self._now(), **({"left_out": left_out} if left_out else {})}
        for index, sensor in enumerate(self._sensors.sensors):
            readings = [sample[index] for _, sample in held]
            require_off_rails(readings, sensor.model)
            if not sensor.model.resolution:
                samples = np.array([reading.values for reading in readings]).T
                self._steps[sensor.serial].add(samples, min(reading.step for reading in readings))
            measurements[sensor.serial] = measurement_of(sensor, position, readings, when, typed)
            gravity = measurements[sensor.serial].gravity
            predicted = sensor.model.scaled and not self._procedure.determines.free and not self._mounted
            expected[sensor.serial] = expectations[sensor.serial].expected(gravity) if predicted else {}
        return PositionResult(position, measurements, typed is not None, expected, left_out).with_steps(self._steps)

    def _now(self) -> str:
        """Return the time of the session as a stamp."""
        return stamp(moment_after(self._plan.started, self._log.now_ns()))

    def _check(
        self, result: PositionResult, accepted: Sequence[PositionResult], expectations: Mapping[str, ExpectedReadings]
    ) -> None:
        """Raise Unsettled where the temperature is absurd, a sensor is stuck, or it is another position."""
        require_plausible_temperature(result, accepted)
        determines = self._procedure.determines
        if determines.level or determines.mounting:
            objection = level.objection if determines.level else missing_temperature
            for serial, measurement in result.measurements.items():
                why = objection(self._plan.bases[serial].calibration, measurement)
                if why:
                    raise Unsettled(why)
        for sensor in self._sensors.sensors:
            require_not_stuck(sensor, result, accepted)
        self._require_plausible(result, expectations, accepted)
        if self._log.next_question() == "position":
            raise Unsettled("an earlier version had this position measured again")

    def _tip(self, position: Position) -> None:
        """Have the sensors tipped once where a channel that no position tilts has shown no more than two values.

        That is the normal state of a good sensor without noise, and of a dead converter. In a replay the journal says
        whether it was asked; those of earlier versions have no such question.
        """
        if self._tipped or self._log.next_question() not in (None, TIP) or not (quiet := self._quiet()):
            return
        names = ", ".join(f"{channel} of {serial}" for serial, channels in quiet.items() for channel in channels)
        gravity = normalised([component + by for component, by in zip(position.gravity, TIPPED, strict=True)])
        prompt = f"{names}: no change was seen. Tip it by hand, some 10° about each axis, and answer while it is."
        tip = replace(position, name=TIP, gravity=gravity, tilt=None, prompt=prompt)
        answer = self._asked(tip, len(self._procedure.positions), TIP)
        if answer.word == "ready":
            self._sensors.read(fresh=True)
        self._tipped = True
        self.unseen = self._quiet()

    def _quiet(self) -> dict[str, list[str]]:
        """Return the channels that no position tilts and that have shown no more than two values, by serial number."""
        quiet: dict[str, list[str]] = {}
        for sensor in self._sensors.sensors:
            seen = np.array([sensor.orientation.seen(one.gravity) for one in self._procedure.positions])
            flat = [channel for channel, by in zip("xyz", np.ptp(seen, axis=0), strict=True) if by <= TILTED]
            channels = [channel for channel in self._spans.quiet(sensor.serial) if channel in flat]
            quiet |= {sensor.serial: channels} if channels else {}
        return quiet

    def _expectations(self, accepted: Sequence[PositionResult]) -> dict[str, ExpectedReadings]:
        """Return what predicts each sensor's readings: its model and the positions accepted so far."""
        expectations = {}
        for sensor in self._sensors.sensors:
            model = sensor.model
            expectations[sensor.serial] = expectation = ExpectedReadings(
                model.channels, model.offset, model.sensitivity, model.offset_spread, model.sensitivity_spread
            )
            for result in accepted:
                before = result.measurements[sensor.serial]
                expectation.learn(before.gravity, result.mean(sensor.serial), before.temperature)
        return expectations

    def _require_plausible(
        self, result: PositionResult, expectations: Mapping[str, ExpectedReadings], accepted: Sequence[PositionResult]
    ) -> None:
        """Refuse a position that a sensor sees as another one."""
        determines = self._procedure.determines
        if determines.mounting or self._mounted:
            return
        if determines.free:
            self._require_new(result, expectations, accepted)
            return
        positions = {position.name: position.gravity for position in self._procedure.positions}
        positions |= {measured.position.name: measured.position.gravity for measured in (*accepted, result)}
        for sensor in self._sensors.sensors:
            if not sensor.model.scaled:
                continue
            seen = {name: sensor.orientation.seen(gravity) for name, gravity in positions.items()}
            temperature = result.measurements[sensor.serial].temperature
            why = expectations[sensor.serial].objection(
                result.position.name, seen, result.mean(sensor.serial), temperature
            )
            if why:
                raise Unsettled(why if len(self._plan.sensors) == 1 else f"{sensor.serial}: {why}")

    @property
    def _mounted(self) -> bool:
        """Whether the positions are those of an application in which a sensor sits in a way of its own."""
        return any(base.calibration.coefficients.mounting is not None for base in self._plan.bases.values())

    def _require_new(
        self, result: PositionResult, expectations: Mapping[str, ExpectedReadings], accepted: Sequence[PositionResult]
    ) -> None:
        """Refuse an attitude that is there already, as a sensor of three axes sees it."""
        for sensor in self._sensors.sensors:
            if sensor.model.scaled and len(sensor.model.channels) == 3:
                before = {one.position.name: one.mean(sensor.serial) for one in accepted}
                why = expectations[sensor.serial].repeated(before, result.mean(sensor.serial))
                if why:
                    raise Unsettled(why)


def measurement_of(
    sensor: ConnectedSensor,
    position: Position,
    readings: Sequence[Reading],
    when: Mapping[str, Any],
    typed: float | None = None,
) -> Measurement:
    """Return one sensor's samples of a position as the estimator takes them, in the sensor's own frame.

    The temperature is the one that was typed, else the mean of the thermometer, else the one that was asked for.
    """
    temperature = position.temperature if typed is None else typed
    measured = [reading.temperature for reading in readings if reading.temperature is not None]
    if typed is None and measured:
        temperature = summarise(measured).mean
    return Measurement(
        position.name,
        sensor.orientation.seen(position.gravity),
        position.tilt if sensor.orientation.straight else None,
        temperature,
        {
            channel: summarise([reading.values[place] for reading in readings], sensor.model.resolution)
            for place, channel in enumerate(sensor.model.channels)
        },
        when,
        heading=position.heading,
        stage=position.stage,
    )

"""The runner: takes the sensors through the positions of a procedure, one by one.

Per position: instruct, wait until still, sample, compare with what is expected, accept or refuse. Whatever it learns
comes from the tape, so a session that is replayed runs exactly as it ran.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from tiltcal.bench.event_log import EventLog, RecordedClock, Resumed
from tiltcal.bench.operators.answer import OperatorAnswer
from tiltcal.bench.operators.operator import MeasuredPosition, Operator
from tiltcal.bench.recorded_operator import RecordedOperator
from tiltcal.bench.sensor_set import ConnectedSensor, Sample, SensorSet
from tiltcal.bench.settle import Unsettled, Window, movement, wait_until_still
from tiltcal.core.frames import gravity_from_tilt, normalised
from tiltcal.core.model import Array
from tiltcal.core.plausibility import ExpectedReadings
from tiltcal.core.statistics import SampleSummary, summarise
from tiltcal.drivers.device import Model, Reading
from tiltcal.drivers.twin.fixture import Fixture
from tiltcal.errors import HardwareError, InputError, JournalError, SensorError
from tiltcal.files.procedure import Position, Procedure

RECOVERY = 1.0
"""Seconds that a bus is left alone after an error."""

NUDGED = 0.002
"""A change while sampling above this is a sensor that was touched, g (0.1° near level)."""

NUDGED_SIGMAS = 6.0
"""And it must be this many standard uncertainties: a refusal costs the operator time, a look while settling none."""


@dataclass(frozen=True)
class SessionSettings:
    """What the command line may change of a procedure.

    Attributes
    ----------
    samples : int
        Per position.
    settle, soak : float
        Windows over which reading, and temperature, must hold still, seconds.
    """

    samples: int
    settle: float
    soak: float


@dataclass(frozen=True)
class PositionResult:
    """An accepted position.

    Attributes
    ----------
    position : Position
        As it was actually set.
    time_ns : int
        When its last sample was taken, since the session began.
    summaries : mapping of str to dict of str to SampleSummary
        Per serial number and channel.
    temperatures : mapping of str to float or None
        Per serial number, °C.
    typed : bool
        Whether the operator typed the temperature.
    """

    position: Position
    time_ns: int
    summaries: Mapping[str, dict[str, SampleSummary]]
    temperatures: Mapping[str, float | None]
    typed: bool = False

    def mean(self, serial: str) -> Array:
        """Mean reading of each channel of a sensor, in its unit."""
        return np.array([summary.mean for summary in self.summaries[serial].values()])


class PositionRunner:
    """One session's walk through a procedure.

    Parameters
    ----------
    procedure : Procedure
    rack : SensorSet
    operator : Operator
    tape : EventLog
    clock : RecordedClock
    settings : SessionSettings
    fixture : Fixture or None
        The virtual jig, where the sensors are virtual.
    """

    def __init__(
        self,
        procedure: Procedure,
        rack: SensorSet,
        operator: Operator,
        tape: EventLog,
        clock: RecordedClock,
        settings: SessionSettings,
        fixture: Fixture | None = None,
    ) -> None:
        self._procedure = procedure
        self._rack = rack
        self._operator = operator
        self._desk = RecordedOperator(tape)
        self._tape = tape
        self._clock = clock
        self._settings = settings
        self._fixture = fixture

    def run(self) -> list[PositionResult]:
        """Every position of the procedure, accepted, in its order.

        Raises
        ------
        Stopped
            The operator quit.
        HardwareError
            The hardware failed several times in a row, and no other sensor remains.
        JournalError
            The journal does not fit, or a replay ends before the procedure does.
        """
        positions = self._procedure.positions
        taken: list[PositionResult] = []
        self._operator.begin(self._procedure.title, len(positions))
        while len(taken) < len(positions):
            position = positions[len(taken)]
            try:
                word, result = self._attempt(position, taken)
            except Resumed:
                continue
            except JournalError:
                raise
            except (Unsettled, InputError, HardwareError) as error:
                self._refuse(position, error)
                continue
            if result is not None:
                taken.append(result)
            elif word == "back" and taken:
                taken.pop()
        return taken

    def confirm_write(self, ask: Callable[[], OperatorAnswer]) -> None:
        """Ask once more before calibration files are written."""
        self._ask("write", ask)

    def _attempt(self, position: Position, taken: list[PositionResult]) -> tuple[str, PositionResult | None]:
        """Ask for a position, measure it, have it judged."""
        self._hold(position)
        answer = self._ask("position", lambda: self._operator.position(position, len(taken) + 1, self._live))
        if answer.word != "ready":
            return answer.word, None
        as_set = _as_set(position, answer)
        if as_set != position:
            self._hold(as_set)
        self._settle(position, self._procedure.positions[len(taken) - 1] if taken else None, answer.temperature)
        result = self._sample(as_set, answer.temperature)
        self._rack.succeeded()
        expectations = self._expectations(taken)
        self._require_plausible(result, expectations, taken)
        measured = self._measured(result, expectations)
        verdict = self._ask("review", lambda: self._operator.review(as_set, measured))
        if verdict.word != "accept":
            return verdict.word, None
        self._tape.position(_record(result))
        self._desk.tell(lambda: self._operator.accepted(as_set, measured))
        return verdict.word, result

    def _refuse(self, position: Position, error: Exception) -> None:
        if isinstance(error, SensorError) and not self._rack.failed(error):
            if not self._tape.resumed_before_here:
                raise error
            # It ended the session once; whoever resumes it has put it right.
            self._rack.succeeded()
        self._desk.tell(lambda: self._operator.refused(position, str(error)))
        if isinstance(error, SensorError) and error.serial in self._rack.lost:
            serial = error.serial
            self._desk.tell(lambda: self._operator.lost(serial, self._rack.lost[serial]))
        if isinstance(error, HardwareError):
            self._clock.sleep(RECOVERY)

    def _ask(self, question: str, live: Callable[[], OperatorAnswer]) -> OperatorAnswer:
        """An answer from the tape or the operator; live readings that were shown meanwhile are played first."""
        while self._tape.playing and not self._tape.next_is_answer():
            with suppress(HardwareError, Resumed):
                self._live()
        return self._desk.ask(question, live)

    def _hold(self, position: Position) -> None:
        if self._fixture is not None:
            self._fixture.move(position.gravity, position.temperature)

    def _fresh(self) -> Sample:
        """A sample of now: what sensors sent while nobody listened is dropped."""
        self._rack.discard()
        return self._rack.read()

    def _live(self) -> Mapping[str, Reading]:
        return self._by_serial(self._fresh())

    def _by_serial(self, sample: Sample) -> dict[str, Reading]:
        return {bay.serial: reading for bay, reading in zip(self._rack.bays, sample, strict=True)}

    def _settle(self, position: Position, before: Position | None, typed: float | None) -> None:
        """Wait until still; until the temperature is, where this position changes it."""
        window = Window(self._settings.settle)
        if position.temperature is not None and (before is None or before.temperature != position.temperature):
            # A temperature that the operator types is vouched for; the thermometer may be far off.
            target = position.temperature if typed is None else None
            window = Window(self._settings.soak, self._procedure.soak_drift, target)
        wait_until_still(
            self._fresh, self._rack.models, self._clock, window, lambda sample, why: self._look(position, sample, why)
        )

    def _sample(self, position: Position, typed: float | None) -> PositionResult:
        held: list[tuple[float, Sample]] = []
        models = self._rack.models
        interval = max(model.interval for model in models)
        for number in range(self._settings.samples):
            sample = self._rack.read()
            held.append((self._clock.now_ns() / 1e9, sample))
            self._look(position, sample, f"sample {number + 1} of {self._settings.samples}")
            self._clock.sleep(interval)
        moved = movement(held, models, still=NUDGED, sigmas=NUDGED_SIGMAS) if len(held) > 2 else None
        if moved:
            raise Unsettled(f"moved while it was sampled: {moved}")
        summaries, temperatures = {}, {}
        for index, bay in enumerate(self._rack.bays):
            readings = [sample[index] for _, sample in held]
            _require_off_rails(readings, bay.model)
            temperatures[bay.serial] = _temperature(readings, typed, position.temperature)
            summaries[bay.serial] = {
                channel: summarise([reading.values[place] for reading in readings], bay.model.resolution)
                for place, channel in enumerate(bay.model.channels)
            }
        return PositionResult(position, self._tape.now_ns(), summaries, temperatures, typed is not None)

    def _look(self, position: Position, sample: Sample, why: str) -> None:
        self._desk.tell(lambda: self._operator.look(position, self._by_serial(sample), why))

    def _expectations(self, taken: Sequence[PositionResult]) -> dict[str, ExpectedReadings]:
        """What each sensor should read, from its model and the positions accepted so far."""
        expectations = {}
        for bay in self._rack.bays:
            model = bay.model
            expectation = ExpectedReadings(
                model.channels, model.offset, model.sensitivity, model.offset_spread, model.sensitivity_spread
            )
            for one in taken:
                seen = bay.orientation.seen(one.position.gravity)
                expectation.learn(seen, one.mean(bay.serial), one.temperatures[bay.serial])
            expectations[bay.serial] = expectation
        return expectations

    def _require_plausible(
        self, result: PositionResult, expectations: Mapping[str, ExpectedReadings], taken: Sequence[PositionResult]
    ) -> None:
        """Refuse a position that a sensor sees as another one."""
        determines = self._procedure.determines
        if determines.mounting:
            return
        if determines.free:
            self._require_new(result, expectations, taken)
            return
        positions = {position.name: position.gravity for position in self._procedure.positions}
        positions |= {one.position.name: one.position.gravity for one in taken}
        positions[result.position.name] = result.position.gravity
        for bay in self._rack.bays:
            if not bay.model.scaled:
                continue
            seen = {name: bay.orientation.seen(gravity) for name, gravity in positions.items()}
            why = expectations[bay.serial].objection(
                result.position.name, seen, result.mean(bay.serial), result.temperatures[bay.serial]
            )
            if why:
                raise Unsettled(why if len(self._rack.bays) == 1 else f"{bay.serial}: {why}")

    def _require_new(
        self, result: PositionResult, expectations: Mapping[str, ExpectedReadings], taken: Sequence[PositionResult]
    ) -> None:
        """Refuse an attitude that is there already, as a sensor of three axes sees it."""
        for bay in self._rack.bays:
            if bay.model.scaled and len(bay.model.channels) == 3:
                before = {one.position.name: one.mean(bay.serial) for one in taken}
                why = expectations[bay.serial].repeated(before, result.mean(bay.serial))
                if why:
                    raise Unsettled(why)

    def _measured(self, result: PositionResult, expectations: Mapping[str, ExpectedReadings]) -> list[MeasuredPosition]:
        """A position as the operator is shown it."""
        return [self._shown(bay, result, expectations[bay.serial]) for bay in self._rack.bays]

    def _shown(self, bay: ConnectedSensor, result: PositionResult, expectation: ExpectedReadings) -> MeasuredPosition:
        summaries = result.summaries[bay.serial]
        seen = bay.orientation.seen(result.position.gravity)
        return MeasuredPosition(
            serial=bay.serial,
            unit=bay.model.unit,
            mean={channel: summary.mean for channel, summary in summaries.items()},
            std={channel: summary.std for channel, summary in summaries.items()},
            expected=expectation.expected(seen) if bay.model.scaled and not self._procedure.determines.free else {},
            n=self._settings.samples,
            temperature=result.temperatures[bay.serial],
        )


def _as_set(position: Position, answer: OperatorAnswer) -> Position:
    """The position with the angles and the temperature that the operator actually set."""
    if answer.temperature is not None:
        position = replace(position, temperature=answer.temperature if position.temperature is not None else None)
    if answer.gravity is not None:
        return replace(position, gravity=normalised(answer.gravity), tilt=None)
    if answer.tilt:
        tilt = {**(position.tilt or {}), **answer.tilt}
        return replace(position, gravity=gravity_from_tilt(tilt), tilt=tilt)
    return position


def _temperature(readings: Sequence[Reading], typed: float | None, asked: float | None) -> float | None:
    """What the operator typed; else what the sensor's own thermometer says; else what was asked for."""
    own = [reading.temperature for reading in readings if reading.temperature is not None]
    if typed is not None:
        return typed
    return summarise(own).mean if own else asked


def _require_off_rails(readings: Sequence[Reading], model: Model) -> None:
    low, high = model.rails
    for place, channel in enumerate(model.channels):
        for reading in readings:
            if not low < reading.values[place] < high:
                raise Unsettled(
                    f"{channel} reads {reading.values[place]:.6g}, at its rail: is the angle within the sensor's "
                    "range, and is it wired right?"
                )


def _record(taken: PositionResult) -> dict[str, object]:
    """An accepted position as the journal notes it."""
    return {
        "position": taken.position.name,
        "sensors": {
            serial: {
                "mean": {channel: summary.mean for channel, summary in summaries.items()},
                "std": {channel: summary.std for channel, summary in summaries.items()},
                "n": next(iter(summaries.values())).n,
                "temperature": taken.temperatures[serial],
            }
            for serial, summaries in taken.summaries.items()
        },
    }

"""The runner of a ramp: samples the sensors without a break while the temperature goes up and down.

Its positions are the temperatures at which it turns. The operator is asked for each, and answers at once: what counts
is the way there. A leg ends when the thermometer is close to its temperature, or has stopped changing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from tiltcal.bench.event_log import EventLog, RecordedClock
from tiltcal.bench.operators.operator import PositionOperator
from tiltcal.bench.position_result import PositionResult
from tiltcal.bench.position_runner import PositionRunner, measurement_of
from tiltcal.bench.sample_checks import ReadingSpans, at_rail, require_few
from tiltcal.bench.sensor_set import RECOVERY, Sample, SensorSet
from tiltcal.bench.session_plan import SessionPlan
from tiltcal.bench.settle import Unsettled
from tiltcal.core.ramp.record import RampRecord, ramp_record
from tiltcal.drivers.virtual import Fixture
from tiltcal.errors import SensorError, UsageError
from tiltcal.files.procedure import Position, Ramp

CHANGE = 0.5
"""°C; a temperature that changes by less within the patience of the procedure has stopped."""

NO_THERMOMETER = "a ramp needs a thermometer that is read: the sensor reports no temperature, and the bench has none"
NO_WAY_BACK = "a ramp is one continuous record: no leg can be taken again; quit, and begin anew"


class RampRunner(PositionRunner):
    """Carries out a ramp; the other parameters are those of :class:`PositionRunner`."""

    def __init__(
        self,
        ramp: Ramp,
        plan: SessionPlan,
        sensors: SensorSet,
        operator: PositionOperator,
        log: EventLog,
        clock: RecordedClock,
        spans: ReadingSpans,
        fixture: Fixture | None = None,
    ) -> None:
        super().__init__(plan, sensors, operator, log, clock, spans, fixture)
        self._ramp = ramp
        self._rows: dict[str, list[tuple[float, ...]]] = {sensor.serial: [] for sensor in sensors.sensors}

    @property
    def records(self) -> Mapping[str, RampRecord]:
        found = {}
        for sensor in self._sensors.sensors:
            rows = np.array(self._rows[sensor.serial]).reshape(-1, 2 + len(sensor.model.channels))
            found[sensor.serial] = ramp_record(rows[:, 0], rows[:, 1], [*rows[:, 2:].T])
        return found

    def _attempt(self, position: Position, accepted: Sequence[PositionResult]) -> PositionResult | str:
        """Ask for a turning point, and sample until it is reached."""
        log, operator = self._log, self._operator
        answer = self._asked(position, len(accepted) + 1)
        if answer.word != "ready":
            raise Unsettled(NO_WAY_BACK)
        # A temperature that is typed is that of one moment; the thermometer is read all the time.
        actual = replace(answer.as_set(position), temperature=position.temperature)
        if accepted and actual.gravity != accepted[0].position.gravity:
            raise Unsettled("a ramp has one attitude: leave the sensor as it lies")
        samples = self._leg(actual)
        result = self._of_leg(actual, samples)
        if len(accepted) == len(self._procedure.positions) - 1:
            self._tip(position)
        log.position(result.record())
        log.report(operator.accepted, result)
        return result

    def _hold(self, position: Position) -> None:
        if self._fixture is not None:
            self._fixture.move(position.gravity, position.temperature, self._ramp.pace)

    def _leg(self, position: Position) -> list[Sample]:
        """Sample until the temperature of a position is reached, or changes no more; SensorError as in a position."""
        samples: list[Sample] = []
        wanted, since, before = position.temperature or 0.0, 0, np.nan
        while True:
            try:
                sample = self._sensors.read(fresh=True)
            except SensorError as error:
                if not self._sensors.count_failure(error, needed=True):
                    raise
                self._clock.sleep(RECOVERY)
                continue
            self._sensors.succeeded()
            now_ns = self._log.now_ns()
            temperature = sample[0].temperature
            if temperature is None:
                raise UsageError(NO_THERMOMETER)
            self._record(sample, now_ns)
            samples.append(sample)
            if abs(temperature - wanted) <= self._ramp.within and len(samples) > 1:
                return samples
            if not abs(temperature - before) < CHANGE:
                since, before = now_ns, temperature
            elif now_ns - since > self._ramp.patience * 1e9:
                return samples
            self._look(position, sample, f"at {temperature:.1f} °C, on the way to {wanted:g} °C")
            self._clock.sleep(self._ramp.interval)

    def _record(self, sample: Sample, now_ns: int) -> None:
        """Add a row to each record; one with a reading at a rail has no temperature and is left out."""
        for sensor, reading in zip(self._sensors.sensors, sample, strict=True):
            seen = np.nan if reading.temperature is None or at_rail(reading, sensor.model) else reading.temperature
            self._rows[sensor.serial].append((now_ns / 1e9, seen, *reading.values))

    def _of_leg(self, position: Position, samples: Sequence[Sample]) -> PositionResult:
        """Return a leg as a position, the means along its way; Unsettled where too many readings are at a rail."""
        measurements = {}
        when = {"time": self._now()}
        for index, sensor in enumerate(self._sensors.sensors):
            readings = [sample[index] for sample in samples]
            railed = [why for reading in readings if (why := at_rail(reading, sensor.model))]
            if railed:
                require_few(len(railed), len(readings), railed[-1])
                readings = [reading for reading in readings if not at_rail(reading, sensor.model)]
            measurements[sensor.serial] = measurement_of(sensor, position, readings, when)
        return PositionResult(position, measurements, asked=position.temperature)

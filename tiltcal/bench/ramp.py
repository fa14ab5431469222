"""The legs of a ramp: sampled without a break until each turning point is reached."""

from __future__ import annotations

from dataclasses import replace
from math import nan

from tiltcal.bench.checks import require_few
from tiltcal.bench.devices import RECOVERY
from tiltcal.bench.session import Session
from tiltcal.bench.settle import Unsettled
from tiltcal.drivers.bus.clock import SECOND
from tiltcal.errors import SensorError, UsageError
from tiltcal.files.procedure import Position, Ramp
from tiltcal.journal.playback import Sample
from tiltcal.journal.positions import as_set, at_rail, result_of

CHANGE = 0.5  # °C; a ramp's temperature that changes by less within the patience of the procedure has stopped


class RampLegs:
    """The legs of a session's ramp."""

    def __init__(self, session: Session, ramp: Ramp) -> None:
        self._session, self._ramp = session, ramp

    def take(self, position: Position) -> None:
        """Ask for a turning point of a ramp, and sample without a break until it is reached.

        The operator answers at once: what counts is the way there.
        """
        session, sensors = self._session, self._session.sensors.sensors
        answer = session.ask_for(position)
        if answer.answer != "ready":
            raise Unsettled(self._ramp.why_not_again)
        # A temperature that is typed is that of one moment; the thermometer is read all the time.
        actual = replace(as_set(position, answer), temperature=position.temperature)
        if session.recorded.accepted and actual.gravity != session.recorded.accepted[0].position.gravity:
            raise Unsettled("a ramp has one attitude: leave the sensor as it lies")
        first = session.recorded.leg[0].line if session.recorded.leg else session.recorder.line + 1
        samples = [*session.recorded.leg, *self._on_the_way(position)]
        last = session.recorder.line
        for sensor in sensors:
            railed = [why for sample in samples if (why := at_rail(sample[sensor.serial], sensor.wired))]
            if railed:
                require_few(len(railed), len(samples), railed[-1])
        result = result_of(sensors, actual, position, samples, session.setup.stamp_after(session.recorder.now_ns()))
        session.recorded.leg = []
        session.accept(result, {"lines": [first, last]})

    def _on_the_way(self, position: Position) -> list[Sample]:
        """Sample until the temperature of a position is reached, or changes no more; SensorError as in a position."""
        session, ramp, samples = self._session, self._ramp, list[Sample]()
        wanted, since, before = position.temperature or 0.0, 0, nan
        while True:
            try:
                samples.append(session.sensors.read(fresh=True))
            except SensorError as error:
                session.sensors.failed(error, needed=True)
                session.clock.sleep(RECOVERY)
                continue
            session.sensors.succeeded()
            now_ns, temperature = session.recorder.now_ns(), next(iter(samples[-1].values())).temperature
            if temperature is None:
                raise UsageError(
                    "a ramp needs a thermometer that is read: the sensor reports no temperature, and the bench has none"
                )
            if abs(temperature - wanted) <= ramp.within and len(samples) > 1:
                return samples
            if not abs(temperature - before) < CHANGE:
                since, before = now_ns, temperature
            elif now_ns - since > ramp.patience * SECOND:
                return samples
            session.talk.look(position, samples[-1], f"at {temperature:.1f} °C, on the way to {wanted:g} °C")
            session.clock.sleep(ramp.interval)

"""A ramp: the sensors are sampled without a break while the temperature goes up and down.

Its positions are the temperatures at which it turns. The operator is asked for each, and answers at once: what counts
is the way there. A leg ends when the thermometer is close to its temperature, or has stopped changing.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tiltcal.bench.checks import at_rail, require_few, result_of
from tiltcal.bench.operators import as_set
from tiltcal.bench.sensors import RECOVERY, Sample
from tiltcal.bench.session import Session
from tiltcal.bench.settle import Unsettled
from tiltcal.errors import SensorError, UsageError
from tiltcal.files.procedure import Position, Ramp

CHANGE = 0.5  # °C; a temperature that changes by less within the patience of the procedure has stopped


def take_leg(session: Session, ramp: Ramp, position: Position) -> str:
    """Ask for a turning point, sample until it is reached, and have it accepted; return the answer."""
    answer = session.ask_for(position)
    if answer.answer != "ready":
        raise Unsettled("a ramp is one continuous record: no leg can be taken again; quit, and begin anew")
    # A temperature that is typed is that of one moment; the thermometer is read all the time.
    actual = replace(as_set(position, answer), temperature=position.temperature)
    if session.accepted and actual.gravity != session.accepted[0].position.gravity:
        raise Unsettled("a ramp has one attitude: leave the sensor as it lies")
    sensors = session.sensors.sensors
    first = session.leg[0].line if session.leg else session.recorder.line + 1
    samples = [one.readings for one in session.leg]
    samples += [session.sensors.by_serial(sample) for sample in _sampled(session, ramp, actual)]
    last = session.recorder.line
    for sensor in sensors:
        railed = [why for sample in samples if (why := at_rail(sample[sensor.serial], sensor.wired))]
        if railed:
            require_few(len(railed), len(samples), railed[-1])
    result = result_of(sensors, actual, position, samples, session.now())
    session.leg = []
    if len(session.accepted) == len(session.setup.steps.positions) - 1:
        session.tip(position)
    session.accept(result, {"lines": [first, last]})
    return answer.answer


def _sampled(session: Session, ramp: Ramp, position: Position) -> list[Sample]:
    """Sample until the temperature of a position is reached, or changes no more; SensorError as in a position."""
    samples: list[Sample] = []
    wanted, since, before = position.temperature or 0.0, 0, np.nan
    while True:
        try:
            sample = session.sensors.read(fresh=True)
        except SensorError as error:
            session.sensors.failed(error, needed=True)
            session.clock.sleep(RECOVERY)
            continue
        session.sensors.succeeded()
        now_ns = session.recorder.now_ns()
        temperature = sample[0].temperature
        if temperature is None:
            raise UsageError(
                "a ramp needs a thermometer that is read: the sensor reports no temperature, and the bench has none"
            )
        samples.append(sample)
        if abs(temperature - wanted) <= ramp.within and len(samples) > 1:
            return samples
        if not abs(temperature - before) < CHANGE:
            since, before = now_ns, temperature
        elif now_ns - since > ramp.patience * 1e9:
            return samples
        session.look(position, sample, f"at {temperature:.1f} °C, on the way to {wanted:g} °C")
        session.clock.sleep(ramp.interval)

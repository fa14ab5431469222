"""The checks of a position: values far off, a channel that is stuck, a wrong one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from statistics import median

import numpy as np

from tiltcal.bench.guidance import COARSE, JIGS, SensorGuidance, calibrated_guidance, guidance
from tiltcal.bench.settle import Unsettled
from tiltcal.calibration.angle_units import identified, shows_convention, too_steep
from tiltcal.calibration.measurement import Measurement, missing_temperature
from tiltcal.calibration.record import compensation_of
from tiltcal.core.angle_readings import AngleReadings
from tiltcal.core.attitude import Vector
from tiltcal.core.compensation import Compensation
from tiltcal.core.detection import (
    LEFT_OUT,
    TEMPERATURE_JUMP,
    TEMPERATURES,
    TILTED,
    identical_by_chance,
    noise_of_positions,
    outliers,
)
from tiltcal.core.plausibility import ExpectedReadings
from tiltcal.core.samples import resolution
from tiltcal.drivers.model import Model, Reading
from tiltcal.files.bench import BenchSensor
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity
from tiltcal.files.procedure import MountingCompletion, Position
from tiltcal.journal.header import Setup
from tiltcal.journal.playback import Sample
from tiltcal.journal.positions import PositionResult

TWO_AXES = "does each line have all axes that columns= or the pattern names"
FEWEST, SEVERAL, IN_TURN = 8, 4.0, 0.8
"""Two values are read in turn: from so many samples on, so many steps apart, by their correlation one sample apart."""

FAR, WITHIN = 0.08, 6.0
"""Positions that differ by more along a channel, g (5°), must differ by so many of its standard deviations."""

POWER_ON = 85.0  # the temperature that a DS18B20 reports as long as it has converted none, °C (its data sheet)
HINTS = 2  # refusals of a session that propose the position that the reading resembles; then it is the wiring
AGREEMENT = 20.0
"""The largest distance of a position's temperature from the one asked for, or from a position before, °C."""


def far_off(samples: Sequence[Sample], models: Mapping[str, Model], *, thermometers: bool) -> dict[int, str]:
    """Return the samples of a position that are no measurement, by their number, with the reason.

    ``thermometers`` says whether temperatures count; not where the operator typed one.
    """
    wrong: dict[int, str] = {}
    for serial, model in models.items():
        readings = [sample[serial] for sample in samples]
        for place, channel in enumerate(model.channels):
            values = np.array([reading.values[place] for reading in readings])
            for number in outliers(values, model.resolution or resolution([values])).tolist():
                middle = float(np.median(values))
                wrong[number] = f"{channel} reads {values[number]:.6g} where the other samples read {middle:.6g}"
        if thermometers:
            wrong |= _absurd_temperatures(readings)
    return wrong


def _absurd_temperatures(readings: Sequence[Reading]) -> dict[int, str]:
    """Return the samples whose temperature no bench has, or that none of the others has."""
    low, high = TEMPERATURES
    measured = {number: one.temperature for number, one in enumerate(readings) if one.temperature is not None}
    possible = [temperature for temperature in measured.values() if low <= temperature <= high]
    middle = median(possible) if possible else None
    return {
        number: f"the thermometer reads {temperature:g} °C"
        for number, temperature in measured.items()
        if not low <= temperature <= high or (middle is not None and abs(temperature - middle) > TEMPERATURE_JUMP)
    }


def require_no_turns(samples: Sequence[Sample], models: Mapping[str, Model]) -> None:
    """Raise Unsettled where a channel reads two values in turn, as of a device that prints x and y line by line."""
    for serial, model in models.items():
        for channel, values in zip(
            model.channels, np.array([sample[serial].values for sample in samples]).T, strict=True
        ):
            away, step = values - values.mean(), model.resolution or resolution([values])
            in_turn = float(away[1:] @ away[:-1]) < -IN_TURN * float(away @ away)
            if in_turn and len(values) >= FEWEST and np.ptp(values) > SEVERAL * step:
                low, high = float(values.min()), float(values.max())
                raise Unsettled(f"{channel} reads about {low:.6g} and {high:.6g} in turn: {TWO_AXES}?")


def require_few(count: int, wanted: int, why: str) -> None:
    """Raise Unsettled, with the last reason, where too many samples of a position had to be taken again."""
    if count > max(1, LEFT_OUT * wanted):
        raise Unsettled(f"{count} samples of a position of {wanted} are far off: {why}; look for a loose contact")


def require_plausible_temperature(result: PositionResult, accepted: Sequence[PositionResult]) -> None:
    """Refuse a thermometer that converts nothing, and a temperature that fits no other of its position."""
    source = "was typed" if result.typed else "is what the thermometer reads"
    for serial, measurement in result.measurements.items():
        temperature = measurement.temperature
        if temperature == POWER_ON and result.asked is None and not result.typed:
            raise Unsettled(
                f"the thermometer reads {temperature:g} °C in every sample, as a DS18B20 does that converts nothing: "
                "see to its supply, or take it out of the bench file"
            )
        alike = [before.measurements[serial].temperature for before in accepted if before.asked == result.asked]
        others = [(result.asked, "was asked for"), *((other, "was measured in a position before") for other in alike)]
        for other, whose in others:
            if temperature is not None and other is not None and abs(temperature - other) > AGREEMENT:
                raise Unsettled(f"{temperature:g} °C {source}, and {other:g} °C {whose}: one of them is wrong")


def _angles_of(model: Model, stated: str | None) -> AngleReadings | None:
    """Return how a device prints angles; None where it prints none."""
    identity = SensorIdentity(model.name, "", model.unit, model.channels, angles=stated or model.angles)
    return identified(identity).angle_readings


class Expectations:
    """What the ``accepted`` positions so far, and the models, predict of the readings of each sensor.

    ``open_`` are the positions that the operator may choose, ``alike`` those that a reading resembled in the session.
    """

    def __init__(
        self,
        setup: Setup,
        sensors: Sequence[BenchSensor],
        accepted: Sequence[PositionResult],
        judged: Mapping[str, CalibrationRecord],
        open_: Sequence[Position],
        alike: list[str],
    ) -> None:
        self._open, self._alike = open_, alike
        self._setup = setup
        self._sensors = {sensor.serial: sensor for sensor in sensors}
        self._accepted = accepted
        self._free = setup.steps.free
        self._mounts = isinstance(setup.steps, MountingCompletion)
        bases = {serial: base.calibration for serial, base in setup.bases.items()}
        self._mounted = any(base.coefficients.mounting is not None for base in bases.values())
        """Whether the positions are those of an application in which a sensor sits in a way of its own."""
        self._known = not (self._free or self._mounts or self._mounted)
        self._readings = {sensor.serial: self._learnt(sensor.serial, sensor.wired) for sensor in sensors}
        self._calibrated: dict[str, tuple[Compensation, tuple[str, ...]]] = {}
        """By serial number the compensation of a sensor that has a calibration, and the channels that this takes."""
        for serial, base in (bases | dict(judged)).items():
            if judged or self._mounts:  # in the sensor's own frame
                base = replace(base, coefficients=replace(base.coefficients, mounting=None))
            self._calibrated[serial] = compensation_of(base), base.coefficients.channels

    def _learnt(self, serial: str, model: Model) -> ExpectedReadings:
        readings = ExpectedReadings(
            model.channels,
            model.offset,
            model.sensitivity,
            model.offset_spread,
            model.sensitivity_spread,
            _angles_of(model, self._setup.settings.angles),
        )
        for result in self._accepted:
            before = result.measurements[serial]
            if self._foreseen(model, before.gravity):
                readings.learn(before.gravity, result.mean(serial), before.temperature)
        return readings

    def _foreseen(self, model: Model, up: Vector) -> bool:
        """Return whether it is known what a channel prints there: not near ±90°, nor of a convention that counts."""
        angles = _angles_of(model, self._setup.settings.angles)
        shown = angles is not None and angles.euler is None and shows_convention([up])
        return not (shown or too_steep(up, model.channels, angles))

    def guidance(
        self, serial: str, values: Sequence[float], gravity: Vector, temperature: float | None
    ) -> SensorGuidance:
        """Return what guides a sensor where the fixture is to be held in an attitude; temperature in °C."""
        sensor = self._sensors[serial]
        if serial not in self._calibrated:
            expected = self._readings[serial] if self._known else None
            return guidance(sensor.wired, sensor.orientation, values, gravity, expected)
        compensation, channels = self._calibrated[serial]
        readings = [values[sensor.wired.channels.index(channel)] for channel in channels]
        tolerance = None if self._mounts else max(COARSE, JIGS * (self._setup.settings.jig or 0.0))
        return calibrated_guidance(compensation, sensor.orientation, readings, temperature, gravity, tolerance)

    def require(self, result: PositionResult) -> None:
        """Raise Unsettled where the temperature is absurd, a sensor is stuck, or it is another position."""
        require_plausible_temperature(result, self._accepted)
        if self._setup.steps.needs_base:
            from tiltcal.calibration.complete import objection_to_level

            objection = missing_temperature if self._mounts else objection_to_level
            for serial, measurement in result.measurements.items():
                if refusal := objection(self._setup.bases[serial].calibration, measurement):
                    raise Unsettled(refusal)
        for serial, sensor in self._sensors.items():
            self._require_not_stuck(serial, sensor.wired.unit, result.measurements[serial])
        if self._mounts or self._mounted:
            return
        for serial, sensor in self._sensors.items():
            why = self._objection(sensor, result) if sensor.wired.scaled else None
            if why:
                alone = self._free or len(self._setup.sensors) == 1
                raise Unsettled(why if alone else f"{serial}: {why}")
            if self._known:
                self._require_change(serial, sensor.wired.unit, result)

    def _require_change(self, serial: str, unit: str, result: PositionResult) -> None:
        """Refuse a channel that differs from a position of another tilt by no more than it scatters within one."""
        now = result.measurements[serial]
        for before in (one.measurements[serial] for one in self._accepted):
            for channel, summary in now.summaries.items():
                other, axis = before.summaries[channel], "xyz".index(channel)
                scatter, change = max(summary.std, other.std), abs(summary.mean - other.mean)
                if abs(now.gravity[axis] - before.gravity[axis]) > FAR and change < WITHIN * scatter:
                    raise Unsettled(
                        f"{channel} of {serial} scatters by {scatter:.3g} {unit} within a position, and differs by "
                        f"{change:.3g} {unit} from {before.position}: was the sensor turned and held still; "
                        f"{TWO_AXES}? If not so in the positions before, go back and repeat them"
                    )

    def _require_not_stuck(self, serial: str, unit: str, now: Measurement) -> None:
        """Refuse a channel that reads one value, never another, where something else has changed.

        A reading that stands still within a position is coarse, unless its noise in the positions before is more than
        its step hides. One that stands still over positions of other tilt is stuck.
        """
        before = [result.measurements[serial] for result in self._accepted]
        for channel, summary in now.summaries.items():
            if summary.std != 0.0:
                continue
            noise = (
                noise_of_positions([one.summaries[channel] for one in before], summary.resolution) if before else 0.0
            )
            if not identical_by_chance(summary.n, noise, summary.resolution):
                raise Unsettled(
                    f"{channel} of {serial} is stuck: all {summary.n} samples read {summary.mean:.6g} {unit}, and "
                    f"those of the positions before scatter by {noise:.3g}; see that the sensor converts (if it was "
                    "shaken in the positions before, go back and repeat them)"
                )
            still = [one for one in before if one.summaries[channel].std == 0.0]
            same = [one for one in still if one.summaries[channel].mean == summary.mean]
            axis = "xyz".index(channel)
            if any(abs(one.gravity[axis] - now.gravity[axis]) > TILTED for one in same):
                count = sum(one.summaries[channel].n for one in (*same, now))
                raise Unsettled(
                    f"{channel} of {serial} is stuck: all {count} samples of {len(same) + 1} positions read "
                    f"{summary.mean:.6g} {unit}; see that the sensor converts, and that its axis is wired"
                )

    def _objection(self, sensor: BenchSensor, result: PositionResult) -> str | None:
        """Return why a sensor sees a position as another one, or an attitude that is there already."""
        readings, serial = self._readings[sensor.serial], sensor.serial
        if not self._foreseen(sensor.wired, result.measurements[serial].gravity):
            return None
        if self._free:
            before = {one.position.name: one.mean(serial) for one in self._accepted}
            return readings.repeated(before, result.mean(serial))
        positions = [*self._setup.steps.positions, *(one.position for one in (*self._accepted, result))]
        seen = {position.name: sensor.orientation.seen(position.gravity) for position in positions}
        temperature = result.measurements[serial].temperature
        taken = result.position.name, seen, result.mean(serial), temperature
        why = readings.objection(*taken)
        other = next((one for one in self._open if one.name == readings.resembled(*taken)), None)
        if why is None or other is None:
            return why
        self._alike.append(other.name)
        if len(self._alike) > HINTS:
            return f"{why} See to the wiring, and to axes: of the bench file"
        place = max(range(3), key=lambda one: abs(other.gravity[one]) - (one == 2 and other.tilt is not None))
        points = "up" if other.gravity[place] > 0.0 else "down"
        return f"{why} If the +{'XYZ'[place]} side really points {points} now, choose {other.name}"

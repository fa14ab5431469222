"""Checks of the samples of a position: values far off, absurd temperatures, rails, a channel that is stuck."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median

import numpy as np

from tiltcal.bench.position_result import PositionResult
from tiltcal.bench.sensor_set import ConnectedSensor
from tiltcal.bench.settle import Timed, Unsettled
from tiltcal.core.detection import (
    LEFT_OUT,
    TEMPERATURE_JUMP,
    TEMPERATURES,
    TILTED,
    identical_by_chance,
    noise_of_positions,
    outliers,
)
from tiltcal.core.quantisation import resolution
from tiltcal.drivers.model import Model, Reading

POWER_ON = 85.0
"""The temperature that a DS18B20 reports as long as it has converted none, °C (its data sheet)."""

AGREEMENT = 20.0
"""The largest distance of a position's temperature from the one asked for, or from a position before, °C."""


def far_off(held: Sequence[Timed], models: Sequence[Model], *, thermometers: bool) -> dict[int, str]:
    """Return the samples of a position that are no measurement, by their number, with the reason.

    Parameters
    ----------
    thermometers : bool
        Whether temperatures count; not where the operator typed one.
    """
    found: dict[int, str] = {}
    for index, model in enumerate(models):
        readings = [sample[index] for _, sample in held]
        for place, channel in enumerate(model.channels):
            values = np.array([reading.values[place] for reading in readings])
            for number in outliers(values, model.resolution or resolution([values])).tolist():
                middle = float(np.median(values))
                found[number] = f"{channel} reads {values[number]:.6g} where the other samples read {middle:.6g}"
        if thermometers:
            found |= _absurd_temperatures(readings)
    return found


def require_few(count: int, wanted: int, why: str) -> None:
    """Raise Unsettled, with the last reason, where too many samples of a position had to be taken again."""
    if count > max(1, LEFT_OUT * wanted):
        raise Unsettled(f"{count} samples of a position of {wanted} are far off: {why}; look for a loose contact")


def at_rail(reading: Reading, model: Model) -> str:
    """Return which channel of a reading is at a rail, and what to look at; nothing where none is."""
    low, high = model.rails
    for channel, value in zip(model.channels, reading.values, strict=True):
        if not low < value < high:
            return (
                f"{channel} reads {value:.6g}, at its rail: is the angle within the sensor's range, and is it wired "
                "right?"
            )
    return ""


def require_off_rails(readings: Sequence[Reading], model: Model) -> None:
    """Raise Unsettled, with the channel, for readings at a rail."""
    for reading in readings:
        if why := at_rail(reading, model):
            raise Unsettled(why)


def require_plausible_temperature(result: PositionResult, accepted: Sequence[PositionResult]) -> None:
    """Refuse a thermometer that converts nothing, and a temperature that fits no other of its position.

    Unsettled: with the temperatures.
    """
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


def require_not_stuck(sensor: ConnectedSensor, result: PositionResult, accepted: Sequence[PositionResult]) -> None:
    """Refuse a channel that reads one value, never another, where something else has changed.

    A reading that stands still within a position is coarse, unless its noise in the positions before is more than its
    step hides. One that stands still over positions of other tilt is stuck.

    Unsettled: with the channel and the value.
    """
    now = result.measurements[sensor.serial]
    for channel, summary in now.summaries.items():
        before = [result.measurements[sensor.serial] for result in accepted]
        noise = noise_of_positions([one.summaries[channel] for one in before], summary.resolution) if before else 0.0
        if summary.std == 0.0 and not identical_by_chance(summary.n, noise, summary.resolution):
            raise Unsettled(
                f"{channel} of {sensor.serial} is stuck: all {summary.n} samples read {summary.mean:.6g} "
                f"{sensor.model.unit}, and those of the positions before scatter by {noise:.3g}; see that the sensor "
                "converts (if it was shaken in the positions before, go back and repeat them)"
            )
        alike = [one for one in before if one.summaries[channel].std == summary.std == 0.0]
        same = [one for one in alike if one.summaries[channel].mean == summary.mean]
        axis = "xyz".index(channel)
        if any(abs(one.gravity[axis] - now.gravity[axis]) > TILTED for one in same):
            count = sum(one.summaries[channel].n for one in (*same, now))
            raise Unsettled(
                f"{channel} of {sensor.serial} is stuck: all {count} samples of {len(same) + 1} positions read "
                f"{summary.mean:.6g} {sensor.model.unit}; see that the sensor converts, and that its axis is wired"
            )


class ReadingSpans:
    """The lowest and the highest reading of each channel that a session has seen, moves between positions included."""

    def __init__(self, sensors: Sequence[ConnectedSensor]) -> None:
        self._models = {sensor.serial: sensor.model for sensor in sensors}
        self._spans: dict[str, list[tuple[float, float, float]]] = {}

    def add(self, readings: Mapping[str, Reading]) -> None:
        """Take one sample, by serial number; a reading at a rail is none."""
        for serial, reading in readings.items():
            step = self._models[serial].resolution or reading.step
            before = self._spans.get(serial) or [(value, value, step) for value in reading.values]
            if not at_rail(reading, self._models[serial]):
                spans = zip(before, reading.values, strict=True)
                self._spans[serial] = [(min(low, one), max(high, one), step) for (low, high, _), one in spans]

    def quiet(self, serial: str) -> list[str]:
        """Return the channels of a sensor that have shown at most two neighbouring values."""
        channels, spans = self._models[serial].channels, self._spans.get(serial, [])
        return [name for name, (low, high, step) in zip(channels, spans, strict=False) if high - low <= 1.5 * step]


def _absurd_temperatures(readings: Sequence[Reading]) -> dict[int, str]:
    """Return the samples whose temperature no bench has, or that none of the others has."""
    low, high = TEMPERATURES
    known = {number: reading.temperature for number, reading in enumerate(readings) if reading.temperature is not None}
    possible = [temperature for temperature in known.values() if low <= temperature <= high]
    middle = median(possible) if possible else None
    return {
        number: f"the thermometer reads {temperature:g} °C"
        for number, temperature in known.items()
        if not low <= temperature <= high or (middle is not None and abs(temperature - middle) > TEMPERATURE_JUMP)
    }

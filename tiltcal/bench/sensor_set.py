"""The rack: the sensors of a bench, read together, and the thermometer beside them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

from tiltcal.core.orientation import STRAIGHT, Orientation
from tiltcal.drivers.device import Model, Reading, Sensor
from tiltcal.errors import HardwareError, SensorError
from tiltcal.files.calibration import SensorIdentity

Sample = tuple[Reading, ...]
"""One reading of each sensor of a rack, in its order."""

Listener = Callable[[Mapping[str, Reading]], None]
"""Has the readings of a sample by serial number."""

ATTEMPTS = 5
"""Failures in a row after which a sensor is given up."""


@dataclass(frozen=True)
class ConnectedSensor:
    """One sensor at the bench.

    Attributes
    ----------
    model : Model
        As it is wired.
    serial : str
        The serial number that goes on the calibration file.
    sensor : Sensor
        The driver at work on the recorded link.
    orientation : Orientation
        How it sits on the fixture.
    """

    model: Model
    serial: str
    sensor: Sensor
    orientation: Orientation = STRAIGHT

    @property
    def identity(self) -> SensorIdentity:
        """What the calibration file says the sensor is."""
        return SensorIdentity(self.model.name, self.serial, self.model.unit, self.model.channels)


def column_name(serial: str, channel: str, *, alone: bool) -> str:
    """What a log calls a channel: by its name alone, or of several devices behind the serial number."""
    return channel if alone else f"{serial}_{channel}"


class SensorSet:
    """Reads several sensors as one, and gives up those that fail for good.

    Parameters
    ----------
    bays : sequence of ConnectedSensor
    thermometer : Sensor, optional
        Its temperature stands for that of every sensor.
    """

    THERMOMETER = "thermometer"

    def __init__(self, bays: Sequence[ConnectedSensor], thermometer: Sensor | None = None) -> None:
        self._bays = tuple(bays)
        self._listeners: list[Listener] = []
        self._thermometer = thermometer
        self._failures: dict[str, int] = {}
        self.lost: dict[str, str] = {}

    @property
    def bays(self) -> tuple[ConnectedSensor, ...]:
        """Those that were not given up."""
        return tuple(bay for bay in self._bays if bay.serial not in self.lost)

    @property
    def models(self) -> tuple[Model, ...]:
        """Of the same sensors."""
        return tuple(bay.model for bay in self.bays)

    def tell(self, listener: Listener) -> None:
        """Let someone have every sample that :meth:`read` takes from here on."""
        self._listeners.append(listener)

    def read(self) -> Sample:
        """One sample of every sensor.

        Raises
        ------
        SensorError
            One of them failed.
        """
        sample = self._sample()
        for listener in self._listeners:
            listener(dict(zip((bay.serial for bay in self.bays), sample, strict=True)))
        return sample

    def _sample(self) -> Sample:
        readings = []
        for bay in self.bays:
            with self._named(bay.serial):
                readings.append(bay.sensor.read())
        if self._thermometer is None:
            return tuple(readings)
        with self._named(self.THERMOMETER):
            temperature = self._thermometer.read().temperature
        return tuple(replace(reading, temperature=temperature) for reading in readings)

    def read_available(self) -> tuple[list[Reading | None], list[str]]:
        """One sample of every sensor that answers, None for the others, and why they did not."""
        readings: list[Reading | None] = []
        reasons = []
        for bay in self.bays:
            try:
                with self._named(bay.serial):
                    readings.append(bay.sensor.read())
            except SensorError as error:
                readings.append(None)
                reasons.append(str(error))
        if self._thermometer is not None:
            try:
                with self._named(self.THERMOMETER):
                    temperature = self._thermometer.read().temperature
            except SensorError as error:
                temperature = None
                reasons.append(str(error))
            readings = [None if one is None else replace(one, temperature=temperature) for one in readings]
        return readings, reasons

    def discard(self) -> None:
        """Drop what sensors sent while nobody listened.

        Raises
        ------
        SensorError
            One of them failed.
        """
        for bay in self.bays:
            with self._named(bay.serial):
                bay.sensor.discard()
        if self._thermometer is not None:
            with self._named(self.THERMOMETER):
                self._thermometer.discard()

    def succeeded(self) -> None:
        """All went well: failures from here on count anew."""
        self._failures.clear()

    def failed(self, error: SensorError, *, needed: bool = False) -> bool:
        """Count a failure; whether the session can go on.

        A sensor that fails :data:`ATTEMPTS` times in a row is given up where others remain, and it is not ``needed``.
        """
        count = self._failures[error.serial] = self._failures.get(error.serial, 0) + 1
        if count < ATTEMPTS:
            return True
        if needed or error.serial == self.THERMOMETER or len(self.bays) == 1:
            return False
        self.lost[error.serial] = str(error)
        return True

    @contextmanager
    def _named(self, serial: str) -> Iterator[None]:
        """Say which device an error is of."""
        try:
            yield
        except HardwareError as error:
            alone = len(self._bays) == 1 and serial != self.THERMOMETER
            raise SensorError(serial, str(error) if alone else f"{serial}: {error}") from error

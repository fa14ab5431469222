"""A bay of the bench: one sensor with its driver, model and serial number."""

from __future__ import annotations

from dataclasses import dataclass

from tiltcal.drivers.device import Model, Sensor
from tiltcal.files.calibration import SensorIdentity


@dataclass(frozen=True)
class Bay:
    """One sensor at the bench.

    Attributes
    ----------
    model : Model
    serial : str
        The serial number that goes on the calibration file.
    sensor : Sensor
        The driver at work on the taped link.
    """

    model: Model
    serial: str
    sensor: Sensor

    @property
    def identity(self) -> SensorIdentity:
        """What the calibration file says the sensor is."""
        return SensorIdentity(self.model.name, self.serial, self.model.unit, self.model.channels)

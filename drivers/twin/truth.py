"""The true coefficients of a virtual sensor, which a calibration should find."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from tiltcal.drivers.twin.noise import normal
from tiltcal.errors import BusError

LEVEL = (0.0, 0.0, 1.0)
"""Up in the frame of a level sensor, g."""

Polynomial = tuple[float, ...]


@dataclass(frozen=True)
class Fault:
    """A fault of a virtual sensor, with its start and end.

    Attributes
    ----------
    kind : str
        ``parity`` (memory error of the part), ``stuck`` (the reading does not change), ``silent`` (the data line floats
        high), ``unplugged`` (every transaction fails); empty for no fault.
    start, end : float
        Seconds after the session began.
    """

    kind: str
    start: float
    end: float


NO_FAULT = Fault("", 0.0, 0.0)


@dataclass(frozen=True)
class Truth:
    """The true coefficients of one virtual sensor, in the terms of the measurement model.

    Attributes
    ----------
    offset : mapping of str to float
        Per channel, unit, at the reference temperature.
    sensitivity : mapping of str to mapping of str to float
        Per channel and axis x, y, z, unit/g.
    reference : float
        Reference temperature, °C.
    drift, gain : mapping of str to tuple of float
        Per channel, coefficients of dT, dT², ..., in unit/°C**k and 1/°C**k.
    nonlinearity : mapping of str to tuple of float
        Per channel, coefficients of a², a³, ... where a is the signal in g, in g.
    noise : mapping of str to float
        Per channel, white, standard deviation of one sample, unit.
    thermometer_error : float
        Error of the sensor's own thermometer, positive if it reads too high, °C.
    lag : float
        By how much the sensing element is later than the chamber and the thermometer, s.
    supply : float
        Supply of an analog sensor, V; its coefficients always refer to 5 V.
    mounting : tuple of float
        Rotation of the sensor on the fixture: roll, pitch, yaw, degrees.
    jig, ambient, time_constant : float
        Of its fixture: see :class:`tiltcal.drivers.twin.fixture.Fixture`.
    """

    channels: tuple[str, ...]
    offset: Mapping[str, float]
    sensitivity: Mapping[str, Mapping[str, float]]
    reference: float = 25.0
    drift: Mapping[str, Polynomial] = field(default_factory=dict)
    gain: Mapping[str, Polynomial] = field(default_factory=dict)
    nonlinearity: Mapping[str, Polynomial] = field(default_factory=dict)
    noise: Mapping[str, float] = field(default_factory=dict)
    thermometer_error: float = 0.0
    lag: float = 0.0
    supply: float = 5.0
    mounting: tuple[float, float, float] = (0.0, 0.0, 0.0)
    seed: int = 0
    jig: float = 0.0
    ambient: float = 24.0
    time_constant: float = 0.0
    faults: tuple[Fault, ...] = ()

    def reading(self, channel: str, gravity: tuple[float, float, float], temperature: float) -> float:
        """Return the reading of ``channel`` without noise, in its unit.

        Parameters
        ----------
        gravity : tuple of float
            Up in the sensor frame, g.
        temperature : float
            Of the sensor, °C.
        """
        row, (x, y, z) = self.sensitivity[channel], gravity
        signal = row.get("x", 0.0) * x + row.get("y", 0.0) * y + row.get("z", 0.0) * z
        own = row[channel]
        bend = own * _powers(self.nonlinearity.get(channel, ()), signal / own, 2)
        dt = temperature - self.reference
        drift = _powers(self.drift.get(channel, ()), dt, 1)
        gain = _powers(self.gain.get(channel, ()), dt, 1)
        return self.offset[channel] + drift + (1.0 + gain) * (signal + bend)

    def sample(
        self, channel: str, gravity: tuple[float, float, float], temperature: float, now_ns: int, number: int
    ) -> float:
        """Return the reading of ``channel`` with the noise of a sample; of a stuck sensor what it reads when level.

        Parameters
        ----------
        gravity, temperature
            As in :meth:`reading`.
        now_ns : int
            Nanoseconds since the session began.
        number : int
            Of the sample, which gives its noise.
        """
        if self.fault(now_ns / 1e9).kind == "stuck":
            # A function of the fault alone, so a resumed session reads the same.
            return self.reading(channel, LEVEL, self.ambient)
        noise = self.noise.get(channel, 0.0)
        drawn = normal(self.seed, f"noise {channel}", number) if noise else 0.0
        return self.reading(channel, gravity, temperature) + noise * drawn

    def fault(self, seconds: float) -> Fault:
        """Return the fault that is present ``seconds`` after the session began; :data:`NO_FAULT` if there is none."""
        for fault in self.faults:
            if fault.start <= seconds < fault.end:
                return fault
        return NO_FAULT

    def fault_on_link(self, now_ns: int, device: str = "sensor") -> Fault:
        """Return the fault that is present at a transaction.

        Parameters
        ----------
        now_ns : int
            Nanoseconds since the session began.
        device : str
            What is at the link, for the message.

        BusError: the device is unplugged.
        """
        fault = self.fault(now_ns / 1e9)
        if fault.kind == "unplugged":
            raise BusError(f"the virtual {device} is unplugged, a fault that its truth sets: resume the session later")
        return fault


def _powers(coefficients: Polynomial, variable: float, lowest: int) -> float:
    """Return a polynomial that begins with a power."""
    total = 0.0
    for power, coefficient in enumerate(coefficients, lowest):
        total += coefficient * variable**power
    return total

"""The voltages at the inputs of a virtual converter, from virtual analog sensors and thermistors."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from typing import TYPE_CHECKING

from tiltcal.drivers.converter import NOMINAL
from tiltcal.drivers.twin.noise import uniform
from tiltcal.drivers.twin.truth import Truth
from tiltcal.errors import UsageError

if TYPE_CHECKING:
    from tiltcal.drivers.analog import AnalogPart, WiredAnalog
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.bus.link import Link
    from tiltcal.drivers.converter import Supply
    from tiltcal.drivers.thermistor import WiredThermistor
    from tiltcal.drivers.twin.fixture import HeldPose


class Wiring(ABC):
    """The wiring of a virtual converter; its voltages depend on the truth, the pose and the time alone.

    Parameters
    ----------
    clock : Clock
        Session time; it numbers the noise.
    supply : Supply
        The input of the sensor's supply; the truth states its voltage.
    """

    def __init__(self, truth: Truth, clock: Clock, supply: Supply) -> None:
        self._truth = truth
        self._clock = clock
        self._supply = supply

    @property
    def seed(self) -> int:
        """Seed of the random numbers of the converter."""
        return self._truth.seed

    @property
    def reference(self) -> float:
        """The true voltage at the converter's reference pin, V."""
        return self._truth.supply if self._supply.reference is None else self._supply.reference

    def volts(self, number: int) -> float:
        """Return the voltage at an input now, V."""
        if number == self._supply.number:
            return self._truth.supply
        return min(max(self.share(number, self._clock.now_ns()), 0.0), 1.0) * self._truth.supply

    @abstractmethod
    def share(self, number: int, now_ns: int) -> float:
        """Return the voltage at an input, as a share of the supply."""

    def silent(self) -> bool:
        """Return whether the converter does not answer now, a fault that the truth sets.

        BusError: it is unplugged.
        """
        return self._truth.fault_on_link(self._clock.now_ns(), "converter").kind == "silent"


class SensorWiring(Wiring):
    """A sensor of two axes at a converter.

    Parameters
    ----------
    parity_signal : bool
        Whether both outputs near ground are the fault signal of the part.
    truth : Truth
        In V referred to a supply of 5 V.
    """

    def __init__(self, parity_signal: bool, wired: WiredAnalog, truth: Truth, fixture: HeldPose, clock: Clock) -> None:
        super().__init__(truth, clock, wired.supply)
        self._parity_signal = parity_signal
        self._fixture = fixture
        self._channels = dict(zip(wired.numbers, truth.channels, strict=True))

    def share(self, number: int, now_ns: int) -> float:
        """Return the voltage at an input, as a share of the supply."""
        channel = self._channels.get(number)
        if channel is None:
            return 0.0
        if self._parity_signal and self._truth.fault(now_ns / 1e9).kind == "parity":
            return 0.05 * uniform(self._truth.seed, f"parity {channel}", now_ns)
        temperature = self._fixture.temperature(self._truth.lag)
        return self._truth.sample(channel, self._fixture.gravity, temperature, now_ns, now_ns) / NOMINAL


class ThermistorWiring(Wiring):
    """A thermistor's divider at a converter.

    Parameters
    ----------
    truth : Truth
        Only its seed, supply, thermometer error and faults are used.
    fixture : HeldPose
        The chamber around it.
    """

    def __init__(self, wired: WiredThermistor, truth: Truth, fixture: HeldPose, clock: Clock) -> None:
        super().__init__(truth, clock, wired.supply)
        self._fixture = fixture
        self._wired = wired

    def share(self, number: int, now_ns: int) -> float:
        """Return the voltage at an input, as a share of the supply."""
        if number != self._wired.number:
            return 0.0
        stuck = self._truth.fault(now_ns / 1e9).kind == "stuck"
        temperature = self._truth.ambient if stuck else self._fixture.temperature()
        return self._wired.divider.share(temperature + self._truth.thermometer_error)


def analog_twin(parity_signal: bool, wired: WiredAnalog, truth: Truth, fixture: HeldPose, clock: Clock) -> Link:
    """Return a virtual converter with a sensor at its inputs."""
    return wired.front_end.twin(SensorWiring(parity_signal, wired, truth, fixture, clock), clock)


def thermistor_twin(wired: WiredThermistor, truth: Truth, fixture: HeldPose, clock: Clock) -> Link:
    """Return a virtual converter with a thermistor at one of its inputs."""
    return wired.front_end.twin(ThermistorWiring(wired, truth, fixture, clock), clock)


def ideal_thermistor(seed: int) -> Truth:
    """Return an ideal thermistor; its jig and chamber are those of the virtual sensors."""
    return Truth(channels=(), offset={}, sensitivity={}, seed=seed, jig=0.01, ambient=24.0, time_constant=20.0)


def draw_truth(part: AnalogPart, seed: int) -> Truth:
    """Return a plausible part: that of its digital port, in V referred to a supply of 5 V.

    UsageError: the tolerances of the part are unknown.
    """
    digital = part.digital
    if digital.default_truth is None:
        raise UsageError(f"{digital.name} has no default twin; name one with twin=FILE")
    truth = digital.default_truth(seed)
    step = part.sensitivity / digital.sensitivity
    return replace(
        truth,
        offset={name: NOMINAL / 2.0 + step * (offset - digital.offset) for name, offset in truth.offset.items()},
        sensitivity={
            name: {axis: step * sensitivity for axis, sensitivity in row.items()}
            for name, row in truth.sensitivity.items()
        },
        drift={name: tuple(step * k for k in drift) for name, drift in truth.drift.items()},
        noise={name: step * noise for name, noise in truth.noise.items()},
        thermometer_error=0.0,
    )

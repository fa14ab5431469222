"""The interface of a driver, and the facts of a sensor model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import sqrt
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from tiltcal.errors import UsageError

if TYPE_CHECKING:
    from tiltcal.drivers.bus import Bus
    from tiltcal.drivers.bus.address import Address
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.bus.link import Link
    from tiltcal.drivers.bus.spi import SpiPort
    from tiltcal.drivers.virtual import HeldPose, Truth


@dataclass(frozen=True, slots=True)
class Reading:
    """One sample of every channel.

    Attributes
    ----------
    values : tuple of float
        One per channel of the model, in the model's unit.
    temperature : float or None
        The sensor's own thermometer, °C; None where it has none.
    step : float
        With which the values were written, in the model's unit, where the model states no resolution and the sample
        shows one; else 0.
    """

    values: tuple[float, ...]
    temperature: float | None = None
    step: float = field(default=0.0, compare=False)


class Sensor(Protocol):
    """The interface of a driver on one link: bytes in, readings out."""

    def probe(self) -> Mapping[str, str]:
        """Check that the device answers plausibly.

        Returns
        -------
        mapping of str to str
            What the device reports about itself, for the operator.

        HardwareError: it does not answer, or shows a fault.
        """
        ...

    def read(self) -> Reading:
        """Take one sample.

        Raises
        ------
        BusError
            The transaction failed.
        DeviceFault
            The bytes show a fault of the device.
        """
        ...

    def discard(self) -> None:
        """Discard what arrived before now, so that the next reading is a new one.

        A sensor that is read sample by sample has nothing to discard; one that streams drops its queued data.

        BusError: the transaction failed.
        """
        ...


@dataclass(frozen=True, slots=True)
class Population:
    """The mean temperature curves of the parts of a model.

    Attributes
    ----------
    drift : tuple of float
        Mean offset, coefficients of 1, T, T², ... with T in °C, in unit.
    gain : tuple of float
        Mean relative change of the sensitivity, likewise.
    drift_spread, gain_spread : float
        Standard deviation over parts of the slopes, unit/°C and 1/°C.
    """

    drift: tuple[float, ...]
    gain: tuple[float, ...]
    drift_spread: float
    gain_spread: float
    source: str


@dataclass(frozen=True)
class Model:
    """The facts of one sensor model, with its driver and its twin.

    Attributes
    ----------
    name : str
        What the user types, such as ``sca100t-d02``.
    title : str
        Maker, part and interface.
    channels : tuple of str
        Names of the readings: x, y, z of a tilt sensor, any others of another device.
    unit : str
        Unit of a reading: ``count``, ``V`` or ``duty``.
    schemes : tuple of str
        Address schemes that it can be connected by.
    addresses : tuple of str
        An example address for each way to connect it, the preferred one first.
    offset : float
        Nominal reading at 0 g, in unit.
    sensitivity : float
        Nominal sensitivity, in unit/g.
    offset_spread : float
        Standard deviation of the offset between parts, in g.
    sensitivity_spread : float
        Standard deviation of the sensitivity between parts, relative.
    cross_axis_limit : float
        Largest sensitivity to each of the other axes, relative; 0 where no source states it.
    nonlinearity : tuple of float
        Typical square and cube of the response to a g, pure numbers; empty where no source states them.
    rails : tuple of float
        Rails: a reading at or beyond one of these is not a measurement, in unit.
    resolution : float
        The step of a reading, in unit; 0 where it is continuous.
    interval : float
        Shortest time between two samples that gives a new reading, s.
    thermometer : bool
        Whether the sensor reports its own temperature.
    population : Population or None
        Its mean temperature curves, if the maker states them.
    thermometer_step : float
        The step of this temperature, °C; 0 if it is continuous.
    driver : callable
        ``driver(link, clock)`` returns the :class:`Sensor`.
    twin : callable
        ``twin(truth, fixture, clock)`` returns a :class:`tiltcal.drivers.bus.link.Link` that answers as the part would:
        ``fixture`` holds it, in the sensor frame, and ``clock`` has the time of the session.
    not_modelled : tuple of str
        What the twin does not model, for ``tiltcal devices``.
    default_truth : callable or None
        ``default_truth(seed)`` draws a plausible part, the same one for one seed, for a ``sim:`` address without a twin
        file.
    spi : SpiPort or None
        None where the part has no SPI.
    options : tuple of str
        Options of an address that belong to the device and not to its bus, such as the input of x.
    scaled : bool
        Whether the nominal offset and sensitivity are known. Without them, a wrong position and a small movement cannot
        be detected.
    configure : callable or None
        ``configure(address)`` returns this model with the facts that these options state; None without such options.
    bus : Bus or None
        What opens its ``package:`` addresses: the bus of a package that adds the model, where tiltcal has none.
    """

    name: str
    title: str
    channels: tuple[str, ...]
    unit: str
    schemes: tuple[str, ...]
    addresses: tuple[str, ...]
    offset: float
    sensitivity: float
    offset_spread: float
    sensitivity_spread: float
    rails: tuple[float, float]
    resolution: float
    interval: float
    thermometer: bool
    driver: Callable[[Link, Clock], Sensor]
    twin: Callable[[Truth, HeldPose, Clock], Link]
    not_modelled: tuple[str, ...] = field(default=())
    default_truth: Callable[[int], Truth] | None = None
    spi: SpiPort | None = None
    options: tuple[str, ...] = ()
    thermometer_step: float = 0.0
    population: Population | None = None
    scaled: bool = True
    configure: Callable[[Address], Model] | None = None
    cross_axis_limit: float = 0.0
    nonlinearity: tuple[float, ...] = ()
    bus: Bus | None = None

    @property
    def thermometer_rounding(self) -> float:
        """Standard uncertainty of the sensor's own temperature due to its step, °C."""
        return round(self.thermometer_step / sqrt(12.0), 4)

    @property
    def senses_tilt(self) -> bool:
        """Whether the readings are components of gravity, x, y and z, and nothing else."""
        return set(self.channels) <= {"x", "y", "z"}

    def drawn(self, seed: int) -> Truth:
        """Return a plausible part, the same one for one seed.

        UsageError: the model has no default twin.
        """
        if self.default_truth is None:
            raise UsageError(f"{self.name} has no default twin; name one with twin=FILE")
        return self.default_truth(seed)

    def at(self, address: Address) -> Model:
        """Return this model as it is connected at an address.

        UsageError: an option of the address is missing or wrong.
        """
        return self if self.configure is None else self.configure(address)


def deviation_within(limit: float) -> float:
    """Return the standard deviation of errors of either sign within a limit: a rectangular distribution (GUM 4.3.7)."""
    return limit / sqrt(3.0)


def typical_nonlinearity(error: float, extent: float) -> tuple[float, float]:
    """Return the square and the cube that each err by so much, g, at the ends of a range of ±extent, g."""
    return error / extent**2, error / extent**3


class SelfTestResult(Protocol):
    """The result of the self-test of one channel; its text is for the operator."""

    @property
    def passed(self) -> bool:
        """Whether the channel passed."""
        ...


@runtime_checkable
class SelfTesting(Protocol):
    """A driver whose part can test itself."""

    def self_test(self, channel: str) -> SelfTestResult:
        """Start the self-test of one channel.

        HardwareError: as :meth:`Sensor.read`.
        """
        ...


@runtime_checkable
class StreamingSensor(Protocol):
    """A driver that counts lost and damaged data, of a sensor that streams or adds a checksum."""

    def link_statistics(self) -> Mapping[str, int]:
        """Return the link statistics: how much data was used, damaged and lost since the driver began.

        Returns
        -------
        mapping of str to int
            Such as ``{"sentences": 120, "damaged": 3, "lost": 1}``: the used data first.
        """
        ...


@runtime_checkable
class IdentifiedSensor(Protocol):
    """A driver of a sensor that states its own serial number."""

    def serial_number(self) -> str:
        """Return the serial number that the sensor states."""
        ...


def link_in_words(link_statistics: Mapping[str, int]) -> str:
    """Return link statistics as text: ``120 sentences, 3 damaged, 1 lost``."""
    return ", ".join(f"{number} {what}" for what, number in link_statistics.items())

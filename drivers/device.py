"""What a driver offers: readings, and the facts of the model it drives."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import sqrt
from typing import TYPE_CHECKING, Protocol, runtime_checkable

if TYPE_CHECKING:
    from tiltcal.drivers.bus.address import Address
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.bus.link import Link
    from tiltcal.drivers.twin.fixture import HeldPose
    from tiltcal.drivers.twin.truth import Truth


@dataclass(frozen=True, slots=True)
class Reading:
    """One sample of every channel.

    Attributes
    ----------
    values : tuple of float
        One per channel of the model, in the model's unit.
    temperature : float or None
        The sensor's own thermometer, °C; None where it has none.
    """

    values: tuple[float, ...]
    temperature: float | None = None


class Sensor(Protocol):
    """A driver at work on one link: bytes in, readings out."""

    def probe(self) -> Mapping[str, str]:
        """Check that the device answers sanely.

        Returns
        -------
        mapping of str to str
            What the device said of itself, for the operator to read.

        Raises
        ------
        HardwareError
            It does not answer, or shows a fault.
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
        """Forget what arrived before now, so that the next reading is a new one.

        Nothing to do for a sensor that is asked for each sample; one that talks by itself drops what has queued up.

        Raises
        ------
        BusError
            The transaction failed.
        """
        ...


@dataclass(frozen=True, slots=True)
class SpiPort:
    """How a part is spoken to over SPI.

    Attributes
    ----------
    modes : tuple of int
        Clock modes (CPOL and CPHA as bits 1 and 0) that the part works in, the preferred one first.
    fastest : int or None
        Highest clock, Hz; None where its maker's word on it is not at hand.
    speed : int or None
        Clock where the address names none, Hz; None is the fastest.
    slowest : int
        Lowest clock at which the part's words do not change while they are read, Hz.
    """

    modes: tuple[int, ...]
    fastest: int | None
    speed: int | None = None
    slowest: int = 1


@dataclass(frozen=True, slots=True)
class Population:
    """How the parts of a model behave over temperature, on average.

    Attributes
    ----------
    drift : tuple of float
        Mean offset, coefficients of 1, T, T², ... with T in °C, in unit.
    gain : tuple of float
        Mean relative change of the sensitivity, likewise.
    drift_spread, gain_spread : float
        Standard deviation over parts of the slopes, unit/°C and 1/°C.
    source : str
    """

    drift: tuple[float, ...]
    gain: tuple[float, ...]
    drift_spread: float
    gain_spread: float
    source: str


@dataclass(frozen=True)
class Model:
    """The facts of one sensor model, and how to make its driver and its twin.

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
        Address schemes that reach it.
    addresses : tuple of str
        An example address for each way to reach it, the first one foremost.
    offset : float
        Nominal reading at 0 g, in unit.
    sensitivity : float
        Nominal sensitivity, in unit/g.
    offset_spread : float
        Standard deviation of the offset over parts, in g.
    sensitivity_spread : float
        Standard deviation of the sensitivity over parts, relative.
    rails : tuple of float
        A reading at or beyond one of these is no measurement, in unit.
    resolution : float
        The step of a reading, in unit; 0 where it is continuous.
    interval : float
        Seconds between samples that lets the reading renew itself.
    thermometer : bool
        Whether the sensor reports its own temperature.
    population : Population or None
        Its parts over temperature, where the maker says so.
    thermometer_step : float
        The step of that report, °C; 0 where it is continuous.
    driver : callable
        ``driver(link, clock)`` returns the :class:`Sensor`.
    twin : callable
        ``twin(truth, fixture, clock)`` returns a :class:`Link` that answers as the part would.
    not_modelled : tuple of str
        What the twin leaves out, shown by ``tiltcal devices``.
    default_truth : callable or None
        ``default_truth(seed)`` draws a plausible part for a ``sim:`` address without a twin file.
    spi : SpiPort or None
        None where the part has no SPI.
    options : tuple of str
        Options of an address that belong to the device and not to its bus, such as which input is wired to x.
    scaled : bool
        Whether the nominal offset and sensitivity are known. Where they are not, a wrong position and a movement too
        small for the noise cannot be told.
    configure : callable or None
        ``configure(address)`` returns this model with the facts that such options settle; None where there are none.
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

    @property
    def thermometer_rounding(self) -> float:
        """Standard uncertainty of the sensor's own temperature that comes of its step, °C."""
        return round(self.thermometer_step / sqrt(12.0), 4)

    @property
    def senses_tilt(self) -> bool:
        """Whether the readings are components of gravity, x, y and z, and nothing else."""
        return set(self.channels) <= {"x", "y", "z"}

    def at(self, address: Address) -> Model:
        """This model as it is wired at an address.

        Raises
        ------
        UsageError
            An option of the address is missing or wrong.
        """
        return self if self.configure is None else self.configure(address)


class SelfTestResult(Protocol):
    """What one channel did in its self-test; its text says it to the operator."""

    @property
    def passed(self) -> bool:
        """Whether it did what the part should do."""
        ...


@runtime_checkable
class SelfTesting(Protocol):
    """A driver whose part can test itself."""

    def self_test(self, channel: str) -> SelfTestResult:
        """Let one channel test itself.

        Raises
        ------
        HardwareError
            As :meth:`Sensor.read`.
        """
        ...


@runtime_checkable
class StreamingSensor(Protocol):
    """A driver that counts what its line loses or damages, of a sensor that talks by itself or adds a checksum."""

    def link_statistics(self) -> Mapping[str, int]:
        """What became of what the sensor said since the driver began.

        Returns
        -------
        mapping of str to int
            In words such as ``{"sentences": 120, "damaged": 3, "lost": 1}``: first what was used, then what was not.
        """
        ...


def in_words(link_statistics: Mapping[str, int]) -> str:
    """A link_statistics for people: ``120 sentences, 3 damaged, 1 lost``."""
    return ", ".join(f"{number} {what}" for what, number in link_statistics.items())

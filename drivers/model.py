"""The interface of a driver, and the facts of a sensor model."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import degrees, sqrt
from typing import NamedTuple

from tiltcal.drivers.bus import Device, Link
from tiltcal.drivers.bus.address import Address
from tiltcal.drivers.bus.clock import Clock
from tiltcal.drivers.virtual import HeldPose, Truth
from tiltcal.errors import UsageError

ACCELERATION = ("m/s2", "m/s^2", "m/s²")

OF_G = {"g": 1.0, "mg": 1000.0, "mm/s2": 9806.65, **dict.fromkeys(ACCELERATION, 9.80665)}
"""What 1 g is in the units that imply a nominal sensitivity."""

OF_TILT = {
    **dict.fromkeys(("degree", "deg", "°"), degrees(1.0)),
    "rad": 1.0,
    **dict.fromkeys(("mrad", "mm/m"), 1000.0),
    **dict.fromkeys(("urad", "µrad"), 1e6),
    "%": 100.0,
    "arcmin": 60.0 * degrees(1.0),
    "arcsec": 3600.0 * degrees(1.0),
}
"""What a tilt of 1 rad is in the units of angle and slope, near level: a change of 1 g there."""

SLOPES = {unit: OF_TILT[unit] for unit in ("mm/m", "%")}
"""The units of those that are the tangent of a tilt, with what a tangent of 1 is."""

NO_TWIN_MODELS = (
    "response time and bandwidth: a new position takes effect at once, and the noise of two samples is independent",
    "supply and start-up; noise, loss and damage on the line",
)


@dataclass(frozen=True, slots=True)
class Reading:
    """One sample of every channel.

    values: one per channel of the model, in the model's unit.
    temperature: of the sensor's own thermometer, °C; None where it has none.
    step: with which the values were written, in the model's unit, where the model states no resolution and the sample
        shows one; else 0.
    """

    values: tuple[float, ...]
    temperature: float | None = None
    step: float = field(default=0.0, compare=False)


class SelfTest(NamedTuple):
    """The self-test of one channel: its word at rest, while an electrode pushes the mass, and after that, count."""

    before: int
    deflected: int
    after: int
    full_scale: int

    def __str__(self) -> str:
        return f"{self.before} count at rest, {self.deflected} while pushed, {self.after} after the recovery"

    @property
    def passed(self) -> bool:
        """Whether it moved to at least 95 % of the supply, and returned to within 5 % of its first value."""
        return self.deflected >= 0.95 * self.full_scale and abs(self.after - self.before) <= 0.05 * self.before


class Sensor(ABC):
    """The base of every driver, which is made on one link: what it has to do, and what it may do.

    channels: of its readings, as :meth:`probe` names them.
    """

    channels: Sequence[str] = "xyz"

    def probe(self) -> Mapping[str, str]:
        """Return what the device reports about itself, for the operator: a new reading and the link statistics."""
        self.discard()
        said = in_words(self.read(), self.channels, "{:g}", trimmed=True)
        counts = self.link_statistics()
        return said | ({"link": link_in_words(counts)} if counts else {})

    @abstractmethod
    def read(self) -> Reading:
        """Take one sample; a failed transaction is a BusError, bytes that show a fault of the device a DeviceFault."""

    def discard(self) -> None:  # noqa: B027 - a sensor that is read sample by sample has nothing to discard
        """Discard what arrived before now, so that the next reading is a new one; a failure is a BusError."""

    def link_statistics(self) -> Mapping[str, int]:
        """Return how much data was used, damaged and lost since the driver began, the used data first.

        Such as ``{"sentences": 120, "damaged": 3, "lost": 1}``; empty where the sensor neither streams nor adds a
        checksum.
        """
        return {}

    def serial_number(self) -> str:
        """Return the serial number that the sensor states; empty where it states none."""
        return ""

    def self_test(self, channel: str) -> SelfTest:
        """Start the self-test of one channel; a part without one is a UsageError."""
        raise UsageError("this model has no self-test")


@dataclass(frozen=True, slots=True)
class Population:
    """The mean temperature curves of the parts of a model.

    drift, gain: mean offset (unit) and mean relative change of the sensitivity, coefficients of 1, T, T², ... in °C.
    drift_spread, gain_spread: standard deviation over parts of the slopes, unit/°C and 1/°C.
    """

    drift: tuple[float, ...]
    gain: tuple[float, ...]
    drift_spread: float
    gain_spread: float
    source: str


@dataclass(frozen=True, kw_only=True)
class Model(Device):
    """The facts of one sensor model, with its driver and its twin.

    title: maker, part and interface.
    channels, unit: names of the readings (x, y, z of a tilt sensor, any others of another device); their unit, such as
        ``count``, ``V`` or ``duty``.
    angles: the convention of readings that are angles, one of CONVENTIONS; None where it is not stated.
    offset, sensitivity: nominal reading at 0 g, unit; nominal, unit/g.
    offset_spread, sensitivity_spread: standard deviation between parts, g; relative.
    rails: a reading at or beyond one of these is not a measurement, unit.
    resolution: the step of a reading, unit; 0 where it is continuous.
    interval: shortest time between two samples that gives a new reading, s.
    thermometer, thermometer_step: whether the sensor reports its own temperature, and its step, °C (0: continuous).
    driver: ``driver(link, clock)`` returns the :class:`Sensor`.
    twin: ``twin(truth, fixture, clock)`` returns a :class:`~tiltcal.drivers.bus.Link` that answers as the part
        would: ``fixture`` holds it, in the sensor frame, and ``clock`` has the time of the session.
    not_modelled: what the twin does not model, beyond what no twin does (:attr:`omissions`).
    memory_fault: whether the part shows a fault of its memory, and its twin the fault ``parity``.
    default_truth: ``default_truth(seed)`` draws a plausible part, the same one for one seed, for a ``sim:`` address
        without a twin file.
    configure: ``configure(address)`` returns this model with the facts that these options state.
    population: its mean temperature curves, if the maker states them.
    scaled: whether the nominal offset and sensitivity are known; without them, a wrong position and a small movement
        cannot be detected.
    cross_axis_limit: largest sensitivity to each of the other axes, relative; 0 where no source states it.
    nonlinearity: typical square and cube of the response to a g, pure numbers; empty where no source states them.
    """

    title: str
    channels: tuple[str, ...]
    unit: str = "count"
    angles: str | None = None
    offset: float = 0.0
    sensitivity: float
    offset_spread: float
    sensitivity_spread: float
    rails: tuple[float, float]
    resolution: float = 0.0
    interval: float = 0.0
    thermometer: bool = False
    thermometer_step: float = 0.0
    driver: Callable[[Link, Clock], Sensor]
    twin: Callable[[Truth, HeldPose, Clock], Link]
    default_truth: Callable[[int], Truth]
    not_modelled: tuple[str, ...] = ()
    memory_fault: bool = False
    population: Population | None = None
    scaled: bool = True
    configure: Callable[[Address], Model] | None = None
    cross_axis_limit: float = 0.0
    nonlinearity: tuple[float, ...] = ()

    @property
    def thermometer_rounding(self) -> float:
        """Standard uncertainty of the sensor's own temperature due to its step, °C."""
        return round(self.thermometer_step / sqrt(12.0), 4)

    @property
    def senses_tilt(self) -> bool:
        """Whether the readings are components of gravity, x, y and z, and nothing else."""
        return set(self.channels) <= {"x", "y", "z"}

    @property
    def omissions(self) -> tuple[str, ...]:
        """What the twin does not model, for ``tiltcal devices``."""
        return (*NO_TWIN_MODELS, *self.not_modelled, *(() if self.memory_fault else ("a fault of a memory (parity)",)))

    def at(self, address: Address) -> Model:
        """Return this model as it is connected at an address."""
        return self if self.configure is None else self.configure(address)


def deviation_within(limit: float) -> float:
    """Return the standard deviation of errors of either sign within a limit: a rectangular distribution (GUM 4.3.7)."""
    return limit / sqrt(3.0)


def typical_nonlinearity(error: float, extent: float) -> tuple[float, float]:
    """Return the square and the cube that each err by so much, g, at the ends of a range of ±extent, g."""
    return error / extent**2, error / extent**3


def link_in_words(link_statistics: Mapping[str, int]) -> str:
    """Return link statistics as text: ``120 sentences, 3 damaged, 1 lost``."""
    return ", ".join(f"{number} {what}" for what, number in link_statistics.items())


def in_words(
    reading: Reading, channels: Iterable[str] = "xyz", form: str = "{:.0f} count", *, trimmed: bool = False
) -> dict[str, str]:
    """Return a reading as text; ``trimmed`` is whether the maker has calibrated the thermometer."""
    said = {channel: form.format(value) for channel, value in zip(channels, reading.values, strict=False)}
    if reading.temperature is not None:
        said["temperature"] = f"{reading.temperature:.1f} °C{'' if trimmed else ' (not trimmed)'}"
    return said

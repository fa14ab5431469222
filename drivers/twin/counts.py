"""Virtual parts that answer in counts: conversions, faults, buses, and simulated tolerances."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import cos, pi, sin
from typing import TYPE_CHECKING, ClassVar, Protocol

from tiltcal.drivers.twin.noise import normal, tolerances, uniform
from tiltcal.drivers.twin.truth import LEVEL, Truth
from tiltcal.errors import BusError

if TYPE_CHECKING:
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.twin.fixture import HeldPose
    from tiltcal.drivers.twin.truth import Fault

REFERENCE = 25.0
"""Temperature of the errors of a simulated part, °C."""

SPI_BIT_SECONDS = 1.0 / 500_000
I2C_BIT_SECONDS = 1.0 / 100_000


class Conversions:
    """The words of a virtual part, conversion by conversion.

    They depend on the truth, the pose, the temperature and the time alone, so a session that is killed and resumed
    goes on with the bytes it would have had.

    Parameters
    ----------
    fixture : HeldPose
        Holds the sensor, in the sensor frame.
    clock : Clock
        Session time.
    """

    def __init__(self, truth: Truth, fixture: HeldPose, clock: Clock) -> None:
        self._truth = truth
        self._fixture = fixture
        self._clock = clock

    def fault(self) -> Fault | None:
        """Return the fault that is present now, if any.

        Raises
        ------
        BusError
            The sensor is unplugged.
        """
        fault = self._truth.fault(self._clock.now_ns() / 1e9)
        if fault is not None and fault.kind == "unplugged":
            raise BusError("the virtual sensor is unplugged, a fault that its truth sets: resume the session later")
        return fault

    def word(self, channel: str, rate: float, low: int, high: int, scale: float = 1.0) -> int:
        """Return a channel with the noise of the present conversion, rounded and clipped, count.

        Parameters
        ----------
        rate : float
            Conversions a second.
        low, high : int
            What the word cannot go beyond.
        scale : float
            Counts of the measuring range that is set, to those of the truth.
        """
        gravity, temperature = self._fixture.gravity, self._fixture.temperature(self._truth.lag)
        now = self._clock.now_ns() / 1e9
        fault = self.fault()
        if fault is not None and fault.kind == "stuck":
            # Held at its level value: a function of the fault alone, so a resumed session reads the same words.
            gravity, temperature, now = LEVEL, self._truth.ambient, fault.start
        reading = self._truth.reading(channel, gravity, temperature)
        noise = self._truth.noise.get(channel, 0.0)
        if noise:
            reading += noise * normal(self._truth.seed, f"noise {channel}", int(now * rate))
        return min(max(round(scale * reading), low), high)

    def temperature(self) -> float:
        """Return what the part's own thermometer measures now, °C."""
        return self._fixture.temperature() + self._truth.thermometer_error

    def filler(self) -> int:
        """Return a random byte, where the data sheet leaves the byte undefined."""
        return int(uniform(self._truth.seed, "filler", self._clock.now_ns()) * 256)


class Registers(Protocol):
    """The registers of a virtual part."""

    @property
    def conversions(self) -> Conversions:
        """The source of its words."""
        ...

    def read(self, first: int, count: int) -> bytes:
        """Return ``count`` registers of one moment, from ``first`` on in the order of the part."""
        ...

    def write(self, register: int, value: int) -> None:
        """Set a register."""
        ...

    def recalled(self) -> None:
        """Take the state of a part after the setup by its driver."""
        ...


class CountingUp(ABC):
    """Registers whose address counts up in a burst, with a flag for a new sample.

    Parameters
    ----------
    clock : Clock
        Session time.
    after_reset : mapping of int to int
        What registers hold after a reset; the others hold 0.
    set_up : mapping of int to int
        What the driver sets.
    """

    FLAG: ClassVar[int]
    """The register whose bit 0 is the flag."""
    CLEARED_BY: ClassVar[int]
    """The register whose reading clears the flag."""

    def __init__(
        self, conversions: Conversions, clock: Clock, after_reset: Mapping[int, int], set_up: Mapping[int, int]
    ) -> None:
        self.conversions = conversions
        self._clock = clock
        self._after_reset = after_reset
        self._set_up = set_up
        self._held = dict(after_reset)
        self._taken = -1

    def read(self, first: int, count: int) -> bytes:
        """Return ``count`` registers from ``first`` up, all of one moment."""
        held = self._held
        if rate := self._rate:
            sample = int(self._clock.now_ns() / 1e9 * rate)
            held = {**held, **self._measured(rate), self.FLAG: int(sample > self._taken)}
            if first <= self.CLEARED_BY < first + count:
                self._taken = sample
        return bytes(held.get(register, 0) for register in range(first, first + count))

    def write(self, register: int, value: int) -> None:
        """Set a register; data and identity registers keep their content."""
        self._held[register] = value

    def recalled(self) -> None:
        """Take the state of a part after the setup by its driver."""
        self._held = {**self._after_reset, **self._set_up}

    def _reset(self) -> None:
        self._held = dict(self._after_reset)

    @property
    @abstractmethod
    def _rate(self) -> float:
        """Samples a second; 0 where nothing is measured."""

    @abstractmethod
    def _measured(self, rate: float) -> dict[int, int]:
        """Return the registers of temperature and data."""


class SpiTwin:
    """A part with registers on the SPI bus.

    The clock advances by each frame's bits at 500 kHz.

    Parameters
    ----------
    clock : Clock
        Session time.
    decode : callable
        Takes a command byte apart: register, and whether it writes.
    """

    letter = "s"

    def __init__(self, registers: Registers, clock: Clock, decode: Callable[[int], tuple[int, bool]]) -> None:
        self._registers = registers
        self._clock = clock
        self._decode = decode
        self._recalling = False

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Answer one frame; see :class:`~tiltcal.drivers.bus.link.Link`."""
        if not out:
            return b""
        fault = self._registers.conversions.fault()
        if fault is not None and fault.kind == "silent":
            answer = b"\xff" * len(out)
        else:
            # It is unknown what the part sends during the command byte, so it is random here.
            filler = bytes([self._registers.conversions.filler()])
            register, writing = self._decode(out[0])
            if writing:
                self._registers.write(register, out[-1])
                answer = filler + bytes(len(out) - 1)
            else:
                answer = filler + self._registers.read(register, len(out) - 1)
        self._clock.sleep(8 * len(out) * SPI_BIT_SECONDS)
        return answer

    def recall(self, out: bytes, now_ns: int) -> None:
        """Take what was written at an earlier time; in mid-session the part is already set up."""
        if not self._recalling:
            self._registers.recalled()
            self._recalling = True
        register, writing = self._decode(out[0])
        began_ns = now_ns - round(8 * len(out) * SPI_BIT_SECONDS * 1e9)
        if writing:
            at_time(self._clock, began_ns, lambda: self._registers.write(register, out[-1]))
        else:
            at_time(self._clock, began_ns, lambda: self._registers.read(register, len(out) - 1))

    def close(self) -> None:
        """Do nothing: there is nothing to release."""


class I2cTwin:
    """A part with registers on the I2C bus.

    The clock advances by each transaction's bits at 100 kHz. The register pointer is kept from the write to the read of
    one transaction.

    Parameters
    ----------
    clock : Clock
        Session time.
    decode : callable
        Takes the first byte that is written to the register it stands for.
    """

    letter = "i"

    def __init__(self, registers: Registers, clock: Clock, decode: Callable[[int], int] = int) -> None:
        self._registers = registers
        self._clock = clock
        self._decode = decode
        self._recalling = False

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Answer one transaction; see :class:`~tiltcal.drivers.bus.link.Link`."""
        fault = self._registers.conversions.fault()
        if fault is not None and fault.kind == "silent":
            raise BusError("no device acknowledges, a fault that the virtual sensor's truth sets")
        register = self._decode(out[0]) if out else 0
        if len(out) > 1:
            self._registers.write(register, out[1])
        answer = self._registers.read(register, count)
        # Each byte has an acknowledge; write and read each begin with an address byte.
        sent = 1 + len(out) + (1 + count if count else 0)
        self._clock.sleep(9 * sent * I2C_BIT_SECONDS)
        return answer

    def recall(self, out: bytes, now_ns: int) -> None:
        """Take what was written at an earlier time; in mid-session the part is already set up."""
        if not self._recalling:
            self._registers.recalled()
            self._recalling = True
        if len(out) > 1:
            at_time(self._clock, now_ns, lambda: self._registers.write(self._decode(out[0]), out[1]))
        elif out:
            # The number of bytes that were read is not known; the first one takes the sample.
            at_time(self._clock, now_ns, lambda: self._registers.read(self._decode(out[0]), 1))

    def close(self) -> None:
        """Do nothing: there is nothing to release."""


def at_time(clock: Clock, now_ns: int, act: Callable[[], object]) -> None:
    """Call ``act`` with the clock set to another session time, in nanoseconds, and set the clock back."""
    present_ns = clock.now_ns()
    clock.seek(now_ns)
    try:
        act()
    finally:
        clock.seek(present_ns)


@dataclass(frozen=True, slots=True)
class Tolerances:
    """The tolerances of a model; every error is uniformly distributed within its limit.

    Attributes
    ----------
    offset : float
        g.
    sensitivity, cross : float
        Relative to the nominal sensitivity, and to the part's own.
    drift : float
        Of the offset, g/°C.
    gain : float
        Of the sensitivity, 1/°C.
    noise : float
        Standard deviation of one sample, g.
    thermometer : float
        °C.
    """

    offset: float
    sensitivity: float
    cross: float
    drift: float
    gain: float
    noise: float
    thermometer: float


def draw_truth(channels: tuple[str, ...], counts_per_g: float, limits: Tolerances, seed: int) -> Truth:
    """Draw a plausible part, on a jig of 0.01° in a chamber with a time constant of 20 s.

    Parameters
    ----------
    channels : tuple of str
        Axes that it measures.
    counts_per_g : float
        Nominal.
    seed : int
        The same seed is the same part.
    """
    within = tolerances(seed)

    def row(channel: str) -> dict[str, float]:
        own = counts_per_g * (1.0 + within(limits.sensitivity, f"sensitivity {channel}"))
        cross, direction = own * within(limits.cross, f"cross {channel}"), within(pi, f"direction {channel}")
        first, second = (other for other in "xyz" if other != channel)
        return {channel: own, first: cross * cos(direction), second: cross * sin(direction)}

    return Truth(
        channels=channels,
        offset={channel: counts_per_g * within(limits.offset, f"offset {channel}") for channel in channels},
        sensitivity={channel: row(channel) for channel in channels},
        reference=REFERENCE,
        drift={channel: (counts_per_g * within(limits.drift, f"drift {channel}"),) for channel in channels},
        gain={channel: (within(limits.gain, f"gain {channel}"),) for channel in channels},
        noise=dict.fromkeys(channels, counts_per_g * limits.noise),
        thermometer_error=within(limits.thermometer, "thermometer"),
        seed=seed,
        jig=0.01,
        ambient=24.0,
        time_constant=20.0,
    )

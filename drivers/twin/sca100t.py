"""The virtual SCA100T: a link that answers the bytes of the part."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import comb, cos, exp, log, pi, radians, sin
from typing import TYPE_CHECKING, ClassVar

from tiltcal.drivers.sca100t import (
    CROSS_AXIS_LIMIT,
    DRIFT_SPREAD,
    FULL_SCALE,
    GAIN_SPREAD,
    LOWEST_SANE_WORD,
    MEAS,
    POPULATION_DRIFT,
    POPULATION_GAIN,
    RDAX,
    RDAY,
    RWTR,
    SENSITIVITY_LIMIT,
    STX,
    STY,
    ZERO,
    Sca100tVariant,
)
from tiltcal.drivers.twin.noise import normal, uniform
from tiltcal.drivers.twin.truth import Polynomial, Truth
from tiltcal.errors import BusError

if TYPE_CHECKING:
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.twin.fixture import HeldPose, Vector
    from tiltcal.drivers.twin.truth import Fault

LEVEL: Vector = (0.0, 0.0, 1.0)

RELOAD_NS = 150_000
"""Time between two reloads of the output registers."""

BIT_SECONDS = 1.0 / 500_000

POINTS_DOWN = -0.065
"""Below this acceleration, in g, an axis does not count as level for the self-test; the datasheet states no number."""


class Sca100tTwin:
    """An SCA100T on the SPI bus, bit by bit.

    The answer to a frame depends on the truth, the pose, the temperature and the time alone, so a session that is
    killed and resumed continues with the same bytes. There is a short-term state: the time when chip select last rose,
    because the registers need 150 µs to reload, and a self-test in progress.

    Parameters
    ----------
    fixture : HeldPose
        Holds the sensor, in the sensor frame.
    clock : Clock
        Session time; each frame advances it by its bits at 500 kHz.
    """

    letter = "s"

    ELEMENTS: ClassVar[Mapping[int | None, str]] = {RDAX: "x", RDAY: "y"}
    """The sensing element behind each command."""

    def __init__(self, truth: Truth, fixture: HeldPose, clock: Clock) -> None:
        self._truth = truth
        self._fixture = fixture
        self._clock = clock
        self._released_ns: int | None = None
        self._latched = self._instant()
        self._pushes = {"x": Push(), "y": Push()}

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Answer one frame; see :class:`~tiltcal.drivers.bus.link.Link`."""
        fault = self._truth.fault(self._clock.now_ns() / 1e9)
        if fault is not None and fault.kind == "unplugged":
            raise BusError("the virtual sensor is unplugged, a fault that its truth sets: resume the session later")
        self._reload()
        floating = b"\xff" * len(out)
        driven = b"" if fault is not None and fault.kind == "silent" else self._driven(out, fault)
        self._clock.sleep(8 * len(out) * BIT_SECONDS)
        self._released_ns = self._clock.now_ns()
        return (driven + floating)[: len(out)]

    def close(self) -> None:
        """Do nothing: there is nothing to release."""

    def _reload(self) -> None:
        """Reload the registers, unless chip select rose too recently."""
        if self._released_ns is None or self._clock.now_ns() - self._released_ns >= RELOAD_NS:
            self._latched = self._instant()

    def _instant(self) -> Instant:
        fixture = self._fixture
        element = fixture.temperature(self._truth.lag)
        return Instant(self._clock.now_ns(), fixture.gravity, element, fixture.temperature())

    def _driven(self, out: bytes, fault: Fault | None) -> bytes:
        """Return the bytes that the part drives; none for an invalid command, where the line floats."""
        command = out[0] if out else None
        now_ns = self._clock.now_ns()
        filler = int(uniform(self._truth.seed, "filler", now_ns) * 2**24).to_bytes(3, "big")
        channel = self.ELEMENTS.get(command)
        if channel is not None:
            word = self._word(channel, fault)
            return bytes([filler[0], word >> 3, (word & 0b111) << 5 | filler[2] & 0b11111])
        if command == RWTR:
            return bytes([filler[0], self._thermometer()])
        if command in (STX, STY, MEAS):
            self._pushes["x"] = self._pushes["x"].switched(command == STX, now_ns)
            self._pushes["y"] = self._pushes["y"].switched(command == STY, now_ns)
            return filler[:1]
        return b""

    def _word(self, channel: str, fault: Fault | None) -> int:
        """Return the output register of a channel, count."""
        if fault is not None and fault.kind == "parity":
            return int(uniform(self._truth.seed, f"parity {channel}", self._latched.conversion) * LOWEST_SANE_WORD)
        if fault is not None and fault.kind == "stuck":
            # Held at its level value: a function of the fault alone, so a resumed session reads the same word.
            return self._converted(channel, Instant(round(fault.start * 1e9), LEVEL, self._truth.ambient))
        return self._converted(channel, self._latched)

    def _converted(self, channel: str, instant: Instant) -> int:
        """Return the reading of an instant with its noise, rounded, and clipped to 11 bits."""
        reading, noise = self._reading(channel, instant)
        reading += self._reach(channel, instant) * self._pushes[channel].at(instant.now_ns)
        if noise:
            reading += noise * normal(self._truth.seed, f"noise {channel}", instant.conversion)
        return min(max(round(reading), 0), FULL_SCALE)

    def _reading(self, channel: str, instant: Instant) -> tuple[float, float]:
        """Return what an element reads, and the standard deviation of its noise, count."""
        reading = self._truth.reading(channel, instant.gravity, instant.temperature)
        return reading, self._truth.noise.get(channel, 0.0)

    def _reach(self, channel: str, instant: Instant) -> float:
        """Return the change of the reading by a full push, count: past the rail, or 1 g if the axis points down."""
        if instant.gravity["xyz".index(channel)] < POINTS_DOWN:
            return self._truth.sensitivity[channel][channel]
        return 0.75 * FULL_SCALE

    def _thermometer(self) -> int:
        """Return the temperature register, by the datasheet's formula."""
        seen = self._latched.thermometer + self._truth.thermometer_error
        return min(max(round(197.0 - 1.083 * seen), 0), 255)


@dataclass(frozen=True, slots=True)
class Instant:
    """The input of the converter when the registers were loaded.

    Attributes
    ----------
    now_ns : int
        Session time.
    gravity : tuple of float
        Up in the sensor frame, g.
    temperature, thermometer : float
        Of the sensing element and of the part's thermometer, °C.
    """

    now_ns: int
    gravity: Vector
    temperature: float
    thermometer: float = 0.0

    @property
    def conversion(self) -> int:
        """The number of the conversion, one per 150 µs; it numbers the noise."""
        return self.now_ns // RELOAD_NS


@dataclass(frozen=True, slots=True)
class Push:
    """The deflection of the proof mass of one axis by the self-test electrode, from 0 (free) to 1.

    Attributes
    ----------
    since_ns : int or None
        Time of the last switch; None if there was none.
    start : float
        Deflection at that time.
    """

    on: bool = False
    since_ns: int | None = None
    start: float = 0.0

    SATURATION: ClassVar[float] = 25e-3
    """Typical time to 95 % of the deflection, s."""
    RECOVERY: ClassVar[float] = 30e-3
    """Typical time to 95 % of the recovery, s."""

    def switched(self, on: bool, now_ns: int) -> Push:
        """Return the deflection after a command; a command without an effect on this axis changes nothing."""
        return self if on == self.on else Push(on, now_ns, self.at(now_ns))

    def at(self, now_ns: int) -> float:
        """Return the deflection now."""
        if self.since_ns is None:
            return 0.0
        goal, typical = (1.0, self.SATURATION) if self.on else (0.0, self.RECOVERY)
        elapsed = max(now_ns - self.since_ns, 0) / 1e9
        return goal + (self.start - goal) * exp(-elapsed * log(20.0) / typical)


REFERENCE = 25.0
"""Temperature of the errors of a simulated part as delivered, °C."""


def draw_truth(variant: Sca100tVariant, seed: int) -> Truth:
    """Return a plausible part, with errors uniformly distributed within the tolerances of the datasheet.

    Parameters
    ----------
    seed : int
        The same seed is the same part.

    Returns
    -------
    Truth
        With noise of 0.6 count (the datasheet's 0.0008 °/√Hz is far below the 11-bit step; a bench is not), a
        thermometer within 2 °C (the datasheet calls it untrimmed and gives no limit), a jig of 0.01° and a chamber with
        a time constant of 20 s, all three ours.
    """
    channels = ("x", "y")

    def within(limit: float, name: str) -> float:
        return limit * (2.0 * uniform(seed, f"part {name}", 0) - 1.0)

    def row(channel: str) -> dict[str, float]:
        own = variant.counts_per_g * (1.0 + within(SENSITIVITY_LIMIT, f"sensitivity {channel}"))
        cross, direction = within(CROSS_AXIS_LIMIT, f"cross {channel}"), within(pi, f"direction {channel}")
        other = "y" if channel == "x" else "x"
        return {channel: own, other: own * cross * cos(direction), "z": own * cross * sin(direction)}

    def drift(channel: str) -> Polynomial:
        linear, *higher = recentred(POPULATION_DRIFT, REFERENCE)[1:]
        degrees = (linear + within(DRIFT_SPREAD, f"drift {channel}"), *higher)
        return tuple(variant.counts_per_g * radians(k) for k in degrees)

    def gain(channel: str) -> Polynomial:
        mean, linear, *higher = recentred(POPULATION_GAIN, REFERENCE)
        percent = (linear + within(GAIN_SPREAD, f"gain {channel}"), *higher)
        return tuple(k / (100.0 + mean) for k in percent)

    def bend(channel: str) -> Polynomial:
        # Each term has half of the tolerance, so that their sum keeps it at the end of the range.
        half = sin(radians(variant.nonlinearity)) / 2.0
        return (
            within(half, f"quadratic {channel}") / variant.range**2,
            within(half, f"cubic {channel}") / variant.range**3,
        )

    offset_limit = variant.counts_per_g * sin(radians(variant.offset_limit))
    return Truth(
        channels=channels,
        offset={channel: ZERO + within(offset_limit, f"offset {channel}") for channel in channels},
        sensitivity={channel: row(channel) for channel in channels},
        reference=REFERENCE,
        drift={channel: drift(channel) for channel in channels},
        gain={channel: gain(channel) for channel in channels},
        nonlinearity={channel: bend(channel) for channel in channels},
        noise=dict.fromkeys(channels, 0.6),
        thermometer_error=within(2.0, "thermometer"),
        seed=seed,
        jig=0.01,
        ambient=24.0,
        time_constant=20.0,
    )


def recentred(coefficients: Polynomial, centre: float) -> Polynomial:
    """Return the same polynomial in powers of (T - centre) instead of T, the constant term first in both."""
    return tuple(
        sum(k * comb(power, n) * centre ** (power - n) for power, k in enumerate(coefficients) if power >= n)
        for n in range(len(coefficients))
    )

"""The virtual SCA100T: a link that answers the bytes of the part."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import comb, exp, log, radians, sin
from typing import TYPE_CHECKING, ClassVar

from tiltcal.drivers.sca100t import (
    CROSS_AXIS_LIMIT,
    FULL_SCALE,
    LOWEST_SANE_WORD,
    MEAS,
    RDAX,
    RDAY,
    RWTR,
    SENSITIVITY_LIMIT,
    STX,
    STY,
)
from tiltcal.drivers.twin.link import TwinLink
from tiltcal.drivers.twin.noise import normal, uniform
from tiltcal.drivers.twin.tolerances import REFERENCE, Tolerances, part_errors
from tiltcal.drivers.twin.truth import LEVEL, Polynomial, Truth

if TYPE_CHECKING:
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.sca100t import InclinometerPart
    from tiltcal.drivers.twin.fixture import HeldPose, Vector
    from tiltcal.drivers.twin.truth import Fault

RELOAD_NS = 150_000
"""Time between two reloads of the output registers."""

BIT_SECONDS = 1.0 / 500_000

POINTS_DOWN = -0.065
"""Below this acceleration, in g, an axis does not count as level for the self-test; the datasheet states no number."""


class Sca100tTwin(TwinLink):
    """An SCA100T on the SPI bus, bit by bit.

    The answer to a frame depends on the truth, the pose, the temperature and the time alone, so a session that is
    killed and resumed continues with the same bytes. There is a short-term state: the time when chip select last rose,
    because the registers need 150 µs to reload, and a self-test in progress.

    Parameters
    ----------
    clock : Clock
        Session time; each frame advances it by its bits at 500 kHz.
    """

    letter = "s"

    ELEMENTS: ClassVar[Mapping[int | None, str]] = {RDAX: "x", RDAY: "y"}
    """The sensing element behind each command."""

    def __init__(self, truth: Truth, fixture: HeldPose, clock: Clock) -> None:
        super().__init__(clock)
        self._truth = truth
        self._fixture = fixture
        self._released_ns: int | None = None
        self._latched = self._instant()
        self._pushes = {"x": Push(), "y": Push()}

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Answer one frame; see :class:`~tiltcal.drivers.bus.link.Link`."""
        fault = self._truth.fault_on_link(self._clock.now_ns())
        self._reload()
        floating = b"\xff" * len(out)
        driven = b"" if fault.kind == "silent" else self._driven(out, fault)
        self._clock.sleep(8 * len(out) * BIT_SECONDS)
        self._released_ns = self._clock.now_ns()
        return (driven + floating)[: len(out)]

    def _reload(self) -> None:
        """Reload the registers, unless chip select rose too recently."""
        if self._released_ns is None or self._clock.now_ns() - self._released_ns >= RELOAD_NS:
            self._latched = self._instant()

    def _instant(self) -> Instant:
        fixture = self._fixture
        element = fixture.temperature(self._truth.lag)
        return Instant(self._clock.now_ns(), fixture.gravity, element, fixture.temperature())

    def _driven(self, out: bytes, fault: Fault) -> bytes:
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

    def _word(self, channel: str, fault: Fault) -> int:
        """Return the output register of a channel, count."""
        if fault.kind == "parity":
            return int(uniform(self._truth.seed, f"parity {channel}", self._latched.conversion) * LOWEST_SANE_WORD)
        if fault.kind == "stuck":
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


def draw_truth(part: InclinometerPart, seed: int) -> Truth:
    """Return a plausible part, with errors uniformly distributed within the tolerances of the datasheet.

    Returns
    -------
    Truth
        With noise of 0.6 count: the datasheet's 0.0008 °/√Hz is far below the 11-bit step; a bench is not.
    """
    within = part_errors(seed)
    # Each term has half of the tolerance, so that their sum keeps it at the end of the range.
    square, cube = part.nonlinearity
    return replace(
        draw_inclinometer(part, 0.6, seed),
        nonlinearity={
            channel: (within(square / 2.0, f"quadratic {channel}"), within(cube / 2.0, f"cubic {channel}"))
            for channel in "xy"
        },
    )


def draw_inclinometer(part: InclinometerPart, noise: float, seed: int) -> Truth:
    """Draw a part within its tolerances, whose drift and sensitivity follow the data sheet's mean curves.

    The thermometer within 2 °C (the data sheets call it untrimmed and give no limit) and the fixture are ours.

    Parameters
    ----------
    noise : float
        Standard deviation of a reading, count.
    """
    limits = Tolerances(
        offset=sin(radians(part.offset_limit)),
        sensitivity=SENSITIVITY_LIMIT,
        cross=CROSS_AXIS_LIMIT,
        drift=part.population.drift_spread / part.counts_per_g,
        gain=part.population.gain_spread,
        noise=noise / part.counts_per_g,
        thermometer=2.0,
    )
    truth = limits.draw(part.channels, part.counts_per_g, seed)
    _, slope, *higher = recentred(part.population.drift, REFERENCE)
    mean, steepness, *bends = recentred(part.population.gain, REFERENCE)
    return replace(
        truth,
        offset={channel: part.zero + offset for channel, offset in truth.offset.items()},
        drift={channel: (slope + drift, *higher) for channel, (drift,) in truth.drift.items()},
        gain={
            channel: tuple(k / (1.0 + mean) for k in (steepness + gain, *bends))
            for channel, (gain,) in truth.gain.items()
        },
    )


def recentred(coefficients: Polynomial, centre: float) -> Polynomial:
    """Return the same polynomial in powers of (T - centre) instead of T, the constant term first in both."""
    return tuple(
        sum(k * comb(power, n) * centre ** (power - n) for power, k in enumerate(coefficients) if power >= n)
        for n in range(len(coefficients))
    )

"""Murata (VTI) SCA100T two-axis, and SCA103T and SCA61T one-axis inclinometers on their SPI port, with virtual parts.

One command byte starts each frame, most significant bit first; chip select stays low for the whole frame::

    RDAX 0x10, RDAY 0x11   command, then 11 bits left-aligned in two bytes; the low 5 bits have no meaning
    RWTR 0x08              command, then 8 bits of temperature
    STX 0x0E, STY 0x0F     start the self-test of one axis
    MEAS 0x00              back to measuring

The SCA103T has two elements on one axis that look opposite ways; its reading is RDAX less RDAY. A memory parity error
drives both words below 102, and their difference would be that of a level part, so each word is judged by itself. The
SCA61T has one element and is asked for nothing but RDAX and the temperature.

Sources: SCA100T Series data sheet, Murata doc. 8261800 Rev. B2; SCA103T data sheet, VTI 8261700 Rev. A; of the SCA61T
(8261900) the title page, pages 10 to 12 and what drivers quote of its curves. Its limits as delivered were not found:
they are taken as those of the SCA100T, which has the same element.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import comb, radians, sin, sqrt
from typing import Any, ClassVar

from tiltcal.drivers.bus import Link, SpiPort, check_data_line, require_length
from tiltcal.drivers.bus.clock import SECOND, Clock
from tiltcal.drivers.model import Model, Population, Reading, SelfTest, Sensor, deviation_within, typical_nonlinearity
from tiltcal.drivers.virtual import (
    REFERENCE,
    HeldPose,
    Polynomial,
    Tolerances,
    Truth,
    VirtualPart,
    part_errors,
    uniform,
)
from tiltcal.errors import DeviceFault, UsageError

MEAS, RWTR, STX, STY, RDAX, RDAY = 0x00, 0x08, 0x0E, 0x0F, 0x10, 0x11
FULL_SCALE = 2047  # largest 11-bit word; it corresponds to the supply voltage
ZERO = 1024  # nominal word at 0 g
LOWEST_SANE_WORD = 102  # after a memory parity error or a broken interconnection, the part sends words below this one
HIGHEST_SANE_WORD = 1945  # largest word of an SCA103T; a larger one is a broken connection or a tilt out of range
REFRESH, RECOVERY = 150e-6, 15e-6
"""Seconds of chip select high before a read (the output registers reload every 150 µs, but not while it is low), and
before any other frame."""
PUSH, SETTLING = 80e-3, 150e-3
"""Seconds of self-test (20 to 100 ms are allowed, saturation takes 25 ms typically), and after it: typically stable
after 55 ms; nearly three times that allows for slow parts."""

SENSITIVITY_LIMIT = 0.005  # largest relative error of the sensitivity as delivered
CROSS_AXIS_LIMIT = 0.04  # largest sum of the two cross-axis sensitivities, relative to the channel's own
SLOPES = (0.008, 0.014)
"""Typical deviation of the slopes of offset (°/°C) and sensitivity (%/°C) from the mean of the parts."""

NOT_MODELLED = (
    "output registers that reload every 150 µs: each read has the word of its moment",
    "thermometer noise; ratiometric error; long-term drift, temperature hysteresis, shock",
    "clock and pauses that the part does not allow; status register and reload command (RDSR, RLOAD)",
    "self-test of both axes at once, of an axis that points down, and how a push builds up and dies away",
)


class Sca61t(Sensor):
    """The driver of an SCA61T, x in counts, 0 to 2047; and what the drivers of the family share."""

    COMMANDS: ClassVar[Mapping[str, int]] = {"x": RDAX}
    """What reads each of the part's output registers."""

    def __init__(self, link: Link, clock: Clock) -> None:
        self._link = link
        self._clock = clock
        self._words: tuple[int, ...] = ()
        """Of the last sample."""

    def probe(self) -> Mapping[str, str]:
        """Take a sample; return its words and the temperature as text, if it is one at which such a part works."""
        temperature = self.read().temperature or 0.0
        # The thermometer is not trimmed, so 10 °C are added to both ends of the part's operating range.
        if not -50.0 <= temperature <= 135.0:
            raise DeviceFault(
                f"the device reports {temperature:.0f} °C, where such a part works from -40 °C to 125 °C: "
                "is another device on this chip select?"
            )
        return {**self._said(), "temperature": f"{temperature:.1f} °C (not trimmed)"}

    def read(self) -> Reading:
        """Take one sample: the channels in counts, and the temperature in °C."""
        answers = [*map(self._answer, self.COMMANDS.values()), self._answer(RWTR, 2)]
        check_data_line(b"".join(answers))
        self._words = tuple(map(self._checked, self.COMMANDS, answers))
        return Reading(self._values(), decode_temperature(answers[-1]))

    def _answer(self, command: int, length: int = 3) -> bytes:
        self._clock.sleep(REFRESH)
        return require_length(self._link.exchange(bytes([command]).ljust(length, b"\0")), length, "frame")

    def _said(self) -> dict[str, str]:
        """Return the words for the operator."""
        return {channel: f"{word} count" for channel, word in zip(self.COMMANDS, self._words, strict=True)}

    def _values(self) -> tuple[float, ...]:
        """Return the readings, count."""
        return tuple(map(float, self._words))

    def _checked(self, channel: str, frame: bytes) -> int:
        """Return the word of a frame; a fault signal is none."""
        word = decode_word(frame)
        if word < LOWEST_SANE_WORD:
            raise DeviceFault(
                f"{channel} reads {word} count, and words below {LOWEST_SANE_WORD} are the part's fault signal (memory "
                "parity error or broken interconnection): switch its supply off and on; if it stays, replace the part"
            )
        return word


class Sca100t(Sca61t):
    """The driver of an SCA100T, either variant: x and y in counts, 0 to 2047."""

    COMMANDS: ClassVar[Mapping[str, int]] = {"x": RDAX, "y": RDAY}

    def probe(self) -> Mapping[str, str]:
        """End a self-test that another program may have left running, then probe as :class:`Sca61t` does."""
        self._command(MEAS)
        self._clock.sleep(SETTLING)
        return super().probe()

    def self_test(self, channel: str) -> SelfTest:
        """Push one axis with its electrode, and test whether it moves and returns, in about a quarter of a second.

        The sensor must lie still. The datasheet forbids both axes at once.
        """
        if channel not in ("x", "y"):
            raise UsageError(f"an SCA100T has channels x and y, not {channel!r}")
        return self._pushed(channel, STX if channel == "x" else STY, self.COMMANDS[channel])

    def _pushed(self, channel: str, start: int, read: int) -> SelfTest:
        """Let one element test itself."""
        before = self._word(channel, read)
        if before < 0.95 * ZERO:
            raise UsageError(
                f"{channel} reads {before} count, so this axis points down, where the self-test has no meaning: "
                "lay the sensor level and repeat it"
            )
        try:
            self._command(start)
            self._clock.sleep(PUSH)
            deflected = self._word(channel, read)
        finally:
            self._command(MEAS)
        self._clock.sleep(SETTLING)
        return SelfTest(before, deflected, self._word(channel, read), FULL_SCALE)

    def _word(self, channel: str, command: int) -> int:
        frame = self._answer(command)
        check_data_line(frame)
        # An element that is pushed is at its rail.
        return Sca61t._checked(self, channel, frame)

    def _command(self, command: int) -> None:
        self._clock.sleep(RECOVERY)
        self._link.exchange(bytes([command]))


class Sca103t(Sca100t):
    """The driver of an SCA103T: the difference of its two elements in counts."""

    COMMANDS: ClassVar[Mapping[str, int]] = {"RDAX": RDAX, "RDAY": RDAY}

    def self_test(self, channel: str) -> SelfTest:
        """Push one element, then the other; return the first that does not pass, or the second one."""
        if channel != "x":
            raise UsageError(f"an SCA103T has channel x, no {channel!r}")
        first, second = self._pushed("RDAX", STX, RDAX), self._pushed("RDAY", STY, RDAY)
        return second if first.passed else first

    def _said(self) -> dict[str, str]:
        plus, minus = self._words
        both = f"{plus} and {minus} count, together {plus + minus} (2048 but for temperature and supply)"
        return {"x": f"{plus - minus} count", "elements": both}

    def _values(self) -> tuple[float, ...]:
        return (float(self._words[0] - self._words[1]),)

    def _checked(self, channel: str, frame: bytes) -> int:
        word = decode_word(frame)
        if not LOWEST_SANE_WORD <= word <= HIGHEST_SANE_WORD:
            raise DeviceFault(
                f"{channel} reads {word} count, outside {LOWEST_SANE_WORD} to {HIGHEST_SANE_WORD}: it is tilted "
                "beyond its range, or shows a memory parity error or a broken connection: bring it near level; if "
                "it stays, switch its supply off and on"
            )
        return word


def decode_word(frame: bytes) -> int:
    """Return the 11-bit word of an answer to RDAX or RDAY, 0 to 2047 count; 1024 at 0 g."""
    return frame[1] << 3 | frame[2] >> 5


def decode_temperature(frame: bytes) -> float:
    """Return the temperature of an answer to RWTR, °C, by the datasheet's formula (the part is not trimmed)."""
    return (frame[1] - 197) / -1.083


RELOAD_NS = 150_000  # time between two conversions, which number the noise
SATURATION = 25e-3  # typical time to 95 % of the deflection of a self-test, s


class VirtualSca100t(VirtualPart):
    """An SCA100T on the SPI bus at 500 kHz; its state is the self-test in progress. An SCA61T has its first element."""

    letter, bit_seconds = "s", 1.0 / 500_000

    def __init__(self, truth: Truth, fixture: HeldPose, clock: Clock) -> None:
        super().__init__(truth, fixture, clock)
        self._pushed = ""
        """The element that the self-test pushes."""
        self._since_ns = 0

    def _answered(self, out: bytes, count: int) -> bytes:
        return (self._driven(out) + b"\xff" * len(out))[: len(out)]

    def _driven(self, out: bytes) -> bytes:
        """Return the bytes that the part drives; none for an invalid command, where the line floats."""
        command = out[0] if out else None
        filler = int(uniform(self._truth.seed, "filler", self._clock.now_ns()) * 2**24).to_bytes(3, "big")
        if command in (RDAX, RDAY):
            word = self._output("x" if command == RDAX else "y")
            return bytes([filler[0], word >> 3, (word & 0b111) << 5 | filler[2] & 0b11111])
        if command == RWTR:
            return bytes([filler[0], min(max(round(197.0 - 1.083 * self._celsius()), 0), 255)])
        if command in (STX, STY, MEAS):
            pushed = {STX: "x", STY: "y"}.get(command, "")
            if pushed != self._pushed:
                self._pushed, self._since_ns = pushed, self._clock.now_ns()
            return filler[:1]
        return b""

    def _output(self, element: str) -> int:
        """Return the output register of an element, count."""
        if self._fault().kind == "parity":
            conversion = self._clock.now_ns() // RELOAD_NS
            return int(uniform(self._truth.seed, f"parity {element}", conversion) * LOWEST_SANE_WORD)
        reading = self._element(element, self._clock.now_ns() // RELOAD_NS)
        if element == self._pushed and self._clock.now_ns() - self._since_ns >= SATURATION * SECOND:
            # A push moves the element past the rail; of one that points down the driver takes no self-test.
            reading += 0.75 * FULL_SCALE
        return min(max(round(reading), 0), FULL_SCALE)

    def _element(self, element: str, number: int) -> float:
        """Return what an element reads in a conversion, count."""
        return self._truth.sample(element, self._fixture, self._clock, number)


class VirtualSca103t(VirtualSca100t):
    """An SCA103T: each element holds half of the difference about its middle, one with either sign."""

    def _element(self, element: str, number: int) -> float:
        half = super()._element("x", number) / 2.0
        return ZERO + (half if element == "x" else -half)


def _recentred(coefficients: Polynomial, centre: float) -> Polynomial:
    """Return the same polynomial in powers of (T - centre) instead of T, the constant term first in both."""
    return tuple(
        sum(k * comb(power, n) * centre ** (power - n) for power, k in enumerate(coefficients) if power >= n)
        for n in range(len(coefficients))
    )


def _draw(model: Model, population: Population, seed: int) -> Truth:
    """Draw a part whose drift and sensitivity follow the mean curves of the population.

    The thermometer is within 2 °C, which is ours: the data sheets call it untrimmed and give no limit. So is the noise:
    the data sheets' 0.0008 °/√Hz is far below the 11-bit step; a bench is not.
    """
    limits = Tolerances(
        offset=model.offset_spread * sqrt(3.0),
        sensitivity=SENSITIVITY_LIMIT,
        cross=CROSS_AXIS_LIMIT,
        drift=population.drift_spread / model.sensitivity,
        gain=population.gain_spread,
        thermometer=2.0,
    )
    noise = 0.6 if model.offset else 0.8
    truth = limits.draw(model.channels, model.sensitivity, noise, seed, model.offset)
    _, slope, *higher = _recentred(population.drift, REFERENCE)
    mean, steepness, *bends = _recentred(population.gain, REFERENCE)
    within, nonlinearity = part_errors(seed), {}
    if model.nonlinearity:
        # Each term of the response has half of the tolerance, which their sum then keeps.
        square, cube = (k / 2.0 for k in model.nonlinearity)
        nonlinearity = {
            channel: (within(square, f"quadratic {channel}"), within(cube, f"cubic {channel}"))
            for channel in model.channels
        }
    return replace(
        truth,
        drift={channel: (slope + drift, *higher) for channel, (drift,) in truth.drift.items()},
        gain={
            channel: tuple(k / (1.0 + mean) for k in (steepness + gain, *bends))
            for channel, (gain,) in truth.gain.items()
        },
        nonlinearity=nonlinearity,
    )


def _inclinometer(
    part: str,
    title: str,
    counts_per_g: float,
    offset_limit: float,
    bend: tuple[float, float] | None,
    *,
    drift: Sequence[float],
    gain: Sequence[float],
    source: str,
    slopes: tuple[float, float] = SLOPES,
    **facts: Any,
) -> Model:
    """Return the model of a part; bus, waits, bandwidth and thermometer are the same in the whole family.

    offset_limit, bend: largest offset of either sign, degrees; nonlinearity, degrees, at the ends of a range, g.
    drift, gain: mean offset over the parts in degrees and mean change of the sensitivity in %, coefficients of 1, T,
        T², ... with T in °C; slopes: standard deviation over parts, °/°C and %/°C; source: of both.
    """
    population = Population(
        drift=tuple(counts_per_g * radians(k) for k in drift),
        gain=tuple(k / 100.0 for k in gain),
        drift_spread=counts_per_g * radians(slopes[0]),
        gain_spread=slopes[1] / 100.0,
        source=source,
    )
    model = Model(
        name=part.lower(),
        title=f"{title.format(part)}, SPI",
        addresses=("spi:///dev/spidev0.0",),
        sensitivity=counts_per_g,
        offset_spread=deviation_within(sin(radians(offset_limit))),
        sensitivity_spread=deviation_within(SENSITIVITY_LIMIT),
        nonlinearity=typical_nonlinearity(sin(radians(bend[0])), bend[1]) if bend else (),
        resolution=1.0,
        # The bandwidth is 8 to 28 Hz: the noise of an earlier sample is not independent.
        interval=0.010,
        thermometer=True,
        thermometer_step=1.0 / 1.083,
        population=population,
        # The data sheets state the cross-axis sensitivity where they state the nonlinearity.
        cross_axis_limit=CROSS_AXIS_LIMIT if bend else 0.0,
        not_modelled=NOT_MODELLED,
        memory_fault=True,
        spi=SpiPort(modes=(0, 3), fastest=500_000),
        default_truth=lambda seed: _draw(model, population, seed),
        **facts,
    )
    return model


ABOUT_ZERO: dict[str, Any] = {"offset": float(ZERO), "rails": (float(LOWEST_SANE_WORD - 1), float(FULL_SCALE))}
"""Of the parts whose reading is that of an element."""
REACH = float(HIGHEST_SANE_WORD - LOWEST_SANE_WORD + 1)

SCA100T: dict[str, Any] = {
    "drift": (0.0522, -0.0039, 0.0001, -0.0000006),
    "gain": (0.0408, 0.0022, -0.00011),
    "source": "SCA100T data sheet 8261800 Rev. B2, mean temperature curves",
    "driver": Sca100t,
    "twin": VirtualSca100t,
    "channels": ("x", "y"),
    **ABOUT_ZERO,
}
SCA103T: dict[str, Any] = {
    # Its offset has no tendency; the slope differs over parts.
    "drift": (0.0, 0.0),
    "gain": (-0.031, 0.0032, -0.00005, -0.0000005),
    "source": "SCA103T data sheet 8261700 Rev. A, mean temperature curve of the sensitivity",
    "slopes": (0.002, 0.013),
    "driver": Sca103t,
    "twin": VirtualSca103t,
    "channels": ("x",),
    "rails": (-REACH, REACH),
}
SCA61T: dict[str, Any] = {
    "drift": (0.0514, -0.0032, 0.0000857, -0.0000005),
    "gain": (0.0362, 0.0019, -0.00011),
    "source": "SCA61T data sheet 8261900, mean temperature curves as a driver quotes them; their spread over parts is "
    "the SCA100T's",
    "driver": Sca61t,
    "twin": VirtualSca100t,
    "channels": ("x",),
    **ABOUT_ZERO,
}
ONE_AXIS = "VTI (Murata) {} one-axis inclinometer"

D01 = _inclinometer("SCA100T-D01", "Murata {} inclinometer, ±30°", 1638.0, 0.11, (0.11, 0.5), **SCA100T)
D02 = _inclinometer("SCA100T-D02", "Murata {} inclinometer, ±90°", 819.0, 0.23, (0.57, 1.0), **SCA100T)
MODELS = {
    model.name: model
    for model in (
        D01,
        D02,
        _inclinometer("SCA103T-D04", f"{ONE_AXIS}, ±15°", 6554.0, 0.057, (0.057, sin(radians(15.0))), **SCA103T),
        _inclinometer("SCA103T-D05", f"{ONE_AXIS}, ±30°", 3277.0, 0.11, (0.11, 0.5), **SCA103T),
        _inclinometer("SCA61T-FAHH1G", f"{ONE_AXIS}, ±30°", 1638.0, 0.11, None, **SCA61T),
        _inclinometer("SCA61T-FA1H1G", f"{ONE_AXIS}, ±90°", 819.0, 0.23, None, **SCA61T),
    )
}

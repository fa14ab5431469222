"""Murata (VTI) SCA100T dual-axis inclinometer on its SPI port.

One command byte starts each frame, most significant bit first; chip select stays low for the whole frame::

    RDAX 0x10, RDAY 0x11   command, then 11 bits left-aligned in two bytes; the low 5 bits have no meaning
    RWTR 0x08              command, then 8 bits of temperature
    STX 0x0E, STY 0x0F     start the self-test of one axis
    MEAS 0x00              back to measuring

Source: SCA100T Series data sheet, Murata doc. 8261800 Rev. B2.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import radians, sin
from typing import TYPE_CHECKING, ClassVar

from tiltcal.drivers.bus.link import require_length
from tiltcal.drivers.device import (
    Model,
    Population,
    Reading,
    SpiPort,
    deviation_within,
    from_twin,
    typical_nonlinearity,
)
from tiltcal.drivers.registers import check_data_line
from tiltcal.errors import DeviceFault, UsageError

if TYPE_CHECKING:
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.bus.link import Link

MEAS, RWTR, STX, STY, RDAX, RDAY = 0x00, 0x08, 0x0E, 0x0F, 0x10, 0x11

FULL_SCALE = 2047
"""Largest 11-bit word; it corresponds to the supply voltage."""

ZERO = 1024
"""Nominal word at 0 g."""

LOWEST_SANE_WORD = 102
"""After a memory parity error or a broken interconnection, the part sends words below this one."""


@dataclass(frozen=True, slots=True)
class SelfTest:
    """The result of the self-test of one axis, in which an electrode pushes the proof mass.

    Attributes
    ----------
    channel : str
        x or y.
    before, deflected, after : int
        Word at rest, during the push, and after the recovery, count.
    """

    channel: str
    before: int
    deflected: int
    after: int

    def __str__(self) -> str:
        return f"{self.before} count at rest, {self.deflected} while pushed, {self.after} after the recovery"

    @property
    def deflection_passed(self) -> bool:
        """Whether the push moved the output to at least 95 % of the supply."""
        return self.deflected >= 0.95 * FULL_SCALE

    @property
    def recovery_passed(self) -> bool:
        """Whether the output returned to within 5 % of its first value."""
        return abs(self.after - self.before) <= 0.05 * self.before

    @property
    def passed(self) -> bool:
        """Whether the axis passed."""
        return self.deflection_passed and self.recovery_passed


class Inclinometer:
    """What the drivers of the family share: frames, their waits, and the sane range of a word."""

    COMMANDS: ClassVar[Mapping[str, int]]
    """What reads each of the part's output registers."""

    REFRESH = 150e-6
    """Seconds of chip select high before a read: the output registers reload every 150 µs, but not while it is low."""
    RECOVERY = 15e-6
    """Seconds of chip select high before any other frame."""

    def __init__(self, link: Link, clock: Clock) -> None:
        self._link = link
        self._clock = clock

    def probe(self) -> Mapping[str, str]:
        """Check that the device answers plausibly.

        Returns
        -------
        mapping of str to str
            The words it sent, and the temperature.

        BusError: no answer, or a data line that never changes.
        DeviceFault: the part reports a fault, or a temperature at which it cannot work.
        """
        words, temperature = self._sample()
        # The thermometer is not trimmed, so 10 °C are added to both ends of the part's operating range.
        if not -50.0 <= temperature <= 135.0:
            raise DeviceFault(
                f"the device reports {temperature:.0f} °C, where such a part works from -40 °C to 125 °C: "
                "is another device on this chip select?"
            )
        return {**self._said(words), "temperature": f"{temperature:.1f} °C (not trimmed)"}

    def read(self) -> Reading:
        """Take one sample: the channels in counts, and the temperature in °C.

        Raises
        ------
        BusError
            The transaction failed, or every bit of the sample is the same.
        DeviceFault
            A word that is a fault of the part.
        """
        words, temperature = self._sample()
        return Reading(self._values(words), temperature)

    def discard(self) -> None:
        """Do nothing: every read is a new conversion."""

    def _said(self, words: Mapping[str, int]) -> dict[str, str]:
        """Return the words for the operator."""
        return {channel: f"{word} count" for channel, word in words.items()}

    def _values(self, words: Mapping[str, int]) -> tuple[float, ...]:
        """Return the reading of each channel, count."""
        return tuple(map(float, words.values()))

    def _sample(self) -> tuple[dict[str, int], float]:
        """Return every word in counts and the temperature in °C, once it is sure that a part has sent them."""
        answers = []
        for frame in (*((command, 0, 0) for command in self.COMMANDS.values()), (RWTR, 0)):
            self._clock.sleep(self.REFRESH)
            answers.append(require_length(self._link.exchange(bytes(frame)), len(frame), "frame"))
        check_data_line(b"".join(answers))
        words = {
            channel: self._checked(channel, answer) for channel, answer in zip(self.COMMANDS, answers, strict=False)
        }
        return words, decode_temperature(answers[-1])

    def _checked(self, channel: str, frame: bytes) -> int:
        """Return the word of a frame; a fault signal is none."""
        word = decode_word(frame)
        if word < LOWEST_SANE_WORD:
            raise DeviceFault(
                f"{channel} reads {word} count, and words below {LOWEST_SANE_WORD} are the part's fault signal (memory "
                "parity error or broken interconnection): switch its supply off and on; if it stays, replace the part"
            )
        return word

    def _fresh(self, *frame: int) -> bytes:
        """Exchange a frame that reads a register, after the reload time of the register."""
        self._clock.sleep(self.REFRESH)
        return require_length(self._link.exchange(bytes(frame)), len(frame), "frame")

    def _command(self, command: int) -> None:
        self._clock.sleep(self.RECOVERY)
        self._link.exchange(bytes([command]))


class Sca100t(Inclinometer):
    """The driver of an SCA100T, either variant: x and y in counts, 0 to 2047."""

    COMMANDS: ClassVar[Mapping[str, int]] = {"x": RDAX, "y": RDAY}

    PUSH = 80e-3
    """Seconds of self-test: the datasheet allows 20 to 100 ms, saturation takes 25 ms typically."""
    SETTLING = 150e-3
    """Seconds after the self-test: typically stable after 55 ms; nearly three times that allows for slow parts."""

    def probe(self) -> Mapping[str, str]:
        """End a self-test that another program may have left running, then as :meth:`Inclinometer.probe`."""
        self._command(MEAS)
        self._clock.sleep(self.SETTLING)
        return super().probe()

    def self_test(self, channel: str) -> SelfTest:
        """Push one axis with its electrode, and test whether it moves and returns.

        It takes about a quarter of a second. The sensor must lie still.

        Parameters
        ----------
        channel : str
            x or y. The datasheet forbids both at once.

        UsageError: another channel, or an axis that points down, where the push may not reach the rail of a good part.
        BusError, DeviceFault: as :meth:`read`.
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
            self._clock.sleep(self.PUSH)
            deflected = self._word(channel, read)
        finally:
            self._command(MEAS)
        self._clock.sleep(self.SETTLING)
        return SelfTest(channel, before, deflected, self._word(channel, read))

    def _word(self, channel: str, command: int) -> int:
        frame = self._fresh(command, 0, 0)
        check_data_line(frame)
        # An element that is pushed is at its rail.
        return Inclinometer._checked(self, channel, frame)


def decode_word(frame: bytes) -> int:
    """Return the 11-bit word of an answer to RDAX or RDAY, 0 to 2047 count; 1024 at 0 g.

    The first of its three bytes and the low 5 bits of the last one have no meaning.
    """
    return frame[1] << 3 | frame[2] >> 5


def decode_temperature(frame: bytes) -> float:
    """Return the temperature of an answer to RWTR, °C, by the datasheet's formula (the part is not trimmed)."""
    return (frame[1] - 197) / -1.083


SENSITIVITY_LIMIT = 0.005
"""Largest relative error of the sensitivity as delivered."""
CROSS_AXIS_LIMIT = 0.04
"""Largest sum of the two cross-axis sensitivities, relative to the channel's own."""
DRIFT_SPREAD = 0.008
"""Typical deviation of the offset's slope from the mean of the parts, °/°C."""
GAIN_SPREAD = 0.014
"""Typical deviation of the sensitivity's slope from the mean of the parts, %/°C."""


@dataclass(frozen=True, slots=True)
class InclinometerPart:
    """The constants of one part of the family as delivered.

    Attributes
    ----------
    offset_limit : float
        Largest offset of either sign, degrees.
    nonlinearity : tuple of float
        Typical square and cube of the response, pure numbers; the data sheet states cross-axis sensitivity with them.
    zero : float
        Nominal reading at 0 g, count.
    rails : tuple of float
        count.
    """

    title: str
    channels: tuple[str, ...]
    counts_per_g: float
    offset_limit: float
    population: Population
    nonlinearity: tuple[float, ...] = ()
    zero: float = float(ZERO)
    rails: tuple[float, float] = (float(LOWEST_SANE_WORD - 1), float(FULL_SCALE))


def population(
    counts: float, drift: Sequence[float], gain: Sequence[float], spread: tuple[float, float], source: str
) -> Population:
    """Return the mean temperature curves of a data sheet in counts.

    Parameters
    ----------
    counts : float
        Sensitivity, count/g.
    drift, gain : sequence of float
        Mean offset in degrees and mean change of the sensitivity in %, coefficients of 1, T, T², ... with T in °C.
    spread : tuple of float
        Standard deviation over parts of the slopes, °/°C and %/°C.
    """
    return Population(
        drift=tuple(counts * radians(k) for k in drift),
        gain=tuple(k / 100.0 for k in gain),
        drift_spread=counts * radians(spread[0]),
        gain_spread=spread[1] / 100.0,
        source=source,
    )


NOT_MODELLED = (
    "response time: a new position and a new temperature take effect at once, without ringing",
    "bandwidth: the noise of two samples 150 µs apart is independent",
    "thermometer noise, and a lag between thermometer and sensing element",
    "supply: start-up time, ratiometric error, brown-out",
    "long-term drift, temperature hysteresis, shock",
    "chip select released for less than 15 µs, clock above 500 kHz, bytes damaged by noise",
    "status register and reload command (RDSR, RLOAD): answered as invalid commands",
    "self-test of both axes at once, which the datasheet forbids",
)


def inclinometer_model(
    name: str, part: InclinometerPart, driver: type[Inclinometer], twin_module: str, twin: str
) -> Model:
    """Return the model of a part of the family; bus, waits, bandwidth and thermometer are the SCA100T's."""
    return Model(
        name=name,
        title=part.title,
        channels=part.channels,
        unit="count",
        schemes=("spi",),
        addresses=("spi:///dev/spidev0.0",),
        offset=part.zero,
        sensitivity=part.counts_per_g,
        offset_spread=deviation_within(sin(radians(part.offset_limit))),
        sensitivity_spread=deviation_within(SENSITIVITY_LIMIT),
        rails=part.rails,
        resolution=1.0,
        # The bandwidth is 8 to 28 Hz: the noise of an earlier sample is not independent.
        interval=0.010,
        thermometer=True,
        thermometer_step=1.0 / 1.083,
        population=part.population,
        cross_axis_limit=CROSS_AXIS_LIMIT if part.nonlinearity else 0.0,
        nonlinearity=part.nonlinearity,
        driver=driver,
        twin=from_twin(twin_module, twin),
        not_modelled=NOT_MODELLED,
        default_truth=from_twin(twin_module, "draw_truth", part),
        spi=SpiPort(modes=(0, 3), fastest=500_000),
    )


def _sca100t(
    variant: str, extent: str, counts_per_g: float, offset_limit: float, range_g: float, nonlinearity: float
) -> Model:
    part = InclinometerPart(
        title=f"Murata SCA100T-{variant} inclinometer, {extent}, SPI",
        channels=("x", "y"),
        counts_per_g=counts_per_g,
        offset_limit=offset_limit,
        population=population(
            counts_per_g,
            (0.0522, -0.0039, 0.0001, -0.0000006),
            (0.0408, 0.0022, -0.00011),
            (DRIFT_SPREAD, GAIN_SPREAD),
            "SCA100T data sheet 8261800 Rev. B2, mean temperature curves",
        ),
        nonlinearity=typical_nonlinearity(sin(radians(nonlinearity)), range_g),
    )
    return inclinometer_model(f"sca100t-{variant.lower()}", part, Sca100t, "sca100t", "Sca100tTwin")


D01 = _sca100t("D01", "±30°", counts_per_g=1638.0, offset_limit=0.11, range_g=0.5, nonlinearity=0.11)
D02 = _sca100t("D02", "±90°", counts_per_g=819.0, offset_limit=0.23, range_g=1.0, nonlinearity=0.57)

"""The virtual SCA3000: links that answer the bytes the part would send, over SPI and over I2C."""

from __future__ import annotations

from math import cos, pi, sin
from typing import TYPE_CHECKING

from tiltcal.drivers.sca3000 import (
    CHECKSUM_ERROR,
    COMMAND_SHIFT,
    OVERFLOW,
    REVID,
    STATUS,
    TEMP_LSB,
    TEMP_MSB,
    X_LSB,
    Z_MSB,
    Sca3000Part,
)
from tiltcal.drivers.twin.noise import normal, uniform
from tiltcal.drivers.twin.truth import Truth
from tiltcal.errors import BusError

if TYPE_CHECKING:
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.twin.fixture import HeldPose, Vector
    from tiltcal.drivers.twin.truth import Fault

LEVEL: Vector = (0.0, 0.0, 1.0)

REVISION = 0x21
"""What REVID holds; which values real parts have is not known."""

HIGHEST_REGISTER = 0x3F

SPI_BIT_SECONDS = 1.0 / 500_000
I2C_BIT_SECONDS = 1.0 / 100_000


class Registers:
    """The registers of one virtual part, as they are at a moment.

    They depend on the truth, the pose, the temperature and the time alone, so a session that is killed and resumed
    goes on with the bytes it would have had.

    Parameters
    ----------
    truth : Truth
    fixture : HeldPose
        Holds the sensor; its frame is the sensor's.
    clock : Clock
        Session time.
    part : Sca3000Part
    """

    def __init__(self, truth: Truth, fixture: HeldPose, clock: Clock, part: Sca3000Part) -> None:
        self._truth = truth
        self._fixture = fixture
        self._clock = clock
        self._part = part

    def fault(self) -> Fault | None:
        """The fault that is present now, if any.

        Raises
        ------
        BusError
            The sensor is unplugged.
        """
        fault = self._truth.fault(self._clock.now_ns() / 1e9)
        if fault is not None and fault.kind == "unplugged":
            raise BusError("the virtual sensor is unplugged, a fault that its truth asks for: resume the session later")
        return fault

    def burst(self, first: int, count: int) -> bytes:
        """``count`` registers from ``first`` down, all of one moment."""
        fault = self.fault()
        held = {REVID: REVISION, STATUS: CHECKSUM_ERROR if fault is not None and fault.kind == "parity" else 0}
        held.update(self._data(fault))
        if self._part.thermometer:
            held.update(self._thermometer())
        answer = bytearray()
        register = first
        for _ in range(count):
            answer.append(held.get(register, 0))
            register = Z_MSB if register == X_LSB else (register - 1) & HIGHEST_REGISTER
        return bytes(answer)

    def _data(self, fault: Fault | None) -> dict[int, int]:
        """The six data registers."""
        gravity, temperature = self._fixture.gravity, self._fixture.temperature()
        now = self._clock.now_ns() / 1e9
        if fault is not None and fault.kind == "stuck":
            # Held at what it would be in the level position: a function of the fault alone, so a resumed session finds
            # the same words.
            gravity, temperature, now = LEVEL, self._truth.ambient, fault.start
        conversion = int(now * self._part.rate)
        held = {}
        for place, channel in enumerate("xyz"):
            word = self._word(channel, gravity, temperature, conversion) << 3 & 0xFFFF
            held[X_LSB + 2 * place], held[X_LSB + 2 * place + 1] = word & 0xFF, word >> 8
        return held

    def _word(self, channel: str, gravity: Vector, temperature: float, conversion: int) -> int:
        """A channel with the noise of one conversion, rounded, or its overflow code, count."""
        reading = self._truth.reading(channel, gravity, temperature)
        noise = self._truth.noise.get(channel, 0.0)
        if noise:
            reading += noise * normal(self._truth.seed, f"noise {channel}", conversion)
        low, high = map(int, OVERFLOW)
        return min(max(round(reading), low), high)

    def _thermometer(self) -> dict[int, int]:
        seen = self._fixture.temperature() + self._truth.thermometer_error
        raw = min(max(round(256.0 + 1.8 * (seen - 23.0)), 0), 511)
        return {TEMP_MSB: raw >> 3, TEMP_LSB: (raw & 0b111) << 5}


class Sca3000SpiTwin:
    """An SCA3000 on the SPI bus; see :class:`Registers` for the parameters.

    The clock advances by each frame's bits at 500 kHz.
    """

    letter = "s"

    def __init__(self, truth: Truth, fixture: HeldPose, clock: Clock, part: Sca3000Part) -> None:
        self._registers = Registers(truth, fixture, clock, part)
        self._clock = clock
        self._seed = truth.seed

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Answer one frame; see :class:`~tiltcal.drivers.bus.link.Link`."""
        if not out:
            return b""
        fault = self._registers.fault()
        if fault is not None and fault.kind == "silent":
            answer = b"\xff" * len(out)
        else:
            # What the part sends under the command byte is not known, so it is left to chance.
            under_command = int(uniform(self._seed, "filler", self._clock.now_ns()) * 256)
            answer = bytes([under_command]) + self._registers.burst(out[0] >> COMMAND_SHIFT, len(out) - 1)
        self._clock.sleep(8 * len(out) * SPI_BIT_SECONDS)
        return answer

    def close(self) -> None:
        """Nothing to release."""


class Sca3000I2cTwin:
    """An SCA3000 on the I2C bus; see :class:`Registers` for the parameters.

    The clock advances by each transaction's bits at 100 kHz. The register pointer lives from the write to the read of
    one transaction.
    """

    letter = "i"

    def __init__(self, truth: Truth, fixture: HeldPose, clock: Clock, part: Sca3000Part) -> None:
        self._registers = Registers(truth, fixture, clock, part)
        self._clock = clock
        self._shift = part.pointer_shift

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Answer one transaction; see :class:`~tiltcal.drivers.bus.link.Link`."""
        fault = self._registers.fault()
        if fault is not None and fault.kind == "silent":
            raise BusError("nobody acknowledges, a fault that the virtual sensor's truth asks for")
        answer = self._registers.burst(out[0] >> self._shift if out else REVID, count)
        # Each byte has an acknowledge; write and read each begin with an address byte.
        sent = 1 + len(out) + (1 + count if count else 0)
        self._clock.sleep(9 * sent * I2C_BIT_SECONDS)
        return answer

    def close(self) -> None:
        """Nothing to release."""


REFERENCE = 25.0
"""Where a drawn part's errors are meant, °C."""


def draw_truth(part: Sca3000Part, seed: int) -> Truth:
    """A plausible part: every error drawn evenly within limits that are ours, for no source names the part's.

    Parameters
    ----------
    part : Sca3000Part
    seed : int
        The same seed is the same part.

    Returns
    -------
    Truth
        Offset within 0.05 g, sensitivity within 3 %, cross-axis sensitivity within 2 %, offset drift within 0.5 mg/°C,
        sensitivity drift within 0.01 %/°C, noise of 1.5 count, a thermometer within 2 °C, a jig of 0.01° and a chamber
        with a time constant of 20 s.
    """
    channels = ("x", "y", "z")

    def within(limit: float, name: str) -> float:
        return limit * (2.0 * uniform(seed, f"part {name}", 0) - 1.0)

    def row(channel: str) -> dict[str, float]:
        own = part.counts_per_g * (1.0 + within(0.03, f"sensitivity {channel}"))
        cross, direction = own * within(0.02, f"cross {channel}"), within(pi, f"direction {channel}")
        first, second = (other for other in channels if other != channel)
        return {channel: own, first: cross * cos(direction), second: cross * sin(direction)}

    return Truth(
        channels=channels,
        offset={channel: part.counts_per_g * within(0.05, f"offset {channel}") for channel in channels},
        sensitivity={channel: row(channel) for channel in channels},
        reference=REFERENCE,
        drift={channel: (part.counts_per_g * within(0.5e-3, f"drift {channel}"),) for channel in channels},
        gain={channel: (within(1e-4, f"gain {channel}"),) for channel in channels},
        noise=dict.fromkeys(channels, 1.5),
        thermometer_error=within(2.0, "thermometer"),
        seed=seed,
        jig=0.01,
        ambient=24.0,
        time_constant=20.0,
    )

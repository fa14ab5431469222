"""The virtual ADXL202: sentences of a microcontroller that times its pulses, or the edges of the pulses."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tiltcal.drivers.adxl202 import SENSITIVITY_LIMIT, ZERO, Adxl202Variant
from tiltcal.drivers.bus.edges import RECORD, Edge, pack_edges
from tiltcal.drivers.sentences import checksum
from tiltcal.drivers.twin.noise import uniform
from tiltcal.drivers.twin.streaming import LineTwin, StreamingTwin
from tiltcal.drivers.twin.tolerances import part_errors
from tiltcal.drivers.twin.truth import Truth

if TYPE_CHECKING:
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.twin.fixture import HeldPose

PERIOD = 0.010
"""T2 with a set resistor of 1.25 MΩ, seconds: the longest period, with the finest resolution."""

TIMER = 8_000_000
"""Ticks a second of the virtual microcontroller's timer."""

BAUDRATE = 115_200


class Pulses:
    """Duty cycles and period of a virtual part, cycle by cycle."""

    def __init__(self, truth: Truth, fixture: HeldPose, clock: Clock) -> None:
        self._truth = truth
        self._fixture = fixture
        self._clock = clock

    @property
    def period(self) -> float:
        """T2 at the reference temperature, seconds: within 5 % of nominal, because resistors and parts vary."""
        return PERIOD * (1.0 + 0.05 * (2.0 * uniform(self._truth.seed, "period", 0) - 1.0))

    @property
    def warm_period(self) -> float:
        """T2 now, seconds: 0.1 % longer per °C, so that T1 alone is wrong."""
        return self.period * (1.0 + 1e-3 * (self._fixture.temperature() - self._truth.reference))

    def duty(self, channel: str, number: int) -> float:
        """Return T1/T2 of one axis in one cycle, between 0 and 1."""
        temperature = self._fixture.temperature(self._truth.lag)
        reading = self._truth.sample(channel, self._fixture.gravity, temperature, self._clock.now_ns(), number)
        return min(max(reading, 0.0), 1.0)


def sentences_twin(truth: Truth, fixture: HeldPose, clock: Clock) -> StreamingTwin:
    """Return a microcontroller that times both pulses and sends 100 sentences per second."""
    pulses = Pulses(truth, fixture, clock)

    def sentence(number: int) -> bytes:
        ticks = round(pulses.warm_period * TIMER)
        x, y = (round(pulses.duty(channel, number) * ticks) for channel in ("x", "y"))
        temperature = fixture.temperature() + truth.thermometer_error
        inside = f"PTCDC,{number},{x},{y},{ticks},{ticks},{temperature:.2f}".encode()
        return b"$%s*%02X\r\n" % (inside, checksum(inside))

    return StreamingTwin(truth, clock, sentence, period=PERIOD, baudrate=BAUDRATE)


class EdgesTwin(LineTwin):
    """Both outputs of a virtual part on two captured lines, the pulses of x and y with common centres.

    The answer depends on the time alone: the edges of the next whole period. An edge that was not read at once is lost,
    and leaves a gap in the numbers.

    clock: advances to the end of that period.
    """

    letter = "e"

    def __init__(self, truth: Truth, fixture: HeldPose, clock: Clock) -> None:
        super().__init__(truth, clock)
        self._pulses = Pulses(truth, fixture, clock)
        self._period_ns = round(self._pulses.period * 1e9)

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Wait for the edges of a period; see :class:`~tiltcal.drivers.bus.link.Link`."""
        self._require_line(silent=count > 0)
        if not count:
            return b""
        now_ns = self._clock.now_ns()
        cycle = -(-now_ns // self._period_ns)
        # To the end of the period, not to its last edge, which moves while the temperature of the chamber changes.
        self._clock.sleep(((cycle + 1) * self._period_ns - now_ns) / 1e9)
        edges = self._edges(cycle)[: max(count // RECORD.size, 1)]
        return pack_edges(edges)

    def _edges(self, cycle: int) -> list[Edge]:
        """Return the four edges of a period in the order of time."""
        centre = cycle * self._period_ns + self._period_ns // 2
        found = []
        for line, channel in enumerate(("x", "y")):
            half = round(self._pulses.duty(channel, cycle) * self._period_ns / 2)
            found += [(centre - half, line, True), (centre + half, line, False)]
        return [Edge(time, line, rising, 4 * cycle + place) for place, (time, line, rising) in enumerate(sorted(found))]


def draw_truth(variant: Adxl202Variant, seed: int) -> Truth:
    """Return a plausible part.

    Returns
    -------
    Truth
        Sensitivity within the part's spread; offset within ±0.4 g, a cross-axis sensitivity within 2 %, drifts within
        the typical 2 mg/°C and 0.02 %/°C, noise at 10 Hz of bandwidth, a jig of 0.01° and a chamber with a time
        constant of 20 s. Where no note states a number, these are ours.
    """
    channels = ("x", "y")

    within = part_errors(seed)

    def row(channel: str) -> dict[str, float]:
        own = variant.duty_per_g * (1.0 + within(SENSITIVITY_LIMIT, f"sensitivity {channel}"))
        other = "y" if channel == "x" else "x"
        return {
            channel: own,
            other: own * within(0.02, f"cross {channel}"),
            "z": own * within(0.02, f"cross {channel} z"),
        }

    return Truth(
        channels=channels,
        offset={channel: ZERO + variant.duty_per_g * within(0.4, f"offset {channel}") for channel in channels},
        sensitivity={channel: row(channel) for channel in channels},
        reference=24.0,
        drift={channel: (variant.duty_per_g * within(0.002, f"drift {channel}"),) for channel in channels},
        gain={channel: (within(2e-4, f"gain {channel}"),) for channel in channels},
        noise=dict.fromkeys(channels, variant.duty_per_g * variant.noise_density * (1.57 * 10.0) ** 0.5),
        thermometer_error=within(0.5, "thermometer"),
        seed=seed,
        jig=0.01,
        ambient=24.0,
        time_constant=20.0,
    )

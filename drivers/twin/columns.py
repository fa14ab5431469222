"""A virtual device that prints numbers on a line, 100 lines per second."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tiltcal.drivers.columns import TEMPERATURE, ColumnLayout
from tiltcal.drivers.twin.streaming import StreamingTwin
from tiltcal.drivers.twin.tolerances import part_errors
from tiltcal.drivers.twin.truth import Truth

if TYPE_CHECKING:
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.twin.fixture import HeldPose

PERIOD = 0.010
"""Time between two lines, s."""

BAUDRATE = 115_200


def columns_twin(columns: ColumnLayout, truth: Truth, fixture: HeldPose, clock: Clock) -> StreamingTwin:
    """Return a device that prints the columns of an address; a skipped column is 0."""

    def line(number: int) -> bytes:
        gravity, element, now_ns = fixture.gravity, fixture.temperature(truth.lag), clock.now_ns()
        numbers = {name: truth.sample(name, gravity, element, now_ns, number) for name in columns.channels}
        return columns.line({**numbers, TEMPERATURE: fixture.temperature() + truth.thermometer_error})

    return StreamingTwin(truth, clock, line, period=PERIOD, baudrate=BAUDRATE)


def draw_truth(channels: tuple[str, ...], offset: float, sensitivity: float, seed: int) -> Truth:
    """Return a device near its nominal coefficients; the tolerances are ours.

    offset: nominal, unit.
    sensitivity: nominal, unit/g.
    """
    within = part_errors(seed)

    def row(channel: str) -> dict[str, float]:
        return {
            axis: sensitivity * (1.0 + within(0.03, f"sensitivity {axis}"))
            if axis == channel
            else sensitivity * within(0.02, f"cross {channel} {axis}")
            for axis in "xyz"
        }

    return Truth(
        channels=channels,
        offset={channel: offset + sensitivity * within(0.05, f"offset {channel}") for channel in channels},
        sensitivity={channel: row(channel) for channel in channels},
        reference=24.0,
        drift={channel: (sensitivity * within(0.001, f"drift {channel}"),) for channel in channels},
        noise=dict.fromkeys(channels, abs(sensitivity) * 0.001),
        seed=seed,
        jig=0.01,
        ambient=24.0,
        time_constant=20.0,
    )

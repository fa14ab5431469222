"""A virtual part with its driver, on a line that a test may disturb."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.model import OF_TILT, SLOPES, Model, Reading, Sensor
from tiltcal.drivers.virtual import Fixture
from tiltcal.errors import HardwareError


class Line:
    """The link to a virtual part; it changes answers on demand, and notes what passes."""

    def __init__(self, link: Any, clock: VirtualClock) -> None:
        self.link, self.letter, self.clock = link, link.letter, clock
        self.sent: list[tuple[bytes, bytes, int]] = []
        self.closed = False
        self.mend()

    def mend(self) -> None:
        self.change: Callable[[bytes, bytes], bytes] = lambda out, answer: answer

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        answer = self.change(out, self.link.exchange(out, count))
        self.sent.append((out, answer, self.clock.now_ns()))
        return answer

    def close(self) -> None:
        self.closed = True


class VirtualDevice:
    """A virtual part with a supply of 4.9 V, level at 24 °C, one second after the session began, and its driver."""

    def __init__(self, model: Model, options: str = "", **truth: Any) -> None:
        self.model = model.at(parse_address(f"sim:{options}"))
        self.channels = self.model.channels if self.model.senses_tilt else ()
        self.clock = VirtualClock()
        self.clock.seek(1_000_000_000)
        self.truth = replace(self.model.default_truth(3), supply=4.9, **truth)
        self.fixture = Fixture(self.clock, ambient=24.0)
        self.line = Line(self.part(), self.clock)
        self.sensor: Sensor = self.model.driver(self.line, self.clock)

    def part(self) -> Any:
        return self.model.twin(self.truth, self.fixture, self.clock)

    @property
    def tolerance(self) -> float:
        ticks = 1e-5 if self.model.unit == "duty" else 0.0
        noise = max(self.truth.noise.values(), default=0.0)
        return 6 * noise + 1.5 * self.model.resolution + 1e-4 * abs(self.model.sensitivity) + ticks

    def expected(self, channel: str) -> float:
        unit = self.model.unit
        printed = self.model.angles or "inclination" if unit in OF_TILT else ""
        truth = replace(self.truth, angles=printed, slope=SLOPES.get(unit, 0.0))
        return truth.reading(channel, self.fixture.gravity, self.fixture.temperature())

    def fresh(self) -> Reading:
        """A reading of what is there now."""
        self.sensor.discard()
        reading = self.sensor.read()
        self.clock.sleep(max(self.model.interval, 1e-3))
        return reading

    def after_errors(self) -> Reading:
        """A reading of a part that works again, after two errors at most."""
        for _ in range(2):
            try:
                return self.fresh()
            except HardwareError:
                continue
        return self.fresh()

    def agrees(self, reading: Reading) -> None:
        """Fail unless the reading is the truth, within noise and resolution."""
        if self.channels:
            assert reading.values == pytest.approx(list(map(self.expected, self.channels)), abs=self.tolerance)
        if self.model.thermometer:
            celsius = self.fixture.temperature() + self.truth.thermometer_error
            assert reading.temperature == pytest.approx(celsius, abs=0.06 + 0.51 * self.model.thermometer_step)

    def fails(self, kind: type[Exception] = HardwareError) -> None:
        """Fail unless neither a reading nor a probe is given, and the reason is."""
        for act in (self.sensor.read, self.sensor.probe, self.sensor.read):
            with pytest.raises(kind) as failure:
                act()
            assert len(str(failure.value)) > 15

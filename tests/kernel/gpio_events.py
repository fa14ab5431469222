"""Pulses on the lines of a simulated GPIO chip, through the kernel and the gpiod package to the ADXL202's driver.

Needs root and a kernel with gpio-sim; ``make test-kernel`` boots one. Each edge of a line is one write to a file of
gpio-sim. The clock is read before and after it, so every timestamp of the kernel has known limits, and so has every
duty cycle.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from time import monotonic_ns, sleep
from typing import NamedTuple

from tiltcal.drivers import find_model
from tiltcal.drivers.bus import open_link
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.bus.gpio import KERNEL_BUFFER, RECORD, unpack_edges
from tiltcal.errors import BusError

T2 = 10_000_000
"""The part's longest period, ns."""

PER_G = 0.125
"""Duty cycle per g."""


class Written(NamedTuple):
    """An edge, and the clock before and after it, ns."""

    line: int
    rising: bool
    before: int
    after: int

    @property
    def time(self) -> float:
        return (self.before + self.after) / 2

    @property
    def limit(self) -> float:
        return (self.after - self.before) / 2


class SimulatedChip:
    """A chip of two lines; x is line 0, y is line 1."""

    def __init__(self) -> None:
        self._device = Path("/sys/kernel/config/gpio-sim/adxl202")
        bank = self._device / "bank"
        bank.mkdir(parents=True)
        (bank / "num_lines").write_text("2")
        self.plug(True)
        name = (bank / "chip_name").read_text().strip()
        lines = Path("/sys/devices/platform", (self._device / "dev_name").read_text().strip(), name)
        self._pulls = [os.open(lines / f"sim_gpio{line}" / "pull", os.O_WRONLY) for line in (0, 1)]
        self.address = parse_address(f"gpio:///dev/{name}?x=0&y=1&timeout=0.5")

    def plug(self, plugged: bool) -> None:
        """Make the chip appear or disappear."""
        (self._device / "live").write_text(str(int(plugged)))

    def pulse(self, periods: int, duty: tuple[float, float]) -> list[Written]:
        """Send pulses that rise together, period by period."""
        edges = sorted(
            (period * T2 + round(share * T2 * high), line, rising)
            for period in range(periods)
            for line, high in enumerate(duty)
            for rising, share in ((True, 0.0), (False, 1.0))
        )
        written = []
        start = monotonic_ns()
        for due, line, rising in edges:
            sleep(max(start + due - monotonic_ns(), 0) / 1e9)
            before = monotonic_ns()
            os.pwrite(self._pulls[line], b"pull-up" if rising else b"pull-down", 0)
            written.append(Written(line, rising, before, monotonic_ns()))
        return written


def duty_cycles(written: list[Written]) -> list[tuple[list[float], float]]:
    """Return the duty cycles of each period but the last, and the limit of their error."""
    x, y = ([edge for edge in written if edge.line == line] for line in (0, 1))
    found = []
    for rise in range(0, len(x) - 2, 2):
        highs = [axis[rise + 1].time - axis[rise].time for axis in (x, y)]
        period = x[rise + 2].time - x[rise].time
        limit = sum(edge.limit for axis in (x, y) for edge in axis[rise : rise + 4])
        found.append(([high / period for high in highs], limit / period))
    return found


def check_edges(chip: SimulatedChip) -> str:
    """Every edge arrives once, in order, numbered, and with a time between the clock before it and after it."""
    link = open_link(chip.address, ADXL202)
    written = chip.pulse(100, (0.6, 0.4))
    received = []
    while len(received) < len(written):
        received += unpack_edges(link.exchange(b"", len(written) * RECORD.size))
    link.close()
    assert [edge.number for edge in received] == list(range(1, len(written) + 1))
    for edge, sent in zip(received, written, strict=True):
        assert (edge.line, edge.rising) == (sent.line, sent.rising)
        assert sent.before <= edge.time_ns <= sent.after
    return f"{len(written)} edges, each within {max(edge.limit for edge in written) / 1e3:.0f} µs of its time"


def check_readings(chip: SimulatedChip) -> str:
    """Every reading is the duty cycle that was sent, within the limits of its edges' times."""
    link = open_link(chip.address, ADXL202)
    sent = duty_cycles(chip.pulse(100, (0.5625, 0.4375)))
    driver = ADXL202.driver(link, VirtualClock())
    errors = []
    for duty, limit in sent:
        for value, exact in zip(driver.read().values, duty, strict=True):
            assert abs(value - exact) <= limit, (value, exact, limit)
            errors.append((value - exact) / PER_G * 1000)
    assert driver.link_statistics() == {"periods": len(sent), "lost edges": 0, "torn periods": 0}
    link.close()
    return (
        f"{len(sent)} readings, mean error {sum(errors) / len(errors):+.3f} mg, largest {max(map(abs, errors)):.3f} mg"
    )


def check_overflow(chip: SimulatedChip) -> str:
    """Edges that the kernel drops, because nobody reads, are counted and give no reading."""
    link = open_link(chip.address, ADXL202)
    driver = ADXL202.driver(link, VirtualClock())
    chip.pulse(2, (0.6, 0.4))
    driver.read()
    written = chip.pulse(KERNEL_BUFFER // 4 + 30, (0.6, 0.4))
    sent = duty_cycles(written[-KERNEL_BUFFER:])
    for duty, limit in sent:
        assert max(abs(value - exact) for value, exact in zip(driver.read().values, duty, strict=True)) <= limit
    link.close()
    assert driver.link_statistics()["lost edges"] == len(written) - KERNEL_BUFFER, driver.link_statistics()
    return f"{len(written)} edges unread, {driver.link_statistics()['lost edges']} counted as lost"


def check_refusals(chip: SimulatedChip) -> str:
    """Lines in use, lines that rest, and a chip that is unplugged in mid-session each have their message."""
    link = open_link(chip.address, ADXL202)
    said = [
        message(lambda: open_link(chip.address, ADXL202), "in use by another program"),
        message(lambda: link.exchange(b"", RECORD.size), "no edge on the lines"),
    ]
    chip.plug(False)
    said.append(message(lambda: link.exchange(b"", RECORD.size), "is gone"))
    link.close()
    return "; ".join(said)


def message(action: Callable[[], object], expected: str) -> str:
    """Return the message of the error that an action has to raise."""
    said = "no error"
    try:
        action()
    except BusError as error:
        said = str(error)
    assert expected in said, said
    return said


if __name__ == "__main__":
    chip = SimulatedChip()
    ADXL202 = find_model("adxl202").at(chip.address)
    for check in (check_edges, check_readings, check_overflow, check_refusals):
        print(f"test-kernel: {check.__name__.removeprefix('check_')}: {check(chip)}", flush=True)

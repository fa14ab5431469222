"""Does capture keep up? Serial at full speed and fast edges, through link, journal and driver, with nothing lost.

    python benchmarks/capture.py [--seconds 60] [--baudrate 921600] [--edges 4000] [--json]

A child process talks on a pseudo-terminal as fast as the baudrate allows. Edges come from a stand-in for gpiod's line
request that is as punctual as a kernel and holds as much, since few machines have two wires to spare. Every transaction
goes into a session journal, as at a bench. Exit code 1 where anything was lost or more than half of a core was used.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
import tty
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from tiltcal.bench.devices import RecordedLink, Recorder
from tiltcal.drivers import find_model
from tiltcal.drivers.bus import Link, open_link
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import SystemClock
from tiltcal.journal.lines import JournalWriter

KERNEL_BUFFER = 1024

TALKER = """
import os, sys, time
descriptor, baudrate = map(int, sys.argv[1:])
start, sent, number = time.monotonic(), 0, 0
while True:
    body = b"PTCDC,%d,%d,%d,10000,10000,24.5" % (number, 4000 + number % 2000, 6000 - number % 2000)
    parity = 0
    for byte in body:
        parity ^= byte
    sentence = b"$%s*%02X\\r\\n" % (body, parity)
    while start + sent * 10 / baudrate > time.monotonic():
        time.sleep(0.002)
    sent += len(sentence)
    while sentence:
        sentence = sentence[os.write(descriptor, sentence):]
    number += 1
"""


class PunctualEdges:
    """Stands for gpiod's request of lines 0 and 1: pulses of both, each period four edges.

    Parameters
    ----------
    rate : int
        Edges a second.
    seconds : float
        After which they stop.
    """

    def __init__(self, rate: int, seconds: float) -> None:
        from gpiod import EdgeEvent

        self._kinds = EdgeEvent.Type.FALLING_EDGE, EdgeEvent.Type.RISING_EDGE
        self._period_ns = round(4e9 / rate)
        self.total = int(rate * seconds) // 4 * 4
        self._start_ns = time.monotonic_ns()
        self._taken = 0
        self.dropped = 0

    def wait_edge_events(self, timeout: float) -> bool:
        deadline = time.monotonic() + timeout
        while not self._waiting():
            if self._taken >= self.total or time.monotonic() > deadline:
                return False
            time.sleep(0.0005)
        return True

    def read_edge_events(self, count: int) -> list[SimpleNamespace]:
        waiting = self._waiting()
        if waiting > KERNEL_BUFFER:
            self.dropped += waiting - KERNEL_BUFFER
            self._taken += waiting - KERNEL_BUFFER
        numbers = range(self._taken, self._taken + min(count, self._waiting()))
        self._taken = numbers.stop
        return [self._edge(number) for number in numbers]

    def release(self) -> None:
        """Nothing to release."""

    def _waiting(self) -> int:
        due = (time.monotonic_ns() - self._start_ns) * 4 // self._period_ns
        return min(due, self.total) - self._taken

    def _edge(self, number: int) -> SimpleNamespace:
        period, place = divmod(number, 4)
        # x and y rise together, y falls first.
        part, line = ((0.0, 0), (0.0, 1), (0.375, 1), (0.625, 0))[place]
        return SimpleNamespace(
            timestamp_ns=self._start_ns + period * self._period_ns + round(part * self._period_ns),
            line_offset=line,
            event_type=self._kinds[place < 2],
            global_seqno=number + 1,
        )


def measured(address: str, live: Callable[[], Link], enough: Callable[[Any], bool]) -> tuple[Any, float, int]:
    """Read until it is enough; the driver, the share of one core that it took, and the journal's size in bytes."""
    where = parse_address(address)
    model = find_model("adxl202").at(where)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "capture.jsonl"
        clock = SystemClock(time.time_ns())
        writer = JournalWriter.create(path, {})
        link = RecordedLink(Recorder(clock, writer), live, "r", 0)
        sensor = model.driver(link, clock)
        wall, processor = time.monotonic(), time.process_time()
        while not enough(sensor):
            sensor.read()
        share = (time.process_time() - processor) / (time.monotonic() - wall)
        writer.finish(0)
        link.close()
        return sensor, share, path.stat().st_size


def capture_serial(baudrate: int, seconds: float) -> dict[str, Any]:
    """Sentences as fast as the baudrate carries them."""
    master, slave = os.openpty()
    tty.setraw(slave)
    address = f"serial://{os.ttyname(slave)}?baudrate={baudrate}"
    link = open_link(parse_address(address), find_model("adxl202"))
    with subprocess.Popen(
        [sys.executable, "-c", TALKER, str(master), str(baudrate)],
        pass_fds=[master],
        stdout=subprocess.PIPE,
        text=True,
    ) as talker:
        end = time.monotonic() + seconds
        sensor, share, size = measured(address, lambda: link, lambda _: time.monotonic() > end)
        link_statistics = dict(sensor.link_statistics())
        talker.kill()
    link.close()
    os.close(master)
    os.close(slave)
    return {"baudrate": baudrate, **link_statistics, "core": round(share, 3), "journal_bytes": size}


def capture_edges(rate: int, seconds: float) -> dict[str, Any]:
    """Edges at a steady rate."""
    import gpiod

    stand_in = PunctualEdges(rate, seconds)
    original, gpiod.request_lines = gpiod.request_lines, lambda *_, **__: stand_in
    address = "gpio:///dev/gpiochip0?x=0&y=1"
    try:
        link = open_link(parse_address(address), find_model("adxl202").at(parse_address(address)))
    finally:
        gpiod.request_lines = original
    # The last period has no next one to end it.
    periods = stand_in.total // 4 - 1
    sensor, share, size = measured(address, lambda: link, lambda sensor: sensor.link_statistics()["periods"] >= periods)
    return {
        "edges_per_second": rate,
        **sensor.link_statistics(),
        "dropped": stand_in.dropped,
        "core": round(share, 3),
        "journal_bytes": size,
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--baudrate", type=int, default=921_600)
    parser.add_argument("--edges", type=int, default=4_000)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    serial = capture_serial(options.baudrate, options.seconds)
    edges = capture_edges(options.edges, options.seconds)
    if options.json:
        print(json.dumps({"serial": serial, "edges": edges}))
    else:
        for name, figures in (("serial", serial), ("edges", edges)):
            print(name, ", ".join(f"{value} {what}" for what, value in figures.items()))
    lost = serial["damaged"] + serial["lost"] + edges["lost edges"] + edges["dropped"]
    return 1 if lost or max(serial["core"], edges["core"]) > 0.5 else 0


if __name__ == "__main__":
    sys.exit(main())

"""Runs a program on a machine that has an emulated device node.

    umockdev-wrapper /usr/bin/python3 host.py CONTROL ADDRESS MODEL TRUTH PROGRAM ARGUMENT...

CONTROL is the number of an inherited socket, ADDRESS that of the part on I2C, null on SPI. The part is the virtual one
of a model, or for ``data-sheet`` an SCA100T of this module, with a JSON object as its truth.

The program inherits the standard streams; its exit code becomes the host's. One JSON line on the control socket is one
order, answered by one line once it is in force::

    {"pose": [gx, gy, gz], "temperature": 24.0 or null}
    {"fault": errno or 0}      {"broken": true}
    {"messages": true}         -> {"messages": [[start_ns, end_ns, "out", "in"], ...], "settings": {...}}
    {"kill": signal}           to the program under test
"""

import json
import os
import random
import socket
import subprocess
import sys
import time
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Any

import gi

sys.path.insert(0, str(Path(__file__).parents[3]))

gi.require_version("UMockdev", "1.0")
from gi.repository import GLib, UMockdev  # noqa: E402
from i2c_node import I2cNode  # noqa: E402
from spidev_node import SpidevNode  # noqa: E402

from tiltcal.drivers import find_model  # noqa: E402
from tiltcal.drivers.bus.address import parse_address  # noqa: E402
from tiltcal.drivers.bus.clock import SystemClock  # noqa: E402
from tiltcal.drivers.virtual import Fault, Fixture, Truth  # noqa: E402

Node = SpidevNode | I2cNode


class DataSheetSca100t:
    """An SCA100T as its data sheet describes it; it shares no line with the driver or its virtual part.

    Modelled: the commands MEAS, RDAX, RDAY and RWTR; 11-bit words with random filler in the command's slot and behind
    the last bit; words that are not fresh sooner than 150 µs after the end of a frame; the thermometer's line.
    """

    def __init__(self, truth: Truth, fixture: Fixture) -> None:
        self._truth, self._fixture, self._chance = truth, fixture, random.Random(truth.seed)
        self._words, self._end_ns = {"x": 0, "y": 0}, 0

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Answer one frame."""
        if time.monotonic_ns() - self._end_ns >= 150_000:
            self._words = {channel: self._converted(channel) for channel in "xy"}
        self._end_ns = time.monotonic_ns()
        celsius = round(197 - 1.083 * self._fixture.temperature())
        driven = {0x00: "", 0x08: f"{celsius:08b}", 0x10: f"{self._words['x']:011b}", 0x11: f"{self._words['y']:011b}"}
        bits = self._filled("", 8) + driven.get(out[0], "1" * 64) if out else ""
        return int(self._filled(bits, 8 * len(out)) or "0", 2).to_bytes(len(out), "big")

    def _filled(self, bits: str, length: int) -> str:
        return (bits + "".join(self._chance.choice("01") for _ in range(length)))[:length]

    def _converted(self, channel: str) -> int:
        """The word of a channel now; of a part with faults its fault signal."""
        truth = self._truth
        if truth.faults:
            return self._chance.randrange(0, 102)
        response = zip(truth.sensitivity[channel].values(), self._fixture.gravity, strict=True)
        warm = truth.drift.get(channel, [0.0])[0] * (self._fixture.temperature() - truth.reference)
        value = truth.offset[channel] + warm + sum(k * g for k, g in response)
        return max(0, min(2047, round(self._chance.gauss(value, truth.noise[channel]))))


class Now(SystemClock):
    """The machine's time; the bits of a message are over when it is answered."""

    def sleep(self, seconds: float) -> None:
        pass


def main(control: str, address: str, model: str, facts: str, *program: str) -> int:
    name, _, options = model.partition("?")
    truth, clock = Truth(**json.loads(facts)), Now(time.time_ns())
    fixture = Fixture(clock, seed=truth.seed, jig=truth.jig)
    part: Any = DataSheetSca100t(truth, fixture)
    if name != "data-sheet":
        part = find_model(name).at(parse_address(f"sim:{options}")).twin(truth, fixture, clock)
    node = SpidevNode(part) if address == "null" else I2cNode(part, int(address))
    testbed = UMockdev.Testbed.new()
    testbed.add_from_string(
        f"P: /devices/platform/{node.name}\nN: {node.name}\n"
        f"E: DEVNAME=/dev/{node.name}\nE: SUBSYSTEM={node.subsystem}\n"
    )
    testbed.attach_ioctl(f"/dev/{node.name}", node)
    channel = socket.socket(fileno=int(control))
    child = subprocess.Popen(program)
    loop = GLib.MainLoop()
    codes: list[int] = []
    lines = channel.makefile("rw", encoding="utf-8")

    def order(*_: object) -> bool:
        line = lines.readline()
        if not line:
            child.kill()
            return False
        answer = obey(json.loads(line), node, fixture, child.pid)
        lines.write(json.dumps(answer) + "\n")
        lines.flush()
        return True

    def ended(_: int, status: int) -> None:
        codes.append(os.waitstatus_to_exitcode(status))
        loop.quit()

    GLib.io_add_watch(channel.fileno(), GLib.PRIORITY_DEFAULT, GLib.IO_IN | GLib.IO_HUP, order)
    GLib.child_watch_add(GLib.PRIORITY_DEFAULT, child.pid, ended)
    loop.run()
    testbed.detach_ioctl(f"/dev/{node.name}")
    return codes[0] if codes[0] >= 0 else 128 - codes[0]


def obey(order: dict, node: Node, fixture: Fixture, child: int) -> dict:
    """Carry out one order from the test."""
    if "pose" in order:
        fixture.move(tuple(order["pose"]), order["temperature"])
    if "fault" in order:
        node.fault = order["fault"]
    if "broken" in order:
        node.part._truth = replace(node.part._truth, faults=(Fault("parity", 0.0, inf),))
    if "kill" in order:
        os.kill(child, order["kill"])
    if "messages" in order:
        return {"messages": node.messages, "settings": node.settings}
    return {}


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))

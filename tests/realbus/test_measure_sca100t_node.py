"""The emulated bench itself: it takes the positions that a program asks for, and ends what does not end by itself."""

from __future__ import annotations

import signal
import sys

import pytest
from support.emulated.bench import Part, run_on_spi

pytest.importorskip("spidev", reason="the spidev package is not installed")

ASKING = """
import json, spidev
bus = spidev.SpiDev()
bus.open_path("/dev/spidev0.0")
for gravity, temperature in (([0, 0, 1], None), ([1, 0, 0], 4.0), ([0, -1, 0], None)):
    print(json.dumps({"ask": "position", "gravity": gravity, "temperature": temperature}), flush=True)
    assert json.loads(input()) == {"answer": "ready"}
    print(json.dumps({"x": bus.xfer2([16, 0, 0]), "t": bus.xfer2([8, 0])}), flush=True)
raise SystemExit(3)
"""


def test_it_takes_each_position_before_it_answers() -> None:
    part = Part(offset=(1000.0, 1000.0), sensitivity=((800.0, 50.0, 7.0), (0.0, 800.0, 0.0)), noise=0.0, jig=0.0)
    with run_on_spi([sys.executable, "-c", ASKING], part) as bench:
        said = bench.lead()
    words = [row["x"][1] << 3 | row["x"][2] >> 5 for row in said if "x" in row]
    # The drift of 0.21 count/°C from 24 °C to 4 °C is 4.2 counts.
    assert words == [1007, round(1800 - 4.2), round(950 - 4.2)]
    # 197 - 1.083 * 24 = 171.008 and 197 - 1.083 * 4 = 192.668
    assert [row["t"][1] for row in said if "t" in row] == [171, 193, 193]
    assert bench.exit_code == 3


def test_it_kills_the_program_on_request() -> None:
    with run_on_spi([sys.executable, "-c", "input()"]) as bench:
        bench.kill(signal.SIGKILL)
        assert bench.exit_code == 128 + signal.SIGKILL


def test_it_ends_a_program_that_hangs() -> None:
    with run_on_spi([sys.executable, "-c", "import threading; threading.Event().wait()"], seconds=0.5) as bench:
        assert bench.process.stdout is not None
        assert bench.process.stdout.read() == ""
    assert bench.exit_code == 128 + signal.SIGKILL

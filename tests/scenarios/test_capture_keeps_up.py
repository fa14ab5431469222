"""The capture benchmark in short: nothing is lost at full speed. How much of a core it takes, the benchmark says."""

import json
import subprocess
import sys

import pytest
from support import ROOT

BENCHMARK = ROOT / "benchmarks" / "capture.py"

for package in ("serial", "gpiod"):
    pytest.importorskip(package, reason=f"the {package} package is not installed")


def test_nothing_is_lost_at_full_speed() -> None:
    done = subprocess.run([sys.executable, BENCHMARK, "--seconds", "1.5", "--json"], capture_output=True, text=True)
    figures = json.loads(done.stdout)

    # No sentence of the benchmark is longer than 50 bytes of ten bits; starting the talker takes a moment.
    assert figures["serial"]["sentences"] >= 921_600 / 10 / 50
    assert figures["serial"]["damaged"] == figures["serial"]["lost"] == 0
    assert figures["edges"]["periods"] == 4000 * 1.5 / 4 - 1
    assert figures["edges"]["lost edges"] == figures["edges"]["dropped"] == 0

"""How far matching online is ahead of real time.

    python benchmarks/match.py [--rows 3600000] [--rate 1000] [--json]

Ten hours at 1 kHz are 36,000,000 rows, a log of 3 GB. Exit code 1 where online is less than 200 times faster than real
time. What matching a log takes is in long_logs.py.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from tiltcal.core.pair.demodulate import CHUNK
from tiltcal.core.pair.model import Pair
from tiltcal.core.pair.online import Online
from tiltcal.logs.formats import open_log
from tiltcal.logs.match import read_pair_log

PAIR = Pair("a1", "a2", "a4")
CHANNELS = ("a1", "a2", "a3", "a4")
SPIN = 0.125
LEAST_AHEAD = 200.0
_BLOCK = 500_000


def write_log(path: Path, rows: int, rate: float) -> None:
    """Write a record of the laboratory's accelerometers."""
    import polars as pl

    draw = np.random.default_rng(0)
    with open(path, "wb") as log:
        for start in range(0, rows, _BLOCK):
            taken = np.arange(start, min(start + _BLOCK, rows)) / rate
            turned = 2 * np.pi * SPIN * taken
            columns = {"time": taken, "theta": np.rad2deg(turned) % 360.0}
            for name, scale, delta, phase in zip(
                CHANNELS, (3.383, 3.415, 3.402, 3.390), (0.022, -0.015, 0.011, -0.02), (0, 180, 90, 270), strict=True
            ):
                angle = turned + np.deg2rad(phase)
                signal = scale * (np.sin(angle) + delta * np.cos(angle))
                columns[name] = signal + 3e-4 * draw.standard_normal(len(taken))
            pl.DataFrame(columns).write_csv(log, include_header=start == 0, float_precision=7)


def online_seconds(path: Path) -> float:
    """Time the estimators alone: a live stream brings its numbers itself."""
    online = Online(PAIR, CHANNELS)
    with open_log(path) as log:
        record = read_pair_log(log, CHANNELS, "theta").record
    begun = time.perf_counter()
    for start in range(0, len(record.theta), CHUNK):
        rows = slice(start, start + CHUNK)
        online.push(record.theta[rows], np.stack([column[rows] for column in record.readings]), record.whole[rows])
    return time.perf_counter() - begun


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--rows", type=int, default=3_600_000)
    parser.add_argument("--rate", type=float, default=1000.0, help="rows per second of the record")
    parser.add_argument("--json", action="store_true")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "disk.csv"
        write_log(path, chosen.rows, chosen.rate)
        online = online_seconds(path)
    found = {
        "rows": chosen.rows,
        "online_s": round(online, 2),
        "online_times_real_time": round(chosen.rows / chosen.rate / online),
    }
    if chosen.json:
        print(json.dumps(found))
    else:
        print("\n".join(f"{name:<26}{value}" for name, value in found.items()))
    return 0 if found["online_times_real_time"] >= LEAST_AHEAD else 1


if __name__ == "__main__":
    sys.exit(main())

"""Applying a calibration against only reading and writing: time and memory of whole commands.

    python benchmarks/apply.py [--rows 2000000] [--repeat 3] [--json]

The yardstick is a program that lets polars read the log and write as many columns as ``tiltcal apply`` does, without
any mathematics. Each is run in turn, and the fastest run of each counts. Exit code 1 where applying takes more than
twice as long, or more than half a gigabyte.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

MOST_TIMES = 2.0
MOST_MEMORY = 0.5
FIXTURE = Path(__file__).parents[1] / "fixtures" / "mavs.yaml"

ONLY_COPY = """
import sys, polars as pl
log = pl.scan_csv(sys.argv[1])
more = [(pl.col(name) * 1.5).alias(f"{made}_{name}") for made in ("g", "tilt") for name in ("x", "y")]
log.with_columns(*more, flag=pl.lit(1), reason=pl.lit(0)).sink_csv(sys.argv[2])
"""


def write_log(path: Path, rows: int) -> None:
    """Readings of a SCA100T that is tilted within ±60° while it cools and warms."""
    import numpy as np
    import polars as pl

    draw, turn = np.random.default_rng(0), np.linspace(0.0, 200.0, rows)
    pl.DataFrame(
        {
            "time": np.arange(rows) * 0.01,
            "x": np.rint(1024.0 + 710.0 * np.sin(turn) + draw.normal(0.0, 0.6, rows)),
            "y": np.rint(1024.0 + 710.0 * np.cos(turn / 3.0) + draw.normal(0.0, 0.6, rows)),
            "temperature": 15.0 + 8.0 * np.sin(turn / 50.0),
        }
    ).write_csv(path, float_precision=3)


def measured(command: Sequence[str | Path]) -> tuple[float, float]:
    """Seconds and gigabytes of a command, from its start to its end."""
    begun = time.perf_counter()
    process = os.posix_spawnp(str(command[0]), [str(part) for part in command], os.environ)
    _, status, used = os.wait4(process, 0)
    if status:
        raise SystemExit(f"{command[0]} failed")
    return time.perf_counter() - begun, used.ru_maxrss / 2**20


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=2_000_000)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        log, out = Path(name) / "log.csv", Path(name) / "out.csv"
        write_log(log, options.rows)
        apply = [sys.executable, "-m", "tiltcal", "apply", FIXTURE, log, "-o", out]
        copy = [sys.executable, "-c", ONLY_COPY, log, out]
        runs = [(measured(copy), measured(apply)) for _ in range(options.repeat)]
    copied, applied = (min(run[which][0] for run in runs) for which in (0, 1))
    memory = max(run[1][1] for run in runs)
    found = {"rows": options.rows, "copy": copied, "apply": applied, "times": applied / copied, "gigabytes": memory}
    if options.json:
        print(json.dumps(found))
    else:
        print(
            f"{options.rows} rows: copied in {copied:.2f} s, applied in {applied:.2f} s, {applied / copied:.2f} times"
        )
        print(f"{memory:.2f} GB at most")
    return 1 if applied > MOST_TIMES * copied or memory > MOST_MEMORY else 0


if __name__ == "__main__":
    sys.exit(main())

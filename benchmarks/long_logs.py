"""Time and memory of the commands that reduce a long log, beside only reading it.

    python benchmarks/long_logs.py [--rows 10000000] [--repeat 5] [--keep] [--json]

Whole commands are run in turn, and the table has their medians: ``fit`` with segments and ``fit free`` without,
``noise``, ``report`` and ``match``, each for CSV and Parquet, beside one pass over the same columns with the project's
reader and with polars. ``--keep`` writes the table to results. Exit code 1 where a command takes more than 0.4 GB or,
for 10 million rows or more, where its start counts little, more than twice the time of the pass with the project's
reader; ``fit free`` may take longer, because it looks for the still intervals in four windows before it fits.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from apply import CALIBRATION, Cost, conditions, in_turn, keep, measure
from apply import write_logs as write_tilt_log
from match import write_log as write_disk_log

MOST_TIMES, LONG = 2.0, 10_000_000
MOST_MEMORY = 0.4
SEVERAL_PASSES = ("fit free",)
FACES = {"x-up": (1, 0, 0), "x-down": (-1, 0, 0), "y-up": (0, 1, 0), "y-down": (0, -1, 0), "z-up": (0, 0, 1),
         "z-down": (0, 0, -1)}  # fmt: skip
ATTITUDES = 24
RATE, MOVE = 100.0, 200  # Hz, and rows between two positions
ONE_PASS = """
import sys
from tiltcal.logs.formats import open_log
with open_log(sys.argv[1]) as log:
    where = [log.names.index(name) for name in sys.argv[2:]]
    for _ in log.rows(where, log.names.index("time")):
        pass
"""
POLARS = """
import sys, polars
read = polars.read_csv if sys.argv[1].endswith("csv") else polars.read_parquet
read(sys.argv[1], columns=sys.argv[2:])
"""


def write_logs(folder: Path, rows: int) -> None:
    """Write a sensor on six faces, in free attitudes, at rest and tilted, and a disk of sensors: CSV and Parquet."""
    import polars as pl

    draw = np.random.default_rng(5)
    free = draw.normal(size=(ATTITUDES, 3))
    free /= np.linalg.norm(free, axis=1)[:, None]
    time = np.arange(rows) / RATE
    for stem, directions in (("faces", np.array([*FACES.values()])), ("free", free), ("rest", free[:1])):
        each = rows // len(directions)
        gravity = np.repeat(directions, each, axis=0)
        gravity = np.pad(gravity, ((0, rows - len(gravity)), (0, 0)), mode="edge")
        noise = draw.normal(0.0, 1e-3, (rows, 3))
        for start in range(each, rows - MOVE, each):
            noise[start : start + MOVE] *= 300.0
        readings = np.round(gravity + noise, 4)
        frame = pl.DataFrame({"time": time, "x": readings[:, 0], "y": readings[:, 1], "z": readings[:, 2]})
        frame.write_csv(folder / f"{stem}.csv")
        frame.write_parquet(folder / f"{stem}.parquet")
    each = rows // len(FACES)
    spans = [f"{name},{number * each + MOVE},{(number + 1) * each}\n" for number, name in enumerate(FACES)]
    (folder / "segments.csv").write_text("position,start,end\n" + "".join(spans))
    write_tilt_log(folder / "tilt", rows)
    write_disk_log(folder / "disk.csv", rows, 1000.0)
    pl.scan_csv(folder / "disk.csv").sink_parquet(folder / "disk.parquet")


def commands(folder: Path, suffix: str) -> dict[str, tuple[Path, list[str], list[str]]]:
    """Return what is run: the log, the columns that it reads, and the command line behind ``tiltcal``."""
    faces, free, rest, tilt, disk = (folder / f"{stem}.{suffix}" for stem in ("faces", "free", "rest", "tilt", "disk"))
    sensor, axes = ["--serial", "S1", "--unit", "g", "-o", str(folder / "out")], ["time", "x", "y", "z"]
    pair = ["--pair", "a1,a2", "--orthogonal", "a4", "--phase", "theta"]
    return {
        "fit six-face": (
            faces, axes, ["fit", "six-face", str(faces), "--segments", str(folder / "segments.csv"), *sensor]
        ),
        "fit free": (free, axes, ["fit", "free", str(free), *sensor]),
        "noise": (rest, axes, ["noise", str(rest), "--unit", "g"]),
        "report": (
            tilt, ["time", "x", "y", "temperature"],
            ["report", str(CALIBRATION), str(tilt), "-o", str(folder / "out")],
        ),
        "match": (disk, ["time", "theta", "a1", "a2", "a4"], ["match", str(disk), *pair]),
    }  # fmt: skip


def table(found: dict[str, dict[str, Cost]]) -> str:
    """Return the medians of each command and format, with the ratios to reading."""
    lines = [
        "| command | log | s | reader, s | times | polars, s | processor s | reader | times | GB |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for name, costs in found.items():
        ours, reader, polars = (costs[who] for who in ("tiltcal", "reader", "polars"))
        wall = f"{ours.seconds:.2f} | {reader.seconds:.2f} | {ours.seconds / reader.seconds:.2f} | {polars.seconds:.2f}"
        processor = f"{ours.processor:.2f} | {reader.processor:.2f} | {ours.processor / reader.processor:.2f}"
        lines.append(f"| {name.replace(', ', ' | ')} | {wall} | {processor} | {ours.gigabytes:.2f} |")
    return "\n".join(lines) + "\n"


def too_much(found: dict[str, dict[str, Cost]], rows: int) -> Sequence[str]:
    """Return the commands that take more than they may."""
    beyond = []
    for name, costs in found.items():
        ours, reader = costs["tiltcal"], costs["reader"]
        judged = rows >= LONG and not name.startswith(SEVERAL_PASSES)
        if ours.gigabytes > MOST_MEMORY or (judged and ours.seconds > MOST_TIMES * reader.seconds):
            beyond.append(name)
    return beyond


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--rows", type=int, default=10_000_000)
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--keep", action="store_true", help="put the table into results")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found: dict[str, dict[str, Cost]] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        writer = get_context("spawn").Process(target=write_logs, args=(folder, options.rows))
        writer.start()
        writer.join()
        for suffix in ("csv", "parquet"):
            for command, (log, columns, line) in commands(folder, suffix).items():
                runs = {
                    "tiltcal": [sys.executable, "-m", "tiltcal", *line],
                    "reader": [sys.executable, "-c", ONE_PASS, str(log), *columns],
                    "polars": [sys.executable, "-c", POLARS, str(log), *columns],
                }
                runs_of = {who: partial(measure, run, folder / "out") for who, run in runs.items()}
                found[f"{command}, {suffix}"] = in_turn(runs_of, options.repeat)
    text = f"{conditions(options.rows, options.repeat)}\n\n{table(found)}"
    print(json.dumps(found) if options.json else text)
    if options.keep:
        keep(text, "long_logs.py")
    beyond = too_much(found, options.rows)
    if beyond:
        print(f"more than {MOST_TIMES:g} times the reader, or than {MOST_MEMORY} GB: {'; '.join(beyond)}")
    return 1 if beyond else 0


if __name__ == "__main__":
    sys.exit(main())

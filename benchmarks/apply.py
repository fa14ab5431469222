"""Speed and memory of ``apply``, beside what would be written in its place.

    python benchmarks/apply.py [--rows 2000000] [--repeat 5] [--without-pandas] [--keep] [--json]

Whole commands are run in turn, and the table has their medians: ``tiltcal apply``, with and without uncertainties,
polars expressions, a copy without any mathematics and pandas, each for CSV and Parquet; xarray for NetCDF; and
``Calibration.apply`` on arrays beside plain numpy and imucal. pandas takes its turn at CSV only once: it needs ten
seconds for a million rows. The result of the command before is removed first, so that each finds as much free memory.
``--keep`` writes the table to results. Exit code 1 where ``apply`` takes more than 0.45 GB or, for 10 million rows or
more, where the start of a command counts little, more than 1.05 times the processor time of polars expressions, or with
uncertainties more than 2 times that without in CSV, 4 times in Parquet.
``--without-pandas`` saves three minutes there.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np

MOST_TIMES, LONG = 1.05, 10_000_000
MOST_UNCERTAIN = {"csv": 2.0, "parquet": 4.0}
MOST_MEMORY = 0.45
HERE = Path(__file__).parent
NAIVE = HERE / "naive"
CALIBRATION = NAIVE / "sensor.yaml"


class Cost(NamedTuple):
    """What a command takes."""

    seconds: float
    processor: float
    gigabytes: float


def write_logs(stem: Path, rows: int) -> None:
    """Write readings of a sensor that is tilted within ±50° while it cools and warms, in three formats."""
    import polars as pl
    import xarray as xr

    draw, turn = np.random.default_rng(7), np.linspace(0.0, 300.0, rows)
    columns = {
        "time": np.arange(rows) * 0.1,
        "x": 2.48 + 1.5 * np.sin(turn) + draw.normal(0.0, 0.003, rows),
        "y": 2.53 + 1.5 * np.cos(turn / 3.0) + draw.normal(0.0, 0.003, rows),
        "temperature": 16.0 + 8.0 * np.sin(turn / 50.0),
    }
    frame = pl.DataFrame(columns)
    frame.write_csv(stem.with_suffix(".csv"), float_precision=6)
    frame.write_parquet(stem.with_suffix(".parquet"))
    dataset = xr.Dataset({name: ("time", column) for name, column in columns.items() if name != "time"})
    dataset.assign_coords(time=columns["time"]).to_netcdf(stem.with_suffix(".nc"), engine="h5netcdf")


def commands(log: Path, out: Path) -> dict[str, list[str]]:
    """Return what is run for a log, by name; the first two are ours."""
    apply = [sys.executable, "-m", "tiltcal", "apply", str(CALIBRATION), str(log), "-o", str(out)]
    others = ["with_xarray"] if log.suffix == ".nc" else ["with_polars", "only_copy", "with_pandas"]
    naive = {name: [sys.executable, str(NAIVE / f"{name}.py"), str(log), str(out)] for name in others}
    return {"tiltcal": apply, "tiltcal --uncertainty": [*apply, "--uncertainty"], **naive}


def measure(command: Sequence[str], out: Path) -> Cost:
    """Run a command from its start to its end."""
    out.unlink(missing_ok=True)
    if hasattr(os, "sync"):
        os.sync()
    begun = time.perf_counter()
    nowhere = [(os.POSIX_SPAWN_OPEN, stream, os.devnull, os.O_WRONLY, 0) for stream in (1, 2)]
    # Python may keep its byte code, as it does where nothing is measured.
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    process = os.posix_spawnp(command[0], command, environment, file_actions=nowhere)
    _, status, used = os.wait4(process, 0)
    if status:
        raise SystemExit(f"failed: {' '.join(command)}")
    return Cost(time.perf_counter() - begun, used.ru_utime + used.ru_stime, used.ru_maxrss / 2**20)


def in_turn(runs: dict[str, Callable[[], Cost]], repeat: int, once: Sequence[str] = ()) -> dict[str, Cost]:
    """Run all of them ``repeat`` times in turn, but for those that run once; return the medians."""
    found: dict[str, list[Cost]] = {name: [] for name in runs}
    for number in range(repeat):
        for name, run in runs.items():
            if not (number and name in once):
                found[name].append(run())
    return {name: Cost(*(median(part) for part in zip(*costs, strict=True))) for name, costs in found.items()}


def on_arrays(rows: int) -> dict[str, Callable[[], Cost]]:
    """Return what converts arrays in memory, by name; imucal is left out where it is not installed."""
    import tiltcal

    calibration = tiltcal.read(CALIBRATION)
    turn = np.linspace(0.0, 300.0, rows)
    arrays = {"x": 2.48 + 1.5 * np.sin(turn), "y": 2.53 + 1.5 * np.cos(turn), "temperature": 16 + 8 * np.sin(turn / 50)}
    readings = np.column_stack([arrays["x"], arrays["y"], arrays["x"]])

    def timed(work: Callable[[], Any]) -> Callable[[], Cost]:
        def run() -> Cost:
            begun, processor = time.perf_counter(), time.process_time()
            work()
            return Cost(time.perf_counter() - begun, time.process_time() - processor, float("nan"))

        work()  # what is imported at the first call does not count
        return run

    runs = {
        "tiltcal": timed(lambda: calibration.apply(arrays)),
        "tiltcal --uncertainty": timed(lambda: calibration.apply(arrays, uncertainty=True)),
        "with numpy": timed(lambda: plain_numpy(arrays)),
    }
    try:
        from imucal import FerrarisCalibrationInfo
    except ImportError:
        return runs
    info = FerrarisCalibrationInfo(
        acc_unit="g", gyr_unit="deg/s", from_acc_unit="V", from_gyr_unit="V", b_a=np.full(3, 2.5), K_a=np.eye(3) * 2.0,
        R_a=np.eye(3), K_g=np.eye(3), R_g=np.eye(3), K_ga=np.zeros((3, 3)), b_g=np.zeros(3),
    )  # fmt: skip
    # It has no temperature, no angles and no flags: three axes of acceleration and of rotation rate.
    return {**runs, "imucal": timed(lambda: info.calibrate(readings, readings, acc_unit="V", gyr_unit="V"))}


def plain_numpy(log: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """What is written in place of ``Calibration.apply`` with numpy, for sensor.yaml."""
    t = log["temperature"] - 22.0
    v = (log["x"] - 2.48 - (0.0017 - 2.0e-5 * t) * t) / (1.0 + 1.5e-4 * t)
    w = (log["y"] - 2.53 - (-0.0012 + 1.1e-5 * t) * t) / (1.0 - 2.5e-4 * t)
    determinant = 1.96 * 2.04 + 0.03 * 0.05
    g_x, g_y = (2.04 * v - 0.03 * w) / determinant, (0.05 * v + 1.96 * w) / determinant
    clipped = (abs(g_x) > 1.0) | (abs(g_y) > 1.0)
    outside = (log["temperature"] < 4.0) | (log["temperature"] > 28.0)
    return {
        "g_x": g_x,
        "g_y": g_y,
        "tilt_x": np.degrees(np.arcsin(g_x.clip(-1.0, 1.0))),
        "tilt_y": np.degrees(np.arcsin(g_y.clip(-1.0, 1.0))),
        "flag": np.where(clipped | outside, 3, 1).astype(np.uint8),
        "reason": (clipped + 2 * outside).astype(np.uint16),
    }


def table(found: dict[str, dict[str, Cost]]) -> str:
    """Return the medians of each format, with the ratios to ``tiltcal``."""
    lines = ["| log | with | s | times | processor s | times | GB |", "|---|---|---|---|---|---|---|"]
    for log, costs in found.items():
        ours = costs["tiltcal"]
        for name, cost in costs.items():
            times = f"{cost.seconds:.2f} | {cost.seconds / ours.seconds:.2f}"
            processor = f"{cost.processor:.2f} | {cost.processor / ours.processor:.2f}"
            memory = "" if cost.gigabytes != cost.gigabytes else f"{cost.gigabytes:.2f}"
            lines.append(f"| {log} | {name.replace('_', ' ')} | {times} | {processor} | {memory} |")
    return "\n".join(lines) + "\n"


def conditions(rows: int, repeat: int) -> str:
    """Return the date, the size of the log, and what the machine had to do."""
    load = f"load {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "load unknown"
    runs = f"medians of {repeat} runs in turn"
    return f"{datetime.now(UTC):%d %B %Y}, {rows} rows, {runs}, {os.cpu_count()} cores, {load}."


def keep(text: str, script: str) -> None:
    """Put what a script has found into the folder of results."""
    (HERE / "results" / f"{Path(script).stem}.txt").write_text(text)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=2_000_000)
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--without-pandas", action="store_true")
    parser.add_argument("--keep", action="store_true", help="put the table into results")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found: dict[str, dict[str, Cost]] = {}
    with tempfile.TemporaryDirectory() as folder:
        stem = Path(folder) / "log"
        # In a process of its own: what the program that starts a command holds counts as its memory.
        writer = get_context("spawn").Process(target=write_logs, args=(stem, options.rows))
        writer.start()
        writer.join()
        for suffix in (".csv", ".parquet", ".nc"):
            out = stem.with_name(f"out{suffix}")
            whole = commands(stem.with_suffix(suffix), out)
            if options.without_pandas:
                whole.pop("with_pandas", None)
            runs = {name: partial(measure, command, out) for name, command in whole.items()}
            found[suffix[1:]] = in_turn(runs, options.repeat, ["with_pandas"] if suffix == ".csv" else ())
    found["arrays"] = in_turn(on_arrays(options.rows), options.repeat)
    note = "" if "imucal" in found["arrays"] else " imucal is not installed."
    text = f"{conditions(options.rows, options.repeat)}{note}\n\n{table(found)}"
    print(json.dumps(found) if options.json else text)
    if options.keep:
        keep(text, "apply.py")
    beyond = []
    for log, most in MOST_UNCERTAIN.items():
        ours, uncertain, polars = (found[log][who] for who in ("tiltcal", "tiltcal --uncertainty", "with_polars"))
        judged = {
            "GB": (max(ours.gigabytes, uncertain.gigabytes), MOST_MEMORY),
            "of polars": (ours.processor / polars.processor, MOST_TIMES if options.rows >= LONG else math.inf),
            "with uncertainty": (uncertain.processor / ours.processor, most if options.rows >= LONG else math.inf),
        }
        beyond += [
            f"{log}: {value:.2f} {what} (limit {limit})" for what, (value, limit) in judged.items() if value > limit
        ]
    if beyond:
        print("\n".join(beyond))
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())

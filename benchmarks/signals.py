"""Is anything lost, and is the exit code right, if a command is killed or interrupted at a random moment?

    python benchmarks/signals.py [--each 200] [--seed 1] [--jobs 2] [--minutes 60] [--pieces signals.jsonl]

Sessions of every kind, recordings, and `apply` in three formats, `fit` and `report` are ended by SIGKILL and by SIGINT
at a random moment of their run. A session that is resumed leaves the same files, byte for byte, as one that nobody
stopped. Any other output is there whole, with the same bytes, or not at all; of a recording the first rows are there.
Exit code of an interrupted command: 130, or 0 if it was at its end; never another signal, never a traceback. Each trial
is kept in a file: a run goes on where an earlier one ended. A signal that meets the start of Python itself is counted
apart. Exit code 1 of this program if a trial shows anything else.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support import FIXTURES
from support.command import TILTCAL

PLANE = str(FIXTURES / "plane.yaml")
ROWS = 150_000
PYTHON = 0.06
"""Share of a run in which Python itself starts, where no program hears a signal; on a busy machine it is larger."""

PYTHON_INTERRUPTED = (1, -signal.SIGINT)
"""Exit codes of Python that is interrupted before the package is imported; no line of its traceback is ours."""

SENSOR = "--sensor sca100t-d02 --address sim:seed=1 --serial S-1 --operator sim -o out.yaml --journal out.journal.jsonl"
POSITIONS = ("plane", "complete", "reversal", "two-temperature", "multi-angle")
SESSIONS = {
    **{
        name: f"measure {name} {SENSOR}" for name in ("plane", "complete", "reversal", "two-temperature", "multi-angle")
    },
    "mounting": f"measure mounting --base {PLANE} {SENSOR.replace('S-1', 'SIM-42')}",
    "six-face": f"measure six-face {SENSOR.replace('sca100t-d02', 'sca3000-d01')}",
    "free": f"measure free {SENSOR.replace('sca100t-d02', 'sca3000-d01')}",
    "rotation": f"measure rotation --turns 3 {SENSOR.replace('sca100t-d02', 'gradiometer')}",
}
OTHERS = {
    "record": "record --sensor sca100t-d02 --address sim:seed=1 --rows 20000 -o out.csv",
    "apply csv": f"apply {PLANE} {{inputs}}/log.csv -o out.csv",
    "apply parquet": f"apply {PLANE} {{inputs}}/log.parquet -o out.parquet",
    "apply netcdf": f"apply {PLANE} {{inputs}}/log.nc -o out.nc",
    "fit": "fit free {inputs}/still.csv --unit g --serial S -o out.yaml",
    "report": f"report {PLANE} {{inputs}}/log.csv -o out.html",
}


@dataclass(frozen=True)
class Undisturbed:
    """A command that nobody stopped."""

    name: str
    line: list[str]
    seconds: float
    files: dict[str, bytes]

    @property
    def session(self) -> bool:
        return self.name in SESSIONS


def files_in(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def ended(line: list[str], folder: Path, after: float | None = None, number: int = 0) -> tuple[int, str]:
    """Run a command, send it a signal after some seconds, and return its exit code and what it said."""
    with (
        tempfile.TemporaryFile("w+") as said,
        subprocess.Popen([*TILTCAL, *line], cwd=folder, stdout=subprocess.DEVNULL, stderr=said) as process,
    ):
        timer = threading.Timer(after or 0.0, process.send_signal, [number])
        if after is not None:
            timer.start()
        process.wait(300)
        timer.cancel()
        said.seek(0)
        return process.returncode, said.read()


def undisturbed(name: str, line: str, inputs: Path) -> Undisturbed:
    words = line.format(inputs=inputs).split()
    with tempfile.TemporaryDirectory() as folder:
        began = time.monotonic()
        code, said = ended(words, Path(folder))
        if code:
            raise SystemExit(f"{name}: {said}")
        return Undisturbed(name, words, time.monotonic() - began, files_in(Path(folder)))


def trial(known: Undisturbed, number: int, draw: random.Random) -> str:
    """Stop a command once, and return how it ended; a text that begins with ``wrong`` is a failure."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        code, said = ended(known.line, folder, draw.uniform(PYTHON, 1.0) * known.seconds, number)
        if number == signal.SIGINT and code not in (0, 130):
            if code in PYTHON_INTERRUPTED and f"{os.sep}tiltcal{os.sep}" not in said:
                return "while Python starts"
            return f"wrong exit code {code}: {said[-2000:]}"
        if number == signal.SIGKILL and code not in (0, -9):
            return f"wrong exit code {code}: {said[-2000:]}"
        if "Traceback" in said or "FATAL" in said:
            return f"wrong words: {said[-2000:]}"
        why = _wrong_session(known, folder) if known.session else _wrong_output(known, folder, killed=code == -9)
        return why or ("at its end" if code == 0 else f"ended with {code}")


def _wrong_session(known: Undisturbed, folder: Path) -> str:
    again = ["measure", "--resume", "out.journal.jsonl", "--operator", "sim"]
    begun = (folder / "out.journal.jsonl").exists()
    code, said = ended(again if begun else known.line, folder)
    if code:
        return f"wrong: resumed, it ends with {code}: {said[-2000:]}"
    differing = [name for name, content in known.files.items() if files_in(folder).get(name) != content]
    return f"wrong: {differing} differ after resuming" if differing else ""


def _wrong_output(known: Undisturbed, folder: Path, *, killed: bool) -> str:
    for name, content in files_in(folder).items():
        if name.startswith("."):
            continue  # a file that was not finished, and has another name until it is
        if known.name == "record":
            if not known.files[name].startswith(content[: content.rfind(b"\n") + 1]):
                return f"wrong: {name} holds other rows"
        elif not _same(name, content, known.files.get(name)):
            return f"wrong: {name} is there and is not whole"
    if not killed and any(name.startswith(".") for name in files_in(folder)):
        return "wrong: an unfinished file is left behind"
    return ""


def _same(name: str, content: bytes, wanted: bytes | None) -> bool:
    """Return whether two outputs are the same; the history of a NetCDF file holds the time at which it was written."""
    if wanted is None or not name.endswith(".nc"):
        return content == wanted
    import xarray as xr

    try:
        one, other = (xr.load_dataset(io.BytesIO(each), engine="h5netcdf") for each in (content, wanted))
    except (OSError, ValueError):
        return False
    return bool(one.equals(other))


def write_inputs(folder: Path) -> None:
    """Write a log of one sensor in three formats, and one of a sensor that is held still in many attitudes."""
    import numpy as np
    import polars as pl
    import xarray as xr

    draw, turn = np.random.default_rng(0), np.linspace(0.0, 200.0, ROWS)
    log = pl.DataFrame(
        {
            "time": np.arange(ROWS) * 0.01,
            "x": np.rint(1024.0 + 300.0 * np.sin(turn)),
            "y": np.rint(1024.0 + 300.0 * np.cos(turn / 3.0)),
        }
    )
    log.write_csv(folder / "log.csv")
    log.write_parquet(folder / "log.parquet")
    columns = {name: ("time", log[name].to_numpy(), {"units": "count"}) for name in "xy"}
    xr.Dataset(columns, {"time": log["time"].to_numpy()}).to_netcdf(folder / "log.nc", engine="h5netcdf")
    attitudes = draw.standard_normal((24, 3))
    attitudes /= np.linalg.norm(attitudes, axis=1, keepdims=True)
    still = np.repeat(attitudes, 400, axis=0) * [1.02, 0.98, 1.01] + [0.02, -0.01, 0.03]
    still += 1e-3 * draw.standard_normal(still.shape)
    pl.DataFrame(still, schema=["x", "y", "z"]).write_csv(folder / "still.csv", float_precision=6)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--each", type=int, default=200, help="trials of each signal")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--minutes", type=float, default=float("inf"), help="begin no trial after so long")
    parser.add_argument("--pieces", type=Path, default=Path("signals.jsonl"))
    options = parser.parse_args()
    until = time.monotonic() + 60.0 * options.minutes
    kept = [json.loads(line) for line in options.pieces.read_text().splitlines()] if options.pieces.exists() else []
    done = {number for number, *_ in kept}
    with (
        tempfile.TemporaryDirectory() as inputs,
        ThreadPoolExecutor(options.jobs) as pool,
        options.pieces.open("a") as stream,
    ):
        write_inputs(Path(inputs))
        known = list(pool.map(lambda one: undisturbed(*one, Path(inputs)), (SESSIONS | OTHERS).items()))

        def one(number: int) -> None:
            if time.monotonic() > until:
                return
            draw, sent = random.Random(f"{options.seed}/{number}"), (signal.SIGKILL, signal.SIGINT)[number % 2]
            which = known[number // 2 % len(known)]
            kept.append((number, sent.name, which.name, trial(which, sent, draw)))
            print(json.dumps(kept[-1]), file=stream, flush=True)

        list(pool.map(one, [number for number in range(2 * options.each) if number not in done]))
    found: dict[tuple[str, str], Counter[str]] = {}
    for _, sent, name, how in kept:
        found.setdefault((sent, name), Counter())[how.partition(":")[0]] += 1
        if how.startswith("wrong"):
            print(f"{sent} {name}: {how}")
    for (sent, name), counted in sorted(found.items()):
        print(f"{sent:8} {name:16}", ", ".join(f"{how} {count}" for how, count in counted.most_common()))
    total = sum(found.values(), Counter())
    wrong = sum(count for how, count in total.items() if how.startswith("wrong"))
    print(f"{total.total()} trials, {wrong} wrong")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())

"""Does the stated 95 % interval hold the truth in 95 % of calibrations, and how near are the errors to the bound?

    python benchmarks/accuracy.py [--calibrations 600] [--minutes 30] [--pieces accuracy.jsonl] [--only "AR(1)"]

For every bench of ``accuracy_study.py``, from the same readings with the jig stated and not stated: the
share of stated intervals (``value ± coverage factor x uncertainty``) that hold the truth, and the Cramér-Rao bound,
with everything stated and the noise known, over the mean square error. Both by class of coefficient, with their Monte
Carlo errors, and the share for the tilt that a calibration makes of a new reading within ±60°.

It works in pieces that are kept in a file, goes on where an earlier run ended, and prints the table of all pieces so
far. Exit code 1 if a share is outside 93 to 97 % or an efficiency below 0.9, by more than two Monte Carlo errors.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from math import isnan
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from accuracy_study import Tally, regimes, sessions

PIECE = 10
"""Sessions that are kept together."""

STATED = ("stated", "not stated")
SHARES, EFFICIENCY = (93.0, 97.0), 0.9


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--calibrations", type=int, default=600, help="for each bench, of all sensors together")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="no new piece is begun after this time")
    parser.add_argument("--pieces", type=Path, default=Path("accuracy.jsonl"))
    parser.add_argument("--only", default="", help="benches whose name has this in it")
    options = parser.parse_args()
    tried = [one for one in regimes() if options.only in one.name]
    tallies = {(one.name, one.sensors, how): Tally() for one in tried for how in STATED}
    done = set()
    if options.pieces.exists():
        for line in options.pieces.read_text().splitlines():
            name, sensors, piece, found = json.loads(line)
            done.add((name, sensors, piece))
            keep(tallies, name, sensors, found)
    end = time.monotonic() + 60.0 * options.minutes
    with options.pieces.open("a") as stream:
        for piece in range(-(-options.calibrations // PIECE)):
            for one in tried:
                wanted = piece * PIECE * one.sensors < options.calibrations
                if not wanted or (one.name, one.sensors, piece) in done or time.monotonic() > end:
                    continue
                found = list(sessions(one, piece, PIECE))
                keep(tallies, one.name, one.sensors, found)
                print(json.dumps((one.name, one.sensors, piece, found)), file=stream, flush=True)
    return table(tallies)


def keep(tallies: dict[tuple[str, int, str], Tally], name: str, sensors: int, found: list[list[dict]]) -> None:
    """Add sessions to the tallies of their bench."""
    for session in found:
        for how, sums in zip(STATED, session, strict=True):
            if (name, sensors, how) in tallies:
                tallies[name, sensors, how].add(sums)


def table(tallies: dict[tuple[str, int, str], Tally]) -> int:
    """Print shares and efficiencies; mark with ! what misses its target, and return 1 where something does."""
    missed = 0
    for (name, sensors, how), tally in tallies.items():
        if not tally.sums:
            continue
        cells = []
        for kind in tally.sums:
            share, error = tally.percent(kind)
            cell = f"{kind} {share:5.1f}±{error:.1f}"
            wrong = not SHARES[0] - 2.0 * error <= share <= SHARES[1] + 2.0 * error
            ratio, spread = tally.efficiency(kind)
            if not isnan(ratio):
                cell += f" {ratio:.2f}±{spread:.2f}".replace("±0.", "±.")
                wrong |= ratio + 2.0 * spread < EFFICIENCY
            missed += wrong
            cells.append(f"{cell:<{26 if not isnan(ratio) else 16}}" + ("!" if wrong else " "))
        count = sensors * len(next(iter(tally.sums.values())))
        print(f"{name:42} {sensors} x {how:10} {count:5}  {' '.join(cells)}".rstrip())
    print(f"{missed} classes miss 93 to 97 % or {EFFICIENCY}")
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())

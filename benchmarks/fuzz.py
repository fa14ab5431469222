"""Does any damaged input end in anything but a result or one of our errors?

    python benchmarks/fuzz.py [--inputs 1000000] [--seed 1] [--jobs 2] [--minutes 60] [--only calibration,journal]

Every reader, driver parser and command gets files and words that were good and are damaged: bytes changed, words put in
place of others, values of another type in one place of a structure, journals with checks that are right. Each input has
10 s of processor time and 1 GB. A library in C or Rust that parses Parquet or NetCDF may end its process; that is
counted. Exit code 1 if an input failed; its target and number make it again: --only TARGET --first NUMBER --inputs 1.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.fuzzing import ENDED, FAILED, OURS, RESULT, TARGETS, campaign

ROUND = 100
"""Inputs of each target between two looks at the clock."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--inputs", type=int, default=1_000_000, help="of all targets together")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--minutes", type=float, default=float("inf"), help="stop after so long")
    parser.add_argument("--only", default=",".join(TARGETS), help="targets, separated by commas")
    parser.add_argument("--first", type=int, default=0, help="number of the first input of each target")
    options = parser.parse_args()
    names = options.only.split(",")
    last = options.first + max(options.inputs // len(names), 1)
    until = time.monotonic() + 60.0 * options.minutes

    def one_round(first: int) -> dict[str, Counter[str]]:
        if time.monotonic() > until:
            return {}
        numbers = range(first, min(first + ROUND, last))
        return campaign(names, options.seed, numbers, lambda text: print(text, flush=True)).ends

    ends: dict[str, Counter[str]] = {name: Counter() for name in names}
    with ThreadPoolExecutor(options.jobs) as pool:
        for one in pool.map(one_round, range(options.first, last, ROUND)):
            for name, counted in one.items():
                ends[name] += counted
    print(f"{'target':16}{'inputs':>8}{RESULT:>10}{OURS:>12}{ENDED:>24}{FAILED:>8}")
    for name, counted in ends.items():
        cells = f"{counted[RESULT]:>10}{counted[OURS]:>12}{counted[ENDED]:>24}{counted[FAILED]:>8}"
        print(f"{name:16}{counted.total():>8}{cells}")
    print(f"{sum(counted.total() for counted in ends.values())} inputs, seed {options.seed}")
    return 1 if any(counted[FAILED] for counted in ends.values()) else 0


if __name__ == "__main__":
    sys.exit(main())

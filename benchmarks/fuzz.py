"""Does any damaged input end in anything but a result or one of our errors?

    python benchmarks/fuzz.py [--inputs 1000000] [--seed 1] [--jobs 2] [--minutes 60] [--pieces fuzz.jsonl]
    python benchmarks/fuzz.py --inputs 100000 --only calibration,pair,procedure,bench,twin --batch 20

Every reader, driver parser and command gets files and words that were good and are damaged: bytes changed, words put in
place of others, values of another type in one place of a structure, journals with checks that are right. Readers and
drivers are called as functions and have most of the inputs; targets whose name ends in ``_used`` give the damaged file
to whole commands, and ``command`` damages arguments. Each input has 10 s of processor time and 1 GB. A library in C or
Rust that parses Parquet or NetCDF may end its process, or keep it busy until it is ended, as the commands do; that is
counted.

It works in rounds that are kept in a file, goes on where an earlier run ended, and prints the table of all rounds so
far. Exit code 1 if an input failed; its target and number make it again: --again TARGET:NUMBER.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("POLARS_MAX_THREADS", "1")

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from fuzzing.attempts import ENDED, FAILED, OURS, RESULT, attempt, attempts
from fuzzing.inputs import TARGETS


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--inputs", type=int, default=1_000_000, help="of all targets together")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--minutes", type=float, default=float("inf"), help="begin no round after so long")
    parser.add_argument("--pieces", type=Path, default=Path("fuzz.jsonl"))
    parser.add_argument("--only", default=",".join(TARGETS), help="targets, with commas between them")
    parser.add_argument("--batch", type=int, default=1, help="so many times the share of each target in a round")
    parser.add_argument("--again", metavar="TARGET:NUMBER", help="try this input alone, in this process")
    options = parser.parse_args()
    if options.again:
        name, _, number = options.again.partition(":")
        end, detail = attempt(name, options.seed, int(number))
        print(end, detail, sep="\n")
        return 1 if end == FAILED else 0
    kept = [json.loads(line) for line in options.pieces.read_text().splitlines()] if options.pieces.exists() else []
    shares = {name: options.batch * TARGETS[name].share for name in options.only.split(",")}
    kept = [one for one in kept if one["seed"] == options.seed and one["shares"] == shares]
    done = {one["round"] for one in kept}
    rounds = -(-options.inputs // sum(shares.values()))
    waiting = iter([number for number in range(rounds) if number not in done])
    until = time.monotonic() + 60.0 * options.minutes

    with options.pieces.open("a") as stream, ThreadPoolExecutor(options.jobs) as pool:

        def work(_: int) -> None:
            while time.monotonic() < until and (number := next(waiting, None)) is not None:
                kept.append(one_round(options.seed, number, shares))
                print(json.dumps(kept[-1]), file=stream, flush=True)

        list(pool.map(work, range(options.jobs)))
    return table(kept)


def one_round(seed: int, number: int, shares: dict[str, int]) -> dict[str, object]:
    """Try the share of every target, and return how the inputs ended."""
    ends: dict[str, Counter[str]] = {name: Counter() for name in shares}
    failures = []
    for name, share in shares.items():
        for k, end, detail in attempts(name, seed, range(number * share, (number + 1) * share)):
            ends[name][end] += 1
            if end == FAILED:
                failures.append((name, k, detail))
    return {"seed": seed, "shares": shares, "round": number, "ends": ends, "failures": failures}


def table(kept: list[dict]) -> int:
    """Print how all inputs ended, and return 1 where one failed."""
    ends: dict[str, Counter[str]] = {name: Counter() for one in kept for name in one["ends"]}
    for one in kept:
        for name, counted in one["ends"].items():
            ends[name].update(counted)
        for name, number, detail in one["failures"]:
            print(f"{name}:{number}: {detail}")
    print(f"{'target':20}{'inputs':>8}{RESULT:>10}{OURS:>12}{ENDED:>24}{FAILED:>8}")
    for name, counted in [*ends.items(), ("all", sum(ends.values(), Counter()))]:
        cells = f"{counted[RESULT]:>10}{counted[OURS]:>12}{counted[ENDED]:>24}{counted[FAILED]:>8}"
        print(f"{name:20}{counted.total():>8}{cells}")
    return 1 if any(counted[FAILED] for counted in ends.values()) else 0


if __name__ == "__main__":
    sys.exit(main())

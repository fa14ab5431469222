"""Coverage and efficiency where a table leans, headings are off, a converter is coarse, or a sweep has a loop.

    python benchmarks/bench_errors.py [--calibrations 400] [--seconds 60] [--pieces pieces.jsonl]

The errors of ``tests/support/bench_errors_study.py``, jig stated and not stated: the share of 95 % intervals that hold
the truth, and the Cramér-Rao bound over the mean square error where there is a bound. It works in pieces of 20
calibrations that are kept in the file, goes on where an earlier run ended, and prints the table of all pieces so far.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections import defaultdict
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.bench_errors_study import REGIMES, calibrated

PIECE = 20


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--calibrations", type=int, default=400, help="for each bench")
    parser.add_argument("--seconds", type=float, default=3600.0, help="no new piece is begun after this time")
    parser.add_argument("--pieces", type=Path, default=Path("bench-errors.jsonl"))
    options = parser.parse_args()
    pieces = [json.loads(line) for line in options.pieces.read_text().splitlines()] if options.pieces.exists() else []
    done = {(one["regime"], one["piece"]) for one in pieces}
    end = time.monotonic() + options.seconds
    with options.pieces.open("a") as stream:
        for piece in range(-(-options.calibrations // PIECE)):
            for number, regime in enumerate(REGIMES):
                if (number, piece) in done or time.monotonic() > end:
                    continue
                rng = np.random.default_rng([piece, number])
                found = [calibrated(rng, regime) for _ in range(PIECE)]
                pieces.append({"regime": number, "piece": piece, "found": found})
                print(json.dumps(pieces[-1]), file=stream, flush=True)
    return table(pieces)


def table(pieces: list[dict[str, object]]) -> int:
    """Print the regimes, and return 1 where a share is below 93 % or above 97 by more than two Monte Carlo errors."""
    outside = 0
    for number, regime in enumerate(REGIMES):
        found = [one for piece in pieces if piece["regime"] == number for one in piece["found"]]
        if not found:
            continue
        shares, squares = defaultdict(list), defaultdict(list)
        for inside, errors in found:
            for name in inside:
                shares[name].append(100.0 * inside[name][0])
                squares[name].append(errors[name])
        cells = []
        for name, values in shares.items():
            share, error = np.mean(values), np.std(values, ddof=1) / np.sqrt(len(values))
            outside += not 93.0 - 2.0 * error <= share <= 97.0 + 2.0 * error
            square, bound = np.array(squares[name]).T
            ratio = bound.mean() / square.mean()
            spread = ratio * np.std(square, ddof=1) / square.mean() / np.sqrt(len(square))
            efficiency = "" if np.isnan(ratio) else f" {ratio:4.2f}±{spread:.2f}"
            cells.append(f"{name} {share:5.1f}±{error:.1f}{efficiency}")
        told = "stated    " if regime.stated else "not stated"
        print(f"{regime.kind:16}  jig {told}  {len(found):4}  " + "  ".join(cells))
    return int(outside > 0)


if __name__ == "__main__":
    sys.exit(main())

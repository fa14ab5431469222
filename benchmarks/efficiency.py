"""How near is the estimator to the Cramér-Rao bound, and how far are the simpler ways?

    python benchmarks/efficiency.py [--noise 0.0005] [--calibrations 1200] [--seed 1] [--jobs 2]

For every jig, number of positions and number of sensors: the bound over the mean square error (1 is the best there is),
for offsets, main sensitivities and cross terms. ``*`` marks where the bound itself is out of reach of any estimator: an
attitude's square moves the readings by more than a twentieth of the bound's variance, and the bound counts only first
powers. Beside it, from the same readings: the estimator with a jig that is not stated, ordinary least squares with the
angles as set, the six-face formula (half sum and half difference of opposite faces, as imucal has it), and unit gravity
alone, whose cross terms are not comparable because its frame is its own.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # every process has a core to itself

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from efficiency_study import CLASSES, METHODS, REACH, EfficiencyRegime, Result, simulate

JIGS, COUNTS, SENSORS = (0.0, 0.02, 0.5), (6, 12, 18, 26), (1, 6)

HEAD = (
    "jig °  positions  sensors  " + "  ".join(f"{method:^26}" for method in METHODS),
    " " * 27 + "  ".join("  offset      own    cross " for _ in METHODS),
)


def line(regime: EfficiencyRegime, result: Result) -> str:
    """Return one regime in numbers."""
    cells = []
    for method in METHODS:
        for name in CLASSES:
            value = result.ratio[method][name]
            told = "    -    " if np.isnan(value) else f"{value:6.3f}   "
            if method == "joint":
                told = f"{value:5.2f}±{result.error[name]:.2f}".replace("±0.", "±.")
                told += "*" if result.attainable[name] < 1 - REACH else " "
            cells.append(told)
    return f"{regime.jig:5.2f}  {regime.count:9}  {regime.sensors:7}  " + "".join(cells)


def below(results: Mapping[EfficiencyRegime, Result]) -> list[str]:
    """Return where the estimator is below 0.95 by over twice the Monte Carlo error, and the bound is attainable."""
    return [
        f"{regime}: {name} {result.ratio['joint'][name]:.3f}"
        for regime, result in results.items()
        for name in CLASSES
        if result.attainable[name] >= 1 - REACH and result.ratio["joint"][name] + 2 * result.error[name] < 1 - REACH
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--noise", type=float, default=5e-4, help="of a position's mean, g")
    parser.add_argument("--calibrations", type=int, default=1200, help="for each bench")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    regimes = [EfficiencyRegime(*one, options.noise) for one in product(JIGS, COUNTS, SENSORS)]
    results = {}
    print(f"Cramér-Rao bound over mean square error, noise {1e3 * options.noise:g} mg a position", *HEAD, sep="\n")
    with ProcessPoolExecutor(options.jobs) as pool:
        futures = [pool.submit(simulate, regime, options.calibrations, options.seed) for regime in regimes]
        for regime, future in zip(regimes, futures, strict=True):
            results[regime] = future.result()
            print(line(regime, results[regime]), flush=True)
    failing = below(results)
    print("\n".join(failing) if failing else "nowhere below 0.95 where the bound is attainable")
    return 1 if failing else 0


if __name__ == "__main__":
    sys.exit(main())

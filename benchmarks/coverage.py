"""Is the truth inside the stated 95 % interval in 95 % of calibrations?

    python benchmarks/coverage.py [--jig stated] [--noise 0.0001] [--calibrations 4000] [--seed 1] [--jobs 2]

For every jig, number of positions and number of sensors, with the jig stated or not stated, for two temperatures and
for a sweep: in how many of the simulated calibrations the truth is inside ``value ± coverage factor x uncertainty``,
for each kind of coefficient and for the tilt that a calibration makes of a new reading. The noise is known from ten
block means a position, as at a real bench. A single class scatters by about 0.3 points at 4000 calibrations of one
sensor, and by more where six sensors share one jig's luck.
"""

from __future__ import annotations

import argparse
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # every process has a core to itself

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.coverage_study import Regime, Tally, regimes, simulate


def line(regime: Regime, tally: Tally) -> str:
    """Return one regime in words."""
    told = "stated    " if regime.stated else "not stated"
    cells = "  ".join(
        f"{name} {share:5.1f}±{error:.1f}" for name in tally.inside for share, error in [tally.percent(name)]
    )
    return f"{regime.name:17} {regime.sensors} x  jig {regime.plan.jig:4.2f}° {told}  {cells}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--jig", choices=("stated", "unstated"), help="only these benches")
    parser.add_argument("--noise", type=float, default=1e-4, help="of a position's mean, g")
    parser.add_argument("--calibrations", type=int, default=4000, help="for each bench")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    tried = [one for one in regimes(options.noise) if options.jig is None or one.stated == (options.jig == "stated")]
    outside = []
    with ProcessPoolExecutor(options.jobs) as pool:
        futures = [pool.submit(simulate, regime, options.calibrations, options.seed) for regime in tried]
        for regime, future in zip(tried, futures, strict=True):
            tally = future.result()
            print(line(regime, tally), flush=True)
            for name in tally.inside:
                share, error = tally.percent(name)
                if not 94.0 - 2 * error <= share <= 96.0 + 2 * error:
                    outside.append(f"{line(regime, tally)}: {name}")
    print(f"{len(outside)} classes outside 94 to 96 %", *outside, sep="\n")
    return 1 if outside else 0


if __name__ == "__main__":
    sys.exit(main())

"""How long does the joint estimate take, and how much memory, as sensors are added to a fixture?

    python benchmarks/fixture.py [--positions 100] [--sensors 1 24 96]

Three-axis sensors in random attitudes, 0.1 mg of noise that is known from ten block means, a jig of 0.1°, stated and
not stated. Processor time, as the machine may be busy; peak memory of the process. The exit code is 1 where 96
sensors take more than 5 s or 0.5 GB with a stated jig, 24 more than 1 s, or the growth between them is above 5.
"""

from __future__ import annotations

import argparse
import os
import resource
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.simulated_bench import Plan, design, fixture, measured, part

from tiltcal.core.estimation.estimate import estimate_jointly


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--positions", type=int, default=100)
    parser.add_argument("--sensors", type=int, nargs="+", default=[1, 24, 96])
    options = parser.parse_args()
    rng = np.random.default_rng(1)
    gravity = rng.normal(size=(options.positions, 3))
    gravity /= np.linalg.norm(gravity, axis=1)[:, None]
    plan = Plan(gravity, np.zeros(options.positions), noise=1e-4, jig=0.1)
    observations = measured(rng, plan, [part(rng) for _ in range(max(options.sensors))], known_noise=False)
    taken = {}
    for sensors in options.sensors:
        for jig in (0.1, None):
            start = time.process_time()
            estimate_jointly(fixture(observations[:sensors], design(plan, jig=jig)))
            taken[sensors, jig] = time.process_time() - start
            memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            told = "not stated" if jig is None else "stated"
            print(f"{sensors:3} sensors  jig {told:10}  {taken[sensors, jig]:6.2f} s  {memory:5.0f} MB", flush=True)
    few, many = taken.get((24, 0.1), 0.0), taken.get((96, 0.1), 0.0)
    return int(few > 1.0 or many > 5.0 or memory > 512.0 or (few > 0.0 and many > 5.0 * few))


if __name__ == "__main__":
    sys.exit(main())

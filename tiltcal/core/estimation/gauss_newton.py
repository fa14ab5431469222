"""The minimum of a weighted sum of squares, by Gauss-Newton steps that are shortened where they lead uphill."""

from __future__ import annotations

from math import inf

from tiltcal.core.estimation.elimination import eliminate
from tiltcal.core.estimation.joint_equations import System
from tiltcal.core.model import Array
from tiltcal.errors import EstimateError

STEPS = 200
"""Most steps; a bench needs three to six, and one that is far worse than it was stated to be some sixty."""

SETTLED = 1e-14
"""A step that changes the readings by less than this share of the largest is lost in their rounding."""

NEAR = 1e-20
"""Where a step promises a fall of the sum of squares below this share of it, its end is the minimum."""

PLATEAU = 1e-12
"""A promise below this share of the sum of squares is near the rounding of the sum, which then judges no step."""

CREEPING = 1e-3
"""A fall below this share of the sum, after all steps: far from what was stated, the way down is long and flat."""

ROUNDING = 1e-6
"""A fall of the sum of squares below this share of it is lost in the rounding of the readings."""

DAMPING = (0.0, 1e-6, 1e-4, 1e-2, 1.0, 1e2, 1e4)
"""Levenberg's damping, tried in turn until the sum of squares falls."""


def minimise(system: System, start: Array) -> Array:
    """Find where the sum of squared residuals is least, shape (unknowns,).

    Parameters
    ----------
    system : System
        Coefficients that are held stay where they start.
    start : ndarray, shape (unknowns,)

    Raises
    ------
    EstimateError
        No minimum is reached.
    """
    z, here = start, system.at(start)
    shared = system.unknowns - system.local
    fall, last = 1.0, inf
    for _ in range(STEPS):
        linear = eliminate(here, shared)
        promised = linear.decrease
        if promised <= max(NEAR * (1.0 + here.cost), (SETTLED * (1.0 + system.reach)) ** 2):
            return z + linear.step(system)
        if promised <= PLATEAU * (1.0 + here.cost):
            if promised >= last:
                return z
            z, last = z + linear.step(system), promised
            here = system.at(z)
            continue
        for damping in DAMPING:
            step = (eliminate(here, shared, damping=damping) if damping else linear).step(system)
            there = system.at(z + step)
            if there.cost < here.cost:
                break
        else:
            if promised <= ROUNDING * (1.0 + here.cost):
                return z
            raise EstimateError(
                "the estimate does not settle: are the positions named right, and the readings plausible?"
            )
        fall = (here.cost - there.cost) / (1.0 + here.cost)
        z, here = z + step, there
    if fall <= CREEPING:
        return z
    raise EstimateError(f"the estimate does not settle in {STEPS} steps: are the positions named right?")

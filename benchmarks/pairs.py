"""How honest the uncertainty of p and q is, and how much of the information in a record is used.

    python benchmarks/pairs.py [--records 2000] [--case NAME ...] [--json]

Every case is a record of four accelerometers by eq. 4 of the source, made here and not by the twin. Shown are, for p
and q, the share of records whose 95 % interval holds the truth, the standard deviation of the error over the stated
uncertainty, and, in white noise, the Cramér-Rao bound over the variance. Exit code 1 where a coverage is outside 94 to
96 %, by more than chance explains for so many records, or an efficiency is below 0.9.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass
from math import sqrt

import numpy as np

from tiltcal.core.model import Array
from tiltcal.core.pair.demodulate import demodulate
from tiltcal.core.pair.matching import solve
from tiltcal.core.pair.model import Pair
from tiltcal.core.pair.online import Online
from tiltcal.core.pair.stage import follow

PAIR = Pair("a1", "a2", "a4")
SCALE = np.array([3.383, 3.415, 3.390])
MISALIGNMENT = np.array([0.022, -0.015, -0.020])
PHASE = np.deg2rad([0.0, 180.0, 270.0])
SPIN = 0.125
COVERAGE = (0.94, 0.96)
LEAST_EFFICIENCY = 0.9


@dataclass(frozen=True)
class Case:
    """A kind of record: turns, rows a second, noise of a row, its corner in Hz, wander, encoder noise in degrees."""

    turns: float = 100.0
    rate: float = 50.0
    noise: float = 3e-4
    corner: float = 0.0
    wander: float = 0.0
    encoder: float = 0.0
    online: bool = False
    loops: bool = False

    @property
    def white(self) -> bool:
        """Whether the bound is that of white noise."""
        return self.corner == 0.0


CASES = {
    "laboratory": Case(),
    "common acceleration wanders": Case(wander=0.02),
    "1/f below 0.1 Hz": Case(corner=0.1),
    "encoder noise": Case(encoder=0.05),
    "25 turns": Case(turns=25.0, rate=10.0),
    "25 turns, 1/f": Case(turns=25.0, rate=10.0, corner=0.1),
    "10 turns, 1/f": Case(turns=10.0, rate=10.0, corner=0.1),
    "2.3 turns": Case(turns=2.3, rate=50.0),
    "recursive, 25 turns, 1/f": Case(turns=25.0, rate=10.0, corner=0.1, online=True),
    "loops, 25 turns": Case(turns=25.0, rate=10.0, online=True, loops=True),
    "loops, 100 turns, 1/f": Case(rate=10.0, corner=0.1, online=True, loops=True),
}


def phasors() -> np.ndarray[tuple[int], np.dtype[np.complex128]]:
    """Sine and cosine component of the three channels, as real and imaginary part, for an acceleration of 1."""
    return np.asarray(SCALE * np.exp(1j * PHASE) * (1.0 + 1j * MISALIGNMENT))


def truth() -> Array:
    """Return p and q that leave no component."""
    first, second, orthogonal = phasors()
    system = np.array([[first.real, orthogonal.real], [first.imag, orthogonal.imag]])
    rest, q = np.linalg.solve(system, [-second.real, -second.imag])
    return np.array([1.0 - rest, q])


def record(case: Case, seed: int) -> tuple[Array, Array]:
    """Stage angle in degrees as the encoder tells it, and the readings."""
    draw = np.random.default_rng(seed)
    rows = round(case.turns / SPIN * case.rate)
    turned = SPIN * np.arange(rows) / case.rate + draw.random()
    common = 1.0 + case.wander * np.sin(2.0 * np.pi * (1.3 * np.arange(rows) / rows + draw.random()))
    sine, cosine = np.sin(2.0 * np.pi * turned), np.cos(2.0 * np.pi * turned)
    readings = common[:, None] * (np.outer(sine, phasors().real) + np.outer(cosine, phasors().imag))
    readings += case.noise * _noise(draw, rows, case.corner / case.rate)
    return 360.0 * turned + case.encoder * draw.standard_normal(rows), readings


def _noise(draw: np.random.Generator, rows: int, corner: float) -> Array:
    """Three columns with the density 1 + corner / f, of a record four times as long."""
    if not corner:
        return draw.standard_normal((rows, 3))
    lines = np.fft.rfft(draw.standard_normal((4 * rows, 3)), axis=0)
    frequency = np.fft.rfftfreq(4 * rows)
    lines[1:] *= np.sqrt(1.0 + corner / frequency[1:])[:, None]
    return np.fft.irfft(lines, 4 * rows, axis=0)[:rows]


def estimate(case: Case, seed: int) -> tuple[float, float, float, float]:
    """Return p, q and their uncertainties."""
    theta, readings = record(case, seed)
    if case.online:
        online = Online(PAIR, PAIR.channels)
        online.push(theta, readings.T)
        solved = online.coefficients(loops=case.loops)
    else:
        solved = solve(demodulate(PAIR.channels, follow(theta), readings.T, np.ones(len(theta), bool)), PAIR)
    return solved.p, solved.q, solved.u_p, solved.u_q


def bound(case: Case) -> float:
    """Return the least standard deviation of p and of q: of three sines in white noise, from their phasors alone."""
    first, _, orthogonal = phasors()
    rows = case.turns / SPIN * case.rate
    rest, q = 1.0 - truth()[0], truth()[1]
    per_component = 2.0 / rows * case.noise**2 * (rest**2 + 1.0 + q**2)
    system = np.array([[first.real, orthogonal.real], [first.imag, orthogonal.imag]])
    return sqrt(per_component * float(np.mean(np.diag(np.linalg.inv(system.T @ system)))))


def judged(case: Case, records: int) -> dict[str, list[float]]:
    found = np.array([estimate(case, seed) for seed in range(records)])
    error, stated = found[:, :2] - truth(), found[:, 2:]
    result = {
        "coverage": np.mean(np.abs(error) < 1.96 * stated, axis=0),
        "scatter_over_stated": np.sqrt(np.mean(error**2, axis=0) / np.mean(stated**2, axis=0)),
    }
    if case.white and not case.online and case.turns == round(case.turns):
        result["efficiency"] = bound(case) ** 2 / np.mean(error**2, axis=0)
    return {name: [round(float(value), 4) for value in values] for name, values in result.items()}


def good(result: dict[str, list[float]], records: int) -> bool:
    """Return whether coverage and efficiency are what they must be."""
    chance = 2.0 * sqrt(0.05 * 0.95 / records)
    low, high = COVERAGE[0] - chance, COVERAGE[1] + chance
    return all(low < share < high for share in result["coverage"]) and all(
        value > LEAST_EFFICIENCY - 2.0 * sqrt(2.0 / records) for value in result.get("efficiency", [])
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--records", type=int, default=2000)
    parser.add_argument("--case", action="append", choices=list(CASES))
    parser.add_argument("--json", action="store_true")
    chosen = parser.parse_args()
    results = {}
    if not chosen.json:
        print(f"{'':<30}{'coverage p, q':<20}{'error / stated':<20}efficiency", flush=True)
    for name in chosen.case or CASES:
        found = results[name] = judged(CASES[name], chosen.records)
        if not chosen.json:
            columns = [
                ", ".join(f"{value:.3f}" for value in found.get(key, []))
                for key in ("coverage", "scatter_over_stated", "efficiency")
            ]
            print(f"{name:<30}" + "".join(f"{text:<20}" for text in columns).rstrip(), flush=True)
    if chosen.json:
        print(json.dumps(results))
    return 0 if all(good(found, chosen.records) for found in results.values()) else 1


if __name__ == "__main__":
    sys.exit(main())

"""Does the curve of ``fit ramp`` hold its 95 % interval, and is the lag right, whatever makes the loop.

The record is made here: a chamber goes from 5 to 45 °C and back at a steady pace, the element follows it by exact
filters, and two channels read a cubic of the element's temperature with noise of 0.5 units. The curve is compared at
ten temperatures within what the element reached: with the true one, which lies between the ways where there is
hysteresis, and with what the sensor reads without noise on the last two ways. Records of two lags are to be refused.
Writes a line of JSON for each record and goes on where it ended:

    python benchmarks/ramp.py --records 100 ramp.jsonl
    python benchmarks/ramp.py --records 0 ramp.jsonl      # the table alone
"""

from __future__ import annotations

import argparse
import json
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import lfilter

from tiltcal.core.ramp.fit import fit_ramp
from tiltcal.core.ramp.record import ramp_record
from tiltcal.core.thermal_lag import ThermalLag
from tiltcal.errors import EstimateError

LOW, SPAN, REFERENCE = 5.0, 40.0, 24.0
CURVES = np.array([[1000.0, 0.8, 0.010, -1e-4], [1000.0, -0.5, 0.004, 1e-4]])
"""unit, unit/°C, unit/°C², unit/°C³."""

ROWS = 2400
DESIGNS = ((1.0, 4), (0.5, 2), (1.0, 3))
"""Pace, °C/min, and legs."""

EXTREMES = ((0.25, 2), (2.0, 4))
"""More of them, for one lag."""

KINDS = {
    "lag": "one lag of 120 s",
    "quiet": "one lag of 120 s, noise of 0.02 units",
    "negative": "the thermometer 120 s behind the element",
    "none": "no lag",
    "parallel": "0.6 of 60 s beside 0.4 of 400 s",
    "series": "150 s behind 60 s",
    "play": "hysteresis: a play of 2 °C",
    "lens": "hysteresis that grows from both turns",
    "wander": "a random walk of 1 unit in all",
    "slow": "noise of 0.7 units that lasts a fifth of the record",
    "thermometer": "noise of 0.2 °C in the thermometer",
    "both": "noise of 0.2 °C in the thermometer, and a lag of 120 s",
    "late quiet": "the thermometer 120 s behind, noise of 0.02 units",
    "late noisy": "the thermometer 120 s behind, with noise of 0.05 °C",
    "late both": "the thermometer 160 s behind, the element 40 s",
}


def delayed(temperature: np.ndarray, lag: float) -> np.ndarray:
    """Return a first-order lag of a temperature that is linear from second to second."""
    decay = np.exp(-1.0 / lag)
    mean = (1.0 - decay) * lag
    first = temperature[0]
    return first + lfilter([1.0 - mean, mean - decay], [1.0, -decay], temperature - first)


def played(temperature: np.ndarray, half: float) -> np.ndarray:
    """Return a temperature that follows by a play of twice ``half``."""
    follows, place = np.empty_like(temperature), temperature[0]
    for k, value in enumerate(temperature):
        follows[k] = place = min(max(place, value - half), value + half)
    return follows


def record(kind: str, pace: float, legs: int, draw: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Return time, thermometer, readings, and thermometer and readings without noise."""
    half = SPAN / pace * 60.0
    time = np.arange(0.0, legs * half)
    chamber = LOW + SPAN * np.abs((time / half + 1.0) % 2.0 - 1.0)
    element = thermometer = chamber
    if kind in ("lag", "quiet", "both"):
        element = delayed(chamber, 120.0)
    elif kind in ("negative", "late quiet", "late noisy"):
        thermometer = delayed(chamber, 120.0)
    elif kind == "late both":
        thermometer, element = delayed(chamber, 160.0), delayed(chamber, 40.0)
    elif kind == "parallel":
        element = 0.6 * delayed(chamber, 60.0) + 0.4 * delayed(chamber, 400.0)
    elif kind == "series":
        element = delayed(delayed(chamber, 60.0), 150.0)
    elif kind == "play":
        element = played(chamber, 1.0)
    readings = np.stack([np.polynomial.polynomial.polyval(element - REFERENCE, curve) for curve in CURVES], axis=1)
    if kind == "lens":
        share = (chamber - LOW) / SPAN
        up = np.where((time // half) % 2 == 0, -1.0, 1.0)
        readings += (0.8 * up * 4.0 * share * (1.0 - share))[:, None] * np.array([1.0, -0.7])
    kept = slice(None, None, max(len(time) // ROWS, 1))
    time, thermometer, readings = time[kept], thermometer[kept], readings[kept]
    still = thermometer, readings
    readings = readings + (0.02 if "quiet" in kind else 0.5) * draw.normal(size=readings.shape)
    if kind == "wander":
        readings += np.cumsum(draw.normal(size=readings.shape), axis=0) / np.sqrt(len(time))
    if kind == "slow":
        decay = np.exp(-5.0 / len(time))
        steps = draw.normal(size=readings.shape) * np.sqrt(1.0 - decay**2)
        steps[0] = draw.normal(size=2)
        readings += 0.7 * lfilter([1.0], [1.0, -decay], steps, axis=0)
    if kind in ("thermometer", "both", "late noisy"):
        thermometer = thermometer + (0.05 if kind == "late noisy" else 0.2) * draw.normal(size=len(time))
    return time, thermometer, readings, *still


def judged(kind: str, pace: float, legs: int, seed: int) -> dict[str, Any]:
    """Fit one record, and compare its curve with the true one."""
    draw = np.random.default_rng([seed, [*KINDS].index(kind), int(100 * pace), legs])
    time, thermometer, readings, exact, still = record(kind, pace, legs, draw)
    whole = ramp_record(time, thermometer, readings.T)
    try:
        fit = fit_ramp(whole, reference=REFERENCE, highest=3)
    except EstimateError as refusal:
        return {"refused": str(refusal)}
    reached = ThermalLag(fit.lag)(whole.time, whole.temperature)
    margin = 0.05 * np.ptp(reached)
    at = np.linspace(reached.min() + margin, reached.max() - margin, 10) - REFERENCE
    powers, true = np.vander(at, fit.order + 1, increasing=True), np.vander(at, 4, increasing=True) @ CURVES.T
    error = powers @ fit.coefficients.T - true
    total = fit.covariance + fit.loop_covariance
    blocks = [total[k : k + fit.order + 1, k : k + fit.order + 1] for k in (0, fit.order + 1)]
    variance = np.stack([np.einsum("ij,jk,ik->i", powers, block, powers) for block in blocks], axis=1)
    slope = powers[:, :-1] @ (fit.coefficients[:, 1:] * np.arange(1, fit.order + 1)).T
    u_on_ways = np.sqrt(variance + (slope * fit.u_element) ** 2)
    element, ways = ThermalLag(fit.lag)(time, exact), []
    for leg in (legs - 2, legs - 1):
        rows = np.flatnonzero((time // (SPAN / pace * 60.0)).astype(int) == leg)
        rows = rows[np.argsort(element[rows])]
        nothing = {"left": np.nan, "right": np.nan}
        read = np.stack([np.interp(at + REFERENCE, element[rows], still[rows, c], **nothing) for c in (0, 1)], axis=1)
        ways.append((powers @ fit.coefficients.T - read) / u_on_ways)
    off = np.abs(np.array(ways))
    alone = np.polynomial.polynomial.polyfit(thermometer - REFERENCE, readings, 3)
    return {
        "held": float(np.mean(np.abs(error) <= 1.96 * np.sqrt(variance))),
        "ways": float(np.mean(off[np.isfinite(off)] <= 1.96)),
        "reach": float(np.median(1.96 * np.sqrt(variance))),
        "used": fit.uses_lag,
        "lag": fit.found_lag,
        "error": float(np.abs(error).max()),
        "alone": float(np.abs(np.vander(at, 4, increasing=True) @ alone - true).max()),
    }


def table(lines: list[dict[str, Any]]) -> None:
    """Print how often intervals hold the curve and both ways, the lag, and the error over that of a cubic alone."""
    groups = defaultdict(list)
    for one in lines:
        groups[one["kind"], one["pace"], one["legs"]].append(one)
    print(f"{'':58} °C/min legs    n  refused  curve %   ways %   lag used    lag s     error / alone")
    for (kind, pace, legs), all_ in sorted(groups.items(), key=lambda group: [*KINDS].index(group[0][0])):
        fits = [one for one in all_ if "held" in one]
        if not fits:
            print(f"{KINDS[kind]:58} {pace:5.2f} {legs:4} {len(all_):4} {len(all_):8}")
            continue
        held, ways, lags = (np.array([one[key] for one in fits]) for key in ("held", "ways", "lag"))
        ratio, used = (
            np.median([one["error"] / one["alone"] for one in fits]),
            100 * np.mean([one["used"] for one in fits]),
        )
        print(
            f"{KINDS[kind]:58} {pace:5.2f} {legs:4} {len(all_):4} {len(all_) - len(fits):8}"
            f"   {100 * held.mean():5.1f}±{100 * held.std() / len(held) ** 0.5:3.1f}  {100 * ways.mean():5.1f}"
            f"   {used:4.0f} %  {lags.mean():7.1f}±{lags.std():4.1f}   {ratio:.3f}"
        )


def main() -> None:
    """Make the records that are missing, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path)
    parser.add_argument("--records", type=int, default=100)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--designs", default=",".join(f"{pace}x{legs}" for pace, legs in DESIGNS))
    options = parser.parse_args()
    lines = [json.loads(line) for line in options.file.read_text().splitlines()] if options.file.exists() else []
    done = {(one["kind"], one["pace"], one["legs"], one["seed"]) for one in lines}
    designs = [(float(pace), int(legs)) for pace, legs in (one.split("x") for one in options.designs.split(","))]
    with options.file.open("a") as file:
        for seed in range(options.records):
            for kind in options.kinds.split(","):
                for pace, legs in designs + [*EXTREMES] * (kind in ("lag", "quiet")):
                    if (kind, pace, legs, seed) not in done:
                        named = {"kind": kind, "pace": pace, "legs": legs, "seed": seed}
                        lines.append(named | judged(kind, pace, legs, seed))
                        print(json.dumps(lines[-1]), file=file, flush=True)
    table(lines)


if __name__ == "__main__":
    main()

"""A continuous record as means of consecutive rows, without temperatures that jump, and its legs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.detection import LEFT_OUT, TEMPERATURE_JUMP
from tiltcal.core.flags import Mask
from tiltcal.core.model import Array
from tiltcal.core.samples import even_step
from tiltcal.errors import EstimateError

MOST = 4096  # means that a record has at least, where it has so many rows
_FEWEST_ROWS = 32  # fewest rows of a record
_STEPS = 4.0  # usual steps by which a ramp of few rows may change from one row to the next
_GAP = 10.0  # usual intervals without a row, after which any temperature may follow
_BURST = 0.8  # rows closer than this fraction of the mean interval count as one
_FIRST = 5  # rows whose median is the temperature that a record begins with
_TURN = 0.2  # a leg ends where the temperature comes back by this fraction of the range
_SMALLEST_RANGE = 2.0  # °C; below it no drift is distinguished from noise
_FEWEST_STEPS = 8  # smallest range of the temperature, in steps of the thermometer
_OVERLAP = 0.5  # fraction of the range that heating and cooling must both cover
_SQUARE_OF_90_PERCENT = 2.706  # 90 % quantile of chi-square with one degree of freedom


@dataclass(frozen=True)
class RampRecord:
    """Means of consecutive rows of a record."""

    time: Array  # s
    temperature: Array  # °C
    readings: Array  # (n, channels)
    noise: Array  # (channels,): standard deviation of a single reading about its neighbours, unit
    rows: int  # that count
    jumps: str  # which temperatures were left out
    step: float  # of the thermometer, °C; 0 where it is continuous


def ramp_record(time: Array, temperature: Array, readings: Sequence[Array], first: int = 0) -> RampRecord:
    """Return the means of the rows that have all values and whose temperature does not jump.

    Times in s, temperatures in °C and the readings of each channel are of shape (n,), NaN where one is missing;
    ``first`` is the number of the first row. An EstimateError where rows are too few.
    """
    table = np.stack([time, temperature, *readings], axis=1)
    there = np.isfinite(table).all(axis=1)
    if (rows := int(there.sum())) < _FEWEST_ROWS:
        raise EstimateError(f"the record has {rows} rows with time, temperature and readings: too few")
    counts, jumps = _without_jumps(time, temperature, first)
    table = table[counts & there]
    rows = len(table)
    bursts = np.flatnonzero(np.diff(table[:, 0], prepend=-np.inf) >= _BURST * np.ptp(table[:, 0]) / rows)
    means = averaged(table, bursts[:: max(len(bursts) // MOST, 1)])
    noise = np.sqrt(np.mean(np.diff(table[:, 2:], axis=0) ** 2, axis=0) / 2.0)
    return RampRecord(means[:, 0], means[:, 1], means[:, 2:], noise, rows, jumps, even_step(table[:, 1]))


def averaged(values: Array, starts: NDArray[np.intp]) -> Array:
    """Return the means of rows from each start to the next one."""
    sizes = np.diff(starts, append=len(values)).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray(np.add.reduceat(values, starts, axis=0) / sizes)


def _without_jumps(time: Array, temperature: Array, first: int) -> tuple[Mask, str]:
    """Return the rows whose temperature does not jump away from those before and come back, and the others in words."""
    counts = np.ones(len(time), dtype=bool)
    rows = np.flatnonzero(np.isfinite(time) & np.isfinite(temperature))
    values, intervals = temperature[rows], np.diff(time[rows])
    steps = np.abs(np.diff(values))
    limit = max(TEMPERATURE_JUMP, _STEPS * float(np.median(steps)))
    fresh = np.append(True, intervals > _GAP * np.median(intervals))
    starts = np.flatnonzero(fresh | np.append(False, steps > limit)).tolist()
    before, example = 0.0, ""
    for start, end in pairwise([*starts, len(rows)]):
        if fresh[start]:
            before = float(np.median(values[start : start + _FIRST]))
        if abs(values[start] - before) > limit:
            counts[rows[start:end]] = False
            example = example or f"row {first + rows[start]}, {values[start]:g} °C beside {before:.4g} °C"
        else:
            before = float(values[end - 1])
    jumping = int(np.count_nonzero(~counts))
    where = f"{jumping}, the first in {example}"
    if jumping > max(1, LEFT_OUT * len(rows)):
        raise EstimateError(
            f"of {len(rows)} temperatures too many jump by more than {TEMPERATURE_JUMP:g} °C ({where}): see to the "
            "thermometer's wiring and supply (a DS18B20 that converts nothing reads 85 °C), or take these rows out of "
            "the log"
        )
    left_out = f"temperatures that jump by more than {TEMPERATURE_JUMP:g} °C are left out: {where}"
    return counts, left_out if jumping else ""


def row_noise(values: Array) -> float:
    """Return the standard deviation of white noise in rows, by fourth differences: a ramp makes these at its turns."""
    return float(np.sqrt(np.quantile(np.diff(values, 4) ** 2, 0.9) / (70.0 * _SQUARE_OF_90_PERCENT)))


@dataclass(frozen=True)
class Leg:
    """A part of a record, from mean ``start`` to before ``end``, in which the temperature goes one way."""

    start: int
    end: int
    low: float  # °C
    high: float
    rising: bool
    seconds: float
    pace: float  # in the middle of its way, °C/min

    @property
    def way(self) -> str:
        """``up`` or ``down``."""
        return "up" if self.rising else "down"


def legs_of(record: RampRecord) -> list[Leg]:
    """Return the legs of a record, from turn to turn of its temperature.

    An EstimateError, with the pace to take, where there is no way up and no way down over the same temperatures.
    """
    if np.any(np.diff(record.time) <= 0.0):
        raise EstimateError("the time of the record goes back or stands still: name its column of times, in order")
    whole, least = float(np.ptp(record.temperature)), max(_SMALLEST_RANGE, _FEWEST_STEPS * record.step)
    if not whole >= least:
        steps = f" in steps of {record.step:.2g} °C" if record.step else ""
        raise EstimateError(
            f"the temperature changes by {whole:.2g} °C{steps} in the record: a drift takes at least {least:.2g} °C, "
            "up and down again, or a finer thermometer"
        )
    legs = [_leg(record, *ends) for ends in pairwise([*_turns(record.temperature, _TURN * whole), len(record.time)])]
    ways = [[leg for leg in legs if leg.rising is way] for way in (True, False)]
    shared = min(max((leg.high for leg in way), default=-np.inf) for way in ways)
    shared -= max(min((leg.low for leg in way), default=np.inf) for way in ways)
    if shared < _OVERLAP * whole:
        raise EstimateError(
            f"the ways up and down share {max(shared, 0.0):.2g} °C of {whole:.2g} °C, too little to separate a thermal "
            "lag from drift: let the temperature come all the way back, at "
            f"{max(leg.pace for leg in legs):.2g} °C/min or slower"
        )
    return legs


def _turns(temperature: Array, threshold: float) -> list[int]:
    """Return the first mean, and those at which the temperature turns."""
    values = temperature.tolist()
    turns, extreme, direction = [0], 0, 0
    for k, value in enumerate(values):
        if direction == 0:
            if abs(value - values[0]) > threshold:
                direction, extreme = (1 if value > values[0] else -1), k
        elif (value - values[extreme]) * direction > 0.0:
            extreme = k
        elif (values[extreme] - value) * direction > threshold:
            turns.append(extreme)
            direction, extreme = -direction, k
    return turns


def _leg(record: RampRecord, start: int, end: int) -> Leg:
    t, time = record.temperature[start:end], record.time[start:end]
    low, high = float(t.min()), float(t.max())
    middle = time[(t > low + 0.1 * (high - low)) & (t < high - 0.1 * (high - low))]
    seconds = float(np.ptp(middle)) if len(middle) > 1 else float(np.ptp(time))
    pace = 0.8 * (high - low) / seconds * 60.0 if seconds > 0.0 else 0.0
    return Leg(start, end, low, high, bool(t[-1] > t[0]), float(np.ptp(time)), pace)

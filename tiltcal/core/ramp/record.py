"""A continuous record as means of consecutive rows, in bounded memory, and its legs."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from tiltcal.core.model import Array
from tiltcal.core.quantisation import StepFinder
from tiltcal.core.ramp.temperature_jumps import JumpDetector, TemperatureJumps
from tiltcal.errors import EstimateError

MOST = 4096
"""Means that are kept; from twice as many on, two by two become one."""

TURN = 0.2
"""Part of the whole range of temperature by which it must come back for a leg to end."""

SMALLEST_RANGE = 2.0
"""°C; below it no drift is distinguished from noise."""

OVERLAP = 0.5
"""Part of the whole range that the ways up and the ways down must both cover."""

FEWEST_STEPS = 8
"""Steps of the thermometer that the whole range must have."""

FEWEST_ROWS = 32
"""Rows of a record."""


@dataclass(frozen=True)
class RampRecord:
    """Means of consecutive rows of a record.

    Attributes
    ----------
    time : ndarray, shape (n,)
        s.
    temperature : ndarray, shape (n,)
        Of the thermometer, °C.
    readings : ndarray, shape (n, channels)
        Unit.
    noise : ndarray, shape (channels,)
        Standard deviation of a single reading about its neighbours, unit.
    rows : int
        Rows of the record that have all values.
    jumps : TemperatureJumps or None
        Of the temperatures that were left out.
    step : float
        Of the thermometer's reading, °C; 0 where it is continuous.
    """

    time: Array
    temperature: Array
    readings: Array
    noise: Array
    rows: int
    jumps: TemperatureJumps | None = None
    step: float = 0.0


class RecordAverager:
    """Makes a record of rows as they come; the first one has the number ``row``."""

    def __init__(self, channels: int, row: int = 0) -> None:
        self._jumps = JumpDetector(row)
        self._step = StepFinder()
        self._sums = np.zeros((0, 2 + channels))
        self._waiting = np.zeros((0, 2 + channels))
        self._size = 1
        self._squares = np.zeros(channels)
        self._last = np.zeros((0, 2 + channels))
        self._rows = 0

    def add(self, time: Array, temperature: Array, readings: Array) -> None:
        """Take some more rows; those that miss a value, and temperatures that jump, are left out.

        Parameters
        ----------
        time, temperature : ndarray, shape (n,)
            s and °C.
        readings : ndarray, shape (n, channels)
        """
        rows = np.column_stack([time, temperature, readings])
        rows = rows[np.isfinite(rows).all(axis=1) & ~self._jumps(time, temperature)]
        self._rows += len(rows)
        self._step.add(rows[:, 1])
        self._squares += np.sum(np.diff(np.concatenate([self._last, rows])[:, 2:], axis=0) ** 2, axis=0)
        self._last = rows[-1:] if len(rows) else self._last
        waiting = np.concatenate([self._waiting, rows])
        whole = len(waiting) // self._size * self._size
        sums = waiting[:whole].reshape(-1, self._size, waiting.shape[1]).sum(axis=1)
        self._sums, self._waiting = np.concatenate([self._sums, sums]), waiting[whole:]
        while len(self._sums) >= 2 * MOST:
            pairs = len(self._sums) // 2 * 2
            if pairs < len(self._sums):
                # The odd one waits as rows that have its mean.
                odd = np.repeat(self._sums[pairs:] / self._size, self._size, axis=0)
                self._waiting = np.concatenate([odd, self._waiting])
            self._sums = self._sums[:pairs].reshape(-1, 2, self._sums.shape[1]).sum(axis=1)
            self._size *= 2

    def record(self) -> RampRecord:
        """Return the means of the rows so far; the last rows that fill no mean are left out.

        Raises
        ------
        EstimateError
            There are too few rows, or too many temperatures jump.
        """
        if self._jumps.found is not None:
            self._jumps.found.require_few(self._rows + self._jumps.found.count)
        if self._rows < FEWEST_ROWS:
            raise EstimateError(f"the record has {self._rows} rows with time, temperature and readings: too few")
        means = self._sums / self._size
        noise = np.sqrt(self._squares / (2.0 * max(self._rows - 1, 1)))
        return RampRecord(
            means[:, 0], means[:, 1], means[:, 2:], noise, self._rows, self._jumps.found, self._step.result()
        )


@dataclass(frozen=True)
class Leg:
    """A part of a record in which the temperature goes one way.

    Attributes
    ----------
    start, end : int
        Its first mean, and the one behind its last.
    low, high : float
        Its temperatures, °C.
    seconds : float
        How long it lasts.
    pace : float
        In the middle of its way, °C/min.
    """

    start: int
    end: int
    low: float
    high: float
    rising: bool
    seconds: float
    pace: float

    @property
    def way(self) -> str:
        """``up`` or ``down``."""
        return "up" if self.rising else "down"


def legs_of(record: RampRecord) -> list[Leg]:
    """Return the legs of a record, from turn to turn of its temperature.

    Raises
    ------
    EstimateError
        Time goes back, or there is no way up and no way down over the same temperatures; the message has the pace to
        take.
    """
    if np.any(np.diff(record.time) <= 0.0):
        raise EstimateError("the time of the record goes back or stands still: name its column of times, in order")
    whole = float(np.ptp(record.temperature))
    if not whole >= SMALLEST_RANGE:
        raise EstimateError(
            f"the temperature changes by {whole:.2g} °C in the record: a drift takes at least {SMALLEST_RANGE:g} °C, "
            "up and down again"
        )
    if record.step * FEWEST_STEPS > whole:
        raise EstimateError(
            f"the temperature changes by {whole:.2g} °C in steps of {record.step:.2g} °C, too coarse to separate drift "
            f"from rounding: let it change by at least {FEWEST_STEPS * record.step:.2g} °C, or read a finer thermometer"
        )
    bounds = [*_turns(record.temperature, TURN * whole), len(record.time)]
    legs = [_leg(record, start, end) for start, end in pairwise(bounds)]
    _require_both_ways(legs, whole)
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


def _require_both_ways(legs: list[Leg], whole: float) -> None:
    pace = f"{max(leg.pace for leg in legs):.2g} °C/min"
    up, down = ([leg for leg in legs if leg.rising is way] for way in (True, False))
    if not up or not down:
        raise EstimateError(
            f"the temperature goes only {legs[0].way}, and one way does not separate a thermal lag from drift: let it "
            f"come back over the same temperatures, at {pace} or slower"
        )
    highest, lowest = (min(max(leg.high for leg in way) for way in (up, down)), max(_lowest(way) for way in (up, down)))
    if highest - lowest < OVERLAP * whole:
        raise EstimateError(
            f"the ways up and down share {max(highest - lowest, 0.0):.2g} °C of {whole:.2g} °C, too little to separate "
            f"a thermal lag from drift: let the temperature come all the way back, at {pace} or slower"
        )


def _lowest(way: list[Leg]) -> float:
    return min(leg.low for leg in way)

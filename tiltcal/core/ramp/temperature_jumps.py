"""Temperatures of a record that jump away from those before them, and back: a thermometer that converts nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.detection import LEFT_OUT, TEMPERATURE_JUMP
from tiltcal.core.flags import Mask
from tiltcal.core.model import Array
from tiltcal.errors import EstimateError

_STEPS = 4.0
"""A ramp of few rows may change by so many of its usual steps from one row to the next."""

_GAP = 10.0
"""After so many usual intervals without a row, any temperature may follow."""

_FIRST = 5
"""Rows whose median is the temperature that a record begins with."""


@dataclass(frozen=True)
class TemperatureJumps:
    """The temperatures that jump: how many there are, and the first of them.

    Attributes
    ----------
    row : int
        Counted from 0.
    value, before : float
        The temperature there, and one beside it that counts, °C.
    """

    count: int
    row: int
    value: float
    before: float

    @property
    def note(self) -> str:
        """What is left out, in words."""
        return f"temperatures that jump by more than {TEMPERATURE_JUMP:g} °C are left out: {self._where}"

    @property
    def _where(self) -> str:
        return f"{self.count}, the first in row {self.row}, {self.value:g} °C beside {self.before:.4g} °C"

    def require_few(self, rows: int) -> None:
        """Refuse a record in which jumps are no exceptions, with an EstimateError."""
        if self.count > max(1, LEFT_OUT * rows):
            raise EstimateError(
                f"of {rows} temperatures too many jump by more than {TEMPERATURE_JUMP:g} °C ({self._where}): see to "
                "the thermometer's wiring and supply (a DS18B20 that converts nothing reads 85 °C), or take these rows "
                "out of the log"
            )


class JumpDetector:
    """Finds the jumps in rows as they come; the first one has the number ``row``."""

    def __init__(self, row: int = 0) -> None:
        self.found: TemperatureJumps | None = None
        self._row = row
        self._time = self._before = np.nan
        self._step, self._interval = 0.0, np.inf

    def __call__(self, time: Array, temperature: Array) -> Mask:
        """Return which of some more rows jump, shape (n,); time in s, temperature in °C, NaN where one is missing."""
        jumps = np.zeros(len(time), dtype=bool)
        known = np.flatnonzero(np.isfinite(time) & np.isfinite(temperature))
        if len(known):
            self._judge(time[known], temperature[known], known, jumps)
        self._row += len(time)
        return jumps

    def _judge(self, time: Array, temperature: Array, rows: NDArray[np.intp], jumps: Mask) -> None:
        intervals = np.diff(time, prepend=self._time)
        steps = np.abs(np.diff(temperature, prepend=self._before))
        if len(rows) > _FIRST:
            self._interval, self._step = float(np.median(intervals[1:])), float(np.median(steps[1:]))
        limit = max(TEMPERATURE_JUMP, _STEPS * self._step)
        fresh = ~(intervals <= _GAP * self._interval)
        starts = np.flatnonzero(fresh | ~(steps <= limit))
        # A jump at the start of these rows may lead back from one at the end of those before.
        for start, end in zip([0, *starts.tolist()], [*starts.tolist(), len(time)], strict=True):
            if start == end:
                continue
            if fresh[start]:
                self._before = float(np.median(temperature[start : start + _FIRST]))
            if abs(temperature[start] - self._before) > limit:
                jumps[rows[start:end]] = True
                self._count(int(rows[start]), end - start, float(temperature[start]))
            else:
                self._before = float(temperature[end - 1])
        self._time = float(time[-1])

    def _count(self, row: int, count: int, value: float) -> None:
        found = self.found or TemperatureJumps(0, self._row + row, value, self._before)
        self.found = TemperatureJumps(found.count + count, found.row, found.value, found.before)

"""The spin of a stage without an encoder: its frequency and phase, estimated from the readings themselves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import atan2, ceil, pi

import numpy as np

from tiltcal.core.model import Array
from tiltcal.core.pair.model import FEWEST_TURNS
from tiltcal.errors import EstimateError

_STEPS = 20
_CONVERGED = 1e-12
"""Turns over the whole record."""
_FOLLOWING_STEPS = 3
_MOST_SLIP = 0.5
"""Turns, over some rows, by which their spin may differ from that before."""
_FEWEST_ROWS = 16
_ROWS_FOR_SPIN = 1 << 20
"""Rows from whose beginning the spin is estimated."""
_TURNS_TO_FOLLOW, _ROWS_TO_FOLLOW = 16, 1 << 14
"""Turns and rows that a piece has at least in which the spin is taken for steady."""
_PADDING = 2
_MOST_EMPTY = 8
"""The length of the record over that of its rows, at the most."""
_CLEAREST = 30.0
"""How far the spin's line must stand above the median of the spectrum, in power."""


@dataclass(frozen=True)
class Spin:
    """A steady turning: turns per unit of time (Hz for seconds), and turns at time 0; the first channel is a sine."""

    frequency: float
    phase: float

    def theta(self, time: Array) -> Array:
        """Stage angle, degrees, shape (n,)."""
        return np.asarray(360.0 * (self.frequency * time + self.phase))


def estimate_spin(time: Array, readings: Array) -> Spin:
    """Find the spin that fits all channels best; time (n,), with gaps and jitter, and readings (n, channels), finite.

    The strongest line of the spectrum is where Gauss's iteration begins; each of its steps fits amplitudes, offset and
    drift anew.

    Raises
    ------
    EstimateError
        No line stands out, or it turns less than twice.
    """
    span = float(time[-1] - time[0]) if len(time) > 1 else 0.0
    if len(time) < _FEWEST_ROWS or not 0.0 < span == float(np.ptp(time)):
        raise EstimateError(
            "the record is too short, its time does not change, or a time lies before its first or after its last: the "
            "spin cannot be estimated"
        )
    spin = _iterated(time, readings, _strongest((time - 0.5 * (time[0] + time[-1])) / span, readings), _STEPS)
    if spin.frequency * span < FEWEST_TURNS:
        raise EstimateError(
            f"the strongest line of the record turns {max(spin.frequency * span, 0.0):.2f} times in it: the stage is "
            f"not turning, or less than {FEWEST_TURNS:g} turns were recorded"
        )
    return spin


def followed_spin(before: Spin, time: Array, readings: Array) -> Spin:
    """Return the spin of some rows, given that of the rows before: no stage keeps its speed for hours.

    It is that of before where the rows have less than two turns or do not say; arguments as of :func:`estimate_spin`.
    """
    span = float(time[-1] - time[0]) if len(time) > _FEWEST_ROWS else 0.0
    if before.frequency * span < FEWEST_TURNS:
        return before
    spin = _iterated(time, readings, before.frequency * span, _FOLLOWING_STEPS)
    return spin if abs(spin.frequency - before.frequency) * span < _MOST_SLIP else before


def _iterated(time: Array, readings: Array, turns: float, steps: int) -> Spin:
    """Return the spin to which so many turns lead."""
    span, middle = float(time[-1] - time[0]), 0.5 * float(time[0] + time[-1])
    centred, coefficients = (time - middle) / span, np.zeros((2, 1))
    for _ in range(steps):
        step, coefficients = _refined(centred, readings, turns)
        turns += step
        if abs(step) < _CONVERGED:
            break
    phase = atan2(coefficients[1, 0], coefficients[0, 0]) / (2.0 * pi)
    return Spin(turns / span, (phase - turns / span * middle) % 1.0)


def estimated_angle(time: Array, readings: Sequence[Array]) -> Array:
    """Return the stage angle of a record without an encoder, degrees; all of shape (n,), NaN where one is missing.

    Raises
    ------
    EstimateError
        There is no spin, or no row has a time and all readings.
    """
    if not np.isfinite(time).any():
        raise EstimateError("no row has a time: write it in seconds, or in ISO 8601 such as 2026-05-01T12:00:00.5Z")

    def timed(start: int, end: int) -> tuple[Array, Array]:
        table = np.stack([time[start:end], *(column[start:end] for column in readings)])
        table = table[:, np.isfinite(table).all(axis=0)]
        return table[0], table[1:].T

    theta = np.empty(len(time))
    times, values = timed(0, _ROWS_FOR_SPIN)
    if not len(times):
        raise EstimateError("no row of the record has all readings: is every accelerometer connected?")
    spin = estimate_spin(times, values)
    turns = spin.frequency * float(times[-1] - times[0])
    rows = max(ceil(_TURNS_TO_FOLLOW * len(times) / turns), _ROWS_TO_FOLLOW)
    for start in range(0, len(time), rows):
        spin = followed_spin(spin, *timed(start, start + rows))
        theta[start : start + rows] = spin.theta(time[start : start + rows])
    return theta


def _strongest(centred: Array, readings: Array) -> float:
    """Turns in the record of the strongest line of all channels together.

    Each row counts in the nearest place of an even grid as fine as most rows are apart, so that a gap is empty places.
    """
    line = np.stack([np.ones(len(centred)), centred])
    level = np.linalg.solve(line @ line.T, line @ readings)
    steps = np.diff(centred)
    apart = float(np.median(steps[steps > 0.0]))
    del line, steps
    if not apart * _MOST_EMPTY * len(centred) > 1.0:
        raise EstimateError(
            f"the gaps of the record are more than {_MOST_EMPTY - 1} times as long as what it holds, and how often the "
            "stage turned in them cannot be counted: match a part of it, or name the column of the --phase"
        )
    places = round(1.0 / apart) + 1
    place = np.rint((centred + 0.5) * (places - 1)).astype(np.intp)
    window = 0.5 + 0.5 * np.cos(2.0 * pi * centred)
    count = _PADDING * places
    power = np.zeros(count // 2 + 1)
    for channel, (offset, drift) in zip(readings.T, level.T, strict=True):
        weighed = np.bincount(place, (channel - offset - drift * centred) * window, places)
        power += np.abs(np.fft.rfft(weighed, count)) ** 2
    first = round(_PADDING * FEWEST_TURNS / 2)
    peak = first + int(np.argmax(power[first:]))
    if not power[peak] > _CLEAREST * float(np.median(power)):
        raise EstimateError(
            "no spectral line is above the noise: the stage is not turning, or its axis is not inclined"
        )
    # The record has one step less than places.
    return peak / _PADDING * (places - 1) / places


def _refined(centred: Array, readings: Array, turns: float) -> tuple[float, Array]:
    """Return how many turns to add, and the coefficients of sine and cosine before it."""
    angle = 2.0 * pi * turns * centred
    waves = np.stack([np.sin(angle), np.cos(angle)])
    columns = np.concatenate([waves, np.ones((1, len(centred))), centred[None], centred * waves])
    # A large offset would take the digits that the noise needs in the sums.
    products, against = columns @ columns.T, columns @ (readings - readings[0])
    solver = np.linalg.pinv(products[:4, :4], hermitian=True)
    coefficients = solver @ against[:4]
    rest = against - products[:, :4] @ coefficients
    # More turns change the readings by 2π t (sine's cos - cosine's sin): by the last two columns.
    slopes = np.zeros_like(against)
    slopes[4], slopes[5] = -2.0 * pi * coefficients[1], 2.0 * pi * coefficients[0]
    changes = products @ slopes
    squares = np.sum(slopes * changes) - np.sum(changes[:4] * (solver @ changes[:4]))
    return float(np.sum(slopes * rest) / squares), coefficients

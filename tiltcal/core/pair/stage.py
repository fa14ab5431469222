"""The stage: its angle by an encoder or from the readings, where it stands or turns back, and the rows that count.

A channel that keeps its value while the stage turns on is stuck, not still: a converter that stops, or an input that is
held at its rail, repeats a value that counts heavily. No channel that senses the turning keeps one for a quarter of a
turn, unless its steps are a third of its amplitude. Such values are left out as missing ones are, from the first to the
last.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import atan2, ceil, pi

import numpy as np

from tiltcal.core.detection import run_bounds
from tiltcal.core.flags import Mask
from tiltcal.core.model import Array
from tiltcal.core.pair.model import FEWEST_TURNS
from tiltcal.errors import Argument, EstimateError

STANDSTILL = 0.05  # turns below which the stage does not turn
PARTS = 8  # number of parts of a turn that must each have rows
BACKWARDS = 0.1875  # turns that the angle may fall behind its highest, by encoder noise and play
STANDING = 4.0  # times the rows of a typical part after which the stage stands
ROUNDING = 1e-6  # turns by which an angle may be rounded
_JUMP = 0.125  # turns back from one row to the next from which on rows are missing
_STUCK = 0.25  # turns over which a value must stay the same to be stuck
_FEWEST_ROWS = 16  # fewest rows that show a spin
_ROWS_FOR_SPIN = 1 << 20  # number of first rows from which the spin is estimated
_TURNS_TO_FOLLOW, _ROWS_TO_FOLLOW = 16, 1 << 14  # shortest piece in which the spin counts as steady
_MOST_SLIP = 0.5  # turns, over such a piece, by which its spin may differ from that before
_STEPS, _FOLLOWING_STEPS = 20, 3  # iterations at the beginning, and from piece to piece
_CONVERGED = 1e-12  # turns over the whole record
_PADDING = 2  # factor of zero padding of the spectrum
_MOST_EMPTY = 8  # times the length of the rows that the record may be long
_CLEAREST = 30.0  # times the median of the spectrum, in power, that the spin's line must have


def follow(theta: Array, last: float | None = None) -> Array:
    """Return angles in turns that do not wrap, shape (n,), from degrees, wrapped or not, and the turns before them."""
    angle = theta / 360.0
    steps = np.diff(angle, prepend=angle[:1] % 1.0 if last is None else last)
    whole = np.rint(steps)
    # No stage is sampled so seldom that it turns back so far at once: rows are missing, and it went on meanwhile.
    whole -= steps - whole < -_JUMP
    # The angle itself and a count of turns: a sum of millions of steps would lose digits.
    return np.asarray(angle - np.cumsum(whole))


def _turning(angle: Array) -> Mask:
    """Return the rows in which the stage turns on, neither standing nor turned back; angle in turns, shape (n,)."""
    highest = np.maximum.accumulate(angle)
    part = np.unique(np.floor(highest * PARTS), return_inverse=True)[1]
    rows = np.bincount(part)
    beside = np.maximum(np.append(0, rows[:-1]), np.append(rows[1:], 0))
    stands = (rows > STANDING * beside) & (len(rows) > 1)
    return np.asarray((highest - angle <= BACKWARDS) & ~stands[part])


@dataclass(frozen=True)
class StageRecord:
    """The samples of a turning stage: its angle in degrees and in turns that do not wrap, and readings of channels.

    All are of shape (n,), NaN where a value is missing. In ``whole`` rows nothing is missing or stuck, and the stage
    turns on.
    """

    channels: tuple[str, ...]
    theta: Array
    angle: Array
    readings: Sequence[Array] | Array
    whole: Mask
    stuck: tuple[str, ...]

    @property
    def turns(self) -> float:
        """The turns from the first whole row to the last; an EstimateError where they are less than two."""
        angle = self.angle[self.whole]
        turns = max(float(np.sum(angle[-1:] - angle[:1])), 0.0)
        # Each row stands for one step, the last one too.
        if turns * len(angle) / max(len(angle) - 1, 1) < FEWEST_TURNS - ROUNDING:
            raise EstimateError(
                f"the record has {turns:.2f} turns of the stage; at least {FEWEST_TURNS:g} are needed, by an angle in "
                "degrees that counts up: where it runs backwards, swap the tracks of the encoder, or log it with the "
                "other sign"
            )
        return turns


def stage_record(channels: Sequence[str], theta: Array, readings: Sequence[Array] | Array) -> StageRecord:
    """Return the record of a stage angle in degrees, shape (n,), and of readings, shape (n,) each."""
    there = np.isfinite(theta)
    angle = np.full(len(theta), np.nan)
    angle[there] = follow(theta[there])
    whole = np.logical_and.reduce([there, *(np.isfinite(column) for column in readings)])
    # Where the angle is missing, it is the last one.
    known = angle[np.maximum.accumulate(np.where(there, np.arange(len(angle)), 0))]
    stuck = []
    for name, column in zip(channels, readings, strict=True):
        starts, ends = run_bounds(np.append(False, column[1:] == column[:-1]))
        turns_on = np.abs(known[ends - 1] - known[starts - 1]) >= _STUCK
        for first, end in zip((starts[turns_on] - 1).tolist(), ends[turns_on].tolist(), strict=True):
            whole[first:end] = False
            why = f"{name} is stuck at {column[first]:.6g} while the stage turns; left out until it changes"
            stuck.append((first, f"row {first}: {why}"))
    whole[whole] = _turning(angle[whole])
    return StageRecord(tuple(channels), theta, angle, readings, whole, tuple(line for _, line in sorted(stuck)))


# A stage without an encoder: the spin is that which fits the readings best.


@dataclass(frozen=True)
class Spin:
    """A steady turning: turns per unit of time (Hz for seconds), and turns at time 0; the first channel is a sine."""

    frequency: float
    phase: float


def estimated_angle(time: Array, readings: Sequence[Array]) -> Array:
    """Return the stage angle of a record without an encoder, degrees; all of shape (n,), NaN where one is missing.

    The spin is followed from piece to piece; one of less than two turns, or that slips, has that of the piece before.
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
        times, values = timed(start, start + rows)
        span = float(times[-1] - times[0]) if len(times) > _FEWEST_ROWS else 0.0
        if spin.frequency * span >= FEWEST_TURNS:
            now = _iterated(times, values, spin.frequency * span, _FOLLOWING_STEPS)
            spin = now if abs(now.frequency - spin.frequency) * span < _MOST_SLIP else spin
        theta[start : start + rows] = 360.0 * (spin.frequency * time[start : start + rows] + spin.phase)
    return theta


def estimate_spin(time: Array, readings: Array) -> Spin:
    """Find the spin that fits all channels best, from time (n,), with gaps and jitter, and readings (n, channels)."""
    span = float(time[-1] - time[0]) if len(time) >= _FEWEST_ROWS else 0.0
    if not 0.0 < span == float(np.ptp(time)):
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


def _iterated(time: Array, readings: Array, turns: float, steps: int) -> Spin:
    """Return the spin to which so many turns lead; each step fits amplitudes, offset and drift anew."""
    span, middle = float(time[-1] - time[0]), 0.5 * float(time[0] + time[-1])
    centred, coefficients = (time - middle) / span, np.zeros((2, 1))
    for _ in range(steps):
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
        step = float(np.sum(slopes * rest) / squares)
        turns += step
        if abs(step) < _CONVERGED:
            break
    phase = atan2(coefficients[1, 0], coefficients[0, 0]) / (2.0 * pi)
    return Spin(turns / span, (phase - turns / span * middle) % 1.0)


def _strongest(centred: Array, readings: Array) -> float:
    """Turns in the record of the strongest line of all channels, by a grid as fine as most rows are apart."""
    line = np.stack([np.ones(len(centred)), centred])
    level = np.linalg.solve(line @ line.T, line @ readings)
    steps = np.diff(centred)
    apart = float(np.median(steps[steps > 0.0]))
    if not apart * _MOST_EMPTY * len(centred) > 1.0:
        raise EstimateError(
            f"the gaps of the record are more than {_MOST_EMPTY - 1} times as long as what it holds, and how often the "
            "stage turned in them cannot be counted",
            advice=("match a part of it, or name the column of the ", Argument("phase")),
        )
    places = round(1.0 / apart) + 1
    place = np.rint((centred + 0.5) * (places - 1)).astype(np.intp)
    window = 0.5 + 0.5 * np.cos(2.0 * pi * centred)
    power = np.zeros(_PADDING * places // 2 + 1)
    for channel, (offset, drift) in zip(readings.T, level.T, strict=True):
        weighed = np.bincount(place, (channel - offset - drift * centred) * window, places)
        power += np.abs(np.fft.rfft(weighed, _PADDING * places)) ** 2
    first = round(_PADDING * FEWEST_TURNS / 2)
    peak = first + int(np.argmax(power[first:]))
    if not power[peak] > _CLEAREST * float(np.median(power)):
        raise EstimateError(
            "no spectral line is above the noise: the stage is not turning, or its axis is not inclined"
        )
    # The record has one step less than places.
    return peak / _PADDING * (places - 1) / places

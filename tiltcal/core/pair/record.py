"""The record of a turning stage: its angle and readings as arrays, and which of its rows count.

A channel that keeps its value while the stage turns on is stuck, not still: a converter that stops, or an input that is
held at its rail, repeats a value that counts heavily. No channel that senses the turning keeps one for a quarter of a
turn, unless its steps are a third of its amplitude. Such values are left out as missing ones are, from the first to the
last.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tiltcal.core.flags import Mask
from tiltcal.core.model import Array
from tiltcal.core.pair.turns import follow
from tiltcal.core.rows import run_bounds

_STUCK = 0.25
"""Turns over which a value must stay the same to be stuck."""


@dataclass(frozen=True)
class StageRecord:
    """The samples of a turning stage: its angle in degrees and in turns that do not wrap, and readings of channels.

    All are of shape (n,), NaN where a value is missing; in ``whole`` rows nothing is missing or stuck.
    """

    channels: tuple[str, ...]
    theta: Array
    angle: Array
    readings: Sequence[Array] | Array
    whole: Mask
    stuck: tuple[str, ...]


def stage_record(channels: Sequence[str], theta: Array, readings: Sequence[Array] | Array) -> StageRecord:
    """Return the record of a stage angle in degrees, shape (n,), and of readings, shape (n,) each."""
    there = np.isfinite(theta)
    angle = np.full(len(theta), np.nan)
    angle[there] = follow(theta[there])
    whole = there.copy()
    for column in readings:
        whole &= np.isfinite(column)
    stuck = []
    for name, column in zip(channels, readings, strict=True):
        for first, end in _stuck(angle, column):
            whole[first:end] = False
            said = f"{name} is stuck at {column[first]:.6g} while the stage turns; left out until it changes"
            stuck.append((first, f"row {first}: {said}"))
    return StageRecord(tuple(channels), theta, angle, readings, whole, tuple(said for _, said in sorted(stuck)))


def _stuck(angle: Array, column: Array) -> Iterator[tuple[int, int]]:
    """Yield the first row of each stuck value, and the row behind its last."""
    starts, ends = run_bounds(np.append(False, column[1:] == column[:-1]))
    if len(starts):
        # Where the angle is missing, it is the last one.
        angle = angle[np.maximum.accumulate(np.where(np.isfinite(angle), np.arange(len(angle)), 0))]
        stuck = np.abs(angle[ends - 1] - angle[starts - 1]) >= _STUCK
        yield from zip((starts[stuck] - 1).tolist(), ends[stuck].tolist(), strict=True)

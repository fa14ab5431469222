"""The loop between the ways up and down: what is left of it, and whether it is a matter of time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.model import Array
from tiltcal.core.ramp.means import FittedMeans
from tiltcal.errors import EstimateError

LOOP = 3.0
"""Standard uncertainties above which a difference between the ways is a loop."""

BINS = 8
"""Of temperature, in which the ways are compared."""

_WIDTHS, _REFINEMENTS = 10, 3


@dataclass(frozen=True)
class Loops:
    """The way up less the way down.

    Attributes
    ----------
    temperatures : ndarray, shape (bins,)
        Middles, °C from the reference.
    differences, u : ndarray, shape (bins, channels)
        With their standard uncertainties, unit.
    repeated : bool
        Whether several legs of one way show how well they repeat.
    """

    temperatures: Array
    differences: Array
    u: Array
    repeated: bool

    @property
    def largest(self) -> Array:
        """Return the largest difference of each channel, unit."""
        return self._of(self.differences)

    @property
    def variance(self) -> Array:
        """Return the variance of a place anywhere between the ways, 0 where no loop is told from the noise, unit²."""
        return np.where(np.abs(self.largest) > LOOP * self._of(self.u), self.largest**2 / 12.0, 0.0)

    def explained_by(self, other: Loops) -> Array:
        """Return the part of the square of this loop that is no longer in another one, shape (channels,)."""
        before, after = (np.mean(one.differences**2, axis=0) for one in (self, other))
        return np.asarray(1.0 - after / np.maximum(before, np.finfo(float).tiny))

    def _of(self, table: Array) -> Array:
        where: NDArray[np.intp] = np.argmax(np.abs(self.differences), axis=0)
        return np.asarray(np.take_along_axis(table, where[None, :], axis=0)[0])


def loops(means: FittedMeans, lag: float, coefficients: Array) -> Loops:
    """Compare the ways after polynomial and lag; ``coefficients`` have the shape (order + 1, channels).

    Raises
    ------
    EstimateError
        The ways have no temperature in common.
    """
    left = means.readings - means.powers(lag, len(coefficients) - 1) @ coefficients
    element = means.element(lag)
    rising = [leg.rising for leg in means.legs]
    up = np.array(rising)[means.leg]
    low, high = max(element[up].min(), element[~up].min()), min(element[up].max(), element[~up].max())
    width = (high - low) / BINS
    number = np.floor((element - low) / width) if width > 0.0 else np.full(len(element), -1.0)
    white = np.var(np.diff(left, axis=0), axis=0) / 2.0
    places, differences, noise, legs, scatter = [], [], [], [], []
    for k in range(BINS):
        ways: dict[bool, list[Array]] = {True: [], False: []}
        counts = {True: 0, False: 0}
        for leg, way in enumerate(rising):
            here = (number == k) & (means.leg == leg)
            if here.any():
                ways[way].append(left[here].mean(axis=0))
                counts[way] += int(here.sum())
        if ways[True] and ways[False]:
            places.append(low + (k + 0.5) * width)
            differences.append(np.mean(ways[True], axis=0) - np.mean(ways[False], axis=0))
            noise.append(white * sum(1.0 / count for count in counts.values()))
            legs.append(sum(1.0 / len(way) for way in ways.values()))
            scatter += [np.var(way, axis=0, ddof=1) for way in ways.values() if len(way) > 1]
    if not differences:
        raise EstimateError(
            "the ways up and down have no temperature in common: let the temperature come all the way back"
        )
    repeats = np.mean(scatter, axis=0) if scatter else np.zeros(len(white))
    variance = np.maximum(np.array(noise), np.array(legs)[:, None] * repeats)
    return Loops(np.array(places), np.array(differences), np.sqrt(variance), bool(scatter))


def error_of_hysteresis(means: FittedMeans, order: int, scale: Array) -> float:
    """Return the sum of squares that the best hysteresis without time leaves, over the variance ``scale`` squared.

    Two forms are tried. A play of the temperature makes, at one pace, the loop that a lag makes; only the turns differ.
    Rayleigh's loop (1887) grows from both turns: its two ways are parabolas between them.
    """

    def error(x: Array) -> float:
        left = means.readings - x @ np.linalg.lstsq(x, means.readings, rcond=None)[0]
        return float(np.sum((left / scale) ** 2))

    widest = max(leg.high - leg.low for leg in means.legs) / 2.0
    low, high = widest / 1000.0, widest
    least = error(np.column_stack([means.powers(0.0, order), means.between_turns]))
    for _ in range(_REFINEMENTS):
        widths = np.geomspace(low, high, _WIDTHS)
        errors = [error(means.played(width, order)) for width in widths.tolist()]
        best = int(np.argmin(errors))
        least = min(least, errors[best])
        low, high = widths[max(best - 1, 0)], widths[min(best + 1, _WIDTHS - 1)]
    return least

"""The loop between the ways up and down: what is left of it, and whether it is a matter of time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tiltcal.core.coverage_factor import COVERAGE, NORMAL_FACTOR
from tiltcal.core.model import Array
from tiltcal.core.ramp.means import FittedMeans
from tiltcal.errors import EstimateError

CHANCE = 0.01
"""Probability with which noise alone makes what counts as a loop."""

BINS = 8
"""Of temperature, in which the ways are compared."""

_WIDTHS, _REFINEMENTS, _BISECTIONS = 10, 3, 40


@dataclass(frozen=True)
class Loops:
    """The way up less the way down.

    Attributes
    ----------
    temperatures : ndarray, shape (bins,)
        Middles, °C from the reference.
    differences : ndarray, shape (bins, channels)
        Unit.
    """

    temperatures: Array
    differences: Array

    def explained_by(self, other: Loops) -> Array:
        """Return the part of the square of this loop that is no longer in another one, shape (channels,)."""
        before, after = (np.mean(loops.differences**2, axis=0) for loops in (self, other))
        return np.asarray(1.0 - after / np.maximum(before, np.finfo(float).tiny))


@dataclass(frozen=True)
class HalfLoop:
    """Half the difference between the ways of a channel, as a polynomial of the temperature, and its covariance."""

    coefficients: Array
    covariance: Array

    @property
    def certain(self) -> bool:
        """Whether noise alone would not make it."""
        from scipy.special import chdtri

        square = self.coefficients @ np.linalg.solve(self.covariance, self.coefficients)
        return bool(square > chdtri(len(self.coefficients), CHANCE))

    def widening(self, powers: Array, covariance: Array) -> Array:
        """Return what it adds to the covariance of a polynomial that lies between the ways.

        A reading is on one way or the other. The square of the half loop is weighted so that 1.96 standard
        uncertainties hold 95 % of the readings on both ways, on the mean over the temperatures.

        Parameters
        ----------
        powers : ndarray, shape (n, p)
            Of these temperatures.
        covariance : ndarray, shape (p, p)
            Of the polynomial.
        """
        from scipy.special import erf

        terms, p = len(self.coefficients), len(covariance)
        own = np.zeros((p, p))
        own[:terms, :terms] = self.covariance
        half = np.abs(powers[:, :terms] @ self.coefficients)
        variance = np.einsum("ij,jk,ik->i", powers, covariance + own, powers)
        u = np.sqrt(2.0 * variance)
        low, high = 0.0, 4.0
        for _ in range(_BISECTIONS):
            weight = 0.5 * (low + high)
            reach = NORMAL_FACTOR * np.sqrt(variance + weight * half**2)
            held = float(np.mean(erf((reach - half) / u) + erf((reach + half) / u))) / 2.0
            low, high = (weight, high) if held < COVERAGE else (low, weight)
        own[:terms, :terms] += high * np.outer(self.coefficients, self.coefficients)
        return own


def loop_terms(order: int) -> int:
    """Return the terms of a loop: a play of a cubic, and Rayleigh's loop, have three."""
    return min(order + 1, 3)


def loops(means: FittedMeans, lag: float, coefficients: Array) -> Loops:
    """Compare the ways after polynomial and lag; ``coefficients`` have the shape (order + 1, channels).

    Raises
    ------
    EstimateError
        The ways have no temperature in common.
    """
    left = means.readings - means.powers(lag, len(coefficients) - 1) @ coefficients
    element = means.temperature(lag)
    rising = [leg.rising for leg in means.legs]
    up = np.array(rising)[means.leg]
    low, high = max(element[up].min(), element[~up].min()), min(element[up].max(), element[~up].max())
    width = (high - low) / BINS
    number = np.floor((element - low) / width) if width > 0.0 else np.full(len(element), -1.0)
    places, differences = [], []
    for k in range(BINS):
        ways: dict[bool, list[Array]] = {True: [], False: []}
        for leg, way in enumerate(rising):
            here = (number == k) & (means.leg == leg)
            if here.any():
                ways[way].append(left[here].mean(axis=0))
        if ways[True] and ways[False]:
            places.append(low + (k + 0.5) * width)
            differences.append(np.mean(ways[True], axis=0) - np.mean(ways[False], axis=0))
    if not differences:
        raise EstimateError(
            "the ways up and down have no temperature in common: let the temperature come all the way back"
        )
    return Loops(np.array(places), np.array(differences))


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

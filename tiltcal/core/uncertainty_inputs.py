"""The uncertain inputs of a calibration: coefficients and the turn of the mounting, with their covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.model import Array

TURN = "mounting.turn."
"""A small rotation error of the mounting about one of the application's axes, by its dotted name."""


@dataclass(frozen=True)
class UncertaintyInputs:
    """The uncertain inputs of the angles: coefficients and the turn of the mounting, with their covariance.

    Attributes
    ----------
    names : tuple of str
        Dotted names of the uncertain coefficients; ``mounting.turn.x`` is a small turn of the mounting about the
        application's x axis, radians.
    covariance : ndarray, shape (k, k)
    factors : ndarray, shape (k,)
        What each one's standard uncertainty is multiplied with for an interval of 95 %.
    readings : ndarray, shape (channels,)
        Standard uncertainty of a single reading, unit; channels are independent.
    temperature : float
        Standard uncertainty of a temperature, °C.
    alignment : float
        How far the sensor may have turned about each axis since it was level, standard uncertainty, radians.
    """

    names: tuple[str, ...]
    covariance: Array
    factors: Array
    readings: Array = field(default_factory=lambda: np.zeros(0))
    temperature: float = 0.0
    alignment: float = 0.0

    def chosen(self, kept: Sequence[int] | NDArray[np.intp]) -> UncertaintyInputs:
        """Return the same with some of the names, by their places."""
        some = np.asarray(kept, dtype=np.intp)
        names = tuple(self.names[k] for k in some)
        return replace(self, names=names, covariance=self.covariance[np.ix_(some, some)], factors=self.factors[some])

    @property
    def without_turn(self) -> UncertaintyInputs:
        """The same without the turn of the mounting."""
        return self.chosen(np.flatnonzero(~is_turn(self.names)))


def is_turn(names: Sequence[str]) -> NDArray[np.bool_]:
    """Return which names are turns of the mounting."""
    return np.array([name.startswith(TURN) for name in names], dtype=bool)


def with_turns_scaled(names: Sequence[str], covariance: Array, factor: float) -> Array:
    """Return a covariance whose turns are in another unit: times ``factor``, such as degrees per radian."""
    scale = np.where(is_turn(names), factor, 1.0)
    return np.asarray(covariance * np.outer(scale, scale))

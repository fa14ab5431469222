"""The uncertainty of what is computed from uncertain parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tiltcal.core.model import Array, Coefficients, Thermal
from tiltcal.errors import EstimateError


def propagated(function: Callable[[Array], Array], parameters: Array, covariance: Array) -> Array:
    """Standard uncertainty of a function of uncertain parameters.

    Parameters
    ----------
    function : callable
        From the parameters, shape (k,), to any number of values, shape (m,).
    parameters : ndarray, shape (k,)
    covariance : ndarray, shape (k, k)

    Returns
    -------
    ndarray, shape (m,)
        NaN where the function is NaN near the parameters.

    Notes
    -----
    The function is taken one standard deviation to either side along each principal axis of the covariance. It is the
    GUM's law of propagation where the function is straight, and still says something where it has a corner, such as the
    angle between two directions that are all but parallel.
    """
    values, axes = np.linalg.eigh(covariance)
    middle = function(parameters)
    variance = np.zeros_like(middle)
    for value, axis in zip(values, axes.T, strict=True):
        if value <= 0.0:
            continue
        step = np.sqrt(value) * axis
        variance += ((function(parameters + step) - middle) ** 2 + (function(parameters - step) - middle) ** 2) / 2.0
    return np.asarray(np.sqrt(variance))


def vector_of(coefficients: Coefficients, names: Sequence[str]) -> Array:
    """The coefficients with these dotted names.

    Raises
    ------
    EstimateError
        The coefficients have none of that name.
    """
    return np.array([_value(coefficients, name) for name in names])


def with_vector(coefficients: Coefficients, names: Sequence[str], vector: Array) -> Coefficients:
    """The coefficients with other values for these dotted names."""
    offset, sensitivity = coefficients.offset.copy(), coefficients.sensitivity.copy()
    thermal, bend = coefficients.thermal, coefficients.nonlinearity
    if thermal is not None:
        thermal = Thermal(thermal.reference, thermal.range, thermal.drift.copy(), thermal.gain.copy())
    bend = None if bend is None else bend.copy()
    changed = replace(coefficients, offset=offset, sensitivity=sensitivity, thermal=thermal, nonlinearity=bend)
    for name, value in zip(names, vector, strict=True):
        table, place = _place(changed, name)
        table[place] = value
    return changed


def _value(coefficients: Coefficients, name: str) -> float:
    table, place = _place(coefficients, name)
    return float(table[place])


def _place(coefficients: Coefficients, name: str) -> tuple[Array, tuple[int, ...]]:
    """The array that holds a coefficient, and where."""
    thermal = coefficients.thermal
    try:
        match name.split("."):
            case ["offset", channel]:
                return coefficients.offset, (coefficients.channels.index(channel),)
            case ["sensitivity", channel, axis]:
                place = coefficients.channels.index(channel), coefficients.axes.index(axis)
                return coefficients.sensitivity, place
            case ["temperature", "offset", channel, power] if thermal is not None:
                return thermal.drift, (coefficients.channels.index(channel), int(power) - 1)
            case ["temperature", "sensitivity", channel, power] if thermal is not None:
                return thermal.gain, (coefficients.channels.index(channel), int(power) - 1)
            case ["nonlinearity", channel, power] if coefficients.nonlinearity is not None:
                return coefficients.nonlinearity, (coefficients.channels.index(channel), int(power) - 2)
    except ValueError:
        pass
    raise EstimateError(f"the calibration has no coefficient {name!r}")

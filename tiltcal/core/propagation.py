"""The uncertainty of what is computed from uncertain parameters: of numbers, and of the tilt of a reading."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tiltcal.core.budget import COVERAGE, NEGLIGIBLE
from tiltcal.core.compensate import Compensation
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


def tilt_uncertainty(
    coefficients: Coefficients,
    names: Sequence[str],
    covariance: Array,
    readings: Array,
    temperature: Array | None = None,
    *,
    u_readings: Array | float = 0.0,
    u_temperature: float = 0.0,
) -> Array:
    """Standard uncertainty of the tilt that a calibration makes of readings.

    Parameters
    ----------
    coefficients : Coefficients
    names : sequence of str
        Dotted names of the uncertain ones, in the order of ``covariance``.
    covariance : ndarray, shape (k, k)
    readings : ndarray, shape (n, channels)
        In the sensor's unit.
    temperature : ndarray, shape (n,), optional
        °C.
    u_readings : ndarray or float
        Standard uncertainty of each reading, broadcast to their shape, same unit; channels are independent.
    u_temperature : float
        Standard uncertainty of each temperature, °C.

    Returns
    -------
    ndarray, shape (n, axes)
        Degrees; NaN where the arcsine has no angle.

    Notes
    -----
    Towards ±90° the tilt's uncertainty grows without bound, as the derivative of the arcsine does; there the direction
    (``pitch``, ``inclination``) is the better number.
    """
    of_parameters, of_readings = _tilt_variances(
        coefficients, names, covariance, readings, temperature, u_readings, u_temperature
    )
    return np.asarray(np.degrees(np.sqrt(of_parameters + of_readings)))


def tilt_interval(
    coefficients: Coefficients,
    names: Sequence[str],
    covariance: Array,
    factors: Array,
    readings: Array,
    temperature: Array | None = None,
    *,
    u_readings: Array | float = 0.0,
    u_temperature: float = 0.0,
) -> Array:
    """Half the width of the 95 % interval of the tilt that a calibration makes of readings.

    Parameters
    ----------
    coefficients, names, covariance, readings, temperature, u_readings, u_temperature
        As for :func:`tilt_uncertainty`; the readings' uncertainties are taken as known.
    factors : ndarray, shape (k,)
        What each coefficient's standard uncertainty is multiplied with for an interval of 95 %.

    Returns
    -------
    ndarray, shape (n, axes)
        Degrees.

    Notes
    -----
    The coefficients' part has the degrees of freedom at which Student's t is the factor that they bring along, each by
    its weight; with the readings' part it is summed after Welch and Satterthwaite.
    """
    from scipy.special import ndtri, stdtridf, stdtrit

    upper = 0.5 + COVERAGE / 2.0
    normal = float(ndtri(upper))
    conditions = (readings, temperature, u_readings, u_temperature)
    stretched = covariance * np.outer(factors, factors) / normal**2
    of_parameters, of_readings = _tilt_variances(coefficients, names, covariance, *conditions)
    widened, _ = _tilt_variances(coefficients, names, stretched, *conditions)
    total = of_parameters + of_readings
    brought = normal * np.sqrt(widened / np.where(of_parameters > 0.0, of_parameters, 1.0))
    estimated = brought > normal * (1.0 + NEGLIGIBLE)
    dof = stdtridf(upper, np.where(estimated, brought, 2.0)) * (total / np.where(estimated, of_parameters, 1.0)) ** 2
    # A factor below 1.96, of errors that their residuals follow, narrows the coefficients' part and nothing else.
    narrowed = normal * np.sqrt((widened + of_readings) / np.where(total > 0.0, total, 1.0))
    factor = np.where(estimated, stdtrit(np.where(estimated, dof, 1.0), upper), narrowed)
    return np.asarray(np.degrees(factor * np.sqrt(total)))


def _tilt_variances(
    coefficients: Coefficients,
    names: Sequence[str],
    covariance: Array,
    readings: Array,
    temperature: Array | None,
    u_readings: Array | float,
    u_temperature: float,
) -> tuple[Array, Array]:
    """Variance of each tilt from the coefficients, and from the readings and their temperature; rad²."""
    sigma = np.broadcast_to(np.asarray(u_readings, dtype=float), readings.shape)

    def tilt(vector: Array, at: Array, warm: Array | None) -> Array:
        gravity = Compensation(with_vector(coefficients, names, vector))(at, warm).gravity
        with np.errstate(invalid="ignore"):
            return np.asarray(np.arcsin(gravity))

    vector = vector_of(coefficients, names)
    shape = tilt(vector, readings, temperature).shape
    u = propagated(lambda v: tilt(v, readings, temperature).ravel(), vector, covariance).reshape(shape)
    of_readings = np.zeros(shape)
    for channel in range(readings.shape[1]):
        step = np.zeros_like(readings)
        step[:, channel] = sigma[:, channel]
        up, down = (tilt(vector, readings + sign * step, temperature) for sign in (1.0, -1.0))
        of_readings += ((up - down) / 2.0) ** 2
    if u_temperature and temperature is not None:
        warmer, colder = (tilt(vector, readings, temperature + sign * u_temperature) for sign in (1.0, -1.0))
        of_readings += ((warmer - colder) / 2.0) ** 2
    return u**2, of_readings


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

"""The second-order bias in one position, where the estimate of a reading can be written out and differentiated."""

from __future__ import annotations

from math import cos, radians, sin

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

from tiltcal.core.estimation.attitude import tangent_basis
from tiltcal.core.estimation.design import Design, Observation, Prior, SensorObservations
from tiltcal.core.estimation.elimination import linearised
from tiltcal.core.estimation.equation_assembly import system_of
from tiltcal.core.estimation.second_order import second_order_bias

Array = NDArray[np.float64]

NOISE, KNOWN, JIG = 0.01, 0.03, radians(1.0)
STEP = 1e-4


def bias(gravity: Array, sensitivity: Array) -> Array:
    """Return what the program takes off each sensitivity, channel by channel, of offsets that are known to be 0."""
    axes = ("x", "y")[: len(sensitivity)]
    priors = {f"offset.{channel}": Prior(0.0) for channel in axes}
    for channel, row in zip(axes, sensitivity, strict=True):
        priors |= {f"sensitivity.{channel}.{axis}": Prior(value, KNOWN) for axis, value in zip(axes, row, strict=True)}
    observation = Observation("p", gravity, sensitivity @ gravity[: len(axes)], np.full(len(axes), NOISE))
    design = Design(axes, axes, jig=float(np.degrees(JIG)), priors=priors)
    system = system_of([SensorObservations(design, [observation])])
    found = second_order_bias(linearised(system, system.start()), system.start())
    return found.reshape(len(axes), -1)[:, 1:]


def estimated(gravity: Array, sensitivity: Array, error: Array) -> Array:
    """Return the sensitivities that explain readings best whose attitude is off by two angles."""
    basis, size = tangent_basis(gravity[None])[0], len(sensitivity)

    def read(matrix: Array, angles: Array) -> list[float]:
        fall = 1.0 - (angles[0] ** 2 + angles[1] ** 2) / 2.0
        up = [fall * gravity[j] + basis[j, 0] * angles[0] + basis[j, 1] * angles[1] for j in range(size)]
        return [sum(matrix[c, i] * up[i] for i in range(size)) for c in range(size)]

    measured = read(sensitivity, error)

    def residual(z: Array) -> list[float]:
        matrix, angles = z[:-2].reshape(size, size), z[-2:]
        rows = [(a - b) / NOISE for a, b in zip(measured, read(matrix, angles), strict=True)]
        rows += [(matrix[c, i] - sensitivity[c, i]) / KNOWN for c in range(size) for i in range(size)]
        return [*rows, *(angle / JIG for angle in angles)]

    start = np.append(sensitivity.ravel(), [0.0, 0.0])
    found = least_squares(residual, start, jac="cs", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    return found.x[:-2].reshape(size, size)


@pytest.mark.parametrize(
    ("gravity", "sensitivity"),
    [
        ([sin(radians(35.0)), 0.0, cos(radians(35.0))], [[1.3]]),
        ([0.48, -0.6, 0.64], [[1.3, 0.05], [-0.1, 0.9]]),
    ],
    ids=["one channel", "two axes"],
)
def test_it_is_half_the_second_derivative_of_the_estimate(gravity: list[float], sensitivity: list[list[float]]) -> None:
    """The mean of e²/2 d²S/de² over both angles, by differences of estimates where the attitude is off."""
    up, matrix = np.array(gravity), np.array(sensitivity)
    here = estimated(up, matrix, np.zeros(2))
    expected = np.zeros_like(matrix)
    for error in STEP * np.eye(2):
        there, back = (estimated(up, matrix, sign * error) for sign in (1.0, -1.0))
        expected += JIG**2 / 2.0 * (there - 2.0 * here + back) / STEP**2
    assert np.max(np.abs(expected)) > 1e-5
    np.testing.assert_allclose(bias(up, matrix), expected, rtol=1e-4, atol=1e-9)


def test_one_channel_in_one_position_by_hand() -> None:
    """The formulas of the module, without an array."""
    s, t = 1.3, radians(35.0)
    variance = NOISE**2 + (KNOWN * sin(t)) ** 2 + (JIG * s * cos(t)) ** 2
    follows = KNOWN**2 * s * sin(t) * cos(t) / variance
    own = (JIG * s * cos(t)) ** 2 / variance
    left = s * cos(t) / variance
    curvature, mixed = s * sin(t), cos(t)
    off = curvature * (own**2 - 2.0) / 2.0 - mixed * follows * own
    by_angle, pull = left * (mixed * follows - curvature * own), left * mixed * own
    second = KNOWN**2 / variance * sin(t) * off
    second += KNOWN**2 / variance * (NOISE**2 + (JIG * s * cos(t)) ** 2) * pull
    second -= KNOWN**2 / variance * JIG**2 * s * sin(t) * cos(t) * by_angle
    found = bias(np.array([sin(t), 0.0, cos(t)]), np.array([[s]]))
    assert found[0, 0] == pytest.approx(JIG**2 * second, rel=1e-9)

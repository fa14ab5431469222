"""The reading of a channel and its derivatives, and coefficients at another reference temperature."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiltcal.core.angle_readings import AngleReadings
from tiltcal.core.model import AXES, Array, ChannelModel, Coefficients, Thermal, referred
from tiltcal.core.uncertain import Uncertain, uncertain_at

small = st.floats(-0.01, 0.01)


def read(model: ChannelModel, theta: Array, up: Array, dt: Array) -> Array:
    """The formulas of the model as its module writes them, shape (n,)."""
    sensitivity, terms = np.zeros(3), list(theta[1 + len(model.axes) :])
    sensitivity[[AXES.index(axis) for axis in model.axes]] = theta[1 : 1 + len(model.axes)]
    drift = sum(terms.pop(0) * dt**k for k in range(1, model.drift + 1))
    gain = sum(terms.pop(0) * dt**k for k in range(1, model.gain + 1))
    signal = up @ sensitivity
    if model.angles is not None:
        size = np.linalg.norm(sensitivity)
        sine = signal / size
        if model.angles.euler and model.name == "y":  # the roll is the tilt of y over the cosine of the pitch
            x = np.array([1.0, 0.0, 0.0]) - sensitivity[0] * sensitivity / size**2
            sine = sine / np.sqrt(1.0 - (up @ x / np.linalg.norm(x)) ** 2)
        signal = size * np.degrees(np.arcsin(sine))
    own = sensitivity[AXES.index(model.name)]
    bent = 1.0 + sum(share * (signal / own) ** k for k, share in enumerate(terms, start=1))
    return np.asarray(theta[0] + drift + (1.0 + gain) * signal * bent)


@pytest.mark.parametrize("name", AXES)
@pytest.mark.parametrize(
    "angles", [None, AngleReadings(0.0, None), AngleReadings(0.0, True)], ids=["g", "tilts", "euler"]
)
def test_every_derivative_of_a_reading_is_that_of_differences(name: str, angles: AngleReadings | None) -> None:
    rng = np.random.default_rng(6)
    up = rng.normal(size=(12, 3))
    up *= 0.8 / np.linalg.norm(up, axis=1, keepdims=True)  # where the arcsine is not steep
    dt, h = rng.uniform(-20.0, 20.0, 12), 1e-6
    for axes, drift, gain, bend in product((("x", "y", "z"), (name,)), (0, 1, 3), (0, 2), (0, 2)):
        model = ChannelModel(name, axes, drift, gain, 0 if angles else bend, angles)
        size = [1024.0, *(800.0 if axis == name else 30.0 for axis in axes)]
        size += [0.2 / 20.0**k for k in range(drift)] + [1e-3 / 20.0**k for k in range(gain)] + [0.02] * bend
        theta = np.array(size[: len(model.coefficients)]) * rng.uniform(0.5, 1.0, len(model.coefficients))
        found = model.read(theta, up, dt)
        np.testing.assert_allclose(found.value, read(model, theta, up, dt), rtol=1e-12)
        step = 1e-4 * np.diag(np.abs(theta))
        by_coefficient = [(read(model, theta + d, up, dt) - read(model, theta - d, up, dt)) / 2 / d.sum() for d in step]
        by_gravity = [(read(model, theta, up + d, dt) - read(model, theta, up - d, dt)) / 2 / h for d in h * np.eye(3)]
        by_dt = (read(model, theta, up, dt + 1e-3) - read(model, theta, up, dt - 1e-3)) / 2e-3
        np.testing.assert_allclose(found.by_coefficient.T, by_coefficient, rtol=1e-5, atol=2e-3)
        np.testing.assert_allclose(found.by_gravity.T, by_gravity, rtol=1e-5, atol=2e-2)
        np.testing.assert_allclose(found.by_temperature, by_dt, rtol=1e-5, atol=1e-5)


def part(reference: float, drift: list[float], gain: list[float], offset: float = 1000.0) -> Coefficients:
    thermal = Thermal(reference, None, np.array([drift]), np.array([gain]).reshape(1, len(gain)))
    return Coefficients(("x",), ("x",), np.array([offset]), np.array([[800.0]]), thermal)


@given(st.lists(small, max_size=3), st.lists(small, max_size=2), st.floats(-20, 20), st.floats(-30, 60))
def test_referred_coefficients_predict_the_same(drift, gain, shift, temperature) -> None:
    """Whatever the reference temperature, the model reads the same at every temperature."""
    one = part(24.0, drift, gain)
    other = referred(one, 24.0 + shift)
    gravity, at = np.array([[0.3, 0.0, 0.95]]), np.array([temperature])
    assert other.predict(gravity, at)[0, 0] == pytest.approx(one.predict(gravity, at)[0, 0], rel=1e-9)


def test_an_offset_at_another_reference_takes_the_uncertainty_of_the_drift_over() -> None:
    """By hand: o' = o + 10 k, with 0.02 between them: 1 + 100 * 0.01 + 2 * 10 * 0.02 = 2.4.

    Of 0.1² and (20 * 0.1)² = 4, the latter with 1 degree of freedom: 1 in all, and t = 12.7, not 1.96.
    """
    names = ("offset.x", "temperature.offset.x.1", "mounting.turn.y")
    covariance = np.array([[1.0, 0.02, 0.0], [0.02, 0.01, 0.0], [0.0, 0.0, 0.04]])
    moved = uncertain_at(part(24.0, [0.5], []), Uncertain.errors(names, covariance), 34.0)
    assert moved.by_name(moved.u) == pytest.approx(dict(zip(names, np.sqrt([2.4, 0.01, 0.04]), strict=True)))
    assert np.all(np.isinf(moved.dof))
    few = Uncertain.errors(names[:2], np.diag([0.01, 0.01]), np.array([np.inf, 1.0]))
    moved = uncertain_at(part(20.0, [0.5], []), few, 0.0)
    assert moved.u == pytest.approx([np.sqrt(4.01), 0.1])
    assert moved.factors == pytest.approx([12.7, 12.706], abs=0.1)

"""The uncertainty of every angle, against differences, against random draws and by hand.

Differences and draws see the compensation from outside alone: they change coefficients and readings and look what comes
out.
"""

from collections.abc import Callable
from dataclasses import replace
from math import asin, cos, degrees, pi, radians, sin, sqrt
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import ndtri
from support.uncertain_readings import moved, uncertain_readings

from tiltcal.core.angle_uncertainty import CompensationWithUncertainty, length_half_width
from tiltcal.core.attitude import mounting_matrix
from tiltcal.core.compensation import Compensated, Compensation
from tiltcal.core.earth_frame import EarthFrameCompensation
from tiltcal.core.model import AXES, Coefficients, Limits, Mounting, Thermal, values
from tiltcal.core.uncertain import ALIGNMENT, READING, Uncertain
from tiltcal.logs.kernel import RoleValues, TiltKernel

Array = NDArray[np.float64]

NORMAL = float(ndtri(0.975))
TURNED = Mounting(0.1, -0.25, 0.4)
SPREAD = {"offset": 0.1, "sensitivity": 0.2, "nonlinearity": 2e-4, "mounting": 2e-4}
NOISE, THERMOMETER = 0.6, 0.25


def sensor(
    channels: int, axes: int, *, drift: int = 0, gain: int = 0, bend: bool = False, mounting: Mounting | None = None
) -> Coefficients:
    rng = np.random.default_rng(3)
    matrix = 800.0 * np.eye(3) + rng.normal(0.0, 12.0, (3, 3))
    thermal = None
    if drift or gain:
        table = rng.normal(0.0, 0.3, (3, drift)) / 20.0 ** np.arange(drift)
        factor = rng.normal(0.0, 3e-4, (3, gain)) / 20.0 ** np.arange(gain)
        thermal = Thermal(24.0, None, table[:channels], factor[:channels])
    return Coefficients(
        AXES[:channels],
        AXES[:axes],
        np.array([1024.0, 1019.0, 1031.0])[:channels],
        matrix[:channels, :axes],
        thermal,
        mounting,
        np.array([[0.004, 0.012], [-0.003, 0.02], [0.002, -0.01]])[:channels] if bend else None,
    )


SENSORS = {
    "one channel": sensor(1, 1),
    "one channel along z": Coefficients(("z",), ("z",), np.array([1024.0]), np.array([[800.0]])),
    "two channels, drift": sensor(2, 2, drift=2),
    "two channels, hidden third": sensor(2, 3, drift=1),
    "two channels, everything": sensor(2, 3, drift=2, gain=2, bend=True, mounting=TURNED),
    "two channels, mounted straight": sensor(2, 2, mounting=Mounting()),
    "three channels, bent": sensor(3, 3, bend=True),
    "three channels, everything": sensor(3, 3, drift=1, gain=1, bend=True, mounting=TURNED),
}


def doubt_of(known: Coefficients, *, factors: float | None = None, alignment: float = 0.0) -> Uncertain:
    """Every coefficient uncertain, and strongly correlated with the others."""
    names = [*values(known), *(() if known.mounting is None else (f"mounting.turn.{axis}" for axis in AXES))]
    rng = np.random.default_rng(1)
    mixed = rng.normal(size=(len(names), 2 * len(names)))
    covariance = mixed @ mixed.T
    u = np.array([_spread(name) for name in names]) / np.sqrt(np.diag(covariance))
    return uncertain_readings(
        tuple(names),
        covariance * np.outer(u, u),
        np.full(len(names), factors or NORMAL),
        np.full(len(known.channels), NOISE),
        THERMOMETER if known.thermal is not None else 0.0,
        alignment,
    )


def _spread(name: str) -> float:
    kind, *rest = name.split(".")
    if kind == "temperature":
        return (0.01 if rest[0] == "offset" else 1e-5) / 20.0 ** (int(rest[-1]) - 1)
    return SPREAD[kind]


def rows(known: Coefficients, count: int = 150) -> tuple[Array, Array]:
    """Up in the sensor's frame, clear of the edges where a derivative says little, and temperatures."""
    rng = np.random.default_rng(5)
    gravity = rng.normal(size=(20 * count, 3))
    gravity /= np.linalg.norm(gravity, axis=1, keepdims=True)
    if len(known.channels) < 3:
        gravity[:, 2] = np.abs(gravity[:, 2])
    turned = gravity @ mounting_matrix(known.mounting or Mounting()).T
    clear = (np.abs(turned).max(axis=1) < 0.9) & (np.abs(gravity[:, 2]) > 0.4)
    gravity = gravity[clear][:count]
    if len(known.channels) == 1:  # the rest of gravity lies where the sensor does not see it
        seen = gravity[:, AXES.index(known.channels[0])]
        rest = np.sqrt(1.0 - seen**2)
        gravity = np.stack([seen, 0 * seen, rest] if known.channels == ("x",) else [rest, 0 * seen, seen], axis=1)
    if len(known.channels) == 3:
        gravity *= rng.uniform(0.9, 1.1, (len(gravity), 1))
    return gravity, rng.uniform(0.0, 40.0, len(gravity))


def result_of(
    known: Coefficients, doubt: Uncertain, readings: Array, t: Array | None = None, limits: Limits | None = None
) -> tuple[Compensated, Array, Array]:
    """What comes out, with standard and expanded uncertainty, shape (n, angles) each."""
    kernel = CompensationWithUncertainty(Compensation(known, limits), known, doubt)
    compensated, (standard, expanded) = kernel(readings, np.zeros(len(readings)) if t is None else t)
    return compensated, standard.T, expanded.T


@pytest.mark.parametrize("compass", [None, True, False], ids=["angles", "field", "heading"])
@pytest.mark.parametrize("name", SENSORS)
def test_it_is_what_differences_give(name: str, compass: bool | None) -> None:
    """The law of propagation, every derivative a central difference: of angles, and of heading and earth velocities."""
    known, draw = SENSORS[name], np.random.default_rng(9)
    if len(known.channels) == 1 and compass is not None:
        return
    (up, temperature), matrix = rows(known), mounting_matrix(known.mounting or Mounting())
    alignment, field_noise = 1e-3, 0.02
    field = draw.normal([[20.0, 5.0, -45.0]], 3.0, (len(up), 3))
    velocity, heading = draw.normal(size=(len(up), 3)), draw.uniform(0.0, 360.0, len(up))
    doubt = doubt_of(known, alignment=alignment)

    def columns(
        one: Coefficients, readings: Array, t: Array, field: Array, uncertain: Uncertain | None = None
    ) -> dict[str, Array]:
        compensation, earth = Compensation(one), None
        kernel = None if uncertain is None else CompensationWithUncertainty(compensation, one, uncertain)
        if compass is not None:
            options: dict[str, Any] = {"magnetometer": compass, "velocity": True, "declination": 3.0}
            earth = EarthFrameCompensation(compensation, **options, uncertain=kernel, field_noise=field_noise)
        given = {"magnetometer": field} if compass else {"heading": heading}
        return dict(TiltKernel(compensation, kernel, earth)(RoleValues(readings, t, velocity=velocity, **given)))

    readings = known.predict(up, temperature)
    found = columns(known, readings, temperature, field, doubt)
    names = [column.removeprefix("u_") for column in found if column.startswith("u_")]

    def slope(change: Callable[[float], dict[str, Array]], step: float) -> Array:
        high, low = (np.stack([change(side)[name] for name in names]) for side in (step, -step))
        return np.asarray(((high - low + 180.0) % 360.0 - 180.0) / (2.0 * step))

    alone, own = doubt.by_name(doubt.u), doubt.without(READING, ALIGNMENT)
    jacobian = [
        slope(lambda h, e=e: columns(moved(known, own.names, h * e), readings, temperature, field), 1e-2 * u)
        for e, u in zip(np.eye(len(own.names)), own.u, strict=True)
    ]
    variance = np.einsum("kcn,kl,lcn->cn", jacobian, own.covariance, jacobian)
    for e, channel in zip(np.eye(len(known.channels)), known.channels, strict=True):
        by_reading = slope(lambda h, e=e: columns(known, readings + h * e, temperature, field), 1e-3)
        variance += (alone.get(READING + channel, 0.0) * by_reading) ** 2
    if warmth := alone[f"{READING}temperature"]:
        variance += (warmth * slope(lambda h: columns(known, readings, temperature + h, field), 1e-3)) ** 2
    for e in np.eye(3):
        turned = [known.predict(up + h * np.cross(e, up - matrix[2]), temperature) for h in (1e-6, -1e-6)]
        by_turn = (turned[0] - turned[1]) / 2e-6  # since the offset was renewed with the application level
        variance += (
            alignment * slope(lambda h, t=by_turn: columns(known, readings + h * t, temperature, field), 1e-5)
        ) ** 2
        if compass:
            by_field = slope(lambda h, e=e: columns(known, readings, temperature, field + h * e), 1e-3)
            variance += (field_noise * by_field) ** 2
    for column, expected in zip(names, np.sqrt(variance), strict=True):
        np.testing.assert_allclose(found[f"u_{column}"], expected, rtol=0.01, atol=2e-5, err_msg=column)
        np.testing.assert_allclose(found[f"U95_{column}"], NORMAL * expected, rtol=0.01, atol=1e-4, err_msg=column)


# Where a derivative says nothing, the interval still holds the truth. The noise is 2 counts, and alone.

LEVELLING = Coefficients(AXES, AXES, np.zeros(3), 1000.0 * np.eye(3))
PLANE = Coefficients(AXES[:2], AXES[:2], np.zeros(2), 1000.0 * np.eye(2))
ASKEW = sensor(2, 3, mounting=TURNED)


def judged(known: Coefficients, readings: Array) -> tuple[Compensated, Array, Array]:
    doubt = uncertain_readings((), np.zeros((0, 0)), np.zeros(0), np.full(len(known.channels), 2.0))
    return result_of(known, doubt, readings)


@pytest.mark.parametrize("tilt", [0.0, 70.0, 88.0, 89.5, 90.0, -90.0])
@pytest.mark.parametrize(
    ("known", "axis", "least", "most", "widest"),
    [*((LEVELLING, k, 0.94, 0.99, 0.46) for k in range(3)), (PLANE, 0, 0.94, 1.0, 10.0), (ASKEW, 0, 0.93, 1.0, 30.0)],
)
def test_an_attitude_towards_90_is_inside(
    known: Coefficients, axis: int, least: float, most: float, widest: float, tilt: float
) -> None:
    """Read 4000 times. Mounted askew, both tilts lean on a g_z that x and y leave."""
    gravity = np.roll([np.sin(radians(tilt)), cos(radians(tilt)), 0.0], axis)
    if known is ASKEW:
        gravity = np.array([np.sin(radians(abs(tilt))), 0.0, cos(radians(tilt))])
    matrix = mounting_matrix(known.mounting or Mounting())
    noise = np.random.default_rng(8).normal(0.0, 2.0, (4000, len(known.channels)))
    compensated, _, expanded = judged(known, known.predict(gravity[None]) + noise)
    off = np.abs(compensated.tilt - np.degrees(np.arcsin(matrix @ gravity))[: len(known.channels)])
    for k in (0, 1) if known is ASKEW else (axis,):
        finite = np.isfinite(expanded[:, k])
        assert np.mean(finite) >= 0.96  # of two channels 2.5 % are beyond ±1 by more than their interval
        assert least <= np.mean(off[finite, k] <= expanded[finite, k]) <= most
        assert np.all(expanded[finite, k] < widest)


def test_an_argument_beyond_its_own_interval_has_no_uncertainty() -> None:
    """1.01 with 0.002 of noise contradicts the calibration: it says nothing of how far; roll of x up is anything."""
    compensated, standard, expanded = judged(PLANE, np.array([[1010.0, 0.0], [1003.0, 0.0]]))
    assert compensated.tilt[:, 0].tolist() == [90.0, 90.0]
    assert np.isnan(expanded[0, 0])
    expected = 90.0 - degrees(asin(1.003 - NORMAL * 0.002))
    assert (expanded[1, 0], standard[1, 0]) == pytest.approx((expected, expected / NORMAL), rel=1e-3)
    _, standard, expanded = judged(LEVELLING, np.array([[1000.0, 0.0, 0.0]]))
    assert (expanded[0, 4], standard[0, 4]) == pytest.approx((180.0, degrees(pi / sqrt(3))), rel=1e-3)


def test_the_length_of_gravity_is_as_uncertain_as_where_it_is_most() -> None:
    """Offsets, own sensitivities, drifts and readings, all independent: u² = o² + s² sum(g_i^4) + (k dT)² + r²."""
    thermal = Thermal(20.0, (0.0, 35.0), np.zeros((3, 1)), np.zeros((3, 0)))
    known = replace(LEVELLING, sensitivity=np.eye(3), thermal=thermal)
    sizes = {"offset.{}": 1e-3, "sensitivity.{0}.{0}": 2e-3, "temperature.offset.{}.1": 1e-4}
    names = [name.format(axis) for name in sizes for axis in AXES]
    doubt = uncertain_readings(
        tuple(names), np.diag(np.repeat([*sizes.values()], 3)) ** 2, np.full(9, NORMAL), [5e-4] * 3
    )
    tilts = {"x": (radians(30.0), radians(60.0)), "y": (0.0, 0.0), "z": (0.0, pi / 2)}
    up, down = {**tilts, "x": (0.0, 0.1)}, {**tilts, "z": (-pi / 2, -1.0)}
    for tilt, within, fourth, warm in (
        ({}, None, 1.0, 20.0),
        (tilts, None, 5 / 8, 20.0),
        (up, (10.0, 50.0), 1.0, 15.0),
        (down, (15.0, 22.0), 5 / 8, 5.0),
        ({**tilts, "z": (0.6, 0.8)}, (15.0, 22.0), sin(radians(52.5)) ** 4 + cos(radians(52.5)) ** 4, 5.0),
        ({**tilts, "z": (0.0, 0.1)}, None, 0.0, 0.0),
    ):
        square = 1e-6 + 4e-6 * fourth + (1e-4 * warm) ** 2 + 25e-8
        found = length_half_width(known, Limits(tilt=tilt, temperature=within), doubt)
        assert found == pytest.approx(NORMAL * sqrt(square) if fourth else 0.0, rel=0.01), tilt


def test_what_has_no_angle_to_use_has_no_uncertainty() -> None:
    known = sensor(2, 2, drift=1)
    x, y = known.offset
    readings, temperature = [[x, y], [np.nan, y], [1500.0, y], [x, y], [x, y]], [20.0, 20.0, 20.0, np.nan, 40.0]
    limits = Limits(temperature=(0.0, 30.0), reading={"x": (0.0, 1500.0)})
    compensated, *found = result_of(known, doubt_of(known), np.array(readings), np.array(temperature), limits)
    assert compensated.flag.tolist() == [1, 9, 4, 3, 3]
    for some in found:
        assert np.isfinite(some).all(axis=1).tolist() == [True, False, False, False, True]


def test_many_rows_give_what_each_gives_alone() -> None:
    """Chunks and blocks have no seam."""
    known = SENSORS["three channels, everything"]
    doubt = doubt_of(known, factors=2.8)
    up, temperature = rows(known, 700)
    readings = known.predict(up, temperature)
    whole = result_of(known, doubt, np.tile(readings, (60, 1)), np.tile(temperature, 60))
    alone = result_of(known, doubt, readings, temperature)
    for found, expected in zip(whole[1:], alone[1:], strict=True):
        np.testing.assert_array_equal(found, np.tile(expected, (60, 1)))

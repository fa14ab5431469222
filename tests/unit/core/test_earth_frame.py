"""Heading and earth velocities against rotations of scipy, which go the other way: from the earth to the instrument."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import cos, nan, radians, sin

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.uncertain_readings import uncertain_readings

from tiltcal.core.angle_uncertainty import CompensationWithUncertainty
from tiltcal.core.attitude import mounting_matrix
from tiltcal.core.compensation import Compensation
from tiltcal.core.earth_frame import EarthFrameCompensation, FieldLength
from tiltcal.core.flags import FAIL, GRAVITY_LENGTH, MISSING, NO_DIRECTION, NOT_A_NUMBER, PASS, SUSPECT
from tiltcal.core.model import Array, Coefficients, Mounting
from tiltcal.core.uncertain import TURN
from tiltcal.errors import EstimateError
from tiltcal.logs.kernel import RoleValues, TiltKernel

DIP, DECLINATION, FIELD = radians(66.0), 10.0, 50.0
SLANTED = Mounting(radians(20.0), radians(30.0), radians(130.0))
UPSIDE_DOWN, RIGHT_ANGLE = Mounting(radians(180.0), 0.0, 0.0), Mounting(0.0, radians(90.0), 0.0)
ENU = ("v_east", "v_north", "v_up")


def coefficients(channels: int, mounting: Mounting | None = None) -> Coefficients:
    axes = ("x", "y", "z")[:channels]
    sensitivity = np.diag([800.0, 810.0, 790.0])[:channels, :channels] + 9.0 * np.tri(channels, k=-1)
    return Coefficients(
        channels=axes, axes=axes, offset=np.full(channels, 1000.0), sensitivity=sensitivity, mounting=mounting
    )


@dataclass(frozen=True)
class Truth:
    """Random attitudes of an instrument, and vectors of the earth in its frame."""

    up: Array
    field: Array
    heading: Array
    flow: Array
    velocity: Array

    @classmethod
    def of(cls, rows: int) -> Truth:
        attitude = Rotation.random(rows, random_state=2)
        east_of_north = radians(DECLINATION)
        field = FIELD * np.array([cos(DIP) * sin(east_of_north), cos(DIP) * cos(east_of_north), -sin(DIP)])
        flow = np.random.default_rng(3).normal(size=(rows, 3))
        nose = attitude.inv().apply([1.0, 0.0, 0.0])
        return cls(
            attitude.apply([0.0, 0.0, 1.0]),
            attitude.apply(field),
            np.degrees(np.arctan2(nose[:, 0], nose[:, 1])) % 360.0,
            flow,
            attitude.apply(flow),
        )


def visible(truth: Truth, known: Coefficients, least: float) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """The rows that a sensor of two channels does not take for their mirror image."""
    if len(known.channels) == 3:
        return np.ones(len(truth.up), bool)
    matrix = np.eye(3) if known.mounting is None else mounting_matrix(known.mounting)
    side = -1.0 if matrix[2, 2] < -1e-9 else 1.0
    on_edge = abs(matrix[2, 2]) < cos(radians(45.0))
    return np.asarray(side * (truth.up @ matrix)[:, 2] > (cos(radians(45.0)) + 0.05 if on_edge else least))


@pytest.mark.parametrize("compass", [True, False])
@pytest.mark.parametrize(
    ("channels", "mounting"), [(3, None), (3, SLANTED), (2, None), (2, UPSIDE_DOWN), (2, RIGHT_ANGLE), (2, SLANTED)]
)
def test_the_earth_as_rotations_have_it(channels: int, mounting: Mounting | None, compass: bool) -> None:
    known, truth = coefficients(channels, mounting), Truth.of(10_000)
    matrix = np.eye(3) if mounting is None else mounting_matrix(mounting)
    compensation = Compensation(known)
    declination = DECLINATION if compass else 0.0
    earth = EarthFrameCompensation(compensation, magnetometer=compass, velocity=True, declination=declination)
    table = TiltKernel(compensation, earth=earth)(
        RoleValues(
            1000.0 + (truth.up @ matrix)[:, :channels] @ known.sensitivity.T,
            magnetometer=truth.field @ matrix if compass else None,
            velocity=truth.velocity,
            heading=None if compass else truth.heading,
        )
    )
    seen = visible(truth, known, 1e-3)  # nearer to the edge, a reading's last bit moves g_z by more
    assert seen.sum() > (1_000 if mounting is RIGHT_ANGLE else 4_000)
    if compass:
        assert np.abs((table["heading"] - truth.heading + 180.0) % 360.0 - 180.0)[seen].max() < 1e-9
        assert 0.0 <= table["heading"][seen].min() < 1.0
        assert 359.0 < table["heading"][seen].max() < 360.0
    found = np.stack([table[name] for name in ENU], axis=1)
    assert np.abs(found - truth.flow)[seen].max() < radians(1e-9)
    assert (table["flag"][seen] == PASS).all()


@pytest.mark.parametrize("compass", [True, False])
@pytest.mark.parametrize(("channels", "mounting"), [(3, None), (3, SLANTED), (2, None), (2, RIGHT_ANGLE), (2, SLANTED)])
def test_intervals_hold_the_truth(channels: int, mounting: Mounting | None, compass: bool) -> None:
    """Sensor, mounting, readings and magnetometer are off by random errors of the stated size, in every row others."""
    rows, noise, field_noise = 15_000, 4.0, 0.3 if compass else 0.0
    known, truth, draw = coefficients(channels, mounting), Truth.of(rows), np.random.default_rng(1)
    alignment = 0.01 if (channels == 3) == (mounting is None) else 0.0
    axes = known.channels
    names = [f"offset.{a}" for a in axes] + [f"sensitivity.{a}.{b}" for a in axes for b in axes]
    size = [3.0] * channels + [4.0] * channels**2
    if mounting is not None:
        names, size = names + [TURN + a for a in "xyz"], [*size, 0.01, 0.01, 0.01]
    mixed = draw.normal(size=(len(size), len(size)))
    mixed = mixed @ mixed.T / len(size) + np.eye(len(size))
    covariance = mixed / np.sqrt(np.outer(np.diag(mixed), np.diag(mixed))) * np.outer(size, size)
    compensation = Compensation(known)
    inputs = uncertain_readings(
        tuple(names), covariance, np.full(len(size), 1.959964), np.full(channels, noise), alignment=alignment
    )
    uncertain = CompensationWithUncertainty(compensation, known, inputs)
    earth = EarthFrameCompensation(
        compensation,
        magnetometer=compass,
        velocity=True,
        declination=DECLINATION if compass else 0.0,
        uncertain=uncertain,
        field_noise=field_noise,
    )
    error = draw.multivariate_normal(np.zeros(len(size)), covariance, rows)
    offset, sensitivity, turn = np.split(error, [channels, channels + channels**2], axis=1)
    matrix = np.eye(3) if mounting is None else mounting_matrix(mounting)
    true = (Rotation.from_rotvec(turn).as_matrix() if mounting is not None else np.eye(3)) @ matrix
    up, field = (
        np.einsum("...ij,ni->nj" if true.ndim == 2 else "nij,ni->nj", true, v) for v in (truth.up, truth.field)
    )
    since = draw.normal(scale=alignment, size=(rows, 3))  # the offset was renewed with the application level
    up = up + np.cross(since, up - matrix[2])
    of_g = known.sensitivity + sensitivity.reshape(rows, channels, channels)
    readings = 1000.0 + offset + np.einsum("nij,nj->ni", of_g, up[:, :channels])
    table = TiltKernel(compensation, uncertain, earth)(
        RoleValues(
            readings + draw.normal(scale=noise, size=readings.shape),
            magnetometer=field + draw.normal(scale=field_noise, size=(rows, 3)) if compass else None,
            velocity=truth.velocity,
            heading=None if compass else truth.heading,
        )
    )
    # Within 5° of the edge of the half sphere an error of first order is not enough to tell g_z.
    seen = visible(truth, known, 0.087)
    errors = dict(zip(ENU, (np.stack([table[n] for n in ENU]) - truth.flow.T), strict=True))
    if compass:
        errors["heading"] = (table["heading"] - truth.heading + 180.0) % 360.0 - 180.0
    for name, found in errors.items():
        half = table[f"U95_{name}"][seen]
        assert 0.94 < np.mean(np.abs(found[seen])[np.isfinite(half)] <= half[np.isfinite(half)]) < 0.965, name
        assert np.isfinite(half).mean() > 0.99


def level(**given: object) -> Mapping[str, Array]:
    """One row, level unless readings say otherwise, with a field that points north along +X."""
    compensation = Compensation(coefficients(given.pop("channels", 3)))  # type: ignore[call-overload]
    earth = EarthFrameCompensation(
        compensation, magnetometer="heading" not in given, velocity=True, declination=given.pop("declination", 0.0)
    )
    values = {"magnetometer": None if "heading" in given else [[20.0, 0.0, -45.0]], "velocity": [[1.0, 0.0, 0.0]]}
    up = np.array(given.pop("up", [[0.0, 0.0, 1.0]]))
    arrays = {name: np.array(value, float) for name, value in {**values, **given}.items() if value is not None}
    known = coefficients(len(compensation.axes))
    readings = known.offset + up[:, : len(compensation.axes)] @ known.sensitivity.T
    return TiltKernel(compensation, earth=earth)(RoleValues(readings, **arrays))


def row(table: Mapping[str, Array]) -> tuple[float, ...]:
    return tuple(float(table[name][0]) for name in ("flag", "reason", "heading", *ENU) if name in table)


class TestFlags:
    def test_level_and_north(self) -> None:
        assert row(level()) == pytest.approx((PASS, 0, 0.0, 0.0, 1.0, 0.0))

    def test_the_declination_is_positive_east(self) -> None:
        assert row(level(declination=90.0)) == pytest.approx((PASS, 0, 90.0, 1.0, 0.0, 0.0))
        assert row(level(declination=-14.3))[2] == pytest.approx(345.7)

    def test_no_heading_where_x_is_vertical(self) -> None:
        found = row(level(up=[[1.0, 0.0, 0.0]], magnetometer=[[-45.0, 20.0, 0.0]]))
        assert found == pytest.approx((FAIL, NO_DIRECTION, nan, nan, nan, 1.0), nan_ok=True)
        found = row(level(up=[[-1.0, 0.0, 0.0]], heading=[10.0]))
        assert found == pytest.approx((FAIL, NO_DIRECTION, nan, nan, -1.0), nan_ok=True)

    def test_no_heading_where_nothing_points_up(self) -> None:
        found = row(level(up=[[0.0, 0.0, 0.0]]))
        assert found == pytest.approx((FAIL, NO_DIRECTION + GRAVITY_LENGTH, nan, nan, nan, nan), nan_ok=True)
        found = row(level(up=[[0.0, 0.0, 0.49]]))
        assert found == pytest.approx((FAIL, GRAVITY_LENGTH, nan, nan, nan, nan), nan_ok=True)

    def test_no_heading_where_the_field_is_vertical_or_nothing(self) -> None:
        for field in ([0.0, 0.0, -45.0], [0.0, 0.0, 0.0]):
            found = row(level(magnetometer=[field]))
            assert found == pytest.approx((FAIL, NO_DIRECTION, nan, nan, nan, 0.0), nan_ok=True)

    def test_a_missing_component_fails_and_leaves_the_tilt(self) -> None:
        table = level(magnetometer=[[20.0, nan, -45.0]])
        assert row(table)[:3] == pytest.approx((FAIL, NOT_A_NUMBER, nan), nan_ok=True)
        assert table["tilt_x"][0] == pytest.approx(0.0)
        assert row(level(velocity=[[1.0, nan, 0.0]]))[:3] == (FAIL, NOT_A_NUMBER, 0.0)
        assert row(level(up=[[nan, 0.0, 1.0]]))[:3] == pytest.approx((MISSING, NOT_A_NUMBER, nan), nan_ok=True)

    def test_a_field_of_unusual_length(self) -> None:
        scale = np.array([1.0, 1.0, 1.04, 0.96, 1.06, 0.94])
        field = scale[:, None] * np.array([20.0, 0.0, -45.0])
        table = level(up=[[0.0, 0.0, 1.0]] * 6, magnetometer=field, velocity=[[1.0, 0.0, 0.0]] * 6)
        assert table["heading"] == pytest.approx(np.zeros(6))
        table = FieldLength().flagged(table, field)
        assert table["flag"].tolist() == [PASS, PASS, PASS, PASS, SUSPECT, SUSPECT]
        assert table["reason"].tolist() == [0, 0, 0, 0, NO_DIRECTION, NO_DIRECTION]


def test_the_usual_length_does_not_depend_on_where_blocks_end() -> None:
    lengths = np.random.default_rng(5).normal(50.0, 1.5, 3000)
    lengths[[3, 1500]] = nan
    whole, parts = FieldLength(), FieldLength()
    field = np.stack([lengths, 0.0 * lengths, 0.0 * lengths], axis=1)
    table = {"flag": np.ones(3000, np.uint8), "reason": np.zeros(3000, np.uint16)}
    blocks = [slice(start, start + 7) for start in range(0, 3000, 7)]
    found = [parts.flagged({name: column[rows] for name, column in table.items()}, field[rows]) for rows in blocks]
    flags = np.concatenate([some["flag"] for some in found])
    assert (flags == whole.flagged(table, field)["flag"]).all()
    usual = np.nanmedian(lengths[:1001])  # a thousand of them are numbers
    assert (flags == SUSPECT)[1001:].tolist() == (np.abs(lengths[1001:] - usual) > 0.05 * usual).tolist()


def test_one_channel_has_no_heading() -> None:
    with pytest.raises(EstimateError, match="at least x and y"):
        EarthFrameCompensation(Compensation(coefficients(1)), magnetometer=True, velocity=False)

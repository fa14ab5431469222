"""Heading and earth velocities against rotations of scipy, which go the other way: from the earth to the instrument."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import cos, nan, radians, sin
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tiltcal.core.attitude import mounting_matrix
from tiltcal.core.compensation import Compensation
from tiltcal.core.earth_frame import EarthFrameCompensation, FieldLength
from tiltcal.core.flags import FAIL, GRAVITY_LENGTH, MISSING, NO_DIRECTION, NOT_A_NUMBER, PASS, SUSPECT
from tiltcal.core.model import Array, Coefficients, Mounting
from tiltcal.logs.kernel import RoleValues, TiltKernel

DIP, DECLINATION, FIELD = radians(66.0), 10.0, 50.0
SLANTED = Mounting(radians(20.0), radians(30.0), radians(130.0))
UPSIDE_DOWN, RIGHT_ANGLE = Mounting(radians(180.0), 0.0, 0.0), Mounting(0.0, radians(90.0), 0.0)
Table = Mapping[str, Array]
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
@pytest.mark.parametrize(("channels", "mounting"), [(3, SLANTED), (2, None), (2, UPSIDE_DOWN), (2, RIGHT_ANGLE)])
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


def level(channels: int = 3, up: list[float] | None = None, declination: float = 0.0, **given: list[float]) -> Table:
    """One row, level unless it is said otherwise, with a field that points north along +X, or a heading."""
    known = coefficients(channels)
    compensation = Compensation(known)
    earth = EarthFrameCompensation(
        compensation, magnetometer="heading" not in given, velocity=True, declination=declination
    )
    vectors = {"velocity": [1.0, 0.0, 0.0], **({} if "heading" in given else {"magnetometer": [20.0, 0.0, -45.0]})}
    arrays = {name: np.array([value], float) for name, value in {**vectors, **given}.items()}
    readings = known.offset + np.array([up or [0.0, 0.0, 1.0]])[:, :channels] @ known.sensitivity.T
    return TiltKernel(compensation, earth=earth)(RoleValues(readings, **arrays))


def row(table: Table) -> tuple[float, ...]:
    return tuple(float(table[name][0]) for name in ("flag", "reason", "heading", *ENU) if name in table)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({}, (PASS, 0, 0.0, 0.0, 1.0, 0.0)),
        ({"declination": 90.0}, (PASS, 0, 90.0, 1.0, 0.0, 0.0)),
        ({"up": [1.0, 0.0, 0.0], "magnetometer": [-45.0, 20.0, 0.0]}, (FAIL, NO_DIRECTION, nan, nan, nan, 1.0)),
        ({"up": [-1.0, 0.0, 0.0], "heading": 10.0}, (FAIL, NO_DIRECTION, nan, nan, -1.0)),
        ({"up": [0.0, 0.0, 0.0]}, (FAIL, NO_DIRECTION + GRAVITY_LENGTH, nan, nan, nan, nan)),
        ({"up": [0.0, 0.0, 0.49]}, (FAIL, GRAVITY_LENGTH, nan, nan, nan, nan)),
        ({"magnetometer": [0.0, 0.0, -45.0]}, (FAIL, NO_DIRECTION, nan, nan, nan, 0.0)),
        ({"magnetometer": [0.0, 0.0, 0.0]}, (FAIL, NO_DIRECTION, nan, nan, nan, 0.0)),
        ({"magnetometer": [20.0, nan, -45.0]}, (FAIL, NOT_A_NUMBER, nan, nan, nan, 0.0)),
        ({"velocity": [1.0, nan, 0.0]}, (FAIL, NOT_A_NUMBER, 0.0, nan, nan, nan)),
        ({"up": [nan, 0.0, 1.0]}, (MISSING, NOT_A_NUMBER, nan, nan, nan, nan)),
    ],
)
def test_heading_and_flags_of_a_row(given: dict[str, Any], expected: tuple[float, ...]) -> None:
    """The declination is positive east; without a direction of x, of up or of the field there is no heading."""
    table = level(**given)
    assert row(table) == pytest.approx(expected, nan_ok=True)
    assert np.isfinite(table["tilt_x"][0]) == (
        GRAVITY_LENGTH & int(table["reason"][0]) == 0 and row(table)[0] < MISSING
    )


def test_the_usual_length_of_the_field_does_not_depend_on_where_blocks_end() -> None:
    """A mark raises the flag, adds its reason, and leaves missing rows as they are."""
    lengths = np.random.default_rng(5).normal(50.0, 1.5, 3000)
    lengths[[3, 1500]] = nan
    whole, parts = FieldLength(), FieldLength()
    field = np.stack([lengths, 0.0 * lengths, 0.0 * lengths], axis=1)
    before, reason = np.tile([PASS, FAIL, MISSING], 1000), np.tile([0, GRAVITY_LENGTH, NOT_A_NUMBER], 1000)
    table = {"a_flag": before.astype(np.uint8), "a_reason": reason.astype(np.uint16), "flagpole": np.zeros(3000)}
    blocks = [slice(start, start + 7) for start in range(0, 3000, 7)]
    found = [parts.flagged({name: column[rows] for name, column in table.items()}, field[rows]) for rows in blocks]
    flagged = whole.flagged(table, field)
    for name, column in flagged.items():
        assert (np.concatenate([some[name] for some in found]) == column).all()
    usual = np.nanmedian(lengths[:1001])  # a thousand of them are numbers
    marked = (np.abs(lengths - usual) > 0.05 * usual) & (before != MISSING)
    assert flagged["a_flag"][1001:].tolist() == np.where(marked, np.maximum(before, SUSPECT), before)[1001:].tolist()
    assert flagged["a_reason"][1001:].tolist() == np.where(marked, reason + NO_DIRECTION, reason)[1001:].tolist()

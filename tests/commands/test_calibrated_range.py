"""Where a calibration holds: rows inside of what was met are good, and rows 10° outside are suspect, by hand or not."""

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import nnls
from support.command import tiltcal

import tiltcal as library
from tiltcal.core.directions import ALL, Cone, common, covered
from tiltcal.core.model import Array
from tiltcal.drivers import find_model

MATRIX = np.array([[1.010, 0.004, -0.003], [-0.006, 0.988, 0.002], [0.001, 0.005, 1.020]])  # g/g
ZERO, NOISE = np.array([0.021, -0.015, 0.033]), 0.002  # g
FACES = np.vstack([np.eye(3), -np.eye(3)])[[0, 3, 1, 4, 2, 5]]
BETWEEN = np.array([(a, b, c) for a in (-1, 0, 1) for b in (-1, 0, 1) for c in (-1, 0, 1) if abs(a) + abs(b) + abs(c)])


def readings(up: Array, rng: np.random.Generator) -> dict[str, Array]:
    up = up / np.linalg.norm(up, axis=1, keepdims=True)
    table = up @ MATRIX.T + ZERO + NOISE * rng.normal(size=up.shape)
    return dict(zip("xyz", table.T, strict=True))


def free(directions: Array, rng: np.random.Generator) -> library.Calibration:
    """Hold the sensor in each direction, about 1° off, and turn it in between."""
    held = directions / np.linalg.norm(directions, axis=1, keepdims=True) + 0.017 * rng.normal(size=directions.shape)
    rows = np.concatenate([np.vstack([np.tile(one, (120, 1)), one + rng.normal(0.0, 0.3, (40, 3))]) for one in held])
    return library.fit("free", readings(rows, rng), serial="A", unit="g")


def passes(calibration: library.Calibration, up: Array, rng: np.random.Generator) -> Array:
    return np.asarray(calibration.apply(readings(up, rng))["flag"]) == 1


def inside(directions: Array, up: Array) -> Array:
    """What SPEC takes in, by non-negative least squares: a sum of directions with positive weights, or 5° from one."""
    every = np.vstack([directions * (a, b, 1.0) for a in (1, -1) for b in (1, -1)])
    every /= np.linalg.norm(every, axis=1, keepdims=True)
    hull = np.array([nnls(every.T, one)[1] < 1e-9 for one in up])
    return hull | ((up @ every.T).max(axis=1) > np.cos(np.radians(5.0)))


def test_level_rows_pass_after_faces_that_were_laid_by_hand() -> None:
    rng = np.random.default_rng(1)
    level = np.array([0.0, 0.0, 1.0]) + 0.01 * rng.normal(size=(1000, 3))
    faces = FACES + 0.02 * rng.normal(size=FACES.shape)
    names = [f"{axis}-{way}" for axis in "xyz" for way in ("up", "down")]
    table = {"position": names, **readings(faces, rng)}
    by_faces = library.fit("six-face", table, serial="A", unit="g", jig=1.0)
    for calibration in (by_faces, free(BETWEEN, rng)):
        assert calibration.limits.directions == "all"
        assert passes(calibration, level, rng).mean() >= 0.95
        assert passes(calibration, FACES, rng).all()


def test_rows_outside_of_the_hull_of_what_was_met_are_suspect() -> None:
    rng = np.random.default_rng(2)
    ring = np.radians(np.arange(0, 360, 45))
    rings = [
        np.column_stack([np.sin(a) * np.cos(ring), np.sin(a) * np.sin(ring), 0 * ring + np.cos(a)]) for a in (0.5, 1)
    ]
    calibration = free(np.vstack([[0.0, 0.0, 1.0], *rings]), rng)
    met = np.array(calibration.limits.directions)
    turn, down = np.radians(rng.uniform(0, 360, 2000)), np.radians(rng.uniform(0, 180, 2000))
    up = np.column_stack([np.sin(down) * np.cos(turn), np.sin(down) * np.sin(turn), np.cos(down)])
    rows = dict(zip("xyz", calibration.coefficients.predict(up).T, strict=True))
    good = np.asarray(calibration.apply(rows)["flag"]) == 1
    assert np.array_equal(good, inside(met, up))
    assert good[np.degrees(down) < 50].all()
    assert not good[np.degrees(down) > 75].any()


def test_a_combination_keeps_what_is_inside_for_each() -> None:
    rng = np.random.default_rng(3)
    up = rng.normal((0.0, 0.0, 1.5), 1.0, size=(2000, 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    wide, long = ([(x, y, z) for x, y, z in one] for one in ([(0.6, 0.3, 0.74), (0, 0, 1)], [(0.2, -0.8, 0.57)]))
    both = Cone(common([tuple(wide), ALL, tuple(long)])).inside(up.T)
    each = inside(np.array(wide), up) & inside(np.array(long), up)
    off = np.array([np.degrees(np.arccos(np.clip(up[each] @ one, -1, 1)).min()) for one in up])
    assert both[off == 0].mean() > 0.97  # but for the margins of 5°
    assert not both[off > 10].any()
    assert common([tuple(wide), tuple(wide)]) == tuple(wide)
    assert covered([(0.0, 0.6, 0.8), (0.6, 0.0, 0.8), (0.0, 0.0, -1.0)]) == ALL


def test_the_range_of_temperatures_is_rounded_outwards_by_half_a_step(tmp_path: Path) -> None:
    """A bench at 23.084026 °C: a thermometer with steps of 0.1 °C reads 23.1 there."""
    rows = [["position", "x", "y", "ux", "uy", "temperature"]]
    for at, change in ((5.004951, 0.0), (23.084026, 3.0)):
        faces = {"level-warm": (0, 0), "x-45": (0.7071, 0), "y-45": (0, 0.7071)} if at > 20 else {"level-cold": (0, 0)}
        rows += [
            [name, 1024 + 818 * x + change, 1022 + 820 * y + change, 0.1, 0.1, at] for name, (x, y) in faces.items()
        ]
    (tmp_path / "t.csv").write_text("\n".join(",".join(map(str, row)) for row in rows))
    stated = ("--table", "--sensor", "sca100t-d02", "--serial", "R", "--jig", "0.1", "--thermometer", "0.1")
    tiltcal("fit", "mavs", "t.csv", *stated, "-o", "r.yaml", cwd=tmp_path, code=0)
    low, high = library.read(tmp_path / "r.yaml").limits.temperature
    step = find_model("sca100t-d02").thermometer_step
    assert 5.004951 - step / 2 - 0.0011 < low < 5.004951 - step / 2.001
    assert high == pytest.approx(23.084026 + step / 2, abs=0.0011)

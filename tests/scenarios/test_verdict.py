"""The verdict on a calibration: wrong positions, what the data sheet states, and what bench and check say of it.

Sensors and jigs are simulated here: gravity is turned by a small vector, readings are written out.
"""

from math import cos, degrees, radians, sin, sqrt
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from support.command import measure
from support.command import tiltcal as command

import tiltcal

Array = NDArray[np.float64]
FACES = {
    f"{axis}-{way}": sign * np.eye(3)[k] for k, axis in enumerate("xyz") for way, sign in (("up", 1), ("down", -1))
}


def up(x: float = 0.0, y: float = 0.0) -> Array:
    """Gravity where the axes x and y are tilted by so many degrees."""
    a, b = sin(radians(x)), sin(radians(y))
    return np.array([a, b, sqrt(1.0 - a * a - b * b)])


PLANE = {"x-tilt1": up(30.0), "x-tilt2": up(-30.0), "y-tilt1": up(y=30.0), "y-tilt2": up(y=-30.0)}
POSITIONS = {"plane": PLANE, "cross-axis": {**PLANE, "z-tilt1": up(), "z-tilt2": -up()}}


def fitted(
    rng: np.random.Generator, procedure: str, error: float, wrong: dict[str, str] | None = None, **stated: object
) -> tiltcal.Calibration:
    """The calibration of an SCA100T-D02 within its data sheet, set with the errors of a jig, degrees.

    Its cross-axis sensitivity is up to 4 % (eq. 1), its non-linearity around 0.57°. Some positions are ``wrong``.
    """
    own, offset = 819.0 * (1.0 + rng.uniform(-0.005, 0.005, 2)), 1024.0 + rng.uniform(-3.0, 3.0, 2)
    (p, q), (a, b) = 0.04 * rng.uniform(0.0, 1.0, 2), rng.uniform(0.0, 2.0 * np.pi, 2)
    rows = np.array([[1.0, p * cos(a), p * sin(a)], [q * cos(b), 1.0, q * sin(b)]])
    bend = rng.normal(0.0, sin(radians(0.57)) / sqrt(2.0), (2, 2))
    columns: dict[str, list] = {name: [] for name in ("position", "x", "y", "ux", "uy")}
    for name in POSITIONS[procedure]:
        gravity = POSITIONS[procedure][(wrong or {}).get(name, name)]
        g = rows @ (gravity + np.cross(rng.normal(0.0, radians(error), 3), gravity))
        x, y = offset + own * g * (1.0 + bend[0] * g + bend[1] * g * g) + rng.normal(0.0, 0.06, 2)
        for column, value in zip(columns.values(), (name, x, y, 0.06, 0.06), strict=True):
            column.append(value)
    return tiltcal.fit(procedure, columns, serial="S", **stated)


def test_non_linearity_that_a_data_sheet_states_is_no_misfit() -> None:
    """Six positions of 20 parts at a jig of 0.05°: p is below 0.01 in one at most."""
    with_sheet, without = (
        [fitted(np.random.default_rng(seed), "cross-axis", 0.05, jig=0.05, **sensor) for seed in range(20)]
        for sensor in ({"sensor": "sca100t-d02"}, {"unit": "count"})
    )
    assert sum(one.fit.p_value < 0.01 for one in with_sheet) <= 1
    assert sum("not credible" in str(one) for one in without) >= 4
    assert all("nonlinearity" in one.fit.not_covered for one in without)
    assert not any("nonlinearity" in note for one in without for note in one.fit.notes)  # it stood in every file


@pytest.mark.parametrize("jig", [0.3, None])
@pytest.mark.parametrize("sensor", [{"sensor": "sca100t-d02"}, {"unit": "count"}], ids=["model", "no model"])
def test_plane_with_the_other_sign_is_refused(jig: float | None, sensor: dict[str, str]) -> None:
    for seed in range(20):
        with pytest.raises(tiltcal.EstimateError, match=r"^x-tilt1 or x-tilt2 is wrong: "):
            fitted(np.random.default_rng(seed), "plane", jig or 0.1, {"x-tilt1": "x-tilt2"}, jig=jig, **sensor)


def test_positions_by_hand_are_asked_for_and_beyond_5_degrees_judged(tmp_path: Path) -> None:
    """Twelve directions; the jig that the residuals show is one figure of each result."""
    rng = np.random.default_rng(4)
    for jig, code, asked in ((0.1, 0, False), (1.0, 0, True), (9.0, 1, True)):
        faces = [*FACES.values(), *(np.array(g) / sqrt(2.0) for g in ((1, 1, 0), (1, 0, 1), (0, 1, 1)))] * 2
        mean = [g + np.cross(rng.normal(0.0, radians(jig), 3), g) for g in faces]
        rows = {
            "position": [f"p{k}" for k in range(18)],
            **{f"g{c}": [g[k] for g in faces] for k, c in enumerate("xyz")},
        }
        rows |= {c: [m[k] for m in mean] for k, c in enumerate("xyz")} | {f"u{c}": [1e-4] * 18 for c in "xyz"}
        found = tiltcal.fit("six-face", rows, serial="S", unit="g")
        shown = found.fit.jig_estimated_degrees
        assert f"the positions agree to {shown:.2g}°" in str(found)
        assert any("were the positions set by hand" in note for note in found.fit.notes) == asked
        found.save(tmp_path / "S.yaml")
        assert command("check", "S.yaml", cwd=tmp_path).returncode == code, degrees(jig)


def test_six_faces_say_once_what_no_position_shows(tmp_path: Path) -> None:
    said = measure("--sensor", "scl3300", cwd=tmp_path, procedure="six-face")
    assert said.stderr.count("along gravity only the noise counts; --closing or --jig shows a drift") == 1
    assert "lean" not in said.stderr.partition("wrote")[2]
    text = (tmp_path / "S-1.yaml").read_text(encoding="utf-8")
    assert text.count("along gravity only the noise counts") == 1
    assert "not_covered: [lean, nonlinearity]" in text
    closed = measure(
        "--closing", "--sensor", "scl3300", "--serial", "S-2", "-o", "S-2.yaml", cwd=tmp_path, procedure="six-face"
    )
    assert "along gravity" not in closed.stderr

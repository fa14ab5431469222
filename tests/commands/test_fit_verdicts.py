"""What a fit says of positions, noise and channels: one cause, one message, and nothing that is not so."""

import re
from pathlib import Path

import numpy as np
import pytest
from support import FIXTURES
from support.command import tiltcal as tiltcal_command

import tiltcal
from tiltcal.core.model import Array
from tiltcal.errors import EstimateError

FACES = {"x-up": (1, 0, 0), "x-down": (-1, 0, 0), "y-up": (0, 1, 0), "y-down": (0, -1, 0)}
FACES |= {"z-up": (0, 0, 1), "z-down": (0, 0, -1)}
MATRIX = np.array([[1.010, 0.004, -0.003], [-0.006, 0.988, 0.002], [0.001, 0.005, 1.020]])  # g/g
ZERO = np.array([0.021, -0.015, 0.033])  # g


def six_faces(up: Array) -> tiltcal.Calibration:
    table = dict(zip("xyz", (up @ MATRIX.T + ZERO).T, strict=True))
    return tiltcal.fit("six-face", {"position": list(FACES), **table}, table=True, serial="A", unit="g")


@pytest.mark.parametrize(
    ("face", "really", "named"),
    [
        ("y-down", (0.0, 0.94, 0.34), "y-up or y-down is wrong"),  # with the +Y side up
        ("x-up", (0.0, 0.0, 1.0), "x-up is wrong"),
        ("z-down", (0.0, 0.0, 1.0), "z-up or z-down is wrong"),
    ],
)
def test_a_wrong_face_is_named_before_a_channel_is_called_broken(face: str, really: Array, named: str) -> None:
    """Without a jig the message was: x does not react to gravity: its sensitivity is 9.9 ± 7.8."""
    up = np.array(list({**FACES, face: really}.values()), dtype=float)
    with pytest.raises(EstimateError, match=named):
        six_faces(up)


def test_faces_that_are_laid_by_hand_are_no_wrong_faces() -> None:
    up = np.array(list(FACES.values())) + 0.1 * np.random.default_rng(1).normal(size=(6, 3))
    assert six_faces(up / np.linalg.norm(up, axis=1, keepdims=True)).sensitivity["x", "x"] == pytest.approx(
        1.0, abs=0.1
    )


@pytest.mark.parametrize(("table", "code"), [("moving_table: true", 1), ("moving_table: false", 0)])
def test_a_moving_table_that_agrees_to_4_tenths_of_a_degree_fails(table: str, code: int, tmp_path: Path) -> None:
    """Two parts were exchanged: with a table that sets the angles by itself nothing else moves them so far."""
    text = (FIXTURES / "multi-angle.yaml").read_text()
    text, jig = re.subn(r"  jig_estimated_degrees: .*\n", "  jig_estimated_degrees: 0.4\n", text)
    text, bench = re.subn(r"  bench: \{", f"  bench: {{{table}, ", text)
    assert (jig, bench) == (1, 1)
    (tmp_path / "a.yaml").write_text(re.sub(r"  (chi_square|p_value): .*\n", "", text))
    checked = tiltcal_command("check", "a.yaml", cwd=tmp_path)
    assert (checked.returncode, "agree to 0.4° only" in checked.stdout) == (code, bool(code))


def test_the_lean_of_the_table_is_no_residual_of_a_reversal(tmp_path: Path) -> None:
    """On a base that leans by 2°: 834 counts, 1.9°, were called the worst residual of readings that fit exactly."""
    plane = {"position": [f"{axis}-tilt{k}" for axis in "xy" for k in (1, 2)]}
    matrix, zero = np.array([[25050.0, 60.0], [-45.0, 24925.0]]), np.array([37.0, -21.0])
    stated = {"table": True, "serial": "P", "unit": "count"}
    read = np.round(np.array([(0.5, 0), (-0.5, 0), (0, 0.5), (0, -0.5)]) @ matrix.T + zero, 1)
    tiltcal.fit("plane", plane | {"x": read[:, 0], "y": read[:, 1]}, jig=0.05, **stated).save(tmp_path / "base.yaml")
    turns = np.radians([0, 90, 180, 270])
    read = np.sin(np.radians(2.0)) * np.column_stack([np.cos(turns + 0.3), -np.sin(turns + 0.3)]) @ matrix.T + zero
    table = {"position": [f"heading-{turn}" for turn in (0, 90, 180, 270)]}
    table |= dict(zip("xy", np.round(read, 1).T, strict=True))
    found = tiltcal.fit("reversal", table, base=tmp_path / "base.yaml", **stated)
    assert max(abs(one) for row in found.fit.residuals.values() for one in row.values()) < 5.0
    assert found.offset == pytest.approx({"x": 37.0, "y": -21.0}, abs=1.0)


@pytest.mark.parametrize(("p", "said"), [("0.0009", False), ("0.02", True), ("0.06", False)])
def test_an_agreement_of_one_session_in_twenty_is_remarked(p: str, said: bool, tmp_path: Path) -> None:
    """Below 1 in 1000 the file is not credible, above 1 in 20 nothing is said."""
    text = (FIXTURES / "comparison.yaml").read_text().replace("p_value: 0.775", f"p_value: {p}")
    (tmp_path / "a.yaml").write_text(text)
    checked = tiltcal_command("check", "a.yaml", cwd=tmp_path)
    assert ("worse than a jig of 0.002° lets them (probability 0.02)" in checked.stdout + checked.stderr) is said
    assert checked.returncode == (1 if p == "0.0009" else 0)

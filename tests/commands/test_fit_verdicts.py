"""What a fit says of positions, noise and channels: one cause, one message, and nothing that is not so."""

from __future__ import annotations

import numpy as np
import pytest

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

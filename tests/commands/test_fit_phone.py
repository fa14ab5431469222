"""Logs as phones and loggers write them: the columns and the unit are in the header, and ``apply`` finds them again."""

from pathlib import Path

import numpy as np
import pytest
from support.command import tiltcal

import tiltcal as library

OFFSET, SCALE = np.array([0.15, -0.2, 0.3]), 9.80665 * np.array([1.02, 0.99, 1.01])
"""Of the phone: m/s², and m/s² per g."""

HEADER = ("Time (s)", "Acceleration x (m/s^2)", "Acceleration y (m/s^2)", "Acceleration z (m/s^2)")
"""Of phyphox; tests/support/kinds_of_logs.py has those of others."""


def carried(up: np.ndarray, rows: int, seed: int) -> np.ndarray:
    """Readings every 20 ms of a phone that lies in attitudes and is turned between them, with times, s."""
    draw = np.random.default_rng(seed)
    up = up / np.linalg.norm(up, axis=1)[:, None]
    still = np.repeat(up * SCALE + OFFSET, rows, axis=0).reshape(-1, rows, 3)
    still += draw.normal(0.0, 0.02, still.shape)
    turned = still[:, -60:] + draw.normal(0.0, 3.0, (len(up), 60, 3))
    readings = np.concatenate([still, turned], axis=1).reshape(-1, 3)
    return np.column_stack([0.02 * np.arange(len(readings)), readings])


HELD = carried(np.vstack([np.eye(3), -np.eye(3), np.random.default_rng(3).normal(size=(8, 3))]), 150, 3)
"""In 14 attitudes."""
LEANING = (0.5, 0.5, 0.7)
FACES = carried(
    np.array([[0, 0, 1], LEANING, [0, 0, -1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1]])
    + np.random.default_rng(4).normal(0.0, 0.005, (8, 3)),
    200,
    5,
)
"""On its six faces, z-up twice, and against a book in between."""


def written(
    path: Path, header: tuple[str, ...], separator: str = ",", point: str = ".", rows: np.ndarray = HELD
) -> Path:
    lines = [separator.join(f'"{name}"' for name in header)]
    lines += [separator.join(f"{cell:.6e}".replace(".", point) for cell in row) for row in rows]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8-sig" if point == "," else "utf-8")
    return path


def test_the_faces_of_a_phone_are_found_and_named(tmp_path: Path) -> None:
    log = written(tmp_path / "faces.csv", HEADER, ";", ",", FACES)
    line = ["fit", "six-face", log, "--serial", "PHONE", "-o", "phone.yaml"]
    tiltcal(*line, cwd=tmp_path, code=0)
    cal = library.read(tmp_path / "phone.yaml")
    assert (cal.sensor.unit, dict(cal.sensor.columns)) == ("m/s2", dict(zip("xyz", HEADER[1:], strict=True)))
    tiltcal("apply", "phone.yaml", log, "-o", "out.csv", cwd=tmp_path, code=0)
    named = [position.position for position in cal.positions]
    assert named == ["z-up", "z-down", "x-up", "x-down", "y-up", "y-down", "z-up (2)"]
    for place, (start, end) in zip((0, 2, 3, 4, 5, 6, 7), (one.row_ranges[0] for one in cal.positions), strict=True):
        assert 260 * place <= start < 260 * place + 110
        assert 260 * place + 90 < end <= 260 * place + 210
    for axis, offset, scale in zip("xyz", OFFSET, SCALE, strict=True):
        assert cal.offset[axis] == pytest.approx(offset, abs=0.05)
        assert cal.sensitivity[axis, axis] == pytest.approx(scale, abs=0.05)


def test_units_that_differ_are_asked_about(tmp_path: Path) -> None:
    log = written(tmp_path / "log.csv", ("time", "ax (m/s^2)", "ay (g)", "az (m/s^2)"))
    done = tiltcal("fit", "free", log, "--serial", "PHONE", "-o", "phone.yaml", cwd=tmp_path, code=2)
    assert done.stderr == "tiltcal: state the --unit of the readings (such as m/s2), or the --sensor model\n"

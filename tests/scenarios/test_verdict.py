"""The verdict on a calibration: wrong positions, what the data sheet states, and what bench and check say of it.

Sensors and jigs are simulated here: gravity is turned by a small vector, readings are written out.
"""

from __future__ import annotations

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
POSITIONS = {
    "plane": PLANE,
    "zero-45": {"level": up(), "x-45": up(45.0), "y-45": up(y=45.0)},
    "mavs": {"x-45": up(45.0), "y-45": up(y=45.0), "level-warm": up(), "level-cold": up()},
    "cross-axis": {**PLANE, "z-tilt1": up(), "z-tilt2": -up()},
    "six-face": FACES,
}


class Part:
    """An SCA100T-D02 within its data sheet: cross-axis sensitivity up to 4 % (eq. 1), non-linearity around 0.57°."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.own = 819.0 * (1.0 + rng.uniform(-0.005, 0.005, 2))
        size, angle = 0.04 * rng.uniform(0.0, 1.0, 2), rng.uniform(0.0, 2.0 * np.pi, 2)
        self.rows = np.array(
            [
                [1.0, size[0] * cos(angle[0]), size[0] * sin(angle[0])],
                [size[1] * cos(angle[1]), 1.0, size[1] * sin(angle[1])],
            ]
        )
        self.bend = rng.normal(0.0, sin(radians(0.57)) / sqrt(2.0), (2, 2))
        self.offset = 1024.0 + rng.uniform(-3.0, 3.0, 2)
        self.drift = rng.normal(0.0, 0.1, 2)

    def read(self, gravity: Array, celsius: float = 24.0) -> Array:
        a = self.rows @ gravity
        bent = a * (1.0 + self.bend[:, 0] * a + self.bend[:, 1] * a * a)
        return self.offset + self.own * bent + self.drift * (celsius - 24.0)


def table(
    rng: np.random.Generator, part: Part, procedure: str, spread: float, wrong: dict[str, str]
) -> dict[str, list]:
    """The means of a session, each position set with the errors of a jig, degrees; some are others than named."""
    columns: dict[str, list] = {name: [] for name in ("position", "x", "y", "ux", "uy", "temperature")}
    error = np.zeros(3)
    for name in POSITIONS[procedure]:
        gravity = POSITIONS[procedure][wrong.get(name, name)]
        if name != "level-cold":
            error = rng.normal(0.0, radians(spread), 3)
        celsius = 5.5 if name == "level-cold" else 24.0
        x, y = part.read(gravity + np.cross(error, gravity), celsius) + rng.normal(0.0, 0.06, 2)
        for column, value in zip(columns.values(), (name, x, y, 0.06, 0.06, celsius), strict=True):
            column.append(value)
    return columns


def fitted(
    rng: np.random.Generator,
    part: Part,
    procedure: str,
    error: float,
    wrong: dict[str, str] | None = None,
    **stated: object,
) -> tiltcal.Calibration:
    return tiltcal.fit(procedure, table(rng, part, procedure, error, wrong or {}), serial="S", **stated)


class TestDataSheet:
    def test_non_linearity_that_it_states_is_no_misfit(self) -> None:
        """Six positions of 20 parts at a jig of 0.05°: p is below 0.01 in one at most."""
        rng = np.random.default_rng(7)
        stated = {"jig": 0.05}
        with_sheet, without = [], []
        for _ in range(20):
            part = Part(rng)
            with_sheet.append(fitted(rng, part, "cross-axis", 0.05, **stated, sensor="sca100t-d02"))
            without.append(fitted(rng, part, "cross-axis", 0.05, **stated, unit="count"))
        assert sum(one.fit.p_value < 0.01 for one in with_sheet) <= 1
        misfits = [one for one in without if "not credible" in str(one)]
        assert len(misfits) >= 4
        assert all(any("non-linearity counts as zero" in note for note in one.fit.notes) for one in without)


class TestWrongPosition:
    @pytest.mark.parametrize("jig", [0.05, 0.3, None])
    @pytest.mark.parametrize("sensor", [{"sensor": "sca100t-d02"}, {"unit": "count"}], ids=["model", "no model"])
    def test_plane_with_the_other_sign_is_refused(self, jig: float | None, sensor: dict[str, str]) -> None:
        for seed in range(20):
            rng = np.random.default_rng(seed)
            with pytest.raises(tiltcal.EstimateError, match=r"^x-tilt1 or x-tilt2 is wrong: "):
                fitted(rng, Part(rng), "plane", jig or 0.1, {"x-tilt1": "x-tilt2"}, jig=jig, **sensor)


def saved(folder: Path, found: tiltcal.Calibration) -> tuple[int, str]:
    """What ``tiltcal check`` says of a calibration."""
    found.save(folder / "S.yaml")
    checked = command("check", "S.yaml", cwd=folder)
    return checked.returncode, checked.stdout


class TestBenchAndCheck:
    def test_positions_by_hand_are_asked_for_and_beyond_5_degrees_judged(self, tmp_path: Path) -> None:
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
            assert saved(tmp_path, found)[0] == code, degrees(jig)

    def test_six_faces_say_once_what_no_position_shows(self, tmp_path: Path) -> None:
        said = measure("--sensor", "scl3300", cwd=tmp_path, procedure="six-face")
        assert said.stderr.count("along gravity only the noise counts; --closing or --jig shows a drift") == 1
        assert "lean" not in said.stderr.partition("wrote")[2]
        text = (tmp_path / "S-1.yaml").read_text(encoding="utf-8")
        assert text.count("along gravity only the noise counts") == 1
        assert "not_covered: [lean]" in text
        closed = measure(
            "--closing", "--sensor", "scl3300", "--serial", "S-2", "-o", "S-2.yaml", cwd=tmp_path, procedure="six-face"
        )
        assert "along gravity" not in closed.stderr

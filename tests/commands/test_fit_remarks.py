"""What ``tiltcal fit`` says against a record, on the terminal as well as in the file."""

from __future__ import annotations

from math import cos, radians, sin
from pathlib import Path

import numpy as np
from support.command import tiltcal

PLACES = {
    "x-tilt1": (30.0, 0.0),
    "x-tilt2": (-30.0, 0.0),
    "y-tilt1": (0.0, 30.0),
    "y-tilt2": (0.0, -30.0),
}


def fitted(folder: Path, wrong: float, places: tuple[str, ...], *options: str) -> str:
    """What a fit says of an ideal sensor in these places, with +x set wrong by so many degrees."""
    rng = np.random.default_rng(1)
    rows, segments = ["x,y,z"], ["position,start,end"]
    for name in places:
        x, y = (radians(angle) for angle in PLACES.get(name, (0.0, 0.0)))
        x += radians(wrong) if name == "x-tilt1" else 0.0
        z = -1.0 if name == "z-tilt2" else cos(x) if x else cos(y)
        segments.append(f"{name},{len(rows) - 1},{len(rows) + 49}")
        rows += [
            ",".join(f"{v:.7f}" for v in row) for row in np.array([sin(x), sin(y), z]) + rng.normal(0, 1e-4, (50, 3))
        ]
    (folder / "log.csv").write_text("\n".join(rows) + "\n")
    (folder / "segments.csv").write_text("\n".join(segments) + "\n")
    result = tiltcal(
        *("fit", "cross-axis", "log.csv", "--segments", "segments.csv", "--unit", "g", "--serial", "S", "-o", "S.yaml"),
        *options,
        cwd=folder,
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


ALL = (*PLACES, "z-tilt1", "z-tilt2")


def test_an_angle_that_was_set_wrong_is_named(tmp_path: Path) -> None:
    said = fitted(tmp_path, 4.0, ALL, "--jig", "0.05")
    assert "not credible: noise, jig or thermometer are worse than stated" in said
    assert "the worst first: x-tilt1 (" in said


def test_where_no_jig_is_stated_the_one_that_shows_is_told(tmp_path: Path) -> None:
    assert "the positions agree to " in fitted(tmp_path, 4.0, ALL)


def test_four_positions_for_four_unknowns_are_warned_of(tmp_path: Path) -> None:
    said = fitted(tmp_path, 0.0, ("x-tilt1", "x-tilt2", "y-tilt1", "z-tilt2"), "--jig", "0.05")
    assert "no degree of freedom is left: the positions fit whatever was read, and nothing checks them" in said

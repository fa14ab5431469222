"""``tiltcal fit reversal``: a recorded log of a sensor that was turned round on a leaning table."""

from __future__ import annotations

from math import cos, radians, sin, sqrt
from pathlib import Path

import numpy as np
import pytest
from support.command import tiltcal

from tiltcal.files.calibration import read_calibration

HEADINGS = (0, 90, 180, 270)
COUNT_PER_G, SAMPLES, NOISE = 819.0, 100, 0.5
LEAN_X, LEAN_Y = sin(radians(0.5)), sin(radians(-0.3))


@pytest.fixture(scope="module")
def readings() -> np.ndarray:
    """The table leans by 0.5° and -0.3°; the sensor, turned to the left, feels it turn to the right."""
    rng = np.random.default_rng(11)
    rows = []
    for heading in map(radians, HEADINGS):
        x = cos(heading) * LEAN_X + sin(heading) * LEAN_Y
        y = -sin(heading) * LEAN_X + cos(heading) * LEAN_Y
        rows.append(np.array([1030.0, 1019.0]) + COUNT_PER_G * np.array([x, y]) + rng.normal(0, NOISE, (SAMPLES, 2)))
    return np.array(rows)


def test_the_lean_turns_with_the_heading_and_the_offset_does_not(readings: np.ndarray, tmp_path: Path) -> None:
    """By hand: the offset is the mean of the four headings, and uncertain by what noise and jig leave of a mean."""
    lines = ["x,y", *(f"{x!r},{y!r}" for x, y in readings.reshape(-1, 2).tolist())]
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    rows = [f"heading-{heading},{k * SAMPLES},{(k + 1) * SAMPLES}" for k, heading in enumerate(HEADINGS)]
    (tmp_path / "segments.csv").write_text("\n".join(["position,start,end", *rows]) + "\n")
    result = tiltcal(
        *("fit", "reversal", "log.csv", "--segments", "segments.csv", "--sensor", "sca100t-d02", "--jig", "0.02"),
        *("--serial", "S-1", "-o", "S-1.yaml"),
        cwd=tmp_path,
    )
    assert result.returncode == 0, result.stderr
    found = read_calibration(tmp_path / "S-1.yaml")
    u = sqrt((NOISE / 10.0) ** 2 + (COUNT_PER_G * radians(0.02)) ** 2) / sqrt(4.0)
    for channel, offset, by_hand in zip("xy", found.coefficients.offset, readings.mean(axis=(0, 1)), strict=True):
        assert offset == pytest.approx(by_hand, abs=0.001)
        assert found.uncertainty[f"offset.{channel}"] == pytest.approx(u, rel=0.05)
    # Without the headings half a degree of lean would be the jig's fault, and chi-square would be tens of thousands.
    assert found.fit.p_value > 0.01
    assert found.fit.degrees_of_freedom == 4

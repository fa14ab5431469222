"""``tiltcal fit`` of a log whose temperature points were not all waited for."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
from command import tiltcal


class TestTemperaturePoint:
    """A log of ``two-temperature`` in which the second point was not waited for."""

    SEGMENTS = "position,start,end\nlevel-warm,0,50\nlevel-cold,50,100\n"

    def fitted(self, folder: Path, cooling: float) -> subprocess.CompletedProcess[str]:
        """The cold point cools by so many degrees while it is recorded; both thermometers scatter by 0.05 °C."""
        draw = np.random.default_rng(6)
        rows = ["x,y,temperature"]
        for number in range(100):
            way = (number - 50) / 49
            temperature = 24.0 if number < 50 else 5.0 - cooling * (way - 0.5)
            x, y = 1024.0 + 0.3 * (temperature - 24.0) + draw.normal(0.0, 0.5, 2)
            rows.append(f"{x:.3f},{y:.3f},{temperature + draw.normal(0.0, 0.05):.3f}")
        (folder / "log.csv").write_text("\n".join(rows) + "\n")
        (folder / "segments.csv").write_text(self.SEGMENTS)
        return tiltcal(
            *("fit", "two-temperature", "log.csv", "--segments", "segments.csv", "--sensor", "sca100t-d02"),
            *("--serial", "S-1", "-o", "S-1.yaml"),
            cwd=folder,
        )

    def test_one_that_stood_still_is_taken(self, tmp_path: Path) -> None:
        result = self.fitted(tmp_path, cooling=0.2)
        assert result.returncode == 0, result.stderr

    def test_one_that_was_heated_too_fast_is_refused_with_its_line(self, tmp_path: Path) -> None:
        result = self.fitted(tmp_path, cooling=2.0)
        assert result.returncode == 2
        assert "segments.csv:3: segment level-cold: the temperature drifts by -1.9" in result.stderr
        assert not (tmp_path / "S-1.yaml").exists()

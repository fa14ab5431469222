"""``tiltcal fit`` of a log whose temperature points were not all waited for."""

from __future__ import annotations

import subprocess
from math import sqrt
from pathlib import Path

import numpy as np
import pytest
from support.command import tiltcal

from tiltcal.files.calibration import CalibrationRecord, read_calibration


class TestTemperaturePoint:
    """A log of ``two-temperature`` in which the second point was not waited for."""

    SEGMENTS = "position,start,end\nlevel-warm,0,50\nlevel-cold,50,100\n"

    def fitted(
        self, folder: Path, cooling: float, *options: str, piped: bool = False
    ) -> subprocess.CompletedProcess[str]:
        """The cold point cools by so many degrees while it is recorded; both thermometers scatter by 0.05 °C."""
        draw = np.random.default_rng(6)
        rows = ["x,y,temperature"]
        for number in range(100):
            way = (number - 50) / 49
            temperature = 24.0 if number < 50 else 5.0 - cooling * (way - 0.5)
            x, y = 1024.0 + 0.3 * (temperature - 24.0) + draw.normal(0.0, 0.5, 2)
            rows.append(f"{x:.3f},{y:.3f},{temperature + draw.normal(0.0, 0.05):.3f}")
        log = "\n".join(rows) + "\n"
        (folder / "log.csv").write_text(log)
        (folder / "segments.csv").write_text(self.SEGMENTS)
        return tiltcal(
            *("fit", "two-temperature", "-" if piped else "log.csv", "--segments", "segments.csv"),
            *("--sensor", "sca100t-d02", "--serial", "S-1", "-o", "S-1.yaml", *options),
            cwd=folder,
            said=log if piped else "",
        )

    def test_a_log_without_times_on_standard_input_gives_the_same(self, tmp_path: Path) -> None:
        written = []
        for piped in (False, True):
            result = self.fitted(tmp_path, 0.02, piped=piped)
            assert result.returncode == 0, result.stderr
            written.append((tmp_path / "S-1.yaml").read_text())
        assert written[1] == written[0].replace("name: log.csv", 'name: "-"')

    def test_the_thermometer_that_was_stated_counts(self, tmp_path: Path) -> None:
        """By hand: 0.3 count/°C over 19 °C, both ends uncertain by 0.4 °C."""
        u = []
        for told in ("0", "0.4"):
            assert self.fitted(tmp_path, 0.0, "--thermometer", told, "--jig", "0").returncode == 0
            found = read_calibration(tmp_path / "S-1.yaml")
            u.append(found.uncertainty["temperature.offset.x.1"])
            drift = found.coefficients.thermal.drift[0][0]  # type: ignore[union-attr]
        assert sqrt(u[1] ** 2 - u[0] ** 2) == pytest.approx(drift * 0.4 * sqrt(2) / 19.0, rel=0.02)

    def test_one_that_was_heated_too_fast_is_refused_with_its_line(self, tmp_path: Path) -> None:
        result = self.fitted(tmp_path, cooling=2.0)
        assert result.returncode == 2
        assert "segments.csv:3: segment level-cold: the temperature drifts by -1.9" in result.stderr
        assert not (tmp_path / "S-1.yaml").exists()


def test_ten_minutes_after_a_leg_of_1_degree_a_minute_a_late_thermometer_is_refused(tmp_path: Path) -> None:
    """A thermometer that is 5 min late is still 0.7 °C behind; its last minute looks still."""
    time = np.arange(0.0, 4200.0, 2.0)
    leg = np.clip(time - 900.0, 0.0, 1110.0)
    chamber = 24.0 - leg / 60.0
    behind = 5.0 * (1.0 - np.exp(-leg / 300.0)) * np.exp(-np.maximum(time - 2010.0, 0.0) / 300.0)
    rows = np.column_stack([time, 1024.0 + 0.3 * (chamber - 24.0), 1024.0 - 0.3 * (chamber - 24.0), chamber + behind])
    rows[:, 1:] += np.random.default_rng(3).normal(0.0, (0.5, 0.5, 0.02), (len(time), 3))
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header="time,x,y,temperature", comments="", fmt="%.4f")
    codes = []
    for end in (2610, 4200):  # 10 min and 36 min after the leg
        cold = f"level-cold,{(end - 60) // 2},{end // 2}"
        (tmp_path / "segments.csv").write_text(f"position,start,end\nlevel-warm,400,440\n{cold}\n")
        result = tiltcal(
            *("fit", "two-temperature", "log.csv", "--segments", "segments.csv", "--sensor", "sca100t-d02"),
            *("--serial", "S-1", "-o", "S-1.yaml"),
            cwd=tmp_path,
        )
        codes.append(result.returncode)
        assert ("segment level-cold: the temperature drifts by -" in result.stderr) is (end == 2610)
    assert codes == [2, 0]


class TestFastRamp:
    """A ramp of 0.5 °C/min, whose thermometer is 1 °C ahead of an element that is 120 s late."""

    @pytest.mark.parametrize(
        ("seconds", "written"),
        [(5, "%.4f"), (20, "%.4f"), (60, "%.4f"), (20, ""), (60, ""), (20, "second %.0f"), (60, "second %.0f")],
    )
    def test_a_short_segment_is_refused_as_a_long_one_is(self, tmp_path: Path, seconds: int, written: str) -> None:
        """The times are in seconds, not there, or in a form of the user's own."""
        time = np.arange(2400.0)
        rows = np.column_stack([1024.0 + 0.02 * time, 1024.0 - 0.02 * time, 24.0 - time * 0.5 / 60.0])
        rows += np.random.default_rng(3).normal(0.0, (0.5, 0.5, 0.02), rows.shape)
        columns = np.column_stack([time, rows]) if written else rows
        names = "time,x,y,temperature" if written else "x,y,temperature"
        form = [written, *["%.4f"] * 3] if written else "%.4f"
        np.savetxt(tmp_path / "log.csv", columns, delimiter=",", header=names, comments="", fmt=form)
        ends = "".join(f"{name},{end - seconds},{end}\n" for name, end in (("level-warm", 300), ("level-cold", 2300)))
        (tmp_path / "segments.csv").write_text(f"position,start,end\n{ends}")
        result = tiltcal(
            *("fit", "two-temperature", "log.csv", "--segments", "segments.csv", "--sensor", "sca100t-d02"),
            *("--serial", "S-1", "-o", "S-1.yaml"),
            cwd=tmp_path,
        )
        assert result.returncode == 2
        assert "segments.csv:2: segment level-warm: the temperature drifts by -" in result.stderr


class TestSweep:
    """A log of ``temperature-sweep``: a straight drift, and x is 0.8 count higher on the way up at 15 °C."""

    DOWN, UP = ("down-24", "down-15", "down-5.5"), ("up-15", "up-24", "up-32", "up-40", "back-32", "back-24")

    @pytest.fixture
    def found(self, tmp_path: Path) -> CalibrationRecord:
        folder, rng = tmp_path, np.random.default_rng(8)
        rows, segments = ["x,y,temperature"], ["position,start,end"]
        for name in (*self.DOWN, *self.UP):
            temperature = float(name.split("-")[1])
            loop = 0.8 if name == "up-15" else 0.0
            segments.append(f"{name},{len(rows) - 1},{len(rows) + 99}")
            for x, y in rng.normal(0.0, 0.5, (100, 2)) + 1024.0 + 0.2 * (temperature - 24.0):
                rows.append(f"{x + loop:.3f},{y:.3f},{temperature}")
        (folder / "log.csv").write_text("\n".join(rows) + "\n")
        (folder / "segments.csv").write_text("\n".join(segments) + "\n")
        result = tiltcal(
            *("fit", "temperature-sweep", "log.csv", "--segments", "segments.csv", "--sensor", "sca100t-d02"),
            *("--serial", "S-1", "-o", "S-1.yaml"),
            cwd=folder,
        )
        assert result.returncode == 0, result.stderr
        return read_calibration(folder / "S-1.yaml")

    def test_the_order_is_chosen_and_not_the_highest(self, found: CalibrationRecord) -> None:
        thermal = found.coefficients.thermal
        assert thermal is not None
        assert found.fit.cross_validation.order == 1
        assert not thermal.drift[:, 1:].any()
        assert found.uncertainty["temperature.offset.x.3"] > 0.0

    def test_the_hysteresis_is_told_with_its_sign(self, found: CalibrationRecord) -> None:
        loop = found.fit.hysteresis["x"]
        assert loop.between == ("down-15", "up-15")
        assert loop.difference == pytest.approx(0.8, abs=3 * 0.05 * sqrt(2))


def test_a_segment_without_a_temperature_does_not_take_the_procedures(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    cells = [(f"{x:.3f},{y:.3f}", "24.0" if k < 50 else "") for k, (x, y) in enumerate(rng.normal(1024, 0.5, (100, 2)))]
    (tmp_path / "log.csv").write_text("x,y,temperature\n" + "".join(f"{xy},{told}\n" for xy, told in cells))
    (tmp_path / "segments.csv").write_text(TestTemperaturePoint.SEGMENTS)
    result = tiltcal(
        *("fit", "two-temperature", "log.csv", "--segments", "segments.csv", "--sensor", "sca100t-d02"),
        *("--serial", "S-1", "-o", "S-1.yaml"),
        cwd=tmp_path,
    )
    assert result.returncode == 2
    assert "segments.csv:3: segment level-cold: there is no temperature in its rows" in result.stderr

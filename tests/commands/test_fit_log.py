"""``tiltcal fit`` of a recorded log by its segments: times, coarse readings, stuck channels, temperatures, remarks."""

from collections.abc import Mapping
from math import cos, radians, sin, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from scipy.spatial.transform import Rotation
from support.command import Completed, tiltcal

from tiltcal.files.calibration import CalibrationRecord, read_calibration

NOON = 1777636800  # date -u -d 2026-05-01T12:00:00Z +%s
SCA100T = ("--sensor", "sca100t-d02")
PLANE = {"x-tilt1": (30, 0), "x-tilt2": (-30, 0), "y-tilt1": (0, 30), "y-tilt2": (0, -30)}


def fitted(
    folder: Path,
    procedure: str,
    columns: Mapping[str, Any],
    segments: Mapping[str, tuple[int, int]],
    *options: str,
    code: int = 0,
) -> Completed:
    """Write a log with these columns, and fit it into S-1.yaml."""
    pl.DataFrame(dict(columns)).write_csv(folder / "log.csv")
    rows = [f"{name},{start},{end}\n" for name, (start, end) in segments.items()]
    (folder / "segments.csv").write_text("position,start,end\n" + "".join(rows))
    words = ("fit", procedure, "log.csv", "--segments", "segments.csv", "--serial", "S-1", "-o", "S-1.yaml", *options)
    return tiltcal(*words, cwd=folder, code=code)


def calibrated(folder: Path, *arguments: Any) -> CalibrationRecord:
    fitted(folder, *arguments)
    return read_calibration(folder / "S-1.yaml")


def refused(folder: Path, *arguments: Any) -> str:
    said = fitted(folder, *arguments, code=2).stderr
    assert not (folder / "S-1.yaml").exists()
    return said


def spans(names: Any, rows: int) -> dict[str, tuple[int, int]]:
    """Segments of so many rows, one after the other."""
    return {name: (number * rows, (number + 1) * rows) for number, name in enumerate(names)}


def test_positions_have_the_time_of_their_last_row_where_it_has_a_date(tmp_path: Path) -> None:
    """An ideal sensor of 1 V/g in four positions of 20 rows."""
    angles = np.repeat(list(PLANE.values()), 20, axis=0)
    x, y = (np.sin(np.radians(angles)) + np.random.default_rng(3).normal(0.0, 1e-3, angles.shape)).T
    moments = [f"2026-05-01T12:{k // 60:02}:{k % 60:02}Z" for k in range(80)]
    for name, times, options in (
        ("time", moments, ()),
        ("when", [NOON + k for k in range(80)], ("--columns", "time=when")),
        *(("time", [form.format(k) for k in range(80)], ()) for form in ("{}", "after {} s", "")),
    ):
        log, dated = {name: times, "x": x, "y": y}, times[0] in (moments[0], NOON)
        found = calibrated(tmp_path, "plane", log, spans(PLANE, 20), "--unit", "V", "--jig", "0.1", *options)
        ends = [f"2026-05-01T{end}.000Z" if dated else None for end in ("12:00:19", "12:00:39", "12:00:59", "12:01:19")]
        assert [position.time for position in found.positions] == ends
        started = "2026-05-01T12:00:00.000Z" if dated else None
        assert (found.provenance.started, found.provenance.ended) == (started, ends[-1])


class TestCoarseReadings:
    """An ideal sensor of 100 count/g with odd offsets on six faces, 100 samples each."""

    FACES = ("x-up", "x-down", "y-up", "y-down", "z-up", "z-down")
    OPTIONS = ("--unit", "count", "--jig", "0")

    def readings(self, noise: float, seed: int = 4, scale: float = 100.0) -> np.ndarray:
        """Shape (faces, samples, 3)."""
        up = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)], dtype=float)
        still = np.array([7.31, -3.83, 11.27]) + scale * up
        return still[:, None, :] + np.random.default_rng(seed).normal(0.0, noise, (6, 100, 3))

    def columns(self, readings: np.ndarray) -> dict[str, Any]:
        return dict(zip("xyz", readings.reshape(-1, 3).T, strict=True))

    def of(self, folder: Path, readings: np.ndarray) -> CalibrationRecord:
        return calibrated(folder, "six-face", self.columns(readings), spans(self.FACES, 100), *self.OPTIONS)

    def test_a_converter_ten_times_coarser_than_the_noise(self, tmp_path: Path) -> None:
        """Most faces read one value in all channels: they are quantised, not stuck, and the rounding counts."""
        found = self.of(tmp_path, np.round(self.readings(noise=0.1, seed=5, scale=103.37)))
        assert 0.7 / sqrt(12) / sqrt(3) < found.uncertainty["offset.x"] < 1.1 / sqrt(12) / sqrt(3)
        assert abs(found.coefficients.offset[0] - 7.31) < 2 * found.uncertainty["offset.x"]

    def test_a_channel_that_is_stuck_in_all_faces(self, tmp_path: Path) -> None:
        data = self.readings(noise=0.5)
        data[:, :, 2] = 37.0
        said = refused(tmp_path, "six-face", self.columns(data), spans(self.FACES, 100), *self.OPTIONS)
        assert "z of S-1 does not react to gravity" in said


@pytest.mark.parametrize(
    ("wrong", "places", "said"),
    [
        (4.0, (*PLANE, "z-tilt1", "z-tilt2"), "not credible: noise, jig or thermometer are worse than stated"),
        (4.0, (*PLANE, "z-tilt1", "z-tilt2"), "the worst first: x-tilt1 ("),
        (
            0.0,
            ("x-tilt1", "x-tilt2", "y-tilt1", "z-tilt2"),
            "no degree of freedom is left: the positions fit whatever was read, and nothing checks them",
        ),
    ],
)
def test_what_is_said_against_a_record(wrong: float, places: tuple[str, ...], said: str, tmp_path: Path) -> None:
    """An ideal sensor on ``cross-axis``, with +x set wrong, or with four positions for four unknowns."""
    up = []
    for name in places:
        x, y = (radians(angle) for angle in PLANE.get(name, (0.0, 0.0)))
        x += radians(wrong) if name == "x-tilt1" else 0.0
        up.append([sin(x), sin(y), -1.0 if name == "z-tilt2" else cos(x) if x else cos(y)])
    readings = np.repeat(up, 50, axis=0) + np.random.default_rng(1).normal(0, 1e-4, (50 * len(up), 3))
    log = dict(zip("xyz", readings.T, strict=True))
    assert said in fitted(tmp_path, "cross-axis", log, spans(places, 50), "--unit", "g", "--jig", "0.05").stdout


class TestTemperaturePoint:
    """A log of ``two-temperature`` in which the second point may not have been waited for."""

    def test_ten_minutes_after_a_leg_of_1_degree_a_minute_a_late_thermometer_is_refused(self, tmp_path: Path) -> None:
        """A thermometer that is 5 min late is still 0.7 °C behind; its last minute looks still."""
        time = np.arange(0.0, 4200.0, 2.0)
        leg = np.clip(time - 900.0, 0.0, 1110.0)
        chamber = 24.0 - leg / 60.0
        behind = 5.0 * (1.0 - np.exp(-leg / 300.0)) * np.exp(-np.maximum(time - 2010.0, 0.0) / 300.0)
        draw = np.random.default_rng(3)
        log = {"time": time, "x": 1024.0 + 0.3 * (chamber - 24.0), "y": 1024.0 - 0.3 * (chamber - 24.0)}
        log = {name: column + draw.normal(0.0, 0.5 * (name != "time"), len(time)) for name, column in log.items()}
        log["temperature"] = chamber + behind + draw.normal(0.0, 0.02, len(time))
        for end in (2610, 4200):  # 10 min and 36 min after the leg
            segments = {"level-warm": (400, 440), "level-cold": ((end - 60) // 2, end // 2)}
            result = fitted(tmp_path, "two-temperature", log, segments, *SCA100T, code=2 if end == 2610 else 0)
            assert ("segment level-cold: the temperature drifts by -" in result.stderr) is (end == 2610)


class TestMounting:
    """How a calibrated sensor of 2 V/g sits in its application."""

    BASE = (
        "tiltcal: 1\nkind: tilt\nsensor: {model: recorded, serial: S-1, unit: V, channels: [x, y, z]}\ncalibration:\n"
        "  offset: {x: 2.5, y: 2.4, z: 2.6}\n  sensitivity:\n    x: {x: 2.0, y: 0.0, z: 0.0}\n"
        "    y: {x: 0.0, y: 2.0, z: 0.0}\n    z: {x: 0.0, y: 0.0, z: 2.0}\nuncertainty: {}\n"
    )
    UP = np.array([[0, 0, 1], [0.5, 0, 0.75**0.5], [-0.5, 0, 0.75**0.5], [0, 0.5, 0.75**0.5], [0, -0.5, 0.75**0.5]])
    NAMES = ("level", "x-up", "x-down", "y-up", "y-down")

    def arguments(self, folder: Path, names: tuple[str, ...], rotation: Rotation, *options: str) -> tuple[Any, ...]:
        """A log of the sensor in these positions; a' = Rz(-yaw) Ry(-pitch) Rx(-roll) a leads to the application."""
        (folder / "base.yaml").write_text(self.BASE)
        seen = np.repeat(rotation.inv().apply(self.UP[: len(names)]), 20, axis=0)
        readings = np.array([2.5, 2.4, 2.6]) + 2.0 * seen + np.random.default_rng(3).normal(0.0, 1e-4, seen.shape)
        return "mounting", dict(zip("xyz", readings.T, strict=True)), spans(names, 20), *options

    def test_positions_that_were_exchanged_are_not_credible(self, tmp_path: Path) -> None:
        for names in (self.NAMES, ("level", "y-up", "x-down", "x-up", "y-down")):
            options = ("--base", "base.yaml", "--jig", "0.1")
            result = fitted(tmp_path, *self.arguments(tmp_path, names, Rotation.identity(), *options))
            assert ("not credible: the jig is worse than stated" in result.stdout) is (names != self.NAMES)
        assert "mounting: chi-square " in tiltcal("check", "S-1.yaml", cwd=tmp_path, code=1).stdout

    @pytest.mark.parametrize(
        ("count", "options", "said"),
        [
            (1, ("--base", "base.yaml"), "about"),
            (5, ("--unit", "V"), "mounting needs --base"),
            (5, ("--base", "base.yaml", "--unit", "count"), "--unit count contradicts the --base, which has V"),
        ],
    )
    def test_refused_with_the_reason(self, count: int, options: tuple[str, ...], said: str, tmp_path: Path) -> None:
        """One position leaves the turn about gravity undetermined."""
        arguments = self.arguments(tmp_path, self.NAMES[:count], Rotation.identity(), *options)
        assert said in refused(tmp_path, *arguments)


def test_a_nominal_sensitivity_in_another_unit_stands_in_for_nothing(tmp_path: Path) -> None:
    log = {"x": [2.5, 2.51] * 20, "y": [2.4, 2.41] * 20}
    segments = spans(("level-warm", "level-cold"), 20)
    said = refused(tmp_path, "two-temperature", log, segments, *SCA100T, "--unit", "V")
    assert "nominal sensitivity of sca100t-d02, which is per g in count and not in V" in said

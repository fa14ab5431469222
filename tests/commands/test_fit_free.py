"""``tiltcal fit free``: recorded logs of sensors that were held still by hand, and unit gravity alone.

Published values are those of the recordings' own projects, imu_tk and imu-calib.
"""

from collections.abc import Sequence
from math import acos, degrees, hypot
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from support.command import tiltcal
from support.recordings import recording

from tiltcal.core.model import values
from tiltcal.files.calibration import CalibrationRecord, read_calibration
from tiltcal.files.results import PositionRecord

XSENS, MPU = recording("xsens_acc.txt"), recording("mpu9150_imu0.txt")


def fitted(folder: Path, log: Path, *options: str | Path) -> tuple[CalibrationRecord, str, str]:
    """Return the file that a fit wrote, what was printed, and what was said."""
    result = tiltcal("fit", "free", log, *options, "--serial", "S-1", "-o", "cal.yaml", cwd=folder, code=0)
    return read_calibration(folder / "cal.yaml"), result.stdout, result.stderr


def test_the_xsens_mti_as_published(tmp_path: Path) -> None:
    """Blanks between columns, no header, counts; scales within 0.02 %, offsets within twice their uncertainty.

    The rows in the file give the same again as segments.
    """
    options = ("--columns", "x=2,y=3,z=4", "--unit", "count", "--gravity", "9.81744")
    found, _, said = fitted(tmp_path, XSENS, *options)
    scales = found.derived.sensitivity_per_m_s2
    assert [scales[axis] for axis in "xyz"] == pytest.approx([414.41, 412.05, 414.61], rel=2e-4)
    published, u = (33123.8, 33275.2, 32364.5), (0.24, 0.14, 0.15)
    for offset, value, uncertainty in zip(found.coefficients.offset, published, u, strict=True):
        assert abs(offset - value) < 2 * uncertainty
    count = len(found.positions)
    assert 36 <= count <= 44
    assert "times the noise of the stillest part" in said
    assert f"in {count} attitudes" in said
    assert found.provenance.segments.threshold > 0
    assert found.coefficients.mounting is None
    assert [found.coefficients.sensitivity[place] for place in ((1, 0), (2, 0), (2, 1))] == [0.0, 0.0, 0.0]
    rows = ((one.position, *span) for one in found.positions for span in _spans(one.rows))
    lines = ["position,start,end", *(",".join(map(str, row)) for row in rows)]
    (tmp_path / "still.csv").write_text("\n".join(lines) + "\n")
    again, _, _ = fitted(tmp_path, XSENS, *options, "--segments", "still.csv")
    assert again.coefficients.offset.tolist() == found.coefficients.offset.tolist()
    assert again.positions == found.positions


def _spans(rows: Any) -> Sequence[tuple[int, int]]:
    return rows if isinstance(rows[0], tuple) else [rows]


def test_the_mpu_9150_as_published(tmp_path: Path) -> None:
    """The record in which a strict threshold leaves nine attitudes; offsets have half of the last digit more."""
    found, _, _ = fitted(tmp_path, MPU, "--columns", "x=1,y=2,z=3", "--unit", "m/s2", "--gravity", "9.81")
    assert [found.derived.scale_error_percent[axis] for axis in "xyz"] == pytest.approx([0.363, 0.315, 0.647], abs=0.02)
    for axis, published in {"x": 0.103, "y": 0.097, "z": 0.344}.items():
        offset = found.coefficients.offset["xyz".index(axis)]
        assert abs(offset - published) < 2 * found.uncertainty[f"offset.{axis}"] + 0.0005


# ------------------------------------------------------------------------------------------- without recorded data

OFFSET = (0.3, -0.2, 0.1)
ROWS = ((9.9, 0.05, -0.08), (0.0, 9.7, 0.12), (0.0, 0.0, 10.1))
UP = [
    *((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)),
    *((0.6, 0.8, 0), (0, 0.6, 0.8), (0.8, 0, 0.6)),
    *((-0.6, 0.8, 0), (0.6, -0.8, 0), (0, -0.6, 0.8), (0, 0.6, -0.8), (-0.8, 0, 0.6)),
]


def reading(up: tuple[float, ...]) -> list[float]:
    """By hand: offset and sensitivity."""
    return [offset + sum(s * g for s, g in zip(row, up, strict=True)) for offset, row in zip(OFFSET, ROWS, strict=True)]


def test_a_table_of_means_in_free_positions(tmp_path: Path) -> None:
    rows = [f"p{k},{','.join(f'{value:.9f}' for value in reading(up))},0.001,0.001,0.001" for k, up in enumerate(UP)]
    for count in (9, 14):
        (tmp_path / "means.csv").write_text("\n".join(["position,x,y,z,ux,uy,uz", *rows[:count], ""]))
        means = tmp_path / "means.csv"
        found, printed, said = fitted(tmp_path, means, "--table", "--unit", "m/s2", "--gravity", "9.81")
        assert (found.fit.degrees_of_freedom == 0) is (count == 9)
        few = (
            "9 different attitudes for 9 unknowns: zero degrees of freedom are left to show whether the result is "
            "right; add attitudes, 12 to 18 or more"
        )
        assert found.fit.warning == (few if count == 9 else None)
        assert (f"warning: {few[:40]}" in said) is (count == 9)
    assert [found.derived.scale_error_percent[axis] for axis in "xyz"] == pytest.approx(
        [100.0 * (row[k] / 9.81 - 1.0) for k, row in enumerate(ROWS)], abs=0.006
    )
    assert found.coefficients.offset == pytest.approx(OFFSET, abs=1e-6)
    assert found.coefficients.sensitivity.ravel() == pytest.approx([s for row in ROWS for s in row], abs=1e-6)
    assert "14 positions, 14 different attitudes" in printed
    own, lengths = found.derived.intrinsic, [hypot(*row) for row in ROWS]
    assert [own.sensitivity[axis] for axis in "xyz"] == pytest.approx(lengths, abs=1e-6)
    # Between channels x and y: the product of their rows by hand, 0.05 * 9.7 - 0.08 * 0.12.
    cosine = (0.485 - 0.0096) / (lengths[0] * lengths[1])
    assert own.angle_degrees["xy"] == pytest.approx(degrees(acos(cosine)), abs=1e-4)
    assert found.provenance.table.name == "means.csv"
    mean, u = dict(zip("xyz", (10.2, -0.2, 0.1), strict=True)), dict.fromkeys("xyz", 0.001)
    assert found.positions[0] == PositionRecord(position="p0", mean=mean, u=u, n=1, line=2)


class TestWarm:
    """Sensors that drift by about 1 mg/°C while they are held in attitudes, from 12.5 to 27.5 °C; readings in mg."""

    SENSITIVITY = np.array([[1010.0, 8.0, -5.0], [0.0, 985.0, 12.0], [0.0, 0.0, 1002.0]])
    OFFSET, DRIFT = np.array([25.0, -40.0, 15.0]), np.array([1.0, -0.8, 0.6])  # at 20 °C
    LEVEL = np.array([0.0, 0.0, 1.0])

    def write(self, file: Path, up: NDArray[np.float64], warmth: NDArray[np.float64]) -> None:
        drawn = np.random.default_rng(len(up)).normal(0.0, 0.5, up.shape)
        read = self.OFFSET + up @ self.SENSITIVITY.T + (warmth - 20.0)[:, None] * self.DRIFT + drawn
        table = np.column_stack([2.0 * np.arange(len(up)), read, warmth])
        np.savetxt(file, table, "%.3f", ",", header="time,x,y,z,temperature", comments="")

    def held(self, file: Path, attitudes: int) -> None:
        rng = np.random.default_rng(attitudes)
        each = Rotation.random(attitudes, random_state=4).as_matrix()[:, :, 2]
        moving = [np.vstack([rng.normal(0.0, 0.5, (10, 3)), np.tile(one, (60, 1))]) for one in each]
        self.write(file, np.vstack(moving), np.linspace(12.5, 27.5, 70 * attitudes))

    def test_the_drift_is_determined_and_a_ramp_joins_it(self, tmp_path: Path) -> None:
        self.held(tmp_path / "held.csv", 16)
        free, _, _ = fitted(tmp_path, tmp_path / "held.csv", "--unit", "mg")
        self.require_true(free)
        warmth = 20.0 - 7.5 * np.cos(np.linspace(0.0, 2.0 * np.pi, 1800))
        self.write(tmp_path / "ramp.csv", np.tile(self.LEVEL, (1800, 1)), warmth)
        for words in (
            ("fit", "ramp", "ramp.csv", "--base", "cal.yaml", "--serial", "S-1", "-o", "ramp.yaml"),
            ("combine", "cal.yaml", "ramp.yaml", "-o", "both.yaml"),
        ):
            assert (result := tiltcal(*words, cwd=tmp_path)).returncode == 0, result.stderr
        both = read_calibration(tmp_path / "both.yaml")
        self.require_true(both)

    def require_true(self, found: CalibrationRecord) -> None:
        at = found.coefficients.thermal.reference
        for k, axis in enumerate("xyz"):
            truth = {f"offset.{axis}": self.OFFSET[k] + self.DRIFT[k] * (at - 20.0)}
            truth |= {f"sensitivity.{axis}.{'xyz'[j]}": self.SENSITIVITY[k, j] for j in range(k, 3)}
            truth |= {f"temperature.offset.{axis}.1": self.DRIFT[k]}
            for name, value in truth.items():
                # Of twenty, one is beyond 1.
                limit = 1.5 * found.uncertainty[name] * found.uncertainty.coverage_factor[name]
                assert abs(values(found.coefficients)[name] - value) < limit, name

    def test_eleven_attitudes_are_too_few(self, tmp_path: Path) -> None:
        self.held(tmp_path / "log.csv", 11)
        words = ("fit", "free", "log.csv", "--unit", "mg", "--serial", "S-1", "-o", "cal.yaml")
        said = tiltcal(*words, cwd=tmp_path, code=2).stderr
        assert "11 free positions for 12 unknowns, three of them drifts because the temperature changes" in said


def test_consecutive_segments_of_one_name_are_one_placement(tmp_path: Path) -> None:
    log = ["x,y,z"]
    segments = ["position,start,end"]
    for number, up in enumerate([*UP, UP[0]]):
        first, second = reading(up), [value + 0.002 for value in reading(up)]
        log += [",".join(map(str, one)) for one in (first, second) for _ in range(5)]
        name = "p0" if up == UP[0] else f"p{number}"
        segments += [f"{name},{10 * number},{10 * number + 4}", f"{name},{10 * number + 4},{10 * number + 10}"]
    (tmp_path / "log.csv").write_text("\n".join([*log, ""]))
    (tmp_path / "seg.csv").write_text("\n".join([*segments, ""]))
    found, _, _ = fitted(tmp_path, tmp_path / "log.csv", "--segments", "seg.csv", "--unit", "m/s2")
    assert len(found.positions) == 15
    assert (found.positions[0].rows, found.positions[0].n) == (((0, 4), (4, 10)), 10)
    assert [one.position for one in (found.positions[0], found.positions[-1])] == ["p0", "p0 (2)"]

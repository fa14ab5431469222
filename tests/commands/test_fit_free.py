"""``tiltcal fit free``: recorded logs of sensors that were held still by hand, and unit gravity alone.

Published values are those of the recordings' own projects, imu_tk and imu-calib.
"""

from collections.abc import Sequence
from dataclasses import dataclass
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


@dataclass(frozen=True)
class Fit:
    """What came out of a fit: the file, what was printed, what was said, and where."""

    calibration: CalibrationRecord
    printed: str
    said: str
    folder: Path


def fitted(folder: Path, log: Path, *options: str | Path) -> Fit:
    result = tiltcal("fit", "free", log, *options, "--serial", "S-1", "-o", "cal.yaml", cwd=folder, code=0)
    return Fit(read_calibration(folder / "cal.yaml"), result.stdout, result.stderr, folder)


XSENS_OPTIONS = ("--columns", "x=2,y=3,z=4", "--unit", "count", "--gravity", "9.81744")
MPU_OPTIONS = ("--columns", "x=1,y=2,z=3", "--unit", "m/s2", "--gravity", "9.81")


@pytest.fixture(scope="module")
def xsens(tmp_path_factory: pytest.TempPathFactory) -> Fit:
    return fitted(tmp_path_factory.mktemp("xsens"), XSENS, *XSENS_OPTIONS)


class TestXsens:
    """The Xsens MTi: blanks between columns, no header, counts; g there is 9.81744 m/s²."""

    def test_the_published_scales_and_offsets(self, xsens: Fit) -> None:
        """Scales within 0.02 %, offsets within twice their uncertainty."""
        scales = xsens.calibration.derived.sensitivity_per_m_s2
        assert [scales[axis] for axis in "xyz"] == pytest.approx([414.41, 412.05, 414.61], rel=2e-4)
        published, u = (33123.8, 33275.2, 32364.5), (0.24, 0.14, 0.15)
        for found, value, uncertainty in zip(xsens.calibration.coefficients.offset, published, u, strict=True):
            assert abs(found - value) < 2 * uncertainty

    def test_about_40_attitudes_are_found_and_shown(self, xsens: Fit) -> None:
        calibration, said = xsens.calibration, xsens.said
        assert 36 <= len(calibration.positions) <= 44
        assert f"{len(calibration.positions)} positions" in xsens.printed
        assert "times the noise of the stillest part" in said
        assert f"in {len(calibration.positions)} attitudes" in said
        assert calibration.provenance.segments.threshold > 0

    def test_the_mounting_is_said_to_be_undetermined(self, xsens: Fit) -> None:
        calibration = xsens.calibration
        assert calibration.coefficients.mounting is None
        assert calibration.derived.mounting.startswith("undetermined")
        assert xsens.printed.count("mounting") == 1
        assert "mounting undetermined: gravity alone does not show how the sensor sits" in xsens.printed
        below = [calibration.coefficients.sensitivity[place] for place in ((1, 0), (2, 0), (2, 1))]
        assert below == [0.0, 0.0, 0.0]

    def test_the_rows_in_the_file_give_the_same_again_as_segments(self, xsens: Fit, tmp_path: Path) -> None:
        rows = ((one.position, *span) for one in xsens.calibration.positions for span in _spans(one.rows))
        lines = ["position,start,end", *(",".join(map(str, row)) for row in rows)]
        (tmp_path / "still.csv").write_text("\n".join(lines) + "\n")
        again = fitted(tmp_path, XSENS, *XSENS_OPTIONS, "--segments", "still.csv").calibration
        assert again.coefficients.offset.tolist() == xsens.calibration.coefficients.offset.tolist()
        assert again.positions == xsens.calibration.positions


def _spans(rows: Any) -> Sequence[tuple[int, int]]:
    return rows if isinstance(rows[0], tuple) else [rows]


class TestMpu9150:
    """The MPU-9150: readings in m/s², g = 9.81; the record in which a strict threshold leaves nine attitudes."""

    def test_the_published_scale_errors_and_offsets(self, tmp_path: Path) -> None:
        """Errors within 0.02 %, offsets within twice their uncertainty and half of the last digit."""
        mpu = fitted(tmp_path, MPU, *MPU_OPTIONS)
        errors = mpu.calibration.derived.scale_error_percent
        assert [errors[axis] for axis in "xyz"] == pytest.approx([0.363, 0.315, 0.647], abs=0.02)
        for axis, published in {"x": 0.103, "y": 0.097, "z": 0.344}.items():
            found = mpu.calibration.coefficients.offset["xyz".index(axis)]
            assert abs(found - published) < 2 * mpu.calibration.uncertainty[f"offset.{axis}"] + 0.0005


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


def table(count: int, *, u: bool = True) -> str:
    header = "position,x,y,z" + (",ux,uy,uz" if u else "")
    lines = [
        ",".join([f"p{number}", *(f"{value:.9f}" for value in reading(up)), *(["0.001"] * 3 if u else [])])
        for number, up in enumerate(UP[:count])
    ]
    return "\n".join([header, *lines, ""])


class TestTable:
    OPTIONS = ("--table", "--unit", "m/s2")

    def test_a_table_of_means_in_free_positions(self, tmp_path: Path) -> None:
        (tmp_path / "means.csv").write_text(table(14))
        fit = fitted(tmp_path, tmp_path / "means.csv", *self.OPTIONS)
        found = fit.calibration
        assert found.coefficients.offset == pytest.approx(OFFSET, abs=1e-6)
        assert found.coefficients.sensitivity.ravel() == pytest.approx([s for row in ROWS for s in row], abs=1e-6)
        assert "14 positions, 14 different attitudes" in fit.printed
        own = found.derived.intrinsic
        lengths = [hypot(*row) for row in ROWS]
        assert [own.sensitivity[axis] for axis in "xyz"] == pytest.approx(lengths, abs=1e-6)
        # Between channels x and y: the product of their rows by hand, 0.05 * 9.7 - 0.08 * 0.12.
        cosine = (0.485 - 0.0096) / (lengths[0] * lengths[1])
        assert own.angle_degrees["xy"] == pytest.approx(degrees(acos(cosine)), abs=1e-4)
        assert found.provenance.table.name == "means.csv"
        assert found.positions[0] == PositionRecord(
            position="p0",
            mean=dict(zip("xyz", (10.2, -0.2, 0.1), strict=True)),
            u=dict.fromkeys("xyz", 0.001),
            n=1,
            line=2,
        )

    def test_nine_positions_for_nine_unknowns_are_warned_of(self, tmp_path: Path) -> None:
        (tmp_path / "means.csv").write_text(table(9))
        fit = fitted(tmp_path, tmp_path / "means.csv", *self.OPTIONS)
        assert fit.calibration.fit.degrees_of_freedom == 0
        assert "zero degrees of freedom" in fit.calibration.fit.warning
        assert "warning: 9 different attitudes for 9 unknowns" in fit.said


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

    @pytest.mark.parametrize("attitudes", [16, 40])
    def test_the_drift_is_determined_and_a_ramp_joins_it(self, attitudes: int, tmp_path: Path) -> None:
        self.held(tmp_path / "held.csv", attitudes)
        free = fitted(tmp_path, tmp_path / "held.csv", "--unit", "mg").calibration
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
        names = [f"temperature.offset.{axis}.1" for axis in "xyz"]
        assert all(both.uncertainty[name] < free.uncertainty[name] for name in names)

    def require_true(self, found: CalibrationRecord) -> None:
        thermal, at = found.coefficients.thermal, found.coefficients.thermal.reference
        for k, axis in enumerate("xyz"):
            truth = {f"offset.{axis}": self.OFFSET[k] + self.DRIFT[k] * (at - 20.0)}
            truth |= {f"sensitivity.{axis}.{'xyz'[j]}": self.SENSITIVITY[k, j] for j in range(k, 3)}
            truth |= {f"temperature.offset.{axis}.1": self.DRIFT[k]}
            for name, value in truth.items():
                limit = (
                    1.5 * found.uncertainty[name] * found.uncertainty.coverage_factor[name]
                )  # of twenty, one is beyond 1
                assert abs(values(found.coefficients)[name] - value) < limit, name
        for warmth in (12.5, 27.5):
            read = self.OFFSET + self.SENSITIVITY @ self.LEVEL + self.DRIFT * (warmth - 20.0)
            drift = thermal.drift @ (warmth - at) ** np.arange(1, 1 + thermal.drift.shape[1])
            found_up = np.linalg.solve(found.coefficients.sensitivity, read - found.coefficients.offset - drift)
            assert found_up == pytest.approx(self.LEVEL, abs=1e-3)

    def test_eleven_attitudes_are_too_few(self, tmp_path: Path) -> None:
        self.held(tmp_path / "log.csv", 11)
        said = refused(tmp_path, "free", "log.csv", "--unit", "mg")
        assert "11 free positions for 12 unknowns, three of them drifts because the temperature changes" in said


def refused(folder: Path, procedure: str, log: str, *options: str) -> str:
    result = tiltcal("fit", procedure, log, *options, "--serial", "S-1", "-o", "cal.yaml", cwd=folder, code=2)
    assert not (folder / "cal.yaml").exists()
    return result.stderr


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
    found = fitted(tmp_path, tmp_path / "log.csv", "--segments", "seg.csv", "--unit", "m/s2").calibration
    assert len(found.positions) == 15
    assert (found.positions[0].rows, found.positions[0].n) == (((0, 4), (4, 10)), 10)
    assert [one.position for one in (found.positions[0], found.positions[-1])] == ["p0", "p0 (2)"]

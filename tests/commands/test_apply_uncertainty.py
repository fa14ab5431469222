"""``tiltcal apply --uncertainty``: what it prints, what it refuses, and that the truth is inside."""

from __future__ import annotations

from math import cos, degrees, hypot, isnan, radians
from pathlib import Path

import pytest
from support.applied import PLAIN, apply, rows

from tiltcal.errors import InputError

ALONE = """\
uncertainty:
  offset: {x: 0.003, y: 0.003}
  sensitivity: {x: {x: 0.002, y: 0.0}, y: {x: 0.0, y: 0.002}}
"""
KNOWN = ALONE + "  single_reading: {x: 0.004, y: 0.004}\n"
LOG = "x,y\n2.5,2.5\n3.5,2.5\n"


@pytest.fixture(autouse=True)
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "log.csv").write_text(LOG)
    (tmp_path / "cal.yaml").write_text(PLAIN + KNOWN)
    return tmp_path


class TestColumns:
    def test_stand_behind_all_others(self) -> None:
        plain, found = apply("cal.yaml", "log.csv").stdout, apply("cal.yaml", "log.csv", "--uncertainty").stdout
        assert found.splitlines()[0].endswith("flag,reason,u_tilt_x,u_tilt_y,U95_tilt_x,U95_tilt_y")
        assert [line.rsplit(",", 4)[0] for line in found.splitlines()] == plain.splitlines()

    def test_are_what_the_gum_gives(self) -> None:
        """Offset 0.003, sensitivity 0.002, reading 0.004 V of 2 V/g, at level and at 30°."""
        level, tilted = rows(apply("cal.yaml", "log.csv", "--uncertainty").stdout)
        assert level["u_tilt_x"] == pytest.approx(degrees(0.005 / 2), rel=1e-3)
        expected = degrees(hypot(0.005, 0.5 * 0.002) / 2 / cos(radians(30)))
        assert tilted["u_tilt_x"] == pytest.approx(expected, rel=1e-3)
        assert tilted["U95_tilt_x"] == pytest.approx(1.96 * expected, rel=2e-3)

    def test_correlations_of_the_file_count(self) -> None:
        """Offset and sensitivity that err together by 0.003 and 0.002 cancel in part at -30°."""
        Path("joint.yaml").write_text(
            PLAIN + KNOWN + "  covariance:\n    parameters: [offset.x, sensitivity.x.x]\n"
            "    matrix: [[9.0e-6, 6.0e-6], [6.0e-6, 4.0e-6]]\n"
        )
        found = rows(apply("joint.yaml", "-", "--uncertainty", stdin="x,y\n1.5,2.5\n3.5,2.5\n").stdout)
        for row, error in zip(found, (0.003 - 0.5 * 0.002, 0.003 + 0.5 * 0.002), strict=True):
            expected = degrees(hypot(error, 0.004) / 2 / cos(radians(30)))
            assert row["u_tilt_x"] == pytest.approx(expected, rel=1e-3)

    def test_rows_without_an_angle_to_use_have_none(self) -> None:
        found = rows(apply("cal.yaml", "-", "--uncertainty", stdin="x,y\n,2.5\n4.9,2.5\n4.502,2.5\n").stdout)
        assert [int(row["flag"]) for row in found] == [9, 4, 3]
        assert [isnan(row["U95_tilt_x"]) for row in found] == [True, True, False]


class TestWhatTheFileDoesNotSay:
    def test_no_uncertainty_at_all_is_refused_with_what_to_do(self) -> None:
        for silent in (PLAIN, PLAIN + "uncertainty: {}\n"):
            Path("silent.yaml").write_text(silent)
            result = apply("silent.yaml", "log.csv", "--uncertainty", "-o", "out.csv")
            assert isinstance(result.exception, InputError)
            assert "silent.yaml" in str(result.exception)
            assert "under `uncertainty`" in str(result.exception)
            assert not Path("out.csv").exists()

    def test_what_counts_as_exact_is_named(self) -> None:
        Path("half.yaml").write_text(PLAIN + "uncertainty: {offset: {x: 0.003, y: 0.003}}\n")
        said = apply("half.yaml", "log.csv", "--uncertainty").stderr
        assert "no uncertainty is stated of sensitivity.x.x, sensitivity.x.y" in said
        assert "--reading-noise" in said

    def test_a_coefficient_that_is_not_there_is_named(self) -> None:
        Path("odd.yaml").write_text(PLAIN + "uncertainty: {covariance: {parameters: [offset.q], matrix: [[1.0]]}}\n")
        result = apply("odd.yaml", "log.csv", "--uncertainty")
        assert isinstance(result.exception, InputError)
        assert "'offset.q'" in str(result.exception)

"""``tiltcal apply`` from the command line to the last byte of its output."""

import csv
import json
from math import asin, cos, degrees, hypot, isnan, radians
from pathlib import Path

import pytest
from support.applied import PLAIN, apply, refused
from support.applied import rows as numbers

from tiltcal.errors import InputError, UsageError

WARM = (
    PLAIN
    + """\
  temperature:
    reference: 20.0
    range: [5.0, 30.0]
    offset: {x: [0.01], y: [0.0]}
    sensitivity: {x: [0.0], y: [0.0]}
"""
)
KNOWN = """\
uncertainty:
  offset: {x: 0.003, y: 0.003}
  sensitivity: {x: {x: 0.002, y: 0.0}, y: {x: 0.0, y: 0.002}}
  single_reading: {x: 0.004, y: 0.004}
"""
LOG = "time,x,y,note\n0.0,3.5,2.5,level\n0.1,2.5,1.5,\n"


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a calibration and a log."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cal.yaml").write_text(PLAIN)
    (tmp_path / "log.csv").write_text(LOG)
    return tmp_path


def rows(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(text.splitlines()))


@pytest.mark.usefixtures("bench")
class TestOutput:
    def test_the_logs_own_columns_come_first_as_they_are(self) -> None:
        result = apply("cal.yaml", "log.csv")
        assert result.exit_code == 0
        header, *lines = result.stdout.splitlines()
        assert header == "time,x,y,note,g_x,g_y,tilt_x,tilt_y,flag,reason"
        assert [line.split(",")[:4] for line in lines] == [line.split(",") for line in LOG.splitlines()[1:]]
        found = rows(result.stdout)
        assert [float(row["tilt_x"]) for row in found] == pytest.approx([30.0, 0.0], abs=1e-12)
        assert [float(row["g_y"]) for row in found] == [0.0, -0.5]
        assert [row["flag"] for row in found] == ["1", "1"]

    def test_a_stated_mounting_replaces_that_of_the_file(self) -> None:
        """Upside down by a roll of 180° y changes its sign and x keeps it; the file says what it loses."""
        Path("mounted.yaml").write_text(PLAIN + "  mounting: {yaw: 90.0}\n")
        result = apply("mounted.yaml", "log.csv", "--mounting", "roll=180")
        assert [float(row["tilt_x"]) for row in rows(result.stdout)] == pytest.approx([30.0, 0.0], abs=1e-9)
        assert [float(row["tilt_y"]) for row in rows(result.stdout)] == pytest.approx([0.0, 30.0], abs=1e-9)

    def test_columns_by_name(self) -> None:
        log = "t,VoutX,VoutY,T\n0,3.6,2.5,30\n"
        Path("warm.yaml").write_text(WARM)
        result = apply("warm.yaml", "-", "--columns", "x=VoutX, y=VoutY,temperature=T", stdin=log.encode())
        (row,) = rows(result.stdout)
        assert float(row["tilt_x"]) == pytest.approx(degrees(asin((3.6 - 0.1 - 2.5) / 2)), abs=1e-12)
        assert row["flag"] == "1"

    def test_the_worse_flag_of_a_row_stays(self) -> None:
        """x is beyond 1.02 g, and y outside the calibrated range."""
        Path("cal.yaml").write_text(PLAIN + "limits: {tilt: {x: [-90, 90], y: [-30, 30]}}\n")
        (row,) = numbers(apply("cal.yaml", "-", stdin=b"x,y\n5.0,4.0\n").stdout)
        assert (row["flag"], row["reason"]) == (4, 1 | 8)
        assert isnan(row["tilt_x"])

    def test_first_order_is_selectable(self) -> None:
        Path("cross.yaml").write_text(PLAIN.replace("y: 0.0}, y: {x: 0.0", "y: 0.04}, y: {x: -0.04"))
        log = b"x,y\n3.016,3.29\n"  # g_x = 0.25, g_y = 0.4
        full, first = (apply("cross.yaml", "-", *more, stdin=log) for more in ((), ("--first-order",)))
        assert float(rows(full.stdout)[0]["g_x"]) == pytest.approx(0.25, abs=1e-12)
        # The first order leaves S_XY S_YX / (S_XX S_YY) of g_x: 0.0004 of 0.25.
        assert float(rows(first.stdout)[0]["g_x"]) == pytest.approx(0.25 + 0.0001, abs=1e-12)


@pytest.mark.usefixtures("bench")
class TestUncertainty:
    def test_columns_stand_behind_all_others(self) -> None:
        Path("known.yaml").write_text(PLAIN + KNOWN)
        plain, found = (apply("known.yaml", "log.csv", *more).stdout for more in ((), ("--uncertainty",)))
        assert found.splitlines()[0].endswith("flag,reason,u_tilt_x,u_tilt_y,U95_tilt_x,U95_tilt_y")
        assert [line.rsplit(",", 4)[0] for line in found.splitlines()] == plain.splitlines()

    def test_columns_are_what_the_gum_gives(self) -> None:
        """Offset 0.003, sensitivity 0.002, reading 0.004 V of 2 V/g, at level and at 30°."""
        Path("known.yaml").write_text(PLAIN + KNOWN)
        level, tilted = numbers(apply("known.yaml", "-", "--uncertainty", stdin="x,y\n2.5,2.5\n3.5,2.5\n").stdout)
        assert level["u_tilt_x"] == pytest.approx(degrees(0.005 / 2), rel=1e-3)
        expected = degrees(hypot(0.005, 0.5 * 0.002) / 2 / cos(radians(30)))
        assert tilted["u_tilt_x"] == pytest.approx(expected, rel=1e-3)
        assert tilted["U95_tilt_x"] == pytest.approx(1.96 * expected, rel=2e-3)

    def test_no_uncertainty_at_all_is_refused_with_what_to_do(self) -> None:
        for silent in (PLAIN, PLAIN + "uncertainty: {}\n"):
            Path("silent.yaml").write_text(silent)
            result = apply("silent.yaml", "log.csv", "--uncertainty", "-o", "out.csv")
            assert "under `uncertainty`" in refused(result, InputError)
            assert "silent.yaml" in str(result.exception)
            assert not Path("out.csv").exists()

    def test_what_counts_as_exact_is_named(self) -> None:
        Path("half.yaml").write_text(PLAIN + "uncertainty: {offset: {x: 0.003, y: 0.003}}\n")
        said = apply("half.yaml", "log.csv", "--uncertainty").stderr
        assert "no uncertainty is stated of sensitivity.x.x, sensitivity.x.y" in said
        assert "--reading-noise" in said


@pytest.mark.usefixtures("bench")
class TestSummary:
    LOG = b"x,y\n3.5,2.5\nNaN,2.5\n4.51,2.5\noops,2.5\n"
    COUNTS = {"rows": 4, "flags": {"1": 1, "3": 1, "9": 2}, "reasons": {"1": 1, "32": 2}, "bad_rows": 1}  # noqa: RUF012

    def test_is_in_words_on_stderr(self) -> None:
        result = apply("cal.yaml", "-", "--skip-bad-rows", stdin=self.LOG)
        assert result.stderr.splitlines() == [
            "4 rows",
            "  flag 1 pass: 1",
            "  flag 3 suspect: 1",
            "  flag 9 missing: 2",
            "  reason 1 arcsine argument beyond ±1: 1",
            "  reason 32 not a number: 2",
            "  1 row could not be parsed and kept as missing",
        ]

    def test_is_json_on_stderr_where_the_rows_go_to_stdout(self) -> None:
        result = apply("cal.yaml", "-", "--skip-bad-rows", "--json", stdin=self.LOG)
        assert json.loads(result.stderr) == self.COUNTS
        assert len(rows(result.stdout)) == 4


@pytest.mark.usefixtures("bench")
class TestRefusals:
    def test_a_bad_row_leaves_no_output(self, bench: Path) -> None:
        (bench / "out.csv").write_text("the one before")
        content = LOG.encode() + b"0.2,oops,2.5,\n"
        assert refused(apply("cal.yaml", "-", stdin=content), InputError) == (
            "standard input:4: column 'x': 'oops' is no number"
        )
        (bench / "log.csv").write_bytes(content)
        assert "log.csv:4" in refused(apply("cal.yaml", "log.csv", "-o", "out.csv"), InputError)
        assert (bench / "out.csv").read_text() == "the one before"
        assert sorted(path.name for path in bench.iterdir()) == ["cal.yaml", "log.csv", "out.csv"]

    def test_a_missing_column_is_named_with_those_there_are(self) -> None:
        said = refused(apply("cal.yaml", "-", stdin=b"time,Vx,Vy\n1,2,3\n"), InputError)
        assert said == (
            "standard input:1: there is no column 'x' (did you mean 'Vx'?); the log has time, Vx, Vy. "
            "Name it with --columns x=NAME"
        )

    def test_a_result_is_not_compensated_again(self) -> None:
        once = apply("cal.yaml", "log.csv").stdout_bytes
        assert "standard input has a column 'g_x' already" in refused(apply("cal.yaml", "-", stdin=once), UsageError)

"""``tiltcal apply`` from the command line to the last byte of its output."""

from __future__ import annotations

import csv
import fcntl
import json
import os
import signal
import subprocess
import sys
import termios
import time
from math import asin, degrees
from pathlib import Path

import pytest
from support import FIXTURES
from support.applied import PLAIN, apply, refused
from support.command import TILTCAL

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
THREE = """\
tiltcal: 1
kind: tilt
sensor: {model: bench-built, serial: S-3, unit: count, channels: [x, y, z]}
calibration:
  offset: {x: 0.0, y: 0.0, z: 0.0}
  sensitivity:
    x: {x: 1000.0, y: 0.0, z: 0.0}
    y: {x: 0.0, y: 1000.0, z: 0.0}
    z: {x: 0.0, y: 0.0, z: 1000.0}
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

    def test_a_log_in_latin_1_becomes_utf_8(self, bench: Path) -> None:
        log = "time,x,y,Bemerkung °C\r\n0,3.5,2.5,über 20°\r\n".encode()
        (bench / "log.csv").write_bytes(log.decode().encode("latin-1"))
        assert apply("cal.yaml", "log.csv", "-o", "out.csv").exit_code == 0
        before, after = log.split(b"\r\n"), (bench / "out.csv").read_bytes().split(b"\r\n")
        assert [line.startswith(start) for line, start in zip(after, before, strict=True)] == [True] * 3

    def test_columns_by_name(self) -> None:
        log = "t,VoutX,VoutY,T\n0,3.6,2.5,30\n"
        Path("warm.yaml").write_text(WARM)
        result = apply("warm.yaml", "-", "--columns", "x=VoutX, y=VoutY,temperature=T", stdin=log.encode())
        (row,) = rows(result.stdout)
        assert float(row["tilt_x"]) == pytest.approx(degrees(asin((3.6 - 0.1 - 2.5) / 2)), abs=1e-12)
        assert row["flag"] == "1"

    def test_first_order_is_selectable(self) -> None:
        Path("cross.yaml").write_text(PLAIN.replace("y: 0.0}, y: {x: 0.0", "y: 0.04}, y: {x: -0.04"))
        log = b"x,y\n3.016,3.29\n"  # g_x = 0.25, g_y = 0.4
        full, first = (apply("cross.yaml", "-", *more, stdin=log) for more in ((), ("--first-order",)))
        assert float(rows(full.stdout)[0]["g_x"]) == pytest.approx(0.25, abs=1e-12)
        # The first order leaves S_XY S_YX / (S_XX S_YY) of g_x: 0.0004 of 0.25.
        assert float(rows(first.stdout)[0]["g_x"]) == pytest.approx(0.25 + 0.0001, abs=1e-12)


@pytest.mark.usefixtures("bench")
class TestFlags:
    def test_a_row_without_temperature_is_suspect(self) -> None:
        Path("warm.yaml").write_text(WARM)
        result = apply("warm.yaml", "-", stdin=b"x,y,temperature\n3.5,2.5,NA\n3.5,2.5,20\n3.5,2.5,31\n")
        assert [(row["flag"], row["reason"]) for row in rows(result.stdout)] == [("3", "16"), ("1", "0"), ("3", "2")]
        assert float(rows(result.stdout)[0]["tilt_x"]) == pytest.approx(30.0, abs=1e-12)
        assert rows(apply("warm.yaml", "-", stdin=b"x,y\n3.5,2.5\n").stdout)[0]["reason"] == "16"

    def test_the_rails_are_those_of_the_model_unless_the_file_names_them(self) -> None:
        from tiltcal.drivers import find_model

        low, high = find_model("sca100t-d02").rails
        text = PLAIN.replace("bench-built", "sca100t-d02").replace("unit: V", "unit: count").replace("2.5", "1024.0")
        text = text.replace("2.0", "819.0")
        log = f"x,y\n{high},1024\n{low},1024\n1024,1024\n".encode()
        Path("counts.yaml").write_text(text)
        Path("limited.yaml").write_text(text + "limits: {reading: {x: [0, 1024]}}\n")
        assert [int(row["reason"]) & 4 for row in rows(apply("counts.yaml", "-", stdin=log).stdout)] == [4, 4, 0]
        assert int(rows(apply("limited.yaml", "-", stdin=log).stdout)[2]["reason"]) & 4


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

    @pytest.mark.parametrize(
        ("columns", "said"),
        [
            ("x", "'x' is no pair"),
            ("x=", "is no pair"),
            ("temprature=T", "did you mean 'temperature'?"),
            ("x=a,x=b", "x is named twice"),
        ],
    )
    def test_columns_that_make_no_sense(self, columns: str, said: str) -> None:
        assert said in refused(apply("cal.yaml", "log.csv", "--columns", columns), UsageError)

    def test_a_result_is_not_compensated_again(self) -> None:
        once = apply("cal.yaml", "log.csv").stdout_bytes
        assert "standard input has a column 'g_x' already" in refused(apply("cal.yaml", "-", stdin=once), UsageError)


def test_ctrl_c_ends_the_wait_for_a_pipe_that_has_gone_quiet(tmp_path: Path) -> None:
    """More than a block of rows has been parsed by then: the engine that did so must not keep Ctrl-C to itself."""
    command = [*TILTCAL, "apply", FIXTURES / "plane.yaml", "-", "-o", "out.csv"]
    with subprocess.Popen(command, cwd=tmp_path, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        if process.stdin is None or process.stderr is None:
            raise RuntimeError("no pipes")
        process.stdin.write(b"time,x,y,temperature\n" + b"".join(b"%d,1020,1021,24\n" % n for n in range(400_000)))
        process.stdin.flush()
        deadline = time.monotonic() + 60
        while int.from_bytes(fcntl.ioctl(process.stdin, termios.FIONREAD, bytes(4)), sys.byteorder):
            assert time.monotonic() < deadline, "the rows were not read"
            time.sleep(0.0005)
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 130
        assert "interrupted" in process.stderr.read().decode()
    assert os.listdir(tmp_path) == []

"""``tiltcal match`` and ``tiltcal apply`` with a pair file, from the command line."""

import csv
import fcntl
import hashlib
import json
import os
import signal
import subprocess
import termios
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from click.testing import CliRunner, Result
from support import accelerometer_disk as disk
from support.applied import refused
from support.warm_start import WarmStart

import tiltcal
from tiltcal.cli.apply import command as apply_command
from tiltcal.cli.match import command as match_command
from tiltcal.errors import EstimateError, InputError

PAIR = ("--pair", "a1,a2", "--orthogonal", "a4")
BOTH = (*PAIR, "--pair", "a3,a4", "--orthogonal", "a1")
TAKEN = disk.record(start=40.0)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The record of the laboratory as a log."""
    return TAKEN.write(tmp_path_factory.mktemp("disk") / "disk.csv")


def match(*arguments: str | Path, stdin: bytes | None = None) -> Result:
    return CliRunner().invoke(match_command, [str(one) for one in arguments], input=stdin)


def apply(*arguments: str | Path) -> Result:
    return CliRunner().invoke(apply_command, [str(one) for one in arguments])


def as_json(result: Result) -> dict[str, object]:
    assert result.exit_code == 0, result.output
    loaded: dict[str, object] = json.loads(result.stdout)
    return loaded


def small(tmp_path: Path, name: str = "small.csv", **options: float) -> Path:
    return disk.record(seconds=80, rate=20, **options).write(tmp_path / name)  # type: ignore[arg-type]


class TestMatch:
    def test_the_laboratory_record(self, log: Path) -> None:
        for how, within, suppressed in (
            (("--phase", "theta", "--online"), 2e-4, 1e4),
            (("--phase", "theta", "--online", "--loops"), 2e-4, 1e4),
            ((), 2e-5, 5e4),  # without an encoder
            (("--phase", "theta"), 2e-5, 5e4),
        ):
            found = as_json(match(log, *PAIR, *how, "--json"))
            assert (found["p"], found["q"]) == pytest.approx(disk.truth(), abs=within), how
            assert disk.suppression(TAKEN, float(str(found["p"])), float(str(found["q"]))) > suppressed
        assert list(found) == ["p", "q", "u_p", "u_q", "suppression", "components"]
        assert set(found["suppression"]) == {"p", "pq"}  # type: ignore[call-overload]
        components = found["components"]
        assert isinstance(components, dict)
        assert list(components) == ["before", "after_p", "after_pq"]
        for stage in components.values():
            assert set(stage) == {"a1", "a2", "a4", "sum"}
            assert stage["sum"] == pytest.approx(np.add(stage["a1"], stage["a2"]), abs=1e-12)
        assert components["before"]["a1"] == pytest.approx(disk.judged(TAKEN, TAKEN.readings[:, 0]), abs=3e-5)
        both = as_json(match(log, *BOTH, "--phase", "theta", "--json"))
        assert [list(one["components"]["before"]) for one in both["pairs"]] == [  # type: ignore[attr-defined]
            ["a1", "a2", "a4", "sum"],
            ["a3", "a4", "a1", "sum"],
        ]

    def test_a_figure(self, log: Path, tmp_path: Path) -> None:
        result = match(log, *PAIR, "--phase", "theta", "--online", "--figure", tmp_path / "six.svg")
        assert result.exit_code == 0, result.output
        drawn = (tmp_path / "six.svg").read_text(encoding="utf-8")
        assert "sum after p and q" in drawn
        ElementTree.fromstring(drawn)
        for text in ("a1", "sum after p", "frequency [Hz]", "p, loops", "q, recursive", "stated uncertainty", "turns"):
            assert text in drawn
        assert "10⁻²" in drawn
        # Of the spectra alone: the course begins at zero, p and q away from its end.
        assert (max(map(abs, disk.truth())) < 0.1, drawn.count("10⁻¹")) == (True, 2)
        assert "$" not in drawn

    def test_a_stop_of_the_stage_is_told_and_survived_online(self, tmp_path: Path) -> None:
        taken = disk.record(seconds=160, rate=20)
        standing = np.repeat(1600, 900)
        rows = np.concatenate([np.arange(1600), standing, np.arange(1600, 3200)])
        path = disk.Record(np.arange(len(rows)) / 20, taken.theta[rows], taken.readings[rows]).write(tmp_path / "s.csv")
        result = match(path, *PAIR, "--phase", "theta", "--online", "--json")
        assert [line.split(": ")[1] for line in result.stderr.splitlines()] == [
            "held, the stage stands still",
            "goes on",
            "a value is missing, or the stage does not turn on",
        ]
        assert (as_json(result)["p"], as_json(result)["q"]) == pytest.approx(disk.truth(), abs=2e-4)


class TestTimes:
    """The column ``time`` as the recorder writes it, and as others do."""

    def test_what_is_no_time_is_needed_only_without_an_encoder(self, tmp_path: Path) -> None:
        path = small(tmp_path)
        header, *rows = path.read_text().splitlines()
        path.write_text("\n".join([header, *(f"noon,{row.partition(',')[2]}" for row in rows)]) + "\n")
        assert match(path, *PAIR, "--phase", "theta", "-o", tmp_path / "p.yaml").exit_code == 0
        assert tiltcal.read(tmp_path / "p.yaml").record.spin.frequency is None
        assert "no row has a time: write it in seconds, or in ISO 8601" in refused(match(path, *PAIR), EstimateError)


class TestStuckValues:
    ROWS = slice(600, 1000)

    def stuck(self, tmp_path: Path, channel: int, rows: slice = ROWS) -> Path:
        taken = disk.record(seconds=80, rate=20)
        taken.readings[rows, channel] = taken.readings[rows.start, channel]
        return taken.write(tmp_path / "stuck.csv")

    def test_are_named_and_left_out(self, tmp_path: Path) -> None:
        for how, within, channel in (
            ((), 1e-4, 0),
            (("--online",), 2e-4, 1),
            (("--online", "--loops"), 1e-3, 3),  # ten turns do not settle the loops
        ):
            result = match(self.stuck(tmp_path, channel), *PAIR, "--phase", "theta", *how, "--json")
            assert f"row 600: {disk.NAMES[channel]} is stuck at " in result.stderr
            assert "400 of 1600 rows are left out" in result.stderr
            found = as_json(result)
            assert (found["p"], found["q"]) == pytest.approx(disk.truth(), abs=within), how

    def test_a_stage_that_stands_is_not_stuck(self, tmp_path: Path) -> None:
        taken = disk.record(seconds=80, rate=20, noise=0.0)
        rows = np.concatenate([np.arange(800), np.repeat(800, 500), np.arange(800, 1600)])
        path = disk.Record(np.arange(len(rows)) / 20, taken.theta[rows], taken.readings[rows]).write(tmp_path / "s.csv")
        result = match(path, *PAIR, "--phase", "theta", "--json")
        assert result.stderr == "520 of 2100 rows are left out: a value is missing, or the stage does not turn on\n"
        assert as_json(result)["p"] == pytest.approx(disk.truth()[0], abs=1e-6)


class TestLiveStream:
    def begun(self, warm: WarmStart, *more: str | Path, log: str = "-") -> subprocess.Popen[bytes]:
        command = [*warm.program, "match", log, *PAIR, "--phase", "theta", "--online", "--json", *map(str, more)]
        return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE)

    def fed(self, process: subprocess.Popen[bytes], lines: Sequence[str]) -> None:
        """Hand over some rows, then a stage that stands, then a row that does not end, and wait until each is taken."""
        assert process.stdin is not None
        last = lines[-1].split(",")
        standing = [[*last[:2], *(f"{float(cell) + 1e-4 * number}" for cell in last[2:])] for number in range(200)]
        # Ctrl-C may come while the last piece is taken, and that is lost then.
        for piece in ("".join(lines) + "".join(",".join(row) + "\n" for row in standing), "60.0,12"):
            process.stdin.write(piece.encode())
            process.stdin.flush()
            waiting = bytearray(b"\1")
            while process.poll() is None and any(waiting):
                os.sched_yield()
                waiting = bytearray(4)
                fcntl.ioctl(process.stdin, termios.FIONREAD, waiting)

    def test_rows_count_as_they_arrive_and_ctrl_c_gives_the_result(self, warm: WarmStart, tmp_path: Path) -> None:
        lines = small(tmp_path).read_text().splitlines(keepends=True)
        process = self.begun(warm, "-o", tmp_path / "p.yaml")
        self.fed(process, lines[:1200])
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=60) == 0
        assert process.stdout is not None
        assert json.loads(process.stdout.read())["p"] == pytest.approx(disk.truth()[0], abs=2e-4)
        process.communicate()
        assert tiltcal.read(tmp_path / "p.yaml").record.provenance.log.rows == 1399

    def test_ctrl_c_before_two_turns_says_what_to_do(self, warm: WarmStart, tmp_path: Path) -> None:
        lines = small(tmp_path).read_text().splitlines(keepends=True)
        process = self.begun(warm, "-o", tmp_path / "p.yaml")
        self.fed(process, lines[:300])
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=60) == 130  # before its standard input ends, which would end it too
        said = process.communicate()[1].decode()
        assert "1.74 turns of the stage; at least 2 are needed" in said
        assert "let the stream run for longer" in said
        assert not (tmp_path / "p.yaml").exists()


class TestRefusals:
    def test_with_the_reason(self, tmp_path: Path) -> None:
        for options, said in (
            ({"spin": 0.0225}, "turns"),  # less than two
            ({"spin": 0.0}, "turn"),
            ({"spin": -0.125}, "has 0.00 turns of the stage; at least 2 are needed"),  # backwards
            ({"scale": (3.4, 0.03, 3.4, 3.4)}, "too near to 1"),
        ):
            path = small(tmp_path, **options)
            for how in ((), ("--online",)):
                result = match(path, *PAIR, "--phase", "theta", *how, "-o", tmp_path / "p.yaml")
                assert said in refused(result, EstimateError)
                assert not (tmp_path / "p.yaml").exists()
        # Eight rows of ten turns: four unknowns are solved from more than twice as many.
        few = disk.record(seconds=80, rate=20).rows(slice(0, None, 210)).write(tmp_path / "few.csv")
        assert "8 rows do not determine" in refused(match(few, *PAIR, "--phase", "theta"), EstimateError)
        # The loops have an answer once p and then q have been trimmed for some turns, of eight seconds each.
        early, later = (disk.record(seconds=s, rate=20).write(tmp_path / f"{s}.csv") for s in (40, 56))
        loops = (*PAIR, "--phase", "theta", "--online", "--loops", "--json")
        assert "the loops have not settled in 4 turns" in refused(match(early, *loops), EstimateError)
        assert as_json(match(later, *loops))["q"] == pytest.approx(disk.truth()[1], abs=1e-3)

    def test_a_channel_that_is_missing(self, tmp_path: Path) -> None:
        path = small(tmp_path)
        said = refused(match(path, "--pair", "a1,a2", "--orthogonal", "a5", "--phase", "theta"), InputError)
        assert "there is no column 'a5'; the log has time, theta, a1, a2, a3, a4" in said
        assert "Name it with --pairs NAME" in said
        said = refused(match(path, *PAIR, "--phase", "angle"), InputError)
        assert "Name it with --phase NAME" in said


def test_the_file_keeps_the_checksum_of_what_was_read(tmp_path: Path) -> None:
    path = small(tmp_path)
    wanted = hashlib.sha256(path.read_bytes()).hexdigest()
    for log, stdin in ((path, None), ("-", path.read_bytes())):
        match(log, *PAIR, "--phase", "theta", "-o", tmp_path / "p.yaml", stdin=stdin)
        assert tiltcal.read(tmp_path / "p.yaml").record.provenance.log.sha256 == wanted


GRADIENT = (2e-3, 1.5e-3)


class TestApply:
    def test_adds_the_matched_sum_of_the_definition(self, log: Path, tmp_path: Path) -> None:
        assert match(log, *PAIR, "--phase", "theta", "-o", tmp_path / "p.yaml").exit_code == 0
        known = tiltcal.read(tmp_path / "p.yaml").record.matchings[0]
        rows = list(csv.DictReader(apply(tmp_path / "p.yaml", log).stdout.splitlines()))
        assert list(rows[0]) == ["time", "theta", "a1", "a2", "a3", "a4", "matched_a1_a2", "flag", "reason"]
        a1, a2, _, a4 = TAKEN.readings.T
        expected = a1 + (a2 + known.q * a4) / (1 - known.p)
        assert [float(row["matched_a1_a2"]) for row in rows] == pytest.approx(expected, abs=1e-9)
        assert {row["flag"] for row in rows} == {"1"}

    def test_a_planted_gradient_survives_within_a_thousandth(self, tmp_path: Path) -> None:
        """Eq. 2 with the scale of a1, by an independent regression of the column ``gradient``."""
        taken = disk.record(gradient=GRADIENT, start=10.0, noise=3e-5)
        path = taken.write(tmp_path / "disk.csv")
        assert match(path, *BOTH, "--phase", "theta", "-o", tmp_path / "both.yaml").exit_code == 0
        rows = list(csv.DictReader(apply(tmp_path / "both.yaml", path).stdout.splitlines()))
        found = np.array([float(row["gradient"]) for row in rows])
        expected = (2 * 3.383 * GRADIENT[0], 4 * 3.383 * GRADIENT[1])
        # The wander multiplies the common acceleration alone; what is left of it at twice the turning is far smaller.
        assert disk.judged(taken, found, harmonic=2) == pytest.approx(expected, abs=1e-3 * np.hypot(*expected))
        by_turn = np.array([[float(row[f"gradient_{part}"] or "nan") for part in ("sin", "cos")] for row in rows])
        begun = int(np.argmax(np.isfinite(by_turn[:, 0])))
        assert 1 <= np.count_nonzero(np.diff(np.unwrap(taken.theta[: begun + 1], period=360.0) // 360.0)) <= 2
        assert np.isfinite(by_turn[begun:]).all()
        assert by_turn[begun:].mean(axis=0) == pytest.approx(expected, abs=2e-3 * np.hypot(*expected))
        alone = np.unique(by_turn[begun:], axis=0)
        assert np.abs(alone - expected).max() < 0.05 * np.hypot(*expected)

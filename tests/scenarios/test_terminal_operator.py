"""A person at a real terminal (a pty): prompts, live reading, keys."""

from pathlib import Path

import pexpect
import pytest
from support.command import TILTCAL, measure, tiltcal
from support.warm_start import WarmStart

from tiltcal.files.calibration import read_calibration


def start(program: list[str], folder: Path, *options: str, procedure: str = "zero-45") -> pexpect.spawn:
    command, *arguments = [
        *(*program, "measure", procedure, "--sensor", "sca100t-d02", "--address", "sim:?seed=1"),
        *("--serial", "S-1", "-o", "S-1.yaml", "--samples", "20", *options),
    ]
    return pexpect.spawn(command, arguments, cwd=str(folder), encoding="utf-8", timeout=20, dimensions=(40, 120))


def accept(terminal: pexpect.spawn, position: str) -> None:
    terminal.expect(position)
    terminal.expect("live")
    terminal.send("\r")
    terminal.expect("Enter.* accept")
    terminal.send("\r")
    terminal.expect("accepted")


def test_the_whole_way(tmp_path: Path) -> None:
    terminal = start(TILTCAL, tmp_path)
    for position in ("1/3  level", "2/3  x-45", "3/3  y-45"):
        accept(terminal, position)
    terminal.expect(r"Write S-1\.yaml\?")
    assert not (tmp_path / "S-1.yaml").exists()
    terminal.send("\r")
    terminal.expect(r"wrote.* S-1\.yaml")
    terminal.expect(pexpect.EOF)
    terminal.close()
    assert terminal.exitstatus == 0
    read_calibration(tmp_path / "S-1.yaml")
    # Live readings that were shown while it waited are in the journal, and replay.
    replayed = tiltcal("replay", "S-1.journal.jsonl", "--golden", "S-1.yaml", cwd=tmp_path)
    assert replayed.returncode == 0, replayed.stderr


def test_the_angle_actually_set_the_temperature_and_a_redo(warm: WarmStart, tmp_path: Path) -> None:
    terminal = start(warm.program, tmp_path)
    accept(terminal, "level")
    terminal.expect("x-45")
    terminal.expect("live")
    terminal.send("a")
    terminal.expect("tilt of x actually set")
    terminal.sendline("lots")
    terminal.expect("is not accepted")
    terminal.sendline("44,9°")
    terminal.expect("live")
    terminal.send("t")
    terminal.expect("temperature")
    terminal.sendline("21.5")
    terminal.expect("live")
    terminal.send("\r")
    terminal.expect("21.5")
    terminal.expect("Enter.* accept")
    terminal.send("r")
    accept(terminal, "2/3  x-45")
    accept(terminal, "y-45")
    terminal.expect("Write")
    terminal.send("y")
    terminal.expect(pexpect.EOF)
    terminal.close()
    assert terminal.exitstatus == 0


@pytest.mark.parametrize("how", ["q", "Ctrl-C"])
def test_stop_and_keep(how: str, warm: WarmStart, tmp_path: Path) -> None:
    terminal = start(warm.program, tmp_path)
    accept(terminal, "level")
    terminal.expect("x-45")
    terminal.expect("live")
    if how == "q":
        terminal.send("q")
    else:
        terminal.sendintr()
        terminal.expect(r"\x1b\[2Ktiltcal: interrupted")  # not behind the live reading
    terminal.expect(r"--resume S-1\.journal\.jsonl")
    terminal.expect(pexpect.EOF)
    terminal.close()
    assert terminal.exitstatus == 130
    assert not (tmp_path / "S-1.yaml").exists()
    command, *arguments = [*warm.program, "measure", "--resume", "S-1.journal.jsonl"]
    resumed = pexpect.spawn(command, arguments, cwd=str(tmp_path), encoding="utf-8", timeout=20)
    resumed.expect("kept from before: level")
    accept(resumed, "2/3  x-45")
    resumed.close(force=True)


def test_input_that_ends_is_a_stop(tmp_path: Path) -> None:
    result = measure("--operator", "terminal", "--plain", cwd=tmp_path, procedure="zero-45", said="\n\n")
    assert result.returncode == 130
    assert "--resume" in result.stderr


@pytest.mark.parametrize("key", ["b", "r"])
def test_back_and_redo_at_the_prompt(key: str, tmp_path: Path) -> None:
    said = f"\n\n{key}\n" + "\n" * 7
    result = measure("--operator", "terminal", "--plain", cwd=tmp_path, procedure="zero-45", said=said)
    assert result.returncode in (0, 130), result.stderr
    asked = [line.split()[1] for line in result.stderr.splitlines() if line[:3] in ("1/3", "2/3", "3/3")]
    assert asked[:3] == (["level", "x-45", "level"] if key == "b" else ["level", "x-45", "x-45"])


def test_not_written_when_the_operator_says_no(tmp_path: Path) -> None:
    result = measure("--operator", "terminal", "--plain", cwd=tmp_path, procedure="zero-45", said="\n" * 6 + "n\n")
    assert result.returncode == 130
    assert "not written: the operator declined" in result.stderr
    assert not (tmp_path / "S-1.yaml").exists()


def test_the_time_that_remains_is_that_of_the_windows(tmp_path: Path) -> None:
    """Two temperatures at a thermometer that may be 360 s late, and twice 100 samples at 100 a second: 722 s."""
    result = measure("--operator", "terminal", "--plain", cwd=tmp_path, procedure="two-temperature", said="q\n")
    assert "1/2  level-warm   at least 13 min left" in result.stderr

"""Journals of ``measure`` and ``verify`` are told apart; a command that cannot go on with one leaves it as it is."""

import json
import shutil
from pathlib import Path
from typing import NoReturn

import pytest
from support import FIXTURES
from support.command import measure, tiltcal

from tiltcal.errors import BusError

READY = '{"answer": "ready"}\n'


@pytest.fixture(scope="module")
def sessions(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """S-1.yaml, a finished and an interrupted verification of it, and an interrupted measurement."""
    folder = tmp_path_factory.mktemp("sessions")
    measure("--samples", "3", cwd=folder, code=0)
    verify = ("verify", "S-1.yaml", "--address", "sim:?seed=1", "--samples", "3")
    tiltcal(*verify, "--operator", "sim", "--journal", "v.jsonl", cwd=folder, code=0)
    tiltcal(*verify, "--operator", "json", "--journal", "v-stopped.jsonl", cwd=folder, said=READY * 2, code=130)
    measure("--operator", "json", "-o", "S-2.yaml", "--journal", "m-stopped.jsonl", cwd=folder, said=READY, code=130)
    text = (folder / "S-1.yaml").read_text()
    (folder / "S-9.yaml").write_text(text.replace("serial: S-1", "serial: S-9"))
    shutil.copy(FIXTURES / "rotation.journal.jsonl", folder / "rotation.jsonl")
    return folder


def unplugged(*_: object) -> NoReturn:
    raise BusError("no device")


def replayed_verdict(folder: Path, journal: str) -> dict:
    done = tiltcal("verify", "S-1.yaml", "--resume", journal, "--operator", "sim", "--json", cwd=folder, code=0)
    return json.loads(done.stdout)


def test_a_finished_verification_is_replayed(sessions: Path) -> None:
    done = tiltcal("replay", "v.jsonl", "--samples", "v.csv", cwd=sessions, code=0)
    assert done.stdout == "", done.stderr
    assert "tiltcal verify CAL --resume v.jsonl" in done.stderr
    assert len((sessions / "v.csv").read_text().splitlines()) > 6 * 3
    assert replayed_verdict(sessions, "v.jsonl")["passed"] is True
    refused = tiltcal("replay", "v.jsonl", "-o", "v.yaml", cwd=sessions, code=2)
    assert "a verification, which makes no calibration file" in refused.stderr


def test_an_interrupted_verification_is_named(sessions: Path) -> None:
    for command, code in (("check", 1), ("replay", 2)):
        done = tiltcal(command, "v-stopped.jsonl", cwd=sessions)
        assert "continue it with: tiltcal verify CAL --resume v-stopped.jsonl" in done.stdout + done.stderr
        assert done.returncode == code


@pytest.mark.parametrize(
    ("command", "journal"), [("measure", "m-stopped.jsonl"), ("verify S-1.yaml", "v-stopped.jsonl")]
)
def test_a_sensor_that_is_still_unplugged(
    sessions: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str, journal: str
) -> None:
    """It is told before the first prompt, and how to go on as in the first session; the journal stays as it was."""
    for name in ("S-1.yaml", journal):
        shutil.copy(sessions / name, tmp_path)
    before = (tmp_path / journal).read_bytes()
    monkeypatch.setattr("tiltcal.bench.devices.open_device", unplugged)
    go_on = (*command.split(), "--resume", journal)
    done = tiltcal(*go_on, "--operator", "json", cwd=tmp_path, code=3)
    assert done.stdout == ""
    kept = f"everything measured is kept; continue with: tiltcal {' '.join(go_on)}"
    assert done.stderr.splitlines()[-1] == f"tiltcal: no device; {kept}"
    assert (tmp_path / journal).read_bytes() == before


def test_another_session_is_refused_and_left_alone(sessions: Path, tmp_path: Path) -> None:
    shutil.copytree(sessions, tmp_path, dirs_exist_ok=True)
    for journal, arguments, says in (
        ("v-stopped.jsonl", ["measure"], "of a verification; continue it with: tiltcal verify CAL --resume"),
        ("m-stopped.jsonl", ["verify", "S-1.yaml"], "of a measurement; continue it with: tiltcal measure --resume"),
        ("v-stopped.jsonl", ["verify", "S-9.yaml"], "of sca100t-d02 S-1, and S-9.yaml of sca100t-d02 S-9"),
        ("rotation.jsonl", ["verify", "S-1.yaml"], "of a measurement"),
    ):
        before = (tmp_path / journal).read_bytes()
        done = tiltcal(*arguments, "--resume", journal, "--operator", "sim", cwd=tmp_path)
        assert (done.returncode, done.stdout, says in done.stderr) == (2, "", True), done.stderr
        assert (tmp_path / journal).read_bytes() == before
    assert replayed_verdict(tmp_path, "v-stopped.jsonl")["passed"] is True


def test_a_journal_with_its_end_needs_no_sensor(
    sessions: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The file is made again at a desk: no device is asked, and the journal may be write-protected."""
    shutil.copy(sessions / "S-1.journal.jsonl", tmp_path)
    monkeypatch.setattr("tiltcal.bench.devices.open_device", unplugged)
    tiltcal("measure", "--resume", "S-1.journal.jsonl", "--operator", "sim", cwd=tmp_path, code=0)
    assert (tmp_path / "S-1.yaml").read_bytes() == (sessions / "S-1.yaml").read_bytes()
    assert replayed_verdict(sessions, "v.jsonl")["passed"] is True


@pytest.mark.parametrize("content", ["dear friend\n", "serial: S-9"])
def test_a_journal_replaces_no_file_of_a_stranger(sessions: Path, tmp_path: Path, content: str) -> None:
    """Neither a letter nor the calibration of another sensor, be it named by the journal or by the user."""
    shutil.copytree(sessions, tmp_path, dirs_exist_ok=True)
    own = (tmp_path / "S-1.yaml").read_text()
    strange = own.replace("serial: S-1", content) if content.startswith("serial") else content
    (tmp_path / "S-1.yaml").write_text(strange)
    (tmp_path / "S-2.yaml").write_text(strange)
    for command in (
        ("measure", "--resume", "m-stopped.jsonl", "--operator", "sim"),
        ("measure", "--resume", "m-stopped.jsonl", "--operator", "sim", "-o", "S-1.yaml"),
        ("measure", "--resume", "S-1.journal.jsonl", "--operator", "sim"),
        ("replay", "S-1.journal.jsonl", "-o", "S-1.yaml"),
        ("replay", "rotation.jsonl", "-o", "S-1.yaml"),
    ):
        assert "the file there is " in tiltcal(*command, cwd=tmp_path, code=2).stderr
    assert (tmp_path / "S-1.yaml").read_text() == (tmp_path / "S-2.yaml").read_text() == strange


def test_several_journals_are_replayed_and_compared_with_a_folder(sessions: Path, tmp_path: Path) -> None:
    """A verification gives no file; a file that no journal gives is a difference, and so is one that is not there."""
    for name in ("S-1.yaml", "S-1.journal.jsonl"):
        shutil.copy(sessions / name, tmp_path)
    shutil.copy(sessions / "v.jsonl", tmp_path / "v.journal.jsonl")
    for more in ((), ("--golden", ".")):
        done = tiltcal("replay", ".", *more, cwd=tmp_path, code=0)
        compared = ", no calibration files differ from those in ." if more else ""
        assert (done.stdout, done.stderr) == (f"2 journals are replayed{compared}\n", "")
    assert tiltcal("replay", "S-1.journal.jsonl", cwd=tmp_path, code=0).stdout == (tmp_path / "S-1.yaml").read_text()
    (tmp_path / "S-1.yaml").rename(tmp_path / "S-2.yaml")
    (tmp_path / "notes.yaml").write_text("tiltcal: 1\nkind: bench\nsensors: []\n")
    done = tiltcal("replay", "S-1.journal.jsonl", "v.journal.jsonl", "--golden", ".", cwd=tmp_path, code=1)
    assert done.stdout == "2 journals are replayed, 2 calibration files differ from those in .\n"
    assert done.stderr == (
        "S-1.journal.jsonl does not give S-1.yaml: there is no such file\nno journal gives S-2.yaml\n"
    )
    (tmp_path / "torn.journal.jsonl").write_bytes((sessions / "S-1.journal.jsonl").read_bytes()[:5000])
    done = tiltcal("replay", ".", "--golden", ".", cwd=tmp_path, code=2)
    *said, last = done.stderr.splitlines()
    assert (done.stdout, last) == ("", "tiltcal: 1 of 3 journals cannot be replayed")
    assert [line.startswith("torn.journal.jsonl:") for line in said] == [True, False]


def test_a_journal_replaces_its_calibration(sessions: Path, tmp_path: Path) -> None:
    shutil.copytree(sessions, tmp_path, dirs_exist_ok=True)
    own = (tmp_path / "S-1.yaml").read_bytes()
    (tmp_path / "S-1.yaml").write_bytes(own.replace(b"operator: sim", b"operator: me"))
    for _ in range(2):
        tiltcal("replay", "S-1.journal.jsonl", "-o", "S-1.yaml", cwd=tmp_path, code=0)
        assert (tmp_path / "S-1.yaml").read_bytes() == own
    for _ in range(2):
        tiltcal("replay", "rotation.jsonl", "-o", "pairs.yaml", cwd=tmp_path, code=0)

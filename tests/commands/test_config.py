"""The defaults of a ``tiltcal.toml``: who reads them, what they say of themselves, and where they stand."""

import json
from pathlib import Path

import pytest
from support.command import tiltcal

import tiltcal as library

SENSOR = ("--sensor", "sca100t-d02", "--address", "sim:?seed=1", "--serial", "S-1")
USERS = 'operator = "Ada"\nfolder = "/nowhere"\n[references.table]\nid = "T-1"\ndue = 2020-03-01\n'


@pytest.fixture
def users(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file of the user, and the folder of a project as the present one."""
    monkeypatch.setattr("click.get_app_dir", lambda name: str(tmp_path / name))
    (tmp_path / "tiltcal").mkdir()
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    return tmp_path / "tiltcal" / "tiltcal.toml"


def test_what_is_used_is_said_and_stands_in_the_journal(users: Path) -> None:
    users.write_text(USERS)
    Path("tiltcal.toml").write_text('folder = "calibrations"\njig = 0.05\n')
    done = tiltcal("measure", "plane", *SENSOR, "--operator", "sim", code=0)
    assert done.stderr.splitlines()[:4] == [
        f"operator Ada: not stated, so it is that of {users}",
        f"references table T-1: not stated, so it is that of {users}",
        "jig 0.05°: not stated, so it is that of tiltcal.toml",
        "folder calibrations: not stated, so it is that of tiltcal.toml",
    ]
    header = json.loads(Path("calibrations/S-1.journal.jsonl").read_text().splitlines()[0])
    assert (header["person"], header["settings"]["jig"], header["sensors"][0]["output"]) == ("Ada", 0.05, "S-1.yaml")
    assert header["references"] == {"table": {"id": "T-1", "due": "2020-03-01"}}
    shown = tiltcal("config", code=0).stdout.splitlines()
    assert shown[:3] == [f"user        {users}", "project     tiltcal.toml", f"operator    Ada  ({users})"]
    assert sorted(shown[3:]) == [
        "folder      calibrations  (tiltcal.toml)",
        "jig         0.05°  (tiltcal.toml)",
        f"references  table T-1  ({users})",
    ]
    assert "jig of 0.05°" in tiltcal("plan", "plane", "--sensor", "sca100t-d02").stdout
    assert (
        "jig 0.05°"
        in tiltcal("verify", "calibrations/S-1.yaml", "--address", "sim:?seed=1", "--operator", "sim").stderr
    )
    # The journal is enough, whatever becomes of the defaults; and what is stated is not replaced.
    Path("tiltcal.toml").write_text("jig = nothing\n")
    tiltcal("replay", "calibrations/S-1.journal.jsonl", "--golden", "calibrations", code=0)
    tiltcal("check", "calibrations/S-1.yaml", code=0)
    tiltcal("measure", "--resume", "calibrations/S-1.journal.jsonl", code=0)
    assert "a perfect jig" in str(library.plan("plane", sensor="sca100t-d02"))
    Path("tiltcal.toml").write_text("jig = 1\n")
    stated = tiltcal("measure", "plane", *SENSOR, "--operator", "sim", "--jig", "0.2", "-o", "other.yaml")
    assert Path("other.yaml").is_file()
    assert "jig 1" not in stated.stderr


def test_a_bench_file_is_completed_and_not_replaced(users: Path) -> None:
    users.write_text(USERS)
    Path("tiltcal.toml").write_text('folder = "night"\njig = 1\n')
    sensor = "sensors: [{serial: S-1, model: sca100t-d02, address: 'sim:?seed=1'}]\n"
    Path("bench.yaml").write_text(f"tiltcal: 1\nkind: bench\njig: 0.1\noperator: Bea\n{sensor}")
    done = tiltcal("measure", "plane", "--bench", "bench.yaml", "--operator", "sim")
    header = json.loads(Path("night/bench.journal.jsonl").read_text().splitlines()[0])
    assert (header["person"], header["settings"]["jig"]) == ("Bea", 0.1)
    assert "references table T-1: not stated" in done.stderr
    assert Path("night/S-1.yaml").is_file()


@pytest.mark.parametrize(
    ("users_text", "projects", "said"),
    [
        ("jig = 0.1\n", "", "tiltcal.toml:1: jig: a jig is of one bench"),
        ("", '\nfolder = "x"\njgi = 1\n', "tiltcal.toml:3: jgi: unknown key 'jgi' (did you mean 'jig'?)"),
        ("", 'folder = "x"\njig = = 1\n', "tiltcal.toml:2: "),
        (
            "",
            '[references.table]\nid = "x"\ndue = "never"\n',
            "tiltcal.toml:3: references.table.due: 'never' is no date",
        ),
        ("", "jig = -1\n", "tiltcal.toml:1: jig: -1 is too small"),
    ],
)
def test_a_wrong_file_is_refused_with_line_and_key(users: Path, users_text: str, projects: str, said: str) -> None:
    users.write_text(users_text)
    Path("tiltcal.toml").write_text(projects)
    for command in (["config"], ["measure", "plane", *SENSOR, "--operator", "sim", "-o", "S-1.yaml"]):
        assert said in tiltcal(*command, code=2).stderr
    assert not Path("S-1.yaml").exists()

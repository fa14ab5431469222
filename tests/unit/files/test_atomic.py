"""A file appears whole or not at all, and a place that takes none is told before anything is measured."""

import errno
import os
import signal
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from tiltcal.errors import UsageError
from tiltcal.files import atomic
from tiltcal.files.atomic import check_writable, whole_file, write_whole


def interrupted_write(path: Path, failure: BaseException) -> None:
    with whole_file(path) as stream:
        stream.write(b"half")
        stream.flush()
        raise failure


def test_nothing_is_left_by_a_program_that_is_killed(tmp_path: Path) -> None:
    if not hasattr(os, "O_TMPFILE"):
        pytest.skip("this system has no files without a name")
    program = (
        "import os, signal; from tiltcal.files.atomic import whole_file\n"
        "with whole_file('out.csv') as stream:\n"
        "    stream.write(b'half'); stream.flush(); os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path)
    assert done.returncode == -signal.SIGKILL
    assert os.listdir(tmp_path) == []


def test_a_system_without_nameless_files_does_as_well(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(atomic, "_nameless", lambda folder: None)
    path = tmp_path / "out.csv"
    with whole_file(path) as stream:
        stream.write(b"a")
        assert not path.exists()
    assert path.read_bytes() == b"a"
    with pytest.raises(KeyboardInterrupt):
        interrupted_write(path, KeyboardInterrupt())
    assert path.read_bytes() == b"a"
    assert os.listdir(tmp_path) == ["out.csv"]


def test_failure_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "out.csv"
    path.write_text("old")
    no_room = OSError(errno.ENOSPC, "No space left on device")
    for failure, kind in (
        (ValueError("bad row"), ValueError),
        (KeyboardInterrupt(), KeyboardInterrupt),
        (no_room, UsageError),
        (ConnectionResetError(errno.ECONNRESET, "input lost"), ConnectionResetError),
    ):
        with pytest.raises(kind, match="No space left" if failure is no_room else None):
            interrupted_write(path, failure)
        assert path.read_text() == "old"
        assert os.listdir(tmp_path) == ["out.csv"]


def test_permissions_are_those_of_a_new_file_or_of_the_one_replaced(tmp_path: Path) -> None:
    plain, path = tmp_path / "plain", tmp_path / "out"
    plain.touch()
    write_whole(path, "x")
    assert path.stat().st_mode == plain.stat().st_mode
    path.chmod(0o640)
    write_whole(path, "y")
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


def test_link_stays_and_its_target_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "real").write_text("old")
    (tmp_path / "link").symlink_to("real")
    write_whole(tmp_path / "link", "new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real").read_text() == "new"


def test_bad_places_are_named_with_the_reason(tmp_path: Path) -> None:
    check_writable(tmp_path / "new.yaml")
    assert os.listdir(tmp_path) == []
    (tmp_path / "file").touch()
    for place, why in (
        (tmp_path, "it is a folder"),
        (tmp_path / "absent" / "c.yaml", "there is no folder"),
        (tmp_path / "file" / "c.yaml", "is a file, not a folder"),
    ):
        with pytest.raises(UsageError, match=why):
            check_writable(place)


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="this system has no /proc")
def test_read_only_place_is_refused() -> None:
    with pytest.raises(UsageError, match="choose another folder"):
        check_writable("/proc/self/c.yaml")
    with pytest.raises(UsageError, match="cannot write"):
        write_whole("/proc/self/c.yaml", "x")

"""The calibration files in a folder, by serial number and date."""

from pathlib import Path

import pytest
from support import FIXTURES

from tiltcal.errors import UsageError
from tiltcal.files.calibration_folder import index_folder

MAVS = (FIXTURES / "mavs.yaml").read_text(encoding="utf-8")


def test_files_are_found_by_serial_number(tmp_path: Path) -> None:
    """The second file has its keys in another layout, so that it is read whole; the third is in a folder below."""
    (tmp_path / "a.yaml").write_text(MAVS)
    (tmp_path / "b.yml").write_text("# of hand\n" + MAVS.replace("SIM-42", "0042").replace("2000-01-01", "2001-03-04"))
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "c.yaml").write_text(MAVS.replace("2000-01-01T00", "1999-12-31T23"))
    index = index_folder(tmp_path)
    assert not index.problems
    named = {serial: [Path(path).name for path in paths] for serial, paths in index.paths.items()}
    assert named == {"0042": ["b.yml"], "SIM-42": ["a.yaml", "c.yaml"]}


def test_files_of_other_kinds_are_passed_over_and_damaged_ones_are_named(tmp_path: Path) -> None:
    (tmp_path / "notes.yaml").write_text("this: is no file of tiltcal\n")
    (tmp_path / "list.yaml").write_text("- this\n- neither\n")
    (tmp_path / "pairs.yaml").write_text((FIXTURES / "rotation.yaml").read_text(encoding="utf-8"))
    (tmp_path / "torn.yaml").write_text(MAVS[:400])
    (tmp_path / "torn-early.yaml").write_text(MAVS[:37])
    (tmp_path / "empty.yaml").touch()
    (tmp_path / "gone.yaml").symlink_to("nowhere.yaml")
    (tmp_path / "random.yaml").write_bytes(bytes(range(256)))
    (tmp_path / "undated.yaml").write_text(
        MAVS[: MAVS.index("positions:")].replace("SIM-42", "S") + "provenance: {operator: me}\n"
    )
    index = index_folder(tmp_path)
    assert not index.paths
    messages = sorted(str(problem) for problem in index.problems)
    assert [Path(message.partition(":")[0]).name for message in messages] == [
        "empty.yaml",
        "gone.yaml",
        "random.yaml",
        "torn-early.yaml",
        "torn.yaml",
        "undated.yaml",
    ]
    assert "write provenance.ended" in messages[-1]


def test_what_is_no_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no-folder: cannot be read as a folder"):
        index_folder(tmp_path / "no-folder")

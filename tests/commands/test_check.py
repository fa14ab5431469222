"""``tiltcal check`` names what is wrong in the records of a file, and never falls over them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support import FIXTURES
from support.command import tiltcal

PLANE = (FIXTURES / "plane.yaml").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("degrees_of_freedom: 2", "chi_square: x", "fit.chi_square: a number is needed here"),
        ("degrees_of_freedom: 2", "degrees_of_freedom: many", "fit.degrees_of_freedom: a whole number is needed here"),
        ("degrees_of_freedom: 2", "chi_square: 3.0", ""),
        ("  journal: {", "  journal: x\n  log: {", "provenance.journal: a mapping is needed here"),
        ("  journal: {name: plane.journal.jsonl", "  journal: {name: [plane]", "provenance.journal.name: text"),
        ("  journal: {name: plane.journal.jsonl", f"  journal: {{name: {'a' * 300}", ""),
        ("  journal: {name: plane.journal.jsonl", '  journal: {name: "a\\0b"', "control character '\\x00'"),
    ],
)
def test_wrong_records_are_named(tmp_path: Path, old: str, new: str, says: str) -> None:
    assert old in PLANE
    (tmp_path / "plane.yaml").write_text(PLANE.replace(old, new, 1), encoding="utf-8")
    result = tiltcal("check", "plane.yaml", cwd=tmp_path)
    assert "Traceback" not in result.stderr
    assert says in result.stderr
    assert result.returncode == (2 if says else 0), result.stdout


def test_a_schema_is_printed_without_files_alone() -> None:
    """With a file and --json there were two JSON documents."""
    assert json.loads(tiltcal("check", "--schema", "bench", "--json").stdout)["type"] == "object"
    result = tiltcal("check", "--schema", "bench", FIXTURES / "plane.yaml", "--json")
    assert (result.returncode, result.stdout) == (2, "")
    assert "--schema prints the JSON Schema of a kind and checks no file" in result.stderr

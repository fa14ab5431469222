"""The section of a procedure that lets a stage turn."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tiltcal.core.pair.model import Pair
from tiltcal.errors import InputError, UsageError
from tiltcal.files.procedure_file import find_procedure, procedure_from_record, read_procedure
from tiltcal.files.rotation import PairSelection, Rotation

OWN = """\
tiltcal: 1
kind: procedure
name: own
title: One pair
rotation:
  phase: angle
  pairs:
    - {pair: [left, right], orthogonal: up}
  turns: 12
  converged: 1e-6
  patience: 30
  prompt: Start the motor.
"""


@pytest.fixture
def own(tmp_path: Path) -> Path:
    path = tmp_path / "own.yaml"
    path.write_text(OWN)
    return path


def test_the_shipped_one_is_the_two_pairs_of_the_source() -> None:
    procedure = find_procedure("rotation")
    assert procedure.positions == ()
    assert procedure.rotation is not None
    assert procedure.rotation.pairs == (Pair("a1", "a2", "a4"), Pair("a3", "a4", "a1"))
    assert (procedure.rotation.phase, procedure.rotation.turns) == ("theta", 100)
    assert procedure.rotation.channels == ("a1", "a2", "a4", "a3")


def test_a_users_own_is_read_and_comes_again_from_its_record(own: Path) -> None:
    procedure = read_procedure(own)
    pair = PairSelection(("left", "right"), "up")
    assert procedure.rotation == Rotation("angle", (pair,), "Start the motor.", 12, 1e-6, 30.0)
    assert procedure_from_record(json.loads(json.dumps(procedure.record))) == procedure


def test_what_is_left_out_has_its_value(own: Path) -> None:
    own.write_text("\n".join(OWN.splitlines()[:8]) + "\n")
    rotation = read_procedure(own).rotation
    assert rotation is not None
    assert (rotation.turns, rotation.converged, rotation.patience) == (100, None, 60.0)
    assert rotation.prompt


def test_the_turns_of_the_command_line_take_the_place_of_the_files(own: Path) -> None:
    procedure = read_procedure(own)
    assert procedure.with_turns(None) is procedure
    longer = procedure.with_turns(40).rotation
    assert longer is not None
    assert longer.turns == 40
    with pytest.raises(UsageError, match="at least 2"):
        procedure.with_turns(1)
    with pytest.raises(UsageError, match="leave --turns out"):
        find_procedure("plane").with_turns(4)
    with pytest.raises(UsageError, match="tiltcal match"):
        procedure.require_positions()


@pytest.mark.parametrize(
    ("old", "new", "line", "key", "about"),
    [
        ("turns: 12", "turn: 12", 9, "rotation.turn", "did you mean 'turns'"),
        ("turns: 12", "turns: 1", 9, "rotation.turns", "at least 2"),
        ("turns: 12", "turns: 1000000000", 9, "rotation.turns", "at most 1000000"),
        ("turns: 12", "turns: many", 9, "rotation.turns", "many"),
        ("converged: 1e-6", "converged: 0", 10, "rotation.converged", "more than 0"),
        ("patience: 30", "patience: -1", 11, "rotation.patience", "more than 0"),
        ("[left, right]", "[left]", 8, "rotation.pairs[0].pair", "a list of 2 values is needed here, found 1"),
        ("[left, right]", "[left, left]", 8, "rotation.pairs[0]", "four different channels"),
        ("orthogonal: up", "orthogonal: left", 8, "rotation.pairs[0]", "four different channels"),
        ("phase: angle", "phase: up", 8, "rotation.pairs[0]", "four different channels"),
        (", orthogonal: up", "", 8, "rotation.pairs[0]", "'orthogonal' is missing"),
        ("    - {pair: [left, right], orthogonal: up}\n", "    []\n", 7, "rotation.pairs", "a list of 1 to 2 values"),
        ("  turns: 12", "    - {pair: [left, right], orthogonal: x}\n  turns: 12", 7, "rotation.pairs", "twice"),
        ("title: One pair", "title: One pair\nsamples: 5", 5, "samples", "unknown key"),
        ("title: One pair", "title: One pair\npositions: []", 5, "positions", "unknown key"),
        ("  phase: angle\n", "", 5, "rotation", "'phase' is missing"),
    ],
)
def test_error_names_line_and_key(own: Path, old: str, new: str, line: int, key: str, about: str) -> None:
    assert old in OWN
    own.write_text(OWN.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_procedure(own)
    assert (caught.value.file, caught.value.line, caught.value.key) == (str(own), line, key)
    assert about in caught.value.message

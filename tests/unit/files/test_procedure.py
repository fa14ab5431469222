"""Procedures are data (SPEC 6): the shipped ones, and a user's own."""

import json
from math import cos, radians
from pathlib import Path

import pytest
from support import ROOT
from support.refused import require_refused

from tiltcal.core.pair.model import Pair
from tiltcal.errors import UsageError
from tiltcal.files.document import document_of, parse_document
from tiltcal.files.procedure import Rotation, find_procedure, procedure_in, read_procedure

OWN = """\
tiltcal: 1
kind: procedure
name: own
title: My own
determines: {axes: [y, x], drift: 1}
angle: 20
reference: 24
positions:
  - {name: level, tilt: {}, prompt: Level, temperature: 24}
  - {name: up, tilt: {x: angle, y: -angle}, prompt: "Up {angle}° at {temperature} °C", temperature: 5.5, heading: 90}
  - {name: side, gravity: [0, 3, 4], prompt: Side, stage: 45}
"""


TURNING = """\
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
  prompt: Start the motor.
"""


@pytest.fixture
def own(tmp_path: Path) -> Path:
    path = tmp_path / "own.yaml"
    path.write_text(OWN)
    return path


@pytest.fixture
def turning(tmp_path: Path) -> Path:
    path = tmp_path / "turning.yaml"
    path.write_text(TURNING)
    return path


def test_signs_are_the_physical_ones() -> None:
    position = {position.name: position for position in find_procedure("cross-axis").positions}
    assert position["x-tilt1"].gravity == pytest.approx((0.5, 0.0, cos(radians(30))))
    assert position["y-tilt2"].gravity == pytest.approx((0.0, -0.5, cos(radians(30))))
    assert position["z-tilt2"].gravity == (0.0, 0.0, -1.0)
    assert (position["y-tilt2"].tilt, position["z-tilt1"].tilt) == ({"y": -30.0}, None)


def test_angle_is_refused_out_of_range_and_where_none_is_free() -> None:
    for angle in (0.0, -30.0, 90.5, float("nan")):
        with pytest.raises(UsageError, match="at most 90"):
            find_procedure("plane", angle)
    assert find_procedure("plane", 90.0).in_positions().angle == 90.0
    with pytest.raises(UsageError, match="'six-face' leaves no angle free"):
        find_procedure("six-face", 30.0)


def test_own_procedure_is_run_by_path(own: Path) -> None:
    procedure = find_procedure(str(own)).in_positions()
    level, up, side = procedure.positions
    assert procedure.axes == ("x", "y")
    assert (procedure.samples, procedure.settle) == (100, 2.0)  # the defaults of the reference
    assert level.gravity == (0.0, 0.0, 1.0)
    assert (up.tilt, up.prompt, up.heading) == ({"x": 20.0, "y": -20.0}, "Up 20° at 5.5 °C", 90.0)
    assert (side.gravity, side.stage) == ((0.0, 0.6, 0.8), 45.0)


def test_unknown_procedure_offers_near_names() -> None:
    with pytest.raises(UsageError, match=r"unknown procedure 'cros-axis'.*'cross-axis'"):
        find_procedure("cros-axis")
    with pytest.raises(UsageError, match=r"'/absent/qqq.yaml', and no such file; there are comparison-16, "):
        find_procedure("/absent/qqq.yaml")


def test_record_gives_the_procedure_again_through_json(own: Path) -> None:
    for angle in (None, 7.0):
        procedure = read_procedure(own, angle)
        assert procedure_in(document_of(json.loads(json.dumps(procedure.record))), angle) == procedure
        # A default that changes later changes no journal: 100 samples by the reference.
        assert (procedure.record["samples"], procedure.record["soak"]["seconds"]) == (100, 20.0)
        assert procedure.record["determines"] == {"axes": ["y", "x"], "drift": 1, "gain": 0, "nonlinearity": 0}


def test_what_is_wrong_with_positions_is_told_with_line_and_key() -> None:
    for kind, text in (("positions", OWN), ("level", shipped("level")), ("ramp", shipped("ramp"))):
        require_refused(kind, text, lambda text: procedure_in(parse_document(text)))


def shipped(name: str) -> str:
    return (ROOT / "procedures" / f"{name}.yaml").read_text(encoding="utf-8")


# A stage that turns.


def test_a_users_own_is_read_and_comes_again_from_its_record(turning: Path) -> None:
    procedure = read_procedure(turning)
    assert isinstance(procedure, Rotation)
    assert (procedure.phase, procedure.pairs) == ("angle", (Pair("left", "right", "up"),))
    assert (procedure.prompt, procedure.turns, procedure.converged) == ("Start the motor.", 12, 1e-6)
    assert (procedure.patience, procedure.record["rotation"]["patience"]) == (60.0, 60.0)  # the default
    assert procedure_in(document_of(json.loads(json.dumps(procedure.record)))) == procedure


def test_the_turns_of_the_command_line_take_the_place_of_the_files(turning: Path) -> None:
    procedure = read_procedure(turning)
    assert procedure.with_turns(None) is procedure
    longer = procedure.with_turns(40)
    assert isinstance(longer, Rotation)
    assert longer.turns == 40
    with pytest.raises(UsageError, match="turns takes a number of turns from 2"):
        procedure.with_turns(1)
    with pytest.raises(UsageError, match="leave turns out"):
        find_procedure("plane").with_turns(4)
    with pytest.raises(UsageError, match="tiltcal match"):
        procedure.in_positions()


def test_what_is_wrong_with_a_rotation_is_told_with_line_and_key() -> None:
    require_refused("rotation", TURNING, lambda text: procedure_in(parse_document(text)))

"""``tiltcal verify`` judges by positions that were not fitted; ``tiltcal diff`` compares two dated calibrations."""

import json
from math import cos, radians
from pathlib import Path

import pytest
import yaml
from support.command import measure, tiltcal

CALIBRATION = """\
tiltcal: 1
kind: tilt
sensor: {{model: sca100t-d02, serial: S-1, unit: count, channels: [x, y]}}
calibration:
  offset: {{x: {offset}, y: 1021.0}}
  sensitivity: {{x: {{x: 818.0, y: 9.0}}, y: {{x: -6.0, y: 820.0}}}}
uncertainty:
  offset: {{x: 0.3, y: 0.3}}
  sensitivity: {{x: {{x: 0.6, y: 0.6}}, y: {{x: 0.6, y: 0.6}}}}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("verify")
    measure("--samples", "40", "--settle", "0.2", cwd=folder, procedure="complete", code=0)
    return folder


def verify(folder: Path, *options: str, seed: int = 1) -> tuple[int, dict]:
    result = tiltcal(
        "verify", "S-1.yaml", "--address", f"sim:?seed={seed}", "--operator", "sim", "--json", *options, cwd=folder
    )
    return result.returncode, json.loads(result.stdout)


def test_a_good_calibration_passes_and_another_part_fails(folder: Path) -> None:
    """The twin bends by up to 0.57° over its whole range; within 20° less than 0.15° of it is seen."""
    code, verdict = verify(folder, "--limit", "0.15")
    assert (code, verdict["passed"], verdict["limit"]) == (0, True, 0.15)
    assert [row["position"] for row in verdict["positions"]] == ["level", "x-up", "x-down", "y-up", "y-down", "both-up"]
    assert verdict["positions"][1]["expected"] == pytest.approx({"x": 20.0, "y": 0.0}, abs=1e-9)
    code, verdict = verify(folder, seed=2)
    assert (code, verdict["passed"]) == (1, False)
    assert verdict["worst"]["error"] > 0.5


BY_COLUMNS = """\
tiltcal: 1
kind: tilt
sensor: {model: serial-columns, serial: C-1, unit: V, channels: [x, y, z]}
calibration:
  offset: {x: 2.5, y: 2.5, z: 2.5}
  sensitivity: {x: {x: 2, y: 0, z: 0}, y: {x: 0, y: 2, z: 0}, z: {x: 0, y: 0, z: 2}}
"""


def test_other_readings_than_the_calibration_s_are_refused(tmp_path: Path) -> None:
    """Before the sensor is looked for: /dev/null answers nothing."""
    (tmp_path / "C-1.yaml").write_text(BY_COLUMNS)
    for given, says in (
        (
            "columns=x,y&unit=V",
            "the calibration of C-1 is of x, y, z in V, and serial:///dev/null?columns=x,y&unit=V gives x, y in V",
        ),
        ("columns=x,y,z&unit=mV", "gives x, y, z in mV: name the address as it was calibrated"),
    ):
        refused = tiltcal("verify", "C-1.yaml", "--address", f"serial:///dev/null?{given}", cwd=tmp_path, code=2)
        assert says in refused.stderr, refused.stderr


def test_options_beside_resume_are_remarked_and_change_nothing(folder: Path) -> None:
    """The same command goes on with the session, and so does one with other settings; a program reads JSON."""
    begun = ("--address", "sim:?seed=1", "--samples", "5", "--jig", "0.2")
    stopped = ("--operator", "json", "--journal", "o.jsonl", "--limit", "5", "--json")
    left = tiltcal("verify", "S-1.yaml", *begun, *stopped, cwd=folder, said='{"answer": "ready"}\n' * 2, code=130)
    go_on = ("verify", "S-1.yaml", "--limit", "5", "--json", "--resume", "o.jsonl")
    assert left.stderr.endswith(f"continue with: tiltcal {' '.join(go_on)}\n")
    ended = tiltcal(*go_on, cwd=folder, said='{"answer": "ready"}\n' * 4, code=0)
    assert json.loads(ended.stdout.splitlines()[-1])["passed"] is True
    plain = tiltcal(*go_on, "--operator", "sim", cwd=folder, code=0)
    assert json.loads(plain.stdout) == json.loads(ended.stdout.splitlines()[-1])
    stated = tiltcal(*go_on, "--operator", "sim", "--samples", "7", "--procedure", "plane", cwd=folder, code=0)
    assert stated.stdout == plain.stdout
    assert "goes on as it began: --procedure, --samples beside --resume changes nothing" in stated.stderr
    assert "no --jig is stated" not in stated.stderr
    words = ("verify", "S-1.yaml", "--address", "sim:?seed=1", "--operator", "sim")
    assert tiltcal(*words, cwd=folder, code=0).stderr.endswith("no --jig is stated: the positions count as exact\n")
    asked = tiltcal(*words[:-1], "json", cwd=folder, code=130).stderr
    assert "tiltcal verify S-1.yaml --resume" in asked


MOUNTED = CALIBRATION.replace("uncertainty:\n", "  mounting: {{roll: {roll}, pitch: 0, yaw: 0}}\nuncertainty:\n")


def test_another_mounting_is_a_change(tmp_path: Path) -> None:
    """1° with 0.1° on either side is 7.07 standard uncertainties; an angle without one is exact."""
    for before, after, u, word, said in (
        (0.0, 1.0, "{roll: 0.1, yaw: 0.1}", "changed", "mounting.turn.x by more than"),
        (0.0, 0.1, "{roll: 0.1, yaw: 0.1}", "unchanged", "unchanged"),
        (179.9, -179.9, "{roll: 0.1, yaw: 0.1}", "unchanged", "unchanged"),
        (0.0, 180.0, "", "unknown", "no uncertainty is stated of mounting.turn.x, which differs"),
    ):
        for name, roll in (("a.yaml", before), ("b.yaml", after)):
            text = MOUNTED.format(offset=1024.0, roll=roll)
            (tmp_path / name).write_text(text + (f"  mounting: {u}\n" if u else ""))
        words = ("diff", "a.yaml", "b.yaml")
        compared = json.loads(tiltcal(*words, "--json", cwd=tmp_path, code=int(word == "changed")).stdout)
        assert compared["verdict"] == word
        turn, exact = (
            next(one for one in compared["coefficients"] if one["name"] == f"mounting.turn.{a}") for a in "xy"
        )
        assert not exact["u"]
        assert abs(turn["change"]) == pytest.approx((after - before) % 360.0)
        assert turn["ratio"] == (pytest.approx(abs(turn["change"]) / 0.1414, rel=1e-3) if u else None)
        assert said in tiltcal(*words, cwd=tmp_path).stdout


def test_an_unchanged_part_in_two_procedures_is_not_called_changed(tmp_path: Path) -> None:
    """One part on the virtual bench: its offset of `plane` was 39.6 u from that of `cross-axis`.

    All positions of `plane` have g_z = cos 30°: its offset holds so much of the column of z, of which the data sheet's
    limit is its uncertainty, while `cross-axis` measures both.
    """
    for procedure in ("plane", "cross-axis"):
        given = ("--sensor", "sca100t-d02", "--address", "sim:seed=7", "--serial", "S-7", "--jig", "0.05")
        tiltcal("measure", procedure, *given, "--operator", "sim", "-o", f"{procedure}.yaml", cwd=tmp_path, code=0)
    tiltcal("diff", "plane.yaml", "cross-axis.yaml", cwd=tmp_path, code=0)
    told = json.loads(tiltcal("diff", "plane.yaml", "cross-axis.yaml", "--json", cwd=tmp_path).stdout)
    assert (told["verdict"], told["not_comparable"]) == ("unchanged", [])
    (of_y,) = (row for row in told["coefficients"] if row["name"] == "offset.y")
    limit = yaml.safe_load((tmp_path / "plane.yaml").read_text())["fit"]["priors"]["sensitivity.y.z"]
    assert of_y["u"] == pytest.approx(cos(radians(30.0)) * limit, rel=0.01)
    assert abs(of_y["change"]) > 10.0

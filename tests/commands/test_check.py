"""``tiltcal check`` names what is wrong in the records of a file, and never falls over them."""

import json
import shutil
from pathlib import Path

import pytest
from support import FIXTURES, ROOT
from support.command import tiltcal


def check(folder: Path, name: str, text: str) -> tuple[int, str]:
    (folder / name).write_text(text, encoding="utf-8")
    result = tiltcal("check", name, cwd=folder)
    assert "Traceback" not in result.stderr
    return result.returncode, result.stderr


def test_a_wrong_file_does_not_hide_the_others(tmp_path: Path) -> None:
    (tmp_path / "wrong.yaml").write_text("tiltcal: 1\nkind: bench\n", encoding="utf-8")
    good = FIXTURES / "plane.yaml"
    unreadable = "/proc/self/mem" if Path("/proc/self/mem").is_file() else "nothing.yaml"
    result = tiltcal("check", "wrong.yaml", unreadable, good, "--json", cwd=tmp_path)
    assert [(entry["file"], entry["findings"]) for entry in json.loads(result.stdout)] == [(str(good), [])]
    assert "wrong.yaml:1: the key 'sensors' is missing" in result.stderr
    assert f"{unreadable}: " in result.stderr
    assert "2 of 3 files are wrong" in result.stderr
    assert result.returncode == 2


def test_a_schema_is_printed_without_files_alone() -> None:
    """With a file and --json there were two JSON documents."""
    assert json.loads(tiltcal("check", "--schema", "bench", "--json", code=0).stdout)["type"] == "object"
    told = [{"file": str(FIXTURES / "plane.yaml"), "kind": "calibration", "findings": [], "remarks": []}]
    shown = tiltcal("check", FIXTURES / "plane.yaml", "--json", code=0).stdout
    assert shown == json.dumps(told, indent=2) + "\n"


BENCH = """tiltcal: 1
kind: bench
jig: 0.1
thermometer: {model: sca100t-d02, address: "sim:"}
sensors:
  - {serial: A, model: sca100t-d02, address: "sim:"}
"""


def test_wrong_bench_files_are_named(tmp_path: Path) -> None:
    sensor = 'A, model: sca100t-d02, address: "sim:'
    for old, new, says in (
        (sensor, sensor.replace("d02", "d2"), ":6: sensors[0]: no sensor"),
        (sensor, sensor.replace("sim:", "smi:"), ":6: sensors[0]: address"),
        ("thermometer: {model: sca100t-d02", "thermometer: {model: scb", ":4: thermometer: no sensor model"),
    ):
        assert BENCH.count(old) == 1
        code, said = check(tmp_path, "bench.yaml", BENCH.replace(old, new))
        assert (code, says in said) == (2, True), (new, said)


def test_a_bench_that_is_measured_is_checked_with_its_lines(tmp_path: Path) -> None:
    (tmp_path / "bench.yaml").write_text(BENCH.replace("A, model: sca100t-d02", "A, model: sca100"))
    for command in (("measure", "plane", "--bench", "bench.yaml"), ("record", "--bench", "bench.yaml", "-o", "l.csv")):
        assert tiltcal(*command, cwd=tmp_path, code=2).stderr.split(" no ")[0] == "tiltcal: bench.yaml:6: sensors[0]:"


MATRIX = "uncertainty.covariance.matrix"
PLACES = "positions[0].time, positions[1].time, positions[2].time, positions[3].time"
OTHERS = "fit.residuals.x-tilt3, fit.residuals.x-tilt2, procedure.set.x-tilt3, procedure.set.x-tilt2"


@pytest.mark.parametrize(
    ("name", "old", "new", "keys"),
    [
        ("plane", '"y": 11.2,', '"y": 11.3,', ""),
        ("plane", "single_reading: {x: 0.6688,", "single_reading: {x: 0.669,", ""),
        ("plane", '"y": 11.2,', '"y": 131.3,', "the coefficients"),
        ("plane", "offset: {x: 1023", "offset: {x: 1000", "the coefficients"),
        ("plane", 'sha256: "', 'sha256: "0', "provenance.journal.sha256"),
        ("plane", "tilt: {x: [-30.040483, 30.040483]", "tilt: {x: [-89, 89]", "limits.tilt.x[0], limits.tilt.x[1]"),
        ("plane", "-309.81124", "-209.81124", f"{MATRIX}[6][9], {MATRIX}[9][6]"),
        ("plane", "2000-01-01T00:", "2001-01-01T00:", f"{PLACES}, provenance.started and 1 more"),
        ("plane", "x-tilt2", "x-tilt3", f"{OTHERS}, positions[1].position"),
        ("plane", "  single_reading: {x: 0.6688, \"y\": 0.58}\n", "", "uncertainty.single_reading"),
        ("mavs", "reference: 24.0", "reference: 20.5", "calibration.temperature.reference"),
        ("mavs", "range: [5.078", "range: [4.078", "calibration.temperature.range[0]"),
        ("rotation", "frequency: 0", "frequency: 1", "spin.frequency"),
    ],
)  # fmt: skip
def test_a_calibration_of_other_digits_beside_its_journal(
    name: str, old: str, new: str, keys: str, tmp_path: Path
) -> None:
    """Digits that agree within 1 % of an uncertainty, or within the uncertainty of a coefficient, are a remark."""
    shutil.copy(FIXTURES / f"{name}.journal.jsonl", tmp_path)
    text = (FIXTURES / f"{name}.yaml").read_text(encoding="utf-8")
    assert old in text
    (tmp_path / f"{name}.yaml").write_text(text.replace(old, new), encoding="utf-8")
    kind, journal = "pair calibration" if name == "rotation" else "calibration", f"{name}.journal.jsonl"
    agrees = "gives other digits with this version, which agree within their uncertainty"
    said = f"does not give this file: {keys} differ" if keys else agrees
    shown = tiltcal("check", f"{name}.yaml", cwd=tmp_path, code=1 if keys else 0).stdout
    assert shown == f"{name}.yaml: {kind}, {journal} {said}\n"
    (tmp_path / f"{name}.yaml").unlink()
    tiltcal("replay", journal, "-o", f"{name}.yaml", cwd=tmp_path, code=0)
    assert tiltcal("check", f"{name}.yaml", cwd=tmp_path).stdout == f"{name}.yaml: {kind}, good\n"


def test_the_devices_that_are_shipped_are_checked() -> None:
    paths = sorted((ROOT / "drivers" / "text_devices").glob("*.yaml"))
    assert tiltcal("check", *paths, code=0).stdout == "".join(f"{path}: device, good\n" for path in paths)

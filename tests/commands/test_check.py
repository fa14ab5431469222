"""``tiltcal check`` names what is wrong in the records of a file, and never falls over them."""

import json
import shutil
from pathlib import Path

from support import FIXTURES, ROOT
from support.command import tiltcal

PLANE = (FIXTURES / "plane.yaml").read_text(encoding="utf-8")


def check(folder: Path, name: str, text: str) -> tuple[int, str]:
    (folder / name).write_text(text, encoding="utf-8")
    result = tiltcal("check", name, cwd=folder)
    assert "Traceback" not in result.stderr
    return result.returncode, result.stderr


def test_wrong_records_are_named(tmp_path: Path) -> None:
    for old, new, says in (
        ("degrees_of_freedom: 2", "chi_square: x", "fit.chi_square: a number is needed here"),
        ("degrees_of_freedom: 2", "degrees_of_freedom: many", "fit.degrees_of_freedom: a whole number is needed here"),
        ("degrees_of_freedom: 2", "chi_square: 3.0", ""),
        ("  journal: {", "  journal: x\n  log: {", "provenance.journal: a mapping is needed here"),
        ("  journal: {name: plane.journal.jsonl", "  journal: {name: [plane]", "provenance.journal.name: text"),
        ("  journal: {name: plane.journal.jsonl", f"  journal: {{name: {'a' * 300}", ""),
        ("  journal: {name: plane.journal.jsonl", '  journal: {name: "a\\0b"', "control character '\\x00'"),
        ('  ended: "2000', '  ended: "2000-13', "is no date: write it as"),
    ):
        assert old in PLANE
        code, said = check(tmp_path, "plane.yaml", PLANE.replace(old, new, 1))
        assert (code, says in said) == (2 if says else 0, True), (new, said)


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
    assert json.loads(tiltcal("check", "--schema", "bench", "--json").stdout)["type"] == "object"


CHAMBER = (
    'chamber: {kind: modbus, address: "modbus:tcp://127.0.0.1:502", limits: {}, tolerance: 0.5, '
    'registers: {temperature: {set: "100", read: "200"}}}'
)
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
        ("0.1", "0,1", ":3: jig: a number is needed here, found '0,1'; write the point as '.'"),
        ("0.1", "0.1°", ":3: jig: a number is needed here, found '0.1°'; write the number alone"),
        ("jig: 0.1", f"jig: 0.1\n{CHAMBER}", ":4: chamber.limits: name at least one key here"),
        ("0.1", "0.1 deg", ":3: jig: a number is needed here, found '0.1 deg'; write the number alone"),
    ):
        assert BENCH.count(old) == 1
        code, said = check(tmp_path, "bench.yaml", BENCH.replace(old, new))
        assert (code, says in said) == (2, True), (new, said)


def test_a_bench_that_is_measured_is_checked_with_its_lines(tmp_path: Path) -> None:
    (tmp_path / "bench.yaml").write_text(BENCH.replace("A, model: sca100t-d02", "A, model: sca100"))
    for command in (("measure", "plane", "--bench", "bench.yaml"), ("record", "--bench", "bench.yaml", "-o", "l.csv")):
        assert tiltcal(*command, cwd=tmp_path, code=2).stderr.split(" no ")[0] == "tiltcal: bench.yaml:6: sensors[0]:"


def test_a_calibration_of_other_digits_beside_its_journal(tmp_path: Path) -> None:
    other = "plane.journal.jsonl does not give this file: "
    text = PLANE.replace('"y": 11.2,', '"y": 11.3,')
    sha256 = text[text.index("plane.journal.jsonl, ") :].split('"')[1]
    shutil.copy(FIXTURES / "plane.journal.jsonl", tmp_path)
    agrees = "calibration, plane.journal.jsonl gives other digits with this version, which agree within their"
    covariance = "uncertainty.covariance.matrix[6][9], uncertainty.covariance.matrix[9][6] differ"
    for old, new, code, says in (
        ("", "", 0, agrees),
        ("single_reading: {x: 0.6688,", "single_reading: {x: 0.669,", 0, agrees),
        ('"y": 11.3,', '"y": 131.3,', 1, f"{other}the coefficients differ"),
        (sha256, sha256[::-1], 1, f"{other}provenance.journal.sha256 differ"),
        ("serial: SIM-42, unit", "serial: SIM-43, unit", 1, f"{other}sensor.serial differ"),
        (
            "tilt: {x: [-30.040483, 30.040483]",
            "tilt: {x: [-89.0, 89.0]",
            1,
            f"{other}limits.tilt.x[0], limits.tilt.x[1] differ",
        ),
        ("operator: sim", "operator: me", 1, f"{other}provenance.operator differ"),
        ("single_reading: {x: 0.6688,", "single_reading: {x: 0.5,", 1, f"{other}uncertainty.single_reading.x differ"),
        ("-309.81124", "-209.81124", 1, other + covariance),
    ):
        assert old in text
        (tmp_path / "plane.yaml").write_text(text.replace(old, new), encoding="utf-8")
        assert says in tiltcal("check", "plane.yaml", cwd=tmp_path, code=code).stdout
    (tmp_path / "plane.yaml").unlink()
    tiltcal("replay", "plane.journal.jsonl", "-o", "plane.yaml", cwd=tmp_path, code=0)
    assert tiltcal("check", "plane.yaml", cwd=tmp_path).stdout == "plane.yaml: calibration, good\n"


def test_the_devices_that_are_shipped_are_checked() -> None:
    paths = sorted((ROOT / "drivers" / "text_devices").glob("*.yaml"))
    assert tiltcal("check", *paths, code=0).stdout == "".join(f"{path}: device, good\n" for path in paths)

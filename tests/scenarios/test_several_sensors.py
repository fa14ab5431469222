"""A board of sensors, one thermometer, one journal."""

from pathlib import Path

import pytest
from support.command import tiltcal

from tiltcal.files.calibration import read_calibration

HEADER = "tiltcal: 1\nkind: bench\noperator: A. Technician\njig: 0.01\n"

TRUTH = """\
tiltcal: 1
kind: twin
model: sca100t-d02
seed: {seed}
truth:
  offset: {{x: {x}, y: 1021.0}}
  sensitivity: {{x: {{x: 817.4, y: 11.2, z: 0.0}}, y: {{x: -7.9, y: 821.6, z: 0.0}}}}
  temperature: {{reference: 24.0, offset: {{x: [0.4], y: [-0.1]}}}}
  noise: {{x: 0.6, y: 0.6}}
{more}"""


def twin(folder: Path, number: int, more: str = "") -> str:
    name = f"twin-{number}.yaml"
    (folder / name).write_text(TRUTH.format(seed=number, x=1020 + number, more=more))
    return f"sim:?twin={name}"


def bench(folder: Path, *sensors: str, more: str = "") -> None:
    (folder / "bench.yaml").write_text(HEADER + more + "sensors:\n" + "".join(f"  - {{{one}}}\n" for one in sensors))


def measured(folder: Path, *options: str, procedure: str = "plane") -> dict[str, object]:
    result = tiltcal(
        *("measure", procedure, "--bench", "bench.yaml", "--operator", "sim", "--samples", "30", *options),
        cwd=folder,
        code=0,
    )
    return {"said": result.stderr}


def test_a_sensor_that_fails_is_reported_and_the_others_go_on(tmp_path: Path) -> None:
    """Its twin is unplugged for good in the second position; each attempt costs a second."""
    good, bad = twin(tmp_path, 1), twin(tmp_path, 2, "  faults: [{kind: unplugged, start: 4.5, end: 1.0e+9}]\n")
    bench(
        tmp_path,
        f'serial: GOOD, model: sca100t-d02, address: "{good}", axes: [-y, x]',
        f'serial: BAD, model: sca100t-d02, address: "{bad}"',
    )
    result = tiltcal(
        "measure", "plane", "--bench", "bench.yaml", "--operator", "sim", "--samples", "30", cwd=tmp_path, code=3
    )
    assert "BAD is dropped, the others continue" in result.stderr
    assert "no calibration file for BAD" in result.stderr
    assert "--resume" not in result.stderr, "the session is complete"
    found = read_calibration(tmp_path / "GOOD.yaml")  # turned by a quarter and over, in its own frame
    assert found.coefficients.offset == pytest.approx([1021.0, 1021.0], abs=0.5)
    assert found.coefficients.sensitivity[:, :2].ravel() == pytest.approx([817.4, 11.2, -7.9, 821.6], abs=0.9)
    assert found.provenance.bench.axes == ("-y", "x", "z")
    assert not (tmp_path / "BAD.yaml").exists()
    tiltcal("replay", "bench.journal.jsonl", "--golden", "GOOD.yaml", cwd=tmp_path, code=0)


def test_a_failure_of_the_whole_bench_loses_no_sensor(tmp_path: Path) -> None:
    """Both twins are unplugged from 4.5 s on, until both have failed five times, a second apart."""
    fault = "  faults: [{kind: unplugged, start: 4.5, end: 15.0}]\n"
    bench(
        tmp_path,
        f'serial: A, model: sca100t-d02, address: "{twin(tmp_path, 1, fault)}"',
        f'serial: B, model: sca100t-d02, address: "{twin(tmp_path, 2, fault)}"',
    )
    options = ("--operator", "sim", "--samples", "30")
    ended = tiltcal("measure", "plane", "--bench", "bench.yaml", *options, cwd=tmp_path, code=3)
    assert "before it A failed: is a supply, a line or an adapter of all of them down?" in ended.stderr
    tiltcal("measure", "--resume", "bench.journal.jsonl", "--operator", "sim", cwd=tmp_path, code=0)
    (tmp_path / "again").mkdir()
    tiltcal("replay", "bench.journal.jsonl", "-o", "again", cwd=tmp_path, code=0)
    for name, x in (("A.yaml", 1021.0), ("B.yaml", 1022.0)):
        found = read_calibration(tmp_path / name)
        assert found.coefficients.offset == pytest.approx([x, 1021.0], abs=0.5)
        assert len(found.positions) == 4
        assert (tmp_path / "again" / name).read_bytes() == (tmp_path / name).read_bytes()


def test_references_stand_in_file_and_report_and_one_that_is_overdue_is_said(tmp_path: Path) -> None:
    """A virtual session is of 2000-01-01: the table was due before it, the thermometer on that day."""
    references = (
        "references:\n"
        "  table: {id: RT-3, certificate: K-117, uncertainty: 0.01, due: 1999-12-31}\n"
        "  thermometer: {id: P-2, uncertainty: 0.1, due: 2000-01-01}\n"
    )
    bench(tmp_path, f'serial: S, model: sca100t-d02, address: "{twin(tmp_path, 3)}"', more=references)
    overdue = "the table RT-3 was due for calibration on 1999-12-31, before this session on 2000-01-01"
    said = str(measured(tmp_path)["said"])
    assert said.index(overdue) < said.index("1/4"), "before anything is measured"
    assert "P-2" not in said
    calibration = read_calibration(tmp_path / "S.yaml")
    assert calibration.fit.notes == (overdue,)
    assert calibration.provenance.references["table"].certificate == "K-117"
    tiltcal("report", "S.yaml", "-o", "S.html", cwd=tmp_path, code=0)
    page = (tmp_path / "S.html").read_text()
    assert "RT-3, certificate K-117, ±0.01° (95 %), due 1999-12-31" in page
    assert "P-2, ±0.1 °C (95 %), due 2000-01-01" in page
    assert overdue in page
    (tmp_path / "bench.yaml").write_text((tmp_path / "bench.yaml").read_text().replace("1999-12-31", "soon"))
    refused = tiltcal("check", "bench.yaml", cwd=tmp_path)
    assert "bench.yaml:6: references.table.due: 'soon' is no date" in refused.stdout + refused.stderr

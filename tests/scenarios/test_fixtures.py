"""Every captured session gives its golden calibration file, and its golden file finds the twin's truth."""

import csv
import json
import os
import re
import shutil
import subprocess
import sys
from decimal import Decimal
from pathlib import Path
from runpy import run_path

import pytest
from support import FIXTURES, ROOT
from support.command import tiltcal

from tiltcal.files.calibration import read_calibration
from tiltcal.files.document import read_document
from tiltcal.files.procedure import shipped_procedures
from tiltcal.files.twin import read_twin
from tiltcal.library.calibration import read

# A number that lies between two roundings is rounded to either, by the linear algebra of the processor.
NUMBER = re.compile(r"(?<![\w.:-])-?\d+\.\d+(?:e[+-]\d+)?(?![\w.:-])")

JOURNALS = sorted(FIXTURES.glob("*.journal.jsonl"))
PLANE = FIXTURES / "plane.journal.jsonl"


def golden(journal: Path) -> Path:
    return journal.with_name(journal.name.replace(".journal.jsonl", ".yaml"))


def last_digit(number: str) -> Decimal:
    """Return one unit of the last digit of a printed number."""
    return Decimal((0, (1,), Decimal(number).as_tuple().exponent))


def test_every_shipped_procedure_has_a_fixture() -> None:
    assert {golden(journal).stem for journal in JOURNALS} >= set(shipped_procedures())


@pytest.mark.parametrize("journal", JOURNALS, ids=lambda path: path.name)
def test_replay_gives_the_golden_file(journal: Path, tmp_path: Path) -> None:
    tiltcal("replay", journal, "-o", "again.yaml", cwd=tmp_path, code=0)
    again, expected = (path.read_text(encoding="utf-8") for path in (tmp_path / "again.yaml", golden(journal)))
    assert NUMBER.split(again) == NUMBER.split(expected)
    assert '"virtual":true' in journal.read_text(encoding="utf-8").splitlines()[0]
    assert "virtual bench" in read_document(golden(journal)).data["provenance"]["made_by"]
    for ours, theirs in zip(NUMBER.findall(again), NUMBER.findall(expected), strict=True):
        assert abs(Decimal(ours) - Decimal(theirs)) <= max(last_digit(ours), last_digit(theirs)), (ours, theirs)


def test_the_samples_of_a_session_are_a_log_that_gives_its_means(tmp_path: Path) -> None:
    """Averaged apart from the session: the last rows before each position was accepted."""
    journal = FIXTURES / "plane.journal.jsonl"
    tiltcal("replay", journal, "--samples", "log.csv", "-o", "again.yaml", cwd=tmp_path, code=0)
    with open(tmp_path / "log.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    for position in read_calibration(golden(journal)).positions:
        before = [row for row in rows if row["time"] <= position.time][-position.n :]
        for channel, mean in position.mean.items():
            assert sum(float(row[channel]) for row in before) / position.n == pytest.approx(mean, abs=1e-9)


def test_the_result_of_a_rotation_is_that_of_its_samples_as_a_log(tmp_path: Path) -> None:
    journal = FIXTURES / "rotation.journal.jsonl"
    tiltcal("replay", journal, "--samples", "log.csv", "-o", "again.yaml", cwd=tmp_path, code=0)
    kept = read(golden(journal)).record.matchings[0]
    for how, within in (((), 1e-3), (("--online",), 4.0)):
        result = tiltcal(
            *("match", "log.csv", "--pair", "a1,a2", "--orthogonal", "a4", "--phase", "theta", *how, "--json"),
            cwd=tmp_path,
            code=0,
        )
        found = json.loads(result.stdout)
        assert abs(found["p"] - kept.p) < within * kept.u_p
        assert abs(found["q"] - kept.q) < within * kept.u_q


def test_a_journal_that_lacks_its_end_line_alone_is_replayed(tmp_path: Path) -> None:
    lines = (FIXTURES / "plane.journal.jsonl").read_bytes().splitlines(keepends=True)
    (tmp_path / "plane.journal.jsonl").write_bytes(b"".join(lines[:-1]))
    golden = FIXTURES / "plane.yaml"
    whole = tiltcal("replay", "plane.journal.jsonl", "--golden", golden, cwd=tmp_path)
    assert (whole.returncode, "its end line is missing, and all positions are there" in whole.stderr) == (0, True)
    last = max(number for number, line in enumerate(lines) if b',"p",' in line)
    (tmp_path / "plane.journal.jsonl").write_bytes(b"".join(lines[:last]))
    half = tiltcal("replay", "plane.journal.jsonl", "--golden", golden, cwd=tmp_path)
    assert (half.returncode, "continue it with: tiltcal measure --resume" in half.stderr) == (2, True)


def test_the_workflow_of_the_page_is_green_and_then_red(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its lines as they stand, on journals of two procedures."""
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "examples" / "driver" / "workflow.yml").read_text(encoding="utf-8")
    install, *lines = re.findall(r"- run: (.*)", page)
    assert install == "pip install . tiltcal pytest"
    (tmp_path / "journals").mkdir()
    for name in ("plane", "zero-45"):
        for end in (".journal.jsonl", ".yaml"):
            shutil.copy(FIXTURES / f"{name}{end}", "journals")

    # The entry point by which pytest finds it is in the wheel; what is installed here may be older.
    environment = {**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTEST_PLUGINS": "tiltcal.pytest_plugin"}

    def run(line: str) -> tuple[int, str]:
        command, *arguments = line.split()
        done = subprocess.run(
            [sys.executable, "-m", command, *arguments], env=environment, capture_output=True, text=True, check=False
        )
        return done.returncode, done.stdout + done.stderr

    (replayed, said), (tested, counted) = map(run, lines)
    assert (replayed, tested) == (0, 0), said + counted
    assert "2 journals are replayed, no calibration files differ" in said
    assert "2 passed" in counted
    golden = tmp_path / "journals" / "plane.yaml"
    kept = golden.read_text(encoding="utf-8")
    golden.write_text(kept.replace("SIM-42", "SIM-43").replace("operator: sim", "operator: me"), encoding="utf-8")
    shutil.copy(golden, tmp_path / "journals" / "other.yaml")
    (tmp_path / "journals" / "zero-45.yaml").unlink()
    (replayed, said), (tested, counted) = map(run, lines)
    assert (replayed, tested) == (1, 1)
    assert "2 journals are replayed, 3 calibration files differ from those in journals" in said
    assert ("@@ -3 +3 @@\n-sensor: {model: sca100t-d02, serial: SIM-43" in counted, "2 failed" in counted) == (
        True,
        True,
    )


@pytest.mark.parametrize("procedure", ["cross-axis", "complete", "sensitivity-drift"])
def test_the_golden_file_finds_the_truth(procedure: str) -> None:
    """Within what nonlinearity and jig can do to a coefficient (1.5 count), of the gain the stated interval of 95 %."""
    file = read_calibration(FIXTURES / f"{procedure}.yaml")
    found, (_, truth) = file.coefficients, read_twin(FIXTURES / "twins" / "sca100t-d02.yaml")
    for row, channel in enumerate(found.channels):
        if procedure == "sensitivity-drift":
            name = f"temperature.sensitivity.{channel}.1"
            expanded = file.uncertainty[name] * file.uncertainty.coverage_factor[name]
            assert found.thermal.gain[row, 0] == pytest.approx(truth.gain[channel][0], abs=expanded)
            continue
        assert found.offset[row] == pytest.approx(truth.offset[channel], abs=1.5)
        own = [truth.sensitivity[channel][axis] for axis in found.axes]
        assert found.sensitivity[row] == pytest.approx(own, abs=1.5)


def test_a_fixture_is_made_again_to_the_byte(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "twins").symlink_to(FIXTURES / "twins")
    monkeypatch.chdir(tmp_path)
    run_path(str(FIXTURES / "make.py"))["make"]("plane")
    for name in ("plane.journal.jsonl", "plane.yaml"):
        assert (tmp_path / name).read_bytes() == (FIXTURES / name).read_bytes()

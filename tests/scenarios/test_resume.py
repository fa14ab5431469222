"""A session that is killed at any point keeps what was accepted, and ends, resumed, in a calibration of the sensor."""

from __future__ import annotations

import random
from collections.abc import Sequence
from pathlib import Path

import pytest
from support import ROOT
from support.command import measure, tiltcal
from support.warm_start import WarmStart

from tiltcal.files.calibration import CalibrationRecord, read_calibration
from tiltcal.files.journal import read_journal
from tiltcal.library.measure import measure as measure_here

JOURNAL = "S-1.journal.jsonl"
TWIN = """\
tiltcal: 1
kind: twin
model: sca100t-d02
seed: 1
truth:
  offset: {x: 1026.3, y: 1020.8}
  sensitivity: {x: {x: 817.4, y: 11.2, z: -3.5}, y: {x: -7.9, y: 821.6, z: 5.1}}
  temperature: {reference: 24.0, offset: {x: [0.21], y: [-0.05]}}
  noise: {x: 0.6, y: 0.6}
  jig: 0.01
"""


@pytest.fixture(scope="module")
def options(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """A session with every kind of event, whose chamber is quick: about 1,500 transactions."""
    folder = tmp_path_factory.mktemp("bench")
    complete = (ROOT / "procedures" / "complete.yaml").read_text()
    (folder / "complete.yaml").write_text(
        complete.replace("soak: {seconds: 20, drift: 0.06, thermometer: 360}", "soak: {seconds: 0.5, drift: 0.3}")
    )
    (folder / "twin.yaml").write_text(TWIN)
    return [
        *("measure", str(folder / "complete.yaml"), "--sensor", "sca100t-d02", "--serial", "S-1"),
        *("--address", f"sim:?twin={folder / 'twin.yaml'}", "-o", "S-1.yaml", "--operator", "sim"),
        *("--samples", "20", "--settle", "0.2"),
    ]


@pytest.fixture(scope="module")
def never_stopped(options: list[str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("never-stopped")
    assert tiltcal(*options, cwd=folder).returncode == 0
    return folder


def accepted(journal: Path) -> list[object]:
    """The accepted positions that a journal holds."""
    return [event.payload[0] for event in read_journal(journal).accepted]


def require_kept(journal: Path, before: Sequence[object], whole: CalibrationRecord) -> None:
    """Each position from before the kill is in the journal as it was; the calibration is that of the sensor."""
    kept = read_calibration(journal.with_name("S-1.yaml"))
    assert accepted(journal)[: len(before)] == list(before)
    assert [one.position for one in kept.positions] == [one.position for one in whole.positions]
    assert [one.mean for one in kept.positions][: len(before)] == [one.mean for one in whole.positions][: len(before)]
    assert kept.coefficients.offset == pytest.approx(whole.coefficients.offset, abs=1.0)


@pytest.mark.parametrize("number", range(8))
def test_killed_at_a_random_moment(
    number: int, options: list[str], never_stopped: Path, warm: WarmStart, tmp_path: Path
) -> None:
    size = (never_stopped / JOURNAL).stat().st_size
    warm.start(options, tmp_path).kill_at(tmp_path / JOURNAL, random.Random(number).randrange(1, size))
    before = accepted(tmp_path / JOURNAL)
    resumed = tiltcal("measure", "--resume", JOURNAL, cwd=tmp_path)
    assert resumed.returncode == 0, resumed.stderr
    require_kept(tmp_path / JOURNAL, before, read_calibration(never_stopped / "S-1.yaml"))
    replayed = tiltcal("replay", JOURNAL, "--golden", "S-1.yaml", cwd=tmp_path)
    assert replayed.returncode == 0, replayed.stderr


def test_truncated_anywhere(never_stopped: Path, tmp_path: Path) -> None:
    """Within one process, at many more places than can be hit by killing: torn lines, the end record, its edges."""
    whole = (never_stopped / JOURNAL).read_bytes()
    header = whole.index(b"\n") + 1
    places = [header, header + 1, len(whole) - 1, whole.rindex(b"\n", 0, -1) + 1]
    places += random.Random(7).sample(range(header, len(whole)), 12)
    for place in places:
        path = tmp_path / JOURNAL
        path.write_bytes(whole[:place])
        before = accepted(path)
        measure_here(resume=path)
        require_kept(path, before, read_calibration(never_stopped / "S-1.yaml"))


@pytest.mark.parametrize(
    ("sensor", "address"),
    [("scl3300", "sim:range=2.4g&seed=3"), ("adxl355", "sim:range=4g&seed=3"), ("iis2iclx", "sim:range=3g&seed=3")],
)
def test_a_part_that_is_set_up_is_set_up_again(sensor: str, address: str, tmp_path: Path) -> None:
    """In another range than after a reset; cut in its start, in a sample, and where a position has just changed."""
    options = ["--sensor", sensor, "--address", address, "--serial", "S-1", "-o", "S-1.yaml", "--operator", "sim"]
    done = tiltcal("measure", "cross-axis", *options, "--samples", "5", "--settle", "0.1", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    path = tmp_path / JOURNAL
    lines = path.read_bytes().splitlines(keepends=True)
    whole = read_calibration(tmp_path / "S-1.yaml")
    moved = next(place for place, line in enumerate(lines) if b'"p"' in line)
    for cut in (2, 9, len(lines) // 4, moved + 1, moved + 3):
        path.write_bytes(b"".join(lines[:cut]))
        before = accepted(path)
        measure_here(resume=path)
        resumed = read_calibration(tmp_path / "S-1.yaml")
        assert accepted(path)[: len(before)] == before
        sensitivity = whole.coefficients.sensitivity
        assert resumed.coefficients.sensitivity == pytest.approx(sensitivity, abs=2e-3 * sensitivity.max())


def test_a_temperature_that_was_reached_needs_no_new_soak(tmp_path: Path) -> None:
    """The chamber takes minutes to its temperature; after the break the next position is taken in seconds."""
    (tmp_path / "twin.yaml").write_text(TWIN + "  time_constant: 60.0\n")
    (tmp_path / "own.yaml").write_text(
        "tiltcal: 1\nkind: procedure\nname: own\ntitle: Two positions in the cold\ndetermines: {axes: [], drift: 1}\n"
        "reference: 24.0\nsoak: {seconds: 20, drift: 0.3}\npositions:\n"
        "  - {name: warm, tilt: {x: 0, y: 0}, temperature: 24.0, prompt: Level.}\n"
        "  - {name: cold, tilt: {x: 0, y: 0}, temperature: 5.5, prompt: Cool.}\n"
        "  - {name: colder, tilt: {x: 0, y: 0}, temperature: 5.5, prompt: Still cool.}\n"
    )
    options = {"sensor": "sca100t-d02", "serial": "S-1", "samples": 10}
    where = {"address": f"sim:?twin={tmp_path}/twin.yaml", "output": tmp_path / "S-1.yaml"}
    measure_here(tmp_path / "own.yaml", operator="sim", **options, **where)  # type: ignore[arg-type]
    path = tmp_path / JOURNAL
    lines = path.read_bytes().splitlines(keepends=True)
    cold = [place for place, line in enumerate(lines) if b'"p"' in line][1]
    path.write_bytes(b"".join(lines[: cold + 1]))
    measure_here(resume=path)
    events = list(read_journal(path).events)
    again = next(place for place, event in enumerate(events) if event.kind == "resumed")
    accepted_at = next(place for place, event in enumerate(events) if place > again and event.kind == "p")
    assert sum(event.dt_ns for event in events[again:accepted_at]) < 20e9
    temperatures = [one.temperature for one in read_calibration(tmp_path / "S-1.yaml").positions]
    assert temperatures[2] == pytest.approx(5.5, abs=2.0 + 0.92)


def test_options_beside_resume_change_nothing_and_are_remarked(never_stopped: Path, tmp_path: Path) -> None:
    (tmp_path / JOURNAL).write_bytes((never_stopped / JOURNAL).read_bytes()[:5000])
    done = tiltcal("measure", "--resume", JOURNAL, "--samples", "7", "--jig", "0.5", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "the session goes on as it began: --samples, --jig beside --resume changes nothing" in done.stderr
    assert {one.n for one in read_calibration(tmp_path / "S-1.yaml").positions} == {20}


def test_resume_of_nothing_says_so(tmp_path: Path) -> None:
    result = tiltcal("measure", "--resume", "no.journal.jsonl", cwd=tmp_path)
    assert result.returncode == 2
    assert "no.journal.jsonl: no such journal" in result.stderr


def test_a_torn_line_is_dropped_with_a_warning(never_stopped: Path, tmp_path: Path) -> None:
    (tmp_path / JOURNAL).write_bytes((never_stopped / JOURNAL).read_bytes()[:5000])
    result = tiltcal("measure", "--resume", JOURNAL, cwd=tmp_path)
    assert result.returncode == 0
    assert "torn" in result.stderr


def test_a_second_session_leaves_the_first_journal_alone(tmp_path: Path) -> None:
    assert measure(cwd=tmp_path).returncode == 0
    first = (tmp_path / JOURNAL).read_bytes()
    assert measure(cwd=tmp_path).returncode == 0
    assert (tmp_path / JOURNAL).read_bytes() == first
    assert (tmp_path / "S-1.2.journal.jsonl").exists()

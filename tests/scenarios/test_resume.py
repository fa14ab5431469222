"""A session that is killed at any point ends, resumed, in the same file as one that was never stopped."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from support import ROOT
from support.command import measure, tiltcal
from support.warm_start import WarmStart

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


@pytest.mark.parametrize("number", range(20))
def test_killed_at_a_random_moment(
    number: int, options: list[str], never_stopped: Path, warm: WarmStart, tmp_path: Path
) -> None:
    whole = (never_stopped / JOURNAL).read_bytes()
    warm.start(options, tmp_path).kill_at(tmp_path / JOURNAL, random.Random(number).randrange(1, len(whole)))
    resumed = tiltcal("measure", "--resume", JOURNAL, cwd=tmp_path)
    assert resumed.returncode == 0, resumed.stderr
    assert (tmp_path / "S-1.yaml").read_bytes() == (never_stopped / "S-1.yaml").read_bytes()
    assert (tmp_path / JOURNAL).read_bytes() == whole


def test_truncated_anywhere(never_stopped: Path, tmp_path: Path) -> None:
    """Within one process, at many more places than can be hit by killing: torn lines, the end record, its edges."""
    from tiltcal.library.measure import measure as measure_here

    whole = (never_stopped / JOURNAL).read_bytes()
    golden = (never_stopped / "S-1.yaml").read_bytes()
    header = whole.index(b"\n") + 1
    places = [header, header + 1, len(whole) - 1, whole.rindex(b"\n", 0, -1) + 1]
    places += random.Random(7).sample(range(header, len(whole)), 12)
    for place in places:
        path = tmp_path / JOURNAL
        path.write_bytes(whole[:place])
        measure_here(resume=path)
        assert (tmp_path / "S-1.yaml").read_bytes() == golden, place
        assert path.read_bytes() == whole, place


@pytest.mark.parametrize(
    ("sensor", "address"),
    [("scl3300", "sim:range=2.4g&seed=3"), ("adxl355", "sim:range=4g&seed=3"), ("iis2iclx", "sim:range=3g&seed=3")],
)
def test_a_part_that_is_set_up_is_as_it_was(sensor: str, address: str, tmp_path: Path) -> None:
    """In another range than after a reset; cut in its start, in a sample, and where a position has just changed."""
    from tiltcal.library.measure import measure as measure_here

    options = ["--sensor", sensor, "--address", address, "--serial", "S-1", "-o", "S-1.yaml", "--operator", "sim"]
    done = tiltcal("measure", "cross-axis", *options, "--samples", "5", "--settle", "0.1", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    path = tmp_path / JOURNAL
    lines = path.read_bytes().splitlines(keepends=True)
    golden = (tmp_path / "S-1.yaml").read_bytes()
    moved = next(place for place, line in enumerate(lines) if b'"p"' in line)
    for cut in (2, 9, len(lines) // 4, moved + 1, moved + 3):
        path.write_bytes(b"".join(lines[:cut]))
        measure_here(resume=path)
        assert (tmp_path / "S-1.yaml").read_bytes() == golden, cut
        assert path.read_bytes() == b"".join(lines), cut


def test_killed_before_the_calibration_was_written(never_stopped: Path, tmp_path: Path) -> None:
    """The journal has its end record, the file is not there: resuming writes it."""
    (tmp_path / JOURNAL).write_bytes((never_stopped / JOURNAL).read_bytes())
    assert tiltcal("measure", "--resume", JOURNAL, cwd=tmp_path).returncode == 0
    assert (tmp_path / "S-1.yaml").read_bytes() == (never_stopped / "S-1.yaml").read_bytes()


def test_resume_of_nothing_says_so(tmp_path: Path) -> None:
    result = tiltcal("measure", "--resume", "no.journal.jsonl", cwd=tmp_path)
    assert result.returncode == 2
    assert "no.journal.jsonl: no such journal" in result.stderr


def test_a_torn_line_is_dropped_with_a_warning(never_stopped: Path, tmp_path: Path) -> None:
    (tmp_path / JOURNAL).write_bytes((never_stopped / JOURNAL).read_bytes()[:5000])
    result = tiltcal("measure", "--resume", JOURNAL, cwd=tmp_path)
    assert result.returncode == 0
    assert "torn" in result.stderr


def test_an_interrupted_journal_is_not_replayed_as_if_it_were_whole(never_stopped: Path, tmp_path: Path) -> None:
    (tmp_path / JOURNAL).write_bytes((never_stopped / JOURNAL).read_bytes()[:5000])
    result = tiltcal("replay", JOURNAL, cwd=tmp_path)
    assert result.returncode == 2
    assert f"measure --resume {JOURNAL}" in result.stderr


def test_a_second_session_leaves_the_first_journal_alone(tmp_path: Path) -> None:
    assert measure(cwd=tmp_path).returncode == 0
    first = (tmp_path / JOURNAL).read_bytes()
    assert measure(cwd=tmp_path).returncode == 0
    assert (tmp_path / JOURNAL).read_bytes() == first
    assert (tmp_path / "S-1.2.journal.jsonl").exists()

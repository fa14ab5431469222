"""A session that is killed or cut at any point keeps what was accepted, and ends, resumed, in the same calibration."""

import random
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from support import ROOT
from support.command import measure, tiltcal
from support.warm_start import WarmStart

from tiltcal import Calibration, read
from tiltcal.drivers.virtual import Fixture
from tiltcal.files.calibration import read_calibration
from tiltcal.journal.lines import Journal
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
RAMP = """\
tiltcal: 1
kind: procedure
name: quick-ramp
title: A ramp
determines: {axes: [], drift: 1}
reference: 24.0
ramp: {pace: 2.0, interval: 20}
positions:
  - {name: down, tilt: {x: 0, y: 0}, temperature: 5.0, prompt: Cool.}
  - {name: up, tilt: {x: 0, y: 0}, temperature: 40.0, prompt: Warm.}
"""
BENCH = """\
tiltcal: 1
kind: bench
thermometer: {model: thermistor, address: "sim:"}
sensors:
""" + "".join(
    f'  - {{serial: S-{n}, model: {model}, address: "sim:seed={n}"}}\n'
    for n, model in enumerate(("sca100t-d02", "adxl202", "adxl202-analog", "sca3000-d01", "scl3300", "adxl355"), 1)
)

QUICK = ("--samples", "5", "--settle", "0.2")
SESSIONS = {
    "positions": ("complete.yaml", "sca100t-d02", "sim:?twin=twin.yaml", "--samples", "20", "--settle", "0.2"),
    "sentences": ("mavs.yaml", "adxl202", "sim:seed=4", *QUICK),
    "edges": ("zero-45", "adxl202", "sim:seed=4&wiring=edges", *QUICK),
    # A conversion is started by one transaction and read by a later one.
    "analog": ("plane", "sca100t-d02-analog", "sim:seed=1", *QUICK),
    # Set up in another range than after a reset, and again after the break.
    "scl3300": ("cross-axis", "scl3300", "sim:range=2.4g&seed=3", *QUICK),
    "adxl355": ("cross-axis", "adxl355", "sim:range=4g&seed=3", *QUICK),
    "ramp": ("ramp.yaml", "sca100t-d02", "sim:?twin=twin.yaml", "--jig", "0"),
    "rotation": ("rotation", "gradiometer", "sim:?seed=3", "--turns", "3"),
}


def line_of(kind: str) -> list[str]:
    """The command of a session of a kind."""
    if kind == "six sensors":
        options = ["--bench", "bench.yaml", "-o", ".", "--journal", JOURNAL, "--samples", "5", "--settle", "0.2"]
        return ["measure", "plane", *options, "--operator", "sim"]
    procedure, model, address, *options = SESSIONS[kind]
    sensor = ["--sensor", model, "--address", address, "--serial", "S-1", "-o", "S-1.yaml"]
    return ["measure", procedure, *sensor, "--operator", "sim", *options]


def furnish(folder: Path) -> None:
    """Write what the sessions need; soaks are short, and no thermometer is late."""
    for name in ("complete", "mavs"):
        text = (ROOT / "procedures" / f"{name}.yaml").read_text()
        (folder / f"{name}.yaml").write_text(re.sub("soak: {.*}", "soak: {seconds: 0.5, drift: 0.3}", text))
    for name, text in (("twin", TWIN), ("ramp", RAMP), ("bench", BENCH)):
        (folder / f"{name}.yaml").write_text(text)


@pytest.fixture(scope="module")
def never_stopped(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """The folder of a session of a kind that nobody stopped."""
    folders: dict[str, Path] = {}

    def folder_of(kind: str) -> Path:
        if kind not in folders:
            folders[kind] = tmp_path_factory.mktemp("never-stopped")
            furnish(folders[kind])
            tiltcal(*line_of(kind), cwd=folders[kind], code=0)
        return folders[kind]

    return folder_of


def accepted(journal: Path) -> list[Any]:
    """The accepted positions that a journal holds."""
    return [event.payload[0] for event in Journal(journal) if event.kind == "p"]


def coefficients(path: Path) -> Iterator[tuple[float, float]]:
    """Offsets or p and q of a calibration file, each with what it may differ by."""
    found = read(path)
    if isinstance(found, Calibration):
        coefficients = found.record.coefficients
        for channel, offset in zip(coefficients.channels, coefficients.offset, strict=True):
            yield offset, 3e-3 * abs(coefficients.own_sensitivity(channel))
    else:
        for one in found.matchings:
            yield from ((one.p, 7.0 * one.u_p), (one.q, 7.0 * one.u_q))


def require_kept(folder: Path, before: list[object], whole: Path) -> None:
    """Each position from before is in the journal as it was; the calibrations are those of the whole session."""
    assert accepted(folder / JOURNAL)[: len(before)] == before
    files = sorted(path.name for path in whole.glob("S-?.yaml"))
    assert files
    for name in files:
        for (ours, within), (theirs, _) in zip(coefficients(folder / name), coefficients(whole / name), strict=True):
            assert ours == pytest.approx(theirs, abs=within), name
    tiltcal("replay", JOURNAL, "--golden", "." if len(files) > 1 else files[0], cwd=folder, code=0)


@pytest.mark.parametrize("kind", ["positions", "six sensors", "rotation"])
def test_killed_at_a_random_moment(
    kind: str, never_stopped: Callable[[str], Path], warm: WarmStart, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    whole = never_stopped(kind)
    furnish(tmp_path)
    moment = random.Random(request.node.name).randrange(1, (whole / JOURNAL).stat().st_size)
    warm.start(line_of(kind), tmp_path).kill_at(tmp_path / JOURNAL, moment)
    before, bytes_before = accepted(tmp_path / JOURNAL), (tmp_path / JOURNAL).read_bytes().rpartition(b"\n")[0]
    tiltcal("measure", "--resume", JOURNAL, cwd=tmp_path, code=0)
    assert (tmp_path / JOURNAL).read_bytes().startswith(bytes_before)
    require_kept(tmp_path, before, whole)


@pytest.mark.parametrize("kind", [*SESSIONS, "six sensors"])
def test_cut_anywhere(
    kind: str, never_stopped: Callable[[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In its start, where a position has just been accepted, in a sample after it, in the end record, and anywhere."""
    whole = never_stopped(kind)
    content = (whole / JOURNAL).read_bytes()
    header, moved = content.index(b"\n") + 1, content.index(b'"p"') if b'"p"' in content else 0
    places = [header + 90, content.index(b"\n", moved) + 1, content.index(b"\n", moved) + 120, len(content) - 1]
    furnish(tmp_path)
    monkeypatch.chdir(tmp_path)
    for place in [*places, random.Random(kind).randrange(header, len(content))]:
        (tmp_path / JOURNAL).write_bytes(content[:place])
        before = accepted(tmp_path / JOURNAL)
        measure_here(resume=JOURNAL)
        require_kept(tmp_path, before, whole)
        if kind == "ramp":  # a sample is three transactions of the part, and goes on in the leg that was begun
            taken = [one["sensors"]["S-1"]["n"] for one in accepted(tmp_path / JOURNAL)]
            assert sum(taken) == sum(event.kind == "s" for event in Journal(tmp_path / JOURNAL)) // 3


@pytest.mark.parametrize(("typed", "warmed"), [(0.0, False), (3.5, False), (0.0, True)])
def test_a_temperature_that_was_reached_needs_no_new_soak(
    typed: float, warmed: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The chamber takes minutes to it; after the break the next position is taken in seconds, whatever was typed."""
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
    rig = SimpleNamespace(position=lambda ask: {"answer": "ready", "temperature": ask["temperature"] + typed})
    operator: Any = rig if typed else "sim"
    measure_here(tmp_path / "own.yaml", operator=operator, **options, **where)  # type: ignore[arg-type]
    path = tmp_path / JOURNAL
    lines = path.read_bytes().splitlines(keepends=True)
    cold = [place for place, line in enumerate(lines) if b'"p"' in line][1]
    path.write_bytes(b"".join(lines[: cold + 1]))
    if warmed:  # the door of the chamber was opened: then it is soaked again, for ten windows where it stays warm
        monkeypatch.setattr(Fixture, "temperature", lambda *_: 24.0)
    measure_here(resume=path, operator=operator)
    events = list(Journal(path))
    again = next(place for place, event in enumerate(events) if event.kind == "resumed")
    accepted_at = next(place for place, event in enumerate(events) if place > again and event.kind == "p")
    assert (sum(event.dt_ns for event in events[again:accepted_at]) < 20e9) != warmed
    temperatures = [one.temperature for one in read_calibration(tmp_path / "S-1.yaml").positions]
    assert warmed or temperatures[2] == pytest.approx(5.5 + typed, abs=0.0 if typed else 2.0 + 0.92)


def test_options_beside_resume_change_nothing_and_a_torn_line_is_dropped(
    never_stopped: Callable[[str], Path], tmp_path: Path
) -> None:
    furnish(tmp_path)
    (tmp_path / JOURNAL).write_bytes((never_stopped("positions") / JOURNAL).read_bytes()[:5000])
    done = tiltcal("measure", "--resume", JOURNAL, "--samples", "7", "--jig", "0.5", cwd=tmp_path, code=0)
    assert "the session goes on as it began: --samples, --jig beside --resume changes nothing" in done.stderr
    assert "the last line was torn off and is dropped" in done.stderr
    assert {one.n for one in read_calibration(tmp_path / "S-1.yaml").positions} == {20}


def test_a_second_session_leaves_the_first_journal_alone(tmp_path: Path) -> None:
    measure(cwd=tmp_path, code=0)
    first = (tmp_path / JOURNAL).read_bytes()
    measure(cwd=tmp_path, code=0)
    assert (tmp_path / JOURNAL).read_bytes() == first
    assert (tmp_path / "S-1.2.journal.jsonl").exists()

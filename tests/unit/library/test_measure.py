"""Measuring from Python: a rig needs no pipe, a reading passes few frames, and nothing of pairs is loaded for tilt."""

import resource
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from traceback import walk_stack
from types import SimpleNamespace
from typing import Any

import pytest

import tiltcal
from tiltcal import PairCalibration, measure
from tiltcal.bench import devices
from tiltcal.bench.operators import PythonObject
from tiltcal.cli.main import run
from tiltcal.errors import UsageError

SENSOR = {"sensor": "sca100t-d02", "address": "sim:?seed=1", "serial": "S-1", "samples": 4, "settle": 0.2}


PLANE = [
    *("measure", "plane", "--operator=sim", "--output=S-1.yaml"),
    *(f"--{name}={value}" for name, value in SENSOR.items()),
]


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_a_session_from_python_is_the_session_of_the_command_line() -> None:
    measure("plane", operator="sim", output="S-1.yaml", journal="J.jsonl", **SENSOR)  # type: ignore[arg-type]
    written = Path("S-1.yaml").read_bytes()
    assert run([*PLANE, "--journal=J.jsonl"]) == 2, "the journal is there"
    Path("J.jsonl").unlink()
    assert run([*PLANE, "--journal=J.jsonl"]) == 0
    assert Path("S-1.yaml").read_bytes() == written


def test_a_stage_is_turned_by_a_rig() -> None:
    class Stage:
        turns = 0
        matched: Mapping[str, Any] = {}

        def rotation(self, ask: Mapping[str, Any]) -> Mapping[str, Any]:
            assert ask["ask"] == "rotation"
            return {"answer": "ready"}

        def turn(self, event: Mapping[str, Any]) -> None:
            self.turns = event["turn"]

        def poll(self) -> Mapping[str, Any] | None:
            return {"answer": "stop"} if self.turns >= 3 else None

        def accepted(self, event: Mapping[str, Any]) -> None:
            self.matched = event

    stage = Stage()
    options = {"sensor": "gradiometer", "address": "sim:", "serial": "G-1", "output": "pair.yaml"}
    found = measure("rotation", operator=stage, **options)
    assert isinstance(found, PairCalibration)
    assert stage.matched["turns"] == pytest.approx(3.0, abs=0.6)
    assert set(stage.matched) == {"event", "position", "turns", "p", "q", "u_p", "u_q", "suppression"}


def test_an_operator_without_the_method_is_refused_before_anything_is_captured() -> None:
    with pytest.raises(UsageError, match=r"no method position\(ask\)"):
        measure("plane", operator=object(), output="S-1.yaml", **SENSOR)  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="no operator 'robot'"):
        measure("plane", operator="robot", output="S-1.yaml", **SENSOR)  # type: ignore[arg-type]
    with pytest.raises(UsageError, match=r"no method rotation\(ask\)"):
        PythonObject(SimpleNamespace(position=print), "rotation")
    assert list(Path().iterdir()) == []


def test_between_the_command_and_the_bus_eight_frames_of_ours_stand_on_the_stack(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """From the library's function to the link that is recorded; counted where the bytes leave."""
    depths: set[int] = set()
    connect, package = devices.open_device, Path(tiltcal.__file__).parent
    ours = (str(package), str(package.with_name("drivers")))

    def counted(*args: Any) -> Any:
        link = connect(*args)

        def exchange(out: bytes, count: int = 0) -> bytes:
            depths.add(sum(one.f_code.co_filename.startswith(ours) for one, _ in walk_stack(None)))
            return link.exchange(out, count)

        return SimpleNamespace(letter="s", close=link.close, exchange=exchange)

    monkeypatch.setattr(devices, "open_device", counted)
    assert run(PLANE) == 0
    assert max(depths) - len(("run", "command")) <= 8, depths


def test_a_full_disk_says_how_to_go_on_and_costs_nothing() -> None:
    """The operating system itself refuses the bytes beyond a limit of the process."""

    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (6000, 6000))

    # Without -B the limit would cut the byte code of a module that no process has imported before, for good.
    command = [sys.executable, "-B", "-m", "tiltcal"]
    done = subprocess.run([*command, *PLANE], capture_output=True, text=True, preexec_fn=limited, timeout=120)
    assert done.returncode == 2
    assert "cannot be written: File too large; make room on the disk, then resume" in done.stderr
    assert "tiltcal measure --resume S-1.journal.jsonl" in done.stderr
    assert "Traceback" not in done.stderr
    measure(resume="S-1.journal.jsonl")
    options = {**SENSOR, "output": "whole/S-1.yaml", "journal": "whole/S-1.journal.jsonl"}
    Path("whole").mkdir()
    measure("plane", operator="sim", **options)  # type: ignore[arg-type]
    assert set(tiltcal.read("S-1.yaml").fit.residuals) == set(tiltcal.read("whole/S-1.yaml").fit.residuals)  # type: ignore[union-attr]
    log = [*command, "record", "--sensor=sca100t-d02", "--address=sim:", "--rows=1000", "-o", "log.csv"]
    done = subprocess.run(log, capture_output=True, text=True, preexec_fn=limited, timeout=120)
    assert done.returncode == 2
    assert "cannot write log.csv: File too large; the rows before are kept" in done.stderr
    assert Path("log.csv").read_text().endswith("\n")


@pytest.mark.parametrize("name", ["../outside.yaml", "{here}/../outside.yaml"])
def test_a_journal_of_somebody_else_writes_nowhere_but_beside_it(name: str, tmp_path: Path) -> None:
    Path("inside").mkdir()
    measure("plane", operator="sim", output=name.format(here=tmp_path), journal="inside/J.jsonl", **SENSOR)  # type: ignore[arg-type]
    written = Path(name.format(here=tmp_path))
    whole = written.read_bytes()
    written.unlink()
    with pytest.raises(UsageError, match="outside its own folder: say with output where the calibration goes"):
        measure(resume="inside/J.jsonl")
    assert not written.exists()
    measure(resume="inside/J.jsonl", output="here.yaml")
    assert Path("here.yaml").read_bytes() == whole

"""The session on the virtual bench: what is refused, what is waited for, what is told."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.command import measure

from tiltcal.bench.journal import SessionResult, calibrations_of
from tiltcal.bench.measure import run_session
from tiltcal.bench.operators import Message, VirtualJig
from tiltcal.bench.session import Session
from tiltcal.bench.setup import SessionFiles, Setup, single
from tiltcal.drivers.virtual import Fixture, VirtualPart
from tiltcal.errors import HardwareError
from tiltcal.files.calibration import CalibrationRecord, read_calibration
from tiltcal.files.journal import read_journal
from tiltcal.files.procedure import find_procedure
from tiltcal.files.results import PositionSet
from tiltcal.library.measure import measure as measure_here

TWIN = """\
tiltcal: 1
kind: twin
model: sca100t-d02
seed: 5
truth:
  offset: {x: 1026.0, y: 1021.0}
  sensitivity: {x: {x: 817.4, y: 11.2, z: 0.0}, y: {x: -7.9, y: 821.6, z: 0.0}}
  temperature: {reference: 24.0, offset: {x: [0.4], y: [-0.1]}}
  noise: {x: 0.6, y: 0.6}
"""


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("twin.yaml").write_text(TWIN)
    return tmp_path


def session(procedure: str = "plane", model: str = "sca100t-d02") -> Session:
    journal = Path("S-1.journal.jsonl")
    bench, outputs = single(model, "S-1", "sim:?twin=twin.yaml"), [Path("S-1.yaml")]
    setup = Setup.begin(find_procedure(procedure), bench, outputs, journal, operator="sim")
    return Session(setup, SessionFiles(setup, journal))


def written(result: SessionResult) -> CalibrationRecord:
    Path("S-1.yaml").write_text(result.texts()["S-1"])
    return read_calibration("S-1.yaml")


def run(procedure: str = "plane", operator: VirtualJig | None = None) -> tuple[CalibrationRecord, list[str]]:
    said: list[str] = []
    live = session(procedure)
    live.probe()
    return written(run_session(live, operator or VirtualJig(said.append))), said


def twin_with(line: str) -> None:
    Path("twin.yaml").write_text(TWIN + f"  {line}\n")


def test_plane_finds_the_twin(bench: Path) -> None:
    found = run()[0].coefficients
    assert found.offset == pytest.approx([1026.0, 1021.0], abs=0.3)
    assert found.sensitivity[:, :2].ravel() == pytest.approx([817.4, 11.2, -7.9, 821.6], abs=0.6)


class Clumsy(VirtualJig):
    """Types, at the second position, the angle of the first one: the sensor is where it was."""

    clumsy = True

    def ask(self, question: Message) -> object:
        if question.get("position") == "x-tilt2" and self.clumsy:
            self.clumsy = False
            return {"answer": "ready", "gravity": [0.0, 0.0, 1.0]}
        return super().ask(question)


def test_what_was_typed_is_what_is_judged(bench: Path) -> None:
    """Level typed for a position, and level taken: odd, but consistent, so it counts as typed."""
    calibration, _ = run("plane", Clumsy())
    assert calibration.procedure.set["x-tilt2"] == PositionSet(gravity=(0.0, 0.0, 1.0))


@pytest.mark.parametrize(
    ("kind", "why"),
    [("parity", "102"), ("silent", "stuck high"), ("unplugged", "unplugged")],
)
def test_a_fault_that_passes_costs_a_redo(kind: str, why: str, bench: Path) -> None:
    """The first position takes about 3 s; the fault begins in the second."""
    twin_with(f"faults: [{{kind: {kind}, start: 5.0, end: 5.2}}]")
    calibration, said = run()
    refused = [line for line in said if "refused" in line]
    assert refused
    assert all(why in line for line in refused)
    assert calibration.coefficients.offset == pytest.approx([1026.0, 1021.0], abs=0.3)


def test_a_session_that_a_fault_ended_goes_on_once_the_fault_is_gone(bench: Path) -> None:
    twin_with("faults: [{kind: unplugged, start: 5.0, end: 11.0}]")
    live = session()
    live.probe()
    with pytest.raises(HardwareError, match="unplugged"):
        run_session(live, VirtualJig())
    measure_here(resume="S-1.journal.jsonl", operator="sim")
    journal = read_journal("S-1.journal.jsonl")
    assert journal.end is not None
    assert calibrations_of(journal).texts() == {"S-1": Path("S-1.yaml").read_text()}


def test_a_slow_chamber_is_waited_for(bench: Path) -> None:
    """From 24 °C to within 2 °C of 5.5 °C with a time constant of two minutes takes 120 ln(18.5 / 2) = 267 s; the
    thermometer's step of 0.92 °C lets it be thought there half a step, 31 s, too early."""
    twin_with("time_constant: 120.0")
    calibration, _ = run("two-temperature")
    warm, cold = calibration.positions
    assert _seconds(str(cold.time)) - _seconds(str(warm.time)) > 267.0 - 31.0
    assert cold.temperature == pytest.approx(5.5, abs=2.0 + 0.92)


def test_a_thermometer_that_is_far_off_is_believed_once_it_holds(bench: Path) -> None:
    """A sensor's own thermometer is not trimmed: 6 °C off, it must hold for ten windows of 20 s."""
    twin_with("thermometer_error: 6.0")
    calibration, _ = run("two-temperature")
    warm, cold = calibration.positions
    assert _seconds(str(cold.time)) - _seconds(str(warm.time)) > 200.0
    assert cold.temperature == pytest.approx(11.5, abs=0.6)


LATE = """\
tiltcal: 1
kind: twin
model: scl3300
seed: 5
truth:
  offset: {x: 10.0, y: -20.0, z: 5.0}
  sensitivity: {x: {x: 6000, y: 0, z: 0}, y: {x: 0, y: 6000, z: 0}, z: {x: 0, y: 0, z: 6000}}
  temperature: {reference: 24.0, offset: {x: [6.0], y: [-6.0], z: [0.0]}}
  noise: {x: 2.0, y: 2.0, z: 2.0}
"""


def test_a_thermometer_that_is_five_minutes_late_is_waited_for(bench: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The chamber goes by 1 °C/min, the part with it; its thermometer is still behind when it has arrived."""
    Path("twin.yaml").write_text(LATE)
    move = Fixture.move
    monkeypatch.setattr(Fixture, "move", lambda fixture, gravity, to=None, _=0.0: move(fixture, gravity, to, 1.0))
    monkeypatch.setattr(VirtualPart, "_celsius", lambda part: part._fixture.temperature(300.0))
    live = session("two-temperature", model="scl3300")
    live.probe()

    found = written(run_session(live, VirtualJig()))
    assert found.positions[1].temperature == pytest.approx(5.5, abs=0.15)
    assert found.coefficients.thermal is not None
    for drift, channel, truth in zip(found.coefficients.thermal.drift[:, 0], "xy", (6.0, -6.0), strict=False):
        name = f"temperature.offset.{channel}.1"
        # What is left of the lag, 0.1 °C, is in no uncertainty unless a thermometer's is stated.
        assert abs(drift - truth) < 1.5 * found.uncertainty[name] * found.uncertainty.coverage_factor[name]


PARTED = """\
tiltcal: 1
kind: procedure
name: parted
title: Two positions at one temperature, and one at another
determines: {axes: [], drift: 1}
reference: 24.0
soak: {seconds: 20, drift: 0.3}
positions:
  - {name: warm-1, tilt: {x: 0, y: 0}, temperature: 24.0, prompt: "Level."}
  - {name: warm-2, tilt: {x: 0, y: 0}, temperature: 24.0, prompt: "Still level."}
  - {name: cold, tilt: {x: 0, y: 0}, temperature: 5.5, prompt: "Cool."}
"""


class Returning(VirtualJig):
    """Measures the cold position, and goes back to the warm one before it."""

    measured = returned = False

    def ask(self, question: Message) -> object:
        match question["ask"], question.get("position"):
            case "review", "cold" if not self.measured:
                self.measured = True
                return {"answer": "redo"}
            case "position", "cold" if self.measured and not self.returned:
                self.returned = True
                return {"answer": "back"}
        return super().ask(question)


def test_a_temperature_is_waited_for_again_after_another_one(bench: Path) -> None:
    """With a time constant of a minute, what is measured at once is measured at the wrong temperature."""
    Path("parted.yaml").write_text(PARTED)
    twin_with("time_constant: 60.0")
    calibration, _ = run("parted.yaml", Returning())
    assert calibration.positions[1].temperature == pytest.approx(24.0, abs=2.0 + 0.92)


def _seconds(stamp: str) -> float:
    hours, minutes, seconds = stamp.rstrip("Z").split("T")[1].split(":")
    return 3600 * int(hours) + 60 * int(minutes) + float(seconds)


class TestBeforeTheFirstPrompt:
    def test_output_in_a_folder_that_takes_no_file(self, tmp_path: Path) -> None:
        result = measure("-o", "/proc/S-1.yaml", "--journal", "S-1.jsonl", cwd=tmp_path)
        assert result.returncode == 2
        assert "/proc/S-1.yaml" in result.stderr
        assert "1/4" not in result.stderr
        assert list(tmp_path.iterdir()) == []

    def test_output_in_a_folder_that_is_not_there(self, tmp_path: Path) -> None:
        result = measure("-o", "there/S-1.yaml", cwd=tmp_path)
        assert result.returncode == 2
        assert "no folder" in result.stderr
        assert list(tmp_path.iterdir()) == []

    def test_an_angle_beyond_the_sensors_range(self, tmp_path: Path) -> None:
        result = measure("--sensor", "sca100t-d01", "--tilt", "45", cwd=tmp_path)
        assert result.returncode == 2
        assert "outside the range of sca100t-d01" in result.stderr

    def test_the_virtual_jig_moves_no_real_sensor(self, tmp_path: Path) -> None:
        result = measure("--address", "spi:///dev/spidev9.9", cwd=tmp_path)
        assert result.returncode in (2, 3)
        assert list(tmp_path.iterdir()) == []

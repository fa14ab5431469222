"""The session on the virtual bench: what is refused, what is waited for, what is told."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from support import ROOT

from tiltcal import Calibration
from tiltcal.bench.journal import calibrations_of
from tiltcal.drivers.virtual import Fixture, VirtualPart
from tiltcal.errors import HardwareError
from tiltcal.files.journal import read_journal
from tiltcal.files.results import PositionSet
from tiltcal.library.measure import measure as measure_here

Event = dict[str, Any]

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


def run(
    procedure: str = "plane", operator: object = "sim", model: str = "sca100t-d02"
) -> tuple[Calibration, list[str]]:
    """A session in the working folder, and what was said in it."""
    said: list[str] = []
    sensor = {"sensor": model, "serial": "S-1", "address": "sim:?twin=twin.yaml"}
    found = measure_here(procedure, operator=operator, output="S-1.yaml", remark=said.append, **sensor)
    assert isinstance(found, Calibration)
    return found, said


def twin_with(line: str) -> None:
    Path("twin.yaml").write_text(TWIN + f"  {line}\n")


class Clumsy:
    """Types, at the second position, the angle of the first one: the sensor is where it was."""

    def position(self, ask: Event) -> Event:
        return {"answer": "ready"} | ({"gravity": [0.0, 0.0, 1.0]} if ask["position"] == "x-tilt2" else {})


def test_what_was_typed_is_what_is_judged(bench: Path) -> None:
    """Level typed for a position, and level taken: odd, but consistent, so it counts as typed."""
    calibration, _ = run("plane", Clumsy())
    assert calibration.record.procedure.set["x-tilt2"] == PositionSet(gravity=(0.0, 0.0, 1.0))


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
    assert list(calibration.offset.values()) == pytest.approx([1026.0, 1021.0], abs=0.3)
    sensitivity = calibration.record.coefficients.sensitivity[:, :2].ravel()
    assert sensitivity == pytest.approx([817.4, 11.2, -7.9, 821.6], abs=0.9)


def test_a_session_that_a_fault_ended_goes_on_once_the_fault_is_gone(bench: Path) -> None:
    twin_with("faults: [{kind: unplugged, start: 5.0, end: 11.0}]")
    with pytest.raises(HardwareError, match="unplugged"):
        run()
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
    # Windows of a minute have a third of the readings, and a third of the judgements.
    shipped = (ROOT / "procedures" / "two-temperature.yaml").read_text()
    Path("two.yaml").write_text(shipped.replace("soak: {seconds: 20,", "soak: {seconds: 60,"))
    move = Fixture.move
    monkeypatch.setattr(Fixture, "move", lambda fixture, gravity, to=None, _=0.0: move(fixture, gravity, to, 1.0))
    monkeypatch.setattr(VirtualPart, "_celsius", lambda part: part._fixture.temperature(300.0))
    found, _ = run("two.yaml", model="scl3300")
    assert found.positions[1].temperature == pytest.approx(5.5, abs=0.15)
    thermal = found.record.coefficients.thermal
    assert thermal is not None
    for drift, channel, truth in zip(thermal.drift[:, 0], "xy", (6.0, -6.0), strict=False):
        name = f"temperature.offset.{channel}.1"
        # What is left of the lag, 0.1 °C, is in no uncertainty unless a thermometer's is stated.
        assert abs(drift - truth) < 1.5 * found.uncertainty[name] * found.uncertainty.coverage_factor[name]


PARTED = """\
tiltcal: 1
kind: procedure
name: parted
title: Two positions at one temperature, and two at another
determines: {axes: [], drift: 1}
reference: 24.0
soak: {seconds: 20, drift: 0.3}
positions:
  - {name: warm-1, tilt: {x: 0, y: 0}, temperature: 24.0, prompt: "Level."}
  - {name: warm-2, tilt: {x: 0, y: 0}, temperature: 24.0, prompt: "Still level."}
  - {name: cold, tilt: {x: 0, y: 0}, temperature: 5.5, prompt: "Cool."}
  - {name: colder, tilt: {x: 0, y: 0}, temperature: 5.5, prompt: "Still cool."}
"""


class Returning:
    """Goes back from the last position to the second, over the cold one that was measured."""

    def __init__(self) -> None:
        self._words = iter(["ready", "ready", "ready", "back", "back"])

    def position(self, ask: Event) -> Event:
        return {"answer": next(self._words, "ready")}


def test_a_temperature_is_waited_for_again_after_another_one(bench: Path) -> None:
    """With a time constant of a minute, what is measured at once is measured at the wrong temperature."""
    Path("parted.yaml").write_text(PARTED)
    twin_with("time_constant: 60.0")
    calibration, _ = run("parted.yaml", Returning())
    assert calibration.positions[1].temperature == pytest.approx(24.0, abs=2.0 + 0.92)


def _seconds(stamp: str) -> float:
    hours, minutes, seconds = stamp.rstrip("Z").split("T")[1].split(":")
    return 3600 * int(hours) + 60 * int(minutes) + float(seconds)

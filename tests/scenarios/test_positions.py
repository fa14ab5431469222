"""Positions on the virtual bench: what is refused, waited for and told, and no wrong number without a word."""

import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import scipy
from support.command import tiltcal

from tiltcal import Calibration, measure
from tiltcal.bench import devices
from tiltcal.bench.settle import Window
from tiltcal.errors import Stopped

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


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("twin.yaml").write_text(TWIN)


def session(procedure: str = "plane", said: list[str] | None = None, **options: Any) -> Calibration:
    """A session in the working folder."""
    chosen = {"sensor": "sca100t-d02", "address": "sim:?twin=twin.yaml", "serial": "S-1", "output": "S-1.yaml"}
    remark = (said if said is not None else []).append
    found = measure(procedure, remark=remark, **{"operator": "sim", **chosen, **options})
    assert isinstance(found, Calibration)
    return found


Change = Callable[[bytes, bytes, int], bytes]


def disturb(monkeypatch: pytest.MonkeyPatch, change: Change) -> None:
    """Let ``change(out, answer, number)`` alter what the virtual part answers to its n-th transaction of a kind."""
    connect = devices.open_device

    class Disturbed:
        letter = "s"

        def __init__(self, *args: Any) -> None:
            self._link = connect(*args)
            self._counts: dict[bytes, int] = {}
            self.close = self._link.close

        def exchange(self, out: bytes, count: int = 0) -> bytes:
            self._counts[out] = self._counts.get(out, 0) + 1
            return change(out, self._link.exchange(out, count), self._counts[out])

    monkeypatch.setattr(devices, "open_device", Disturbed)


def word(value: int) -> bytes:
    """An SCA100T's answer: 11 bits behind the first byte."""
    return bytes([0, value >> 3, (value & 7) << 5])


def degrees(celsius: float) -> bytes:
    """An SCA100T's thermometer: T = (counts - 197) / -1.083."""
    return bytes([0, max(0, min(255, round(197 - 1.083 * celsius)))])


def test_a_channel_at_its_rail_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """11 bits end at 2047."""
    disturb(monkeypatch, lambda out, answer, n: word(2047) if out[0] == 0x10 else answer)
    with pytest.raises(Stopped, match=r"x-tilt1 failed 10 times in a row.* x reads 2047, at its rail: is the angle"):
        session(samples=20)
    assert not Path("S-1.yaml").exists()


@pytest.mark.parametrize(("procedure", "flickers"), [("reversal", 0), ("two-temperature", 1)])
def test_a_converter_that_never_followed_is_in_the_file(
    procedure: str, flickers: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The procedure has one attitude; a dead converter shows one code, or flickers between two."""
    disturb(monkeypatch, lambda out, answer, n: word(1024 + flickers * (n // 3 % 2)) if out[0] == 0x10 else answer)
    found = session(procedure, samples=20)
    assert [note.split()[0] for note in found.fit.notes if "was not seen to follow" in note] == ["x"]
    checked = tiltcal("check", "S-1.yaml")
    assert checked.returncode == (0 if flickers else 1)
    assert "no channel followed" not in checked.stdout  # y did
    assert ("x was not seen to follow any movement" in checked.stdout) == (not flickers)
    tiltcal("replay", "S-1.journal.jsonl", "--golden", "S-1.yaml", code=0)


def test_one_sample_of_a_hundred_that_is_far_off_is_taken_again_and_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """578 counts in one of a hundred samples would move a mean by 5.8 counts, ten times the noise; and 135 °C once."""

    def change(out: bytes, answer: bytes, number: int) -> bytes:
        if out[0] == 0x10 and number == 120:
            return word((answer[1] << 3 | answer[2] >> 5) - 578)
        return degrees(135.0) if out[0] == 0x08 and number == 400 else answer

    disturb(monkeypatch, change)
    found = session()
    assert [one.left_out for one in found.positions].count(1) == 2
    assert found.offset["x"] == pytest.approx(1026.0, abs=0.4)
    assert [one.n for one in found.positions] == [100] * 4
    tiltcal("replay", "S-1.journal.jsonl", "--golden", "S-1.yaml", code=0)


@pytest.mark.parametrize(("kind", "why"), [("parity", "102"), ("unplugged", "unplugged")])
def test_a_fault_that_passes_costs_a_redo(kind: str, why: str) -> None:
    """The first position takes about 3 s; the fault begins in the second."""
    Path("twin.yaml").write_text(f"{TWIN}  faults: [{{kind: {kind}, start: 5.0, end: 5.2}}]\n")
    said: list[str] = []
    found = session(said=said)
    refused = [line for line in said if "refused" in line]
    assert refused
    assert all(why in line for line in refused)
    assert list(found.offset.values()) == pytest.approx([1026.0, 1021.0], abs=0.3)
    assert found.record.coefficients.sensitivity[0, :2] == pytest.approx([817.4, 11.2], abs=0.9)


def test_a_closing_visit_shows_a_sensor_that_was_knocked(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the fourth position x steps by 12 counts, 15 mg; each position takes about 140 readings."""
    said: list[str] = []
    quiet = session(said=said, closing=True, journal="quiet.jsonl", jig=0.05)
    assert [one.position for one in quiet.positions][-1] == "x-tilt1-again"
    assert re.search(r"S-1: back in x-tilt1 the readings have changed by x [+-]0\.\d+ ± 0\.\d+ count", said[-1])
    step = 12

    def change(out: bytes, answer: bytes, number: int) -> bytes:
        return word((answer[1] << 3 | answer[2] >> 5) + step) if out[0] == 0x10 and number > 430 else answer

    disturb(monkeypatch, change)
    knocked = session(said=said, closing=True, jig=0.05)
    change_of_x = re.search(r"changed by x \+(\d+\.?\d*) ±", said[-1])
    assert change_of_x is not None
    assert float(change_of_x[1]) == pytest.approx(step, abs=1.5)
    p = [scipy.stats.chi2.sf(one.fit.chi_square, one.fit.degrees_of_freedom) for one in (knocked, quiet)]
    assert p[0] < 1e-3 < p[1]


def test_a_sensor_whose_offset_nobody_states_is_said_to_be_compared_with_itself_alone() -> None:
    said: list[str] = []
    session(said=said, sensor="serial-columns", address="sim:columns=x,y&unit=V&sensitivity=2", samples=5)
    assert any(re.fullmatch(r"S-1: \d\d+ lines, 0 damaged", one) for one in said)
    assert any("S-1: no offset= is stated, so that positions are compared with each other" in one for one in said)


PARTED = """\
tiltcal: 1
kind: procedure
name: parted
title: Two positions at one temperature, and two at another
determines: {axes: [], drift: 1}
reference: 24.0
soak: {seconds: 20, drift: 0.3, thermometer: 60}
positions:
  - {name: warm-1, tilt: {x: 0, y: 0}, temperature: 24.0, prompt: "Level."}
  - {name: warm-2, tilt: {x: 0, y: 0}, temperature: 24.0, prompt: "Still level."}
  - {name: cold, tilt: {x: 0, y: 0}, temperature: 5.5, prompt: "Cool."}
  - {name: colder, tilt: {x: 0, y: 0}, temperature: 5.5, prompt: "Still cool."}
"""


def test_how_long_a_position_and_a_new_temperature_have_to_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    """Twice the settling is twice the soak; back from the cold to a warm one; a typed temperature needs no near one."""
    windows, go, back = list[Window](), {"answer": "ready"}, {"answer": "back"}
    monkeypatch.setattr("tiltcal.bench.session.wait_until_still", lambda _, __, window, ___: windows.append(window))
    Path("parted.yaml").write_text(PARTED)
    said = iter([go, go, go, back, back, go, {**go, "temperature": 5.5}, go])
    session("parted.yaml", samples=5, settle=4.0, operator=SimpleNamespace(position=lambda ask: next(said)))
    warm, cold, typed = (Window(40.0, 0.3, target, 120.0) for target in (24.0, 5.5, None))
    assert windows == [warm, Window(4.0), cold, warm, typed, Window(4.0)]

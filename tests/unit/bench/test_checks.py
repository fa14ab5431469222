"""Sessions of virtual parts whose sensor, line or thermometer fails: no wrong number without a word."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import scipy
from support.command import tiltcal

from tiltcal import Calibration, measure
from tiltcal.bench import devices, settle
from tiltcal.bench.checks import PositionResult, require_plausible_temperature
from tiltcal.bench.session import Session
from tiltcal.bench.settle import Unsettled
from tiltcal.calibration.measurement import Measurement
from tiltcal.core.samples import summarise
from tiltcal.errors import Stopped
from tiltcal.files.procedure import Position, find_procedure

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


def session(procedure: str, said: list[str] | None = None, **options: Any) -> Calibration:
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


def test_a_sensor_that_is_stuck_from_the_first_sample_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    disturb(monkeypatch, lambda out, answer, n: word(1024) if out[0] in (0x10, 0x11) else answer)
    why = (
        r"x-tilt1 was asked for 10 times in a row in vain, the last time .*x reads 1024 where about 1433\.5 is expected"
    )
    with pytest.raises(Stopped, match=why):
        session("plane")
    assert not Path("S-1.yaml").exists()


class Table:
    """A rig that notes what it is asked for, and what is refused; after three refusals it quits."""

    def __init__(self, answer: dict[str, Any] | None = None) -> None:
        self.asks: list[dict[str, Any]] = []
        self.refusals: list[str] = []
        self._answer = answer or {"answer": "ready"}

    def position(self, ask: dict[str, Any]) -> dict[str, Any]:
        self.asks.append(ask)
        return {"answer": "quit"} if len(self.refusals) > 2 else self._answer

    def refused(self, event: dict[str, Any]) -> None:
        self.refusals.append(f"{event['position']}: {event['why']}")


def frozen(out: bytes, answer: bytes, number: int) -> bytes:
    return word(1024) if out[0] == 0x10 else answer


def flickering(out: bytes, answer: bytes, number: int) -> bytes:
    return word(1024 + number // 3 % 2) if out[0] == 0x10 else answer


@pytest.mark.parametrize(
    ("procedure", "dead"),
    [("reversal", frozen), ("two-temperature", flickering), ("temperature-sweep", frozen)],
)
def test_a_dead_converter_is_tipped_and_what_does_not_follow_is_in_the_file(
    procedure: str, dead: Change, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The procedure has one attitude; a converter that shows one code, or flickers between two, looks like a sensor."""
    disturb(monkeypatch, dead)
    found = session(procedure, operator=(table := Table()), samples=20)
    positions = [position.name for position in find_procedure(procedure).positions]
    assert [ask["position"] for ask in table.asks] == [*positions, "tip"]
    assert table.asks[-1]["prompt"].startswith("x of S-1: no change was seen. Tip it by hand")
    assert not table.refusals
    assert [note.split()[0] for note in found.fit.notes if "was not seen to follow" in note] == ["x"]
    checked = tiltcal("check", "S-1.yaml")
    assert checked.returncode == 1
    assert "x was not seen to follow when the sensor was tipped" in checked.stdout
    assert tiltcal("replay", "S-1.journal.jsonl", "--golden", "S-1.yaml").returncode == 0


@pytest.mark.parametrize("offset", [1026.1, 1026.5])
def test_a_sound_sensor_that_stands_still_is_tipped_once_and_good(offset: float) -> None:
    """Noise of a fiftieth of a step, no drift: one code, or two where the reading lies between them."""
    quiet = TWIN.replace("{x: 0.6, y: 0.6}", "{x: 0.02, y: 0.6}").replace("x: [0.4]", "x: [0.0]")
    Path("twin.yaml").write_text(quiet.replace("x: 1026.0", f"x: {offset}"))
    found = session("reversal", operator=(table := Table()))
    assert [ask["position"] for ask in table.asks].count("tip") == 1
    assert not any("was not seen to follow" in note for note in found.fit.notes)
    assert tiltcal("check", "S-1.yaml").returncode == 0
    assert tiltcal("replay", "S-1.journal.jsonl", "--golden", "S-1.yaml").returncode == 0


def test_a_session_that_is_stopped_at_the_tip_is_resumed_there(monkeypatch: pytest.MonkeyPatch) -> None:
    disturb(monkeypatch, frozen)
    session("reversal", journal="whole.jsonl", samples=10)
    lines = Path("whole.jsonl").read_bytes().splitlines(keepends=True)
    tip = next(number for number, line in enumerate(lines) if b'"to":"tip"' in line)
    for end in (tip, tip + 1, tip + 2):
        Path("whole.jsonl").write_bytes(b"".join(lines[:end]))
        found = measure(resume="whole.jsonl", operator="sim")
        assert [note.split()[0] for note in found.fit.notes if "was not seen to follow" in note] == ["x"]


@pytest.mark.parametrize("procedure", ["two-temperature", "reversal", "mavs"])
def test_a_sensor_that_freezes_between_positions_of_one_attitude_is_refused(
    procedure: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From its last position of level on, which reads as the one before: in two-temperature the drift would be zero."""
    last = find_procedure(procedure).positions[-1]
    frozen: dict[bytes, bytes] = {}
    held: list[Position] = []
    hold = Session._hold

    def noted(session: Session, position: Position) -> None:
        held.append(position)
        hold(session, position)

    def change(out: bytes, answer: bytes, number: int) -> bytes:
        if held and held[-1].name == last.name and out[0] in (0x10, 0x11):
            return frozen[out]
        frozen[out] = answer
        return answer

    monkeypatch.setattr(Session, "_hold", noted)
    disturb(monkeypatch, change)
    why = r"x of S-1 is stuck: all 100 samples read \d+ count, and those of the positions before scatter by 0\.\d+"
    with pytest.raises(Stopped, match=why):
        session(procedure)
    assert not Path("S-1.yaml").exists()


def test_a_coarse_reading_that_flickers_in_one_position_and_stands_still_in_the_next_is_not_stuck() -> None:
    """Noise of a fiftieth of a step: 1026.5 lies between two values, and 18.5 °C colder 1026.5 - 7.4 does not."""
    Path("twin.yaml").write_text(
        TWIN.replace("noise: {x: 0.6, y: 0.6}", "noise: {x: 0.02, y: 0.02}").replace("x: 1026.0", "x: 1026.5")
    )
    found = session("two-temperature")
    assert [one.std["x"] > 0.4 for one in found.positions] == [True, False]
    assert found.positions[1].std["x"] == 0.0


def test_one_sample_of_a_hundred_that_is_far_off_is_taken_again_and_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """578 counts in one of a hundred samples would move a mean by 5.8 counts, ten times the noise; and 135 °C once."""
    undisturbed = session("plane", journal="first.jsonl")

    def change(out: bytes, answer: bytes, number: int) -> bytes:
        if out[0] == 0x10 and number == 120:
            return word((answer[1] << 3 | answer[2] >> 5) - 578)
        return degrees(135.0) if out[0] == 0x08 and number == 400 else answer

    disturb(monkeypatch, change)
    found = session("plane", journal="second.jsonl")
    assert [one.left_out for one in found.positions].count(1) == 2
    assert [one.left_out for one in found.positions].count(None) == 2
    assert found.offset["x"] == pytest.approx(undisturbed.offset["x"], abs=0.4)
    assert [one.n for one in found.positions] == [100] * 4


def test_many_samples_far_off_are_a_fault_that_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def change(out: bytes, answer: bytes, number: int) -> bytes:
        if out[0] == 0x10 and number % 12 == 0:
            return word((answer[1] << 3 | answer[2] >> 5) - 60)
        return answer

    disturb(monkeypatch, change)
    with pytest.raises(Stopped, match="samples of a position of 100 are far off: x reads"):
        session("plane", settle=0.05)


# An SCA100T's thermometer: T = (counts - 197) / -1.083.
def degrees(celsius: float) -> bytes:
    return bytes([0, max(0, min(255, round(197 - 1.083 * celsius)))])


def test_a_thermometer_that_says_85_all_the_time_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    disturb(monkeypatch, lambda out, answer, n: degrees(85) if out[0] == 0x08 else answer)
    monkeypatch.setattr(settle, "SOAK_LOOKS", 40)  # each of ten attempts waits for ten windows
    with pytest.raises(Stopped, match=r"is what the thermometer reads, and 24 °C was asked for: one of them is wrong"):
        session("two-temperature")


@pytest.mark.parametrize(
    ("temperature", "why"),
    [
        (9999.0, "temperature in the answer is 9999 °C, not between -60 and 150"),
        (-127.0, "temperature in the answer is -127 °C, not between -60 and 150"),
        (55.0, "55 °C was typed, and 24 °C was asked for: one of them is wrong"),
    ],
)
def test_a_temperature_that_is_answered_is_judged_too(temperature: float, why: str) -> None:
    with pytest.raises(Stopped):
        session("two-temperature", operator=(table := Table({"answer": "ready", "temperature": temperature})))
    assert table.refusals[0] == f"level-warm: {why}"


def test_a_closing_visit_shows_a_sensor_that_was_knocked(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the fourth position x steps by 12 counts, 15 mg; each position takes about 140 readings."""
    said: list[str] = []
    quiet = session("plane", said, closing=True, journal="quiet.jsonl", jig=0.05)
    assert [one.position for one in quiet.positions][-1] == "x-tilt1-again"
    assert re.search(r"S-1: back in x-tilt1 the readings have changed by x [+-]0\.\d+ ± 0\.\d+ count", said[-1])
    step = 12

    def change(out: bytes, answer: bytes, number: int) -> bytes:
        return word((answer[1] << 3 | answer[2] >> 5) + step) if out[0] == 0x10 and number > 430 else answer

    disturb(monkeypatch, change)
    knocked = session("plane", said, closing=True, jig=0.05)
    change_of_x = re.search(r"changed by x \+(\d+\.?\d*) ±", said[-1])
    assert change_of_x is not None
    assert float(change_of_x[1]) == pytest.approx(step, abs=1.5)
    p = [scipy.stats.chi2.sf(one.fit.chi_square, one.fit.degrees_of_freedom) for one in (knocked, quiet)]
    assert p[0] < 1e-3 < p[1]


def test_a_thermometer_at_its_power_on_value_is_refused_where_no_temperature_is_asked_for() -> None:
    """A DS18B20's data sheet: 85 °C stands in its register until the first conversion."""
    position = find_procedure("plane").positions[0]
    summaries = {"x": summarise([1.0, 2.0]), "y": summarise([1.0, 2.0])}
    at = {
        celsius: PositionResult(
            position, {"S-1": Measurement(position.name, position.gravity, position.tilt, celsius, summaries)}
        )
        for celsius in (85.0, 84.94)
    }
    with pytest.raises(Unsettled, match=r"reads 85 °C in every sample, as a DS18B20 does that converts nothing"):
        require_plausible_temperature(at[85.0], [])
    require_plausible_temperature(replace(at[85.0], asked=85.0), [])
    require_plausible_temperature(replace(at[85.0], typed=True), [])
    require_plausible_temperature(at[84.94], [])

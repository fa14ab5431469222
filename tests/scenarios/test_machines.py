"""Tables and chambers that move by themselves: a night without a person, faults, and what is left to a person."""

import json
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import invalidate_caches
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.command import tiltcal
from support.moving_machines import (
    CHAMBER,
    TABLE,
    VirtualChamber,
    VirtualTable,
    by_clock,
    movers_of,
    serving,
    serving_registers,
)

from tiltcal.bench.drives import TextDrive
from tiltcal.bench.machines import Machines, angles_of, gravity_of
from tiltcal.bench.messages import PositionQuestion, Review
from tiltcal.bench.operators import VirtualJig
from tiltcal.drivers import find_model
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.errors import HardwareError
from tiltcal.files.calibration import read_calibration
from tiltcal.files.procedure import find_procedure
from tiltcal.journal.lines import ANSWER, Journal

SENSORS = "".join(f'  - {{serial: A-{n}, model: adxl202-analog, address: "sim:?seed={n}"}}\n' for n in range(2))

BENCH = """\
tiltcal: 1
kind: bench
jig: 0.05
thermometer: {{model: thermistor, address: "sim:"}}
table:
  kind: text
  address: {table}
  limits: {{x: [-95, 95], y: [-95, 95]}}
  tolerance: 0.05
  approach: 2
  timeout: 30
  start: [$H]
  set: ["G0 X{{x:.3f}} Y{{y:.3f}}"]
  accepted: ^ok
  failed: error|ALARM
  read: "?"
  read_alone: true
  pattern: MPos:(?P<x>[-0-9.]+),(?P<y>[-0-9.]+)
  done: <Idle
  stop: "!"
chamber:
  kind: modbus
  address: {chamber}
  limits: {{temperature: [-40, 90]}}
  tolerance: 0.5
  registers: {{temperature: {{set: "100:int16*0.1", read: "200:int16*0.1"}}}}
sensors:
{sensors}"""


@contextmanager
def machines(folder: Path, sensors: str = SENSORS) -> Iterator[VirtualTable]:
    """A table on a socket and a chamber behind pymodbus, whose time goes on with each look at them."""
    rng = np.random.default_rng(1)
    table, chamber = VirtualTable(rng, lambda: 0.1), VirtualChamber(rng, lambda: 10.0)
    table.switch_on()
    with serving(table.line) as place, serving_registers(chamber.line) as registers:
        (folder / "bench.yaml").write_text(BENCH.format(table=place, chamber=registers, sensors=sensors))
        yield table


def answers(folder: Path, journal: str = "bench.journal.jsonl") -> list[dict]:
    """What was answered to each position."""
    events = Journal(folder / journal)
    return [one.payload[0] for one in events if one.kind == ANSWER and one.payload[0]["to"] == "position"]


def test_a_night_without_a_person_and_with_a_power_cut(tmp_path: Path) -> None:
    """Two sensors, nine temperatures, nobody at the keyboard; the journal is cut in the middle of a line."""
    pytest.importorskip("pymodbus", reason="the pymodbus package is not installed")
    options = (*QUICK[:4], "--samples", "10", "--settle", "0.05")
    with machines(tmp_path) as table:
        done = tiltcal("measure", "temperature-sweep", *options, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        said = [json.loads(line) for line in done.stdout.splitlines()]
        assert not [one for one in said if "ask" in one]
        assert [one["position"] for one in said if one.get("event") == "accepted"][-1] == "back-24"
        waits = [one["seconds"] for one in said if one.get("event") == "waiting" and one["position"] == "up-40"]
        assert waits[:3] == [60, 120, 180], "once a minute of the bench's clock"
        for number in range(2):
            (tmp_path / f"A-{number}.yaml").rename(tmp_path / f"whole-{number}.yaml")
        journal = tmp_path / "bench.journal.jsonl"
        os.truncate(journal, int(0.55 * journal.stat().st_size))
        table.switch_on()
        resumed = tiltcal("measure", "--resume", journal, "--operator", "json", cwd=tmp_path)
        assert resumed.returncode == 0, resumed.stderr
        again = [json.loads(line) for line in resumed.stdout.splitlines()]
        assert 1 < len([one for one in again if one.get("event") == "accepted"]) < 9
    for number in range(2):
        calibration = read_calibration(tmp_path / f"A-{number}.yaml")
        assert len(calibration.positions) == 9
        truth = find_model("adxl202-analog").default_truth(number)
        for channel, drift in zip("xy", calibration.coefficients.thermal.drift[:, 0], strict=True):
            u = calibration.uncertainty[f"temperature.offset.{channel}.1"]
            assert abs(drift - truth.drift[channel][0]) < 4 * u
        assert tiltcal("diff", f"whole-{number}.yaml", f"A-{number}.yaml", cwd=tmp_path).returncode == 0


@pytest.mark.parametrize("name", ["table", "chamber"])
def test_a_machine_that_has_moved_while_it_was_sampled_is_refused(name: str) -> None:
    """By ten tolerances, between the answer and the review; the chamber's door lets its temperature fall."""
    clock, rng = VirtualClock(), np.random.default_rng(1)
    table, chamber = VirtualTable(rng, by_clock(clock)), VirtualChamber(rng, by_clock(clock))
    movers = movers_of({"table": (TABLE, table), "chamber": (CHAMBER, chamber)}, clock)
    steps = find_procedure("mavs")
    operator = Machines(VirtualJig(), movers, steps, clock, thermometer=True)
    first = {**vars(steps.positions[0]), "heading": 0}
    question = PositionQuestion(position=first.pop("name"), **first)
    assert operator.ask(question) == {"answer": "ready", "tilt": {"x": 45.0, "y": 0.0}}
    assert operator.ask(Review("x-45", {})) == {"answer": "accept"}
    if name == "table":
        table.axis = table.motor = table.target = table.axis - 0.5
    else:
        chamber.temperature -= 5.0
    with pytest.raises(HardwareError, match=f"{name}: it was at .*, and is at "):
        operator.ask(Review("x-45", {}))


def test_what_a_machine_began_to_say_is_no_part_of_its_next_answer() -> None:
    """A chamber that also talks unasked; the link of a serial port drops what arrived before a question."""
    answers = iter((b"PV=10.0\nPV=1", b"PV=45.0\n"))
    link = SimpleNamespace(exchange=lambda out, count: next(answers))
    chamber = TextDrive(CHAMBER, cast(Any, link))
    assert [chamber.read()[0]["temperature"] for _ in range(2)] == [10.0, 45.0]


def test_a_table_that_creeps_is_awaited() -> None:
    """It tells no state and goes 0.04° from look to look: within its tolerance of 0.05° it still moves."""

    class Nobody(VirtualJig):
        def ask(self, question: object) -> object:
            raise AssertionError(question)

    clock = VirtualClock()
    table = VirtualTable(np.random.default_rng(1), by_clock(clock))
    table.speed = 0.2
    movers = movers_of({"table": (TABLE.replaced(done=None), table)}, clock)
    operator = Machines(Nobody(), movers, find_procedure("plane"), clock, thermometer=True)
    up = gravity_of({"x": 2.0, "y": 0.0}, "x")
    asked = {"position": "x", "prompt": "", "gravity": up, "tilt": {"x": 2.0}, "heading": 0, "temperature": None}
    assert operator.ask(PositionQuestion(**asked, stage=None)) == {"answer": "ready", "tilt": {"x": 2.0, "y": 0.0}}
    assert operator.ask(Review("x", {})) == {"answer": "accept"}  # what no person has set, none reviews


SENSOR = '  - {serial: S-1, model: sca100t-d02, address: "sim:?seed=1"}\n'
QUICK = ("--bench", "bench.yaml", "--operator", "json", "--samples", "5", "--settle", "0.5")


def measured(
    folder: Path, procedure: str, machines: str, *options: str, said: str = "", sensor: str = SENSOR
) -> list[str]:
    """Measure with the machines of a bench file, and return the positions for which a program was asked."""
    (folder / "bench.yaml").write_text(f"tiltcal: 1\nkind: bench\njig: 0.05\nsensors:\n{sensor}{machines}")
    done = tiltcal("measure", procedure, *QUICK, *options, cwd=folder, said=said)
    assert done.returncode == 0, done.stderr
    return [one["position"] for one in map(json.loads, done.stdout.splitlines()) if "ask" in one]


RIG = """\
class Status:
    done, success = True, {success}

class Axis:
    sent = []

    def __init__(self, name):
        self.name, self.at = name, 0.0

    def set(self, value):
        self.at = value + 0.02
        self.sent.append(value)
        return Status()

    def read(self):
        return {{self.name: {{"value": self.at}}, self.name + "_setpoint": {{"value": self.at - 0.02}}}}

def table_x():
    return Axis("x")

def table_y():
    return Axis("tilt")
"""
OBJECTS = """\
table:
  kind: object
  limits: {x: [-90, 90], y: [-90, 90]}
  tolerance: 0.05
  objects: {x: {address: "python:tilt_rig:table_x"}, y: {address: "python:tilt_rig:table_y", reading: tilt}}
"""


def test_a_dry_run_reaches_every_position_without_a_sensor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It opens no sensor and writes nothing; a position that is not reached is named. The table goes 30 °/s."""
    table, sensor = (
        VirtualTable(np.random.default_rng(1), lambda: 0.1),
        SENSOR.replace("sim:?seed=1", "spi:///dev/none"),
    )
    monkeypatch.setattr("tiltcal.bench.dry_run.session_clock", lambda began, virtual: VirtualClock())
    with serving(table.line) as place:
        bench = BENCH.split("chamber:")[0].format(table=place).replace("thermometer: {model: thermistor, ", "#")
        (tmp_path / "bench.yaml").write_text(f"{bench}sensors:\n{sensor}")
        done = tiltcal("measure", "plane", "--bench", "bench.yaml", "--dry-run", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        found = re.findall(r"(\d)/4  (\S+) +x (\S+)°, y (\S+)°   (\d+) s\n", done.stdout)
        assert [(number, name) for number, name, *_ in found] == [
            *zip("1234", ("x-tilt1", "x-tilt2", "y-tilt1", "y-tilt2"), strict=True)
        ]
        reached = [(float(x), float(y)) for _, _, x, y, _ in found]
        assert reached == [pytest.approx(pair, abs=0.05) for pair in ((30, 0), (-30, 0), (0, 30), (0, -30))]
        assert re.search(r"went from -30\S* to (30|29.9)\S* in x; its limits are -95 and 95\n", done.stdout)
        assert list(tmp_path.iterdir()) == [tmp_path / "bench.yaml"]
        table.speed = 0.0
        (tmp_path / "bench.yaml").write_text(f"{bench}sensors:\n{sensor}".replace("timeout: 30", "timeout: 1"))
        stalled = tiltcal("measure", "plane", "--bench", "bench.yaml", "--dry-run", cwd=tmp_path)
    assert stalled.returncode == 3
    assert "x-tilt1: table: it is at" in stalled.stderr
    refused = tiltcal("measure", "plane", "--sensor", "sca100t-d02", "--dry-run", cwd=tmp_path)
    assert refused.returncode == 2


def test_an_object_with_set_and_read_moves_the_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What it reads back is the angle that was set; one that fails stops the session until it is mended.

    A file from elsewhere imports nothing of the present folder that nobody named.
    """
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "tilt_rig.py").write_text(RIG.format(success=False))
    with pytest.raises(AssertionError, match="x-tilt1 failed 3 times in a row: table: x has not got there") as stopped:
        measured(tmp_path, "plane", OBJECTS, "--python", "tilt_rig")
    assert "continue with: tiltcal measure --resume bench.journal.jsonl" in str(stopped.value)
    assert sys.modules["tilt_rig"].Axis.sent == [30.0, 0.0] * 3
    (tmp_path / "tilt_rig.py").write_text(RIG.format(success=True))
    monkeypatch.delitem(sys.modules, "tilt_rig")
    invalidate_caches()
    resume = ("measure", "--resume", "bench.journal.jsonl", "--operator", "json")
    for command, file in (
        (resume, "bench.journal.jsonl"),
        (("measure", "plane", *QUICK, "--python", "numpy"), "bench.yaml"),
        (("record", "--bench", "bench.yaml", "--rows", "2", "-o", "log.csv"), "bench.yaml"),
    ):
        refused = tiltcal(*command, cwd=tmp_path)
        assert (refused.returncode, refused.stdout, "tilt_rig" in sys.modules) == (2, "", False)
        assert f"{file} names tilt_rig, a module of Python that would be imported" in refused.stderr
        assert "if you trust it, say --python tilt_rig" in refused.stderr
    done = tiltcal(*resume, "--python", "tilt_rig", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    told = [tuple(one["tilt"].values()) for one in answers(tmp_path)]
    # The tilt of the axis that is carried is asin(cos 30.02° sin 0.02°), 0.017°.
    expected = [(30.02, 0.017), (-29.98, 0.017), (0.02, 30.02), (0.02, -29.98)]
    assert told == [pytest.approx(pair, abs=1e-3) for pair in expected]


ONE_AXIS = """\
table:
  kind: text
  address: {place}
  limits: {{x: [-90, 90]}}
  tolerance: 0.05
  approach: 2
  set: ["G0 X{{x:.3f}} Y0"]
  read: "?"
  accepted: ok
  pattern: MPos:(?P<x>[-0-9.]+)
chamber:
  kind: modbus
  address: modbus:tcp://127.0.0.1:9
  limits: {{temperature: [0, 50]}}
  tolerance: 1
  registers: {{temperature: {{set: "1", read: "2"}}}}
"""


def test_what_no_machine_does_is_left_to_the_operator(tmp_path: Path) -> None:
    """A table of one axis: the other is asked for where it changes. A chamber that has nothing to do is left alone."""
    table = VirtualTable(np.random.default_rng(1), lambda: 0.1)
    said = '{"answer": "ready"}\n{"answer": "ready", "tilt": {"y": 30.02}}\n{"answer": "ready"}\n'
    with serving(table.line) as place:
        asked = measured(tmp_path, "plane", ONE_AXIS.format(place=place), said=said)
    assert asked == ["x-tilt1", "y-tilt1", "y-tilt2"]
    assert [one["tilt"] for one in answers(tmp_path)] == [{"x": 30.0}, {"x": -30.0}, {"x": 0.0, "y": 30.02}, {"x": 0.0}]


def test_a_chamber_alone_asks_for_the_attitude_once(tmp_path: Path) -> None:
    """Its temperature is answered where no device of the bench is a thermometer."""
    chamber = VirtualChamber(np.random.default_rng(1), lambda: 5.0)
    stated = 'limits: {temperature: [-40, 90]}, tolerance: 0.5, set: ["SP {temperature:.1f}"], read: PV'
    pattern = "'PV=(?P<temperature>[-0-9.]+)'"
    with serving(chamber.line) as place:
        machines = f"chamber: {{kind: text, address: '{place}', {stated}, pattern: {pattern}}}\n"
        sensor = SENSOR.replace("sca100t-d02", "adxl202-analog")
        asked = measured(tmp_path, "two-temperature", machines, said='{"answer": "ready"}\n', sensor=sensor)
    positions = find_procedure("two-temperature").positions
    assert asked == [positions[0].name]
    wanted = [position.temperature for position in positions]
    assert [one["temperature"] for one in answers(tmp_path)] == pytest.approx(wanted, abs=0.5)


def test_a_position_beyond_the_limits_is_refused_before_anything_is_opened(tmp_path: Path) -> None:
    bench = BENCH.format(table="serial:///dev/none", chamber="modbus:tcp://127.0.0.1:9", sensors=SENSOR)
    (tmp_path / "bench.yaml").write_text(bench.replace("x: [-95, 95]", "x: [-31, 95]"))
    refused = tiltcal("measure", "plane", *QUICK, cwd=tmp_path)
    assert refused.returncode == 2
    assert "x-tilt2 takes x of the table to -32, and its limits are -31 and 95: name a procedure" in refused.stderr
    assert not list(tmp_path.glob("*.jsonl"))


def test_a_bench_file_says_what_is_wrong_with_its_machines(tmp_path: Path) -> None:
    right = BENCH.format(table="serial:///dev/ttyUSB0", chamber="modbus:tcp://127.0.0.1:9", sensors=SENSOR)
    for before, after, where in (
        ("serial:///", "spi:///", "table: address 'spi:///dev/ttyUSB0': a machine of kind text has an address such as"),
        ("Y{y:.3f}", "", "table.set: nothing sets y: write {y} where its number belongs"),
        ("Y{y:.3f}", "Y{z}", "table.set[0]: 'G0 X{x:.3f} Y{z}' is no template of x, y"),
        ("(?P<y>", "(", "table.pattern: nothing reads y: the pattern needs the group (?P<y>...)"),
        ("error|ALARM", "error)", "table.failed: this is no regular expression"),
        ('  read: "?"\n', "", "table: the key 'read' is missing; a machine of kind text needs it"),
        ("kind: text", "kind: modbus", "table.set: a machine of kind modbus has no set: that is one of kind text"),
        ("temperature: [-40", "x: [-40", "chamber.limits.x: unknown key 'x'; known here: temperature"),
        ("[-40, 90]", "[90, -40]", "chamber.limits.temperature: the range [90, -40] is the wrong way round"),
        ("100:int16", "100:int17", "chamber: address 'modbus:tcp://127.0.0.1:9': type 'int17' of column temperature"),
        ("{temperature: {set", "{x: {set", "chamber.registers.x: unknown key 'x'"),
    ):
        assert before in right, before
        (tmp_path / "bench.yaml").write_text(right.replace(before, after, 1))
        checked = tiltcal("check", "bench.yaml", cwd=tmp_path)
        assert checked.returncode == 2, after
        assert re.fullmatch(rf"tiltcal: bench\.yaml:\d+: {re.escape(where)}.*\n", checked.stderr), checked.stderr


def test_the_angles_of_two_axes_of_which_one_carries_the_other() -> None:
    """Raising +X turns about -Y, raising +Y about +X; the carried axis turns with the one that carries it."""
    rng = np.random.default_rng(2)
    for carrier in "xy":
        for a, b in rng.uniform(-90, 90, (20, 2)):
            raised = {"x": Rotation.from_euler("y", -a, degrees=True), "y": Rotation.from_euler("x", b, degrees=True)}
            carried = "y" if carrier == "x" else "x"
            up = (raised[carrier] * raised[carried]).inv().apply([0.0, 0.0, 1.0])
            assert gravity_of({"x": a, "y": b}, carrier) == pytest.approx(up)
            assert angles_of(up, carrier) == pytest.approx({"x": a, "y": b})
    assert angles_of((0.0, -0.0, -1.0), "x") == {"x": 0.0, "y": 180.0}
    assert angles_of((-1.0, 0.0, 0.0), "x") == {"x": -90.0, "y": 0.0}

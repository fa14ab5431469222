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
import yaml
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

from tiltcal.bench.drives import CHUNK, ObjectDrive, TextDrive
from tiltcal.bench.machines import Machines, angles_of, gravity_of
from tiltcal.bench.messages import Accepted, Look, PositionQuestion, Question, Refused, Review, SessionEvent, Waiting
from tiltcal.bench.operators import Operator, in_words
from tiltcal.drivers import find_model
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.errors import BusError, HardwareError, InputError
from tiltcal.files.calibration import read_calibration
from tiltcal.files.document import document_of
from tiltcal.files.machine import Machine, MachineObject
from tiltcal.files.procedure import Procedure, procedure_in
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
        done = tiltcal("measure", "temperature-sweep", *options, cwd=tmp_path, code=0)
        said = [json.loads(line) for line in done.stdout.splitlines()]
        assert not [one for one in said if "ask" in one]
        assert [one["position"] for one in said if one.get("event") == "accepted"][-1] == "back-24"
        assert all({*one["sensors"]} == {"A-0", "A-1"} for one in said if one.get("event") == "accepted")
        waits = [one["seconds"] for one in said if one.get("event") == "waiting" and one["position"] == "up-40"]
        assert waits[:3] == [60, 120, 180], "once a minute of the bench's clock"
        for number in range(2):
            (tmp_path / f"A-{number}.yaml").rename(tmp_path / f"whole-{number}.yaml")
        journal = tmp_path / "bench.journal.jsonl"
        os.truncate(journal, int(0.55 * journal.stat().st_size))
        table.switch_on()
        resumed = tiltcal("measure", "--resume", journal, "--operator", "json", cwd=tmp_path, code=0)
        again = [json.loads(line) for line in resumed.stdout.splitlines()]
        assert 1 < len([one for one in again if one.get("event") == "accepted"]) < 9
    for number in range(2):
        calibration = read_calibration(tmp_path / f"A-{number}.yaml")
        assert len(calibration.positions) == 9
        truth = find_model("adxl202-analog").default_truth(number)
        for channel, drift in zip("xy", calibration.coefficients.thermal.drift[:, 0], strict=True):
            u = calibration.uncertainty[f"temperature.offset.{channel}.1"]
            assert abs(drift - truth.drift[channel][0]) < 4 * u
        tiltcal("diff", f"whole-{number}.yaml", f"A-{number}.yaml", cwd=tmp_path, code=0)


class Person(Operator):
    """Answers from a list, and keeps the questions and events that it gets; a look only once in a row."""

    watches = True

    def __init__(self, *said: object) -> None:
        self.said, self.got = list(said), list[str]()

    def ask(self, question: Question) -> object:
        self.got.append(f"{question.kind} {question.subject}")
        return self.said.pop(0)

    def tell(self, event: SessionEvent) -> None:
        words = f"waiting {event.seconds // 60} min" if isinstance(event, Waiting) else "".join(in_words(event)).strip()
        if isinstance(event, Look):
            words = re.sub(" is at .* on", " on", event.why)
        self.got += [] if words in self.got[-1:] else [words]


def table_and_chamber(
    person: Person, table: Machine, positions: str, speed: float = 30.0
) -> tuple[Machines, Any, Any, Any]:
    """The operator of a virtual table and a virtual chamber, and these two, with the positions of a procedure."""
    clock, rng = VirtualClock(), np.random.default_rng(1)
    moved, warmed = VirtualTable(rng, by_clock(clock)), VirtualChamber(rng, by_clock(clock))
    moved.speed = speed
    movers = movers_of({"table": (table, moved), "chamber": (CHAMBER, warmed)}, clock)
    steps = procedure_in(document_of({**HEAD, "positions": yaml.safe_load(positions)}))
    return Machines(person, movers, steps, clock, thermometer=False), moved, warmed, steps


HEAD = {"tiltcal": 1, "kind": "procedure", "name": "two", "title": "Two", "determines": {"axes": ["x"], "drift": 1},
        "reference": 20, "soak": {"seconds": 1, "drift": 1}}  # fmt: skip
TWO = "[{name: a, tilt: {x: 30}, temperature: 24, prompt: p}, {name: b, tilt: {x: -30}, temperature: 20, prompt: p%s}]"


def asked(steps: Procedure, name: str) -> PositionQuestion:
    (one,) = (position for position in steps.positions if position.name == name)
    return PositionQuestion(
        position=name, tilt=one.tilt, gravity=one.gravity, heading=one.heading or 0, temperature=one.temperature,
        stage=one.stage, prompt="",
    )  # fmt: skip


def test_what_machines_set_is_answered_and_what_moves_afterwards_is_refused() -> None:
    """Nobody is asked where they set all; a table that tells no state and creeps within its tolerance is awaited."""
    operator, table, chamber, steps = table_and_chamber(
        person := Person(), TABLE.replaced(done=None, timeout=900.0), TWO % "", 0.2
    )
    operator.probe()
    for name, tilt, warmth in (("a", 30.0, 24.0), ("b", -30.0, 20.0)):
        said: Any = operator.ask(asked(steps, name))
        assert said == {"answer": "ready", "tilt": {"x": tilt, "y": 0.0}, "temperature": pytest.approx(warmth, abs=0.5)}
        assert operator.most_attempts == 10
        assert operator.ask(Review(name, {})) == {"answer": "accept"}
        assert operator.ask(asked(steps, name)) == said  # it is there
        operator._thermometer = True  # of the bench, which says the temperature
        assert operator.ask(asked(steps, name)) == {"answer": "ready", "tilt": {"x": tilt, "y": 0.0}}
        operator._thermometer = False

    def on_the_way(machine: str, goal: str, minutes: int) -> list[str]:
        way = f"the {machine} on the way to {goal}"
        return [way, *(line for minute in range(1, minutes + 1) for line in (f"waiting {minute} min", way))]

    # 0.2° a second from 0° to 28° and from 30° to -32°; a third of a degree each ten seconds to within 0.5 °C.
    assert person.got == [
        *on_the_way("table", "x 28°, y -2°", 2), *on_the_way("table", "x 30°, y 0°", 0),
        *on_the_way("chamber", "24 °C", 0), "a: x 30°, y 0°, 23.67 °C",
        *on_the_way("table", "x -32°, y -2°", 5), *on_the_way("table", "x -30°, y 0°", 0),
        *on_the_way("chamber", "20 °C", 1), "b: x -30°, y 0°, 20.33 °C",
    ]  # fmt: skip
    table.axis = table.motor = table.target = table.axis - 0.5
    with pytest.raises(HardwareError, match=r"^table: it was at x -30°, y 0°, and is at x -30.5°, y -0.5°$"):
        operator.ask(Review("b", {}))
    chamber.temperature -= 5.0  # its door
    with pytest.raises(HardwareError, match=r"^chamber: it was at 20\.\d+ °C, and is at 15\.\d+ °C$"):
        operator.ask(Review("b", {}))


def test_a_chamber_alone_answers_its_temperature_and_is_only_sent_on_its_way_on_a_ramp() -> None:
    clock, ready, level = (
        VirtualClock(),
        {"answer": "ready"},
        TWO.replace("x: 30", "x: 0").replace("x: -30", "x: 0") % "",
    )
    ramp = {"determines": {"axes": [], "drift": 1}, "ramp": {"pace": 1.0, "interval": 10}}
    for more, left_out, reached in (({}, "", {"temperature": pytest.approx(24.0, abs=0.5)}), (ramp, "soak", {})):
        chamber = VirtualChamber(np.random.default_rng(1), by_clock(clock))
        head = {key: value for key, value in {**HEAD, **more}.items() if key != left_out}
        steps = procedure_in(document_of({**head, "positions": yaml.safe_load(level)}))
        movers, began_ns = movers_of({"chamber": (CHAMBER, chamber)}, clock), clock.now_ns()
        operator = Machines(Person(ready), movers, steps, clock, thermometer=False)
        assert operator.ask(asked(steps, "a")) == {**ready, **reached}
        assert (clock.now_ns() > began_ns, chamber.target) == (bool(reached), 24.0)


def test_what_no_machine_sets_is_asked_for_where_it_changes_or_was_wrong() -> None:
    """A table of one axis: heading and the other tilt are a person's, and are asked for again after all but ready."""
    ready, accept = {"answer": "ready"}, {"answer": "accept"}
    person = Person("nonsense", {"answer": "redo"}, {**ready, "position": "b"}, {**ready, "tilt": {"y": 0.2}}, accept,
                    ready, {"answer": "back"}, ready, ready, accept, ready, accept)  # fmt: skip
    one_axis = TABLE.replaced(limits={"x": (-95, 95)}, pattern="MPos:(?P<x>[-0-9.]+)", set=("G0 X{x:.3f} Y0",))
    operator, table, _, steps = table_and_chamber(person, one_axis, TWO % ", heading: 90")
    a, b, review = asked(steps, "a"), asked(steps, "b"), Review("a", {})
    set_x: Any = {"tilt": {"x": 30.0}, "temperature": pytest.approx(24.0, abs=0.5)}
    assert [operator.ask(a), operator.ask(a)] == ["nonsense", {"answer": "redo"}]
    with pytest.raises(InputError, match="machines take the positions in the procedure's order: set this one"):
        operator.ask(a)
    assert operator.ask(a) == {**ready, **set_x, "tilt": {"x": 30.0, "y": 0.2}}
    assert operator.most_attempts is None
    assert operator.ask(review) == accept
    assert operator.ask(a) == {**ready, **set_x}  # it was set by hand and accepted
    operator.tell(Accepted("a", {}, {}, 1))
    assert operator.ask(b)["answer"] == "ready"  # type: ignore[index]
    assert operator.ask(review) == {"answer": "back"}
    assert operator.ask(b)["answer"] == "ready"  # type: ignore[index]
    operator.tell(Refused("b", "askew"))
    assert [operator.ask(b)["answer"], operator.ask(review)] == ["ready", accept]  # type: ignore[index]
    assert [operator.to_take_again(["b"], ["a", "b"]) for _ in range(2)] == [["b"], ["b"]]
    table.switch_on()  # it is opened anew for a reference run, which lets it move
    assert operator.ask(b)["answer"] == "ready"  # type: ignore[index]
    assert operator.ask(review) == accept
    asks = [one for one in person.got if one.startswith(("position", "review"))]
    assert asks == [*["position a"] * 4, "review a", *["position b", "review a", *["position b"] * 2, "review a"],
                    "position b", "review a"]  # fmt: skip


class Lines:
    """A link that keeps what is sent, and answers one piece after the other."""

    letter = "r"

    def __init__(self, *pieces: bytes) -> None:
        self.sent, self._pieces = list[tuple[bytes, int]](), iter(pieces)

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        self.sent.append((out, count))
        return next(self._pieces, b"x\n" * 600) if count else b""


def test_what_is_sent_to_a_table_and_what_of_its_lines_is_an_answer() -> None:
    """What a machine began to say is no part of its next answer: the link drops what arrived before a question."""
    stated = TABLE.replaced(greeting="^Grbl", start=("$H", "G21"), line_end="crlf")
    link = Lines(b"\r\nGr", b"bl 1.1\r\n", b"ok\r\n", b"o", b"k\r\nok",
                 b"junk\r\nok\r\n",
                 b"<Run|MPos:1.000,-2.5>\r\n<Idle|MPos:1", b"<Idle|MPos:9,9>\r\n<Idle|MPos:1.5,-2.5>\r\n",
                 b"<Idle|MPos:1-,2>\n", b"error:9\r\n")  # fmt: skip
    table = TextDrive(stated, cast(Any, link))
    table.set({"x": 1.0, "y": -2.5})
    assert [table.read(), table.read()] == [({"x": 1.0, "y": -2.5}, False), ({"x": 1.5, "y": -2.5}, True)]
    with pytest.raises(HardwareError, match=r"1-.*, in '<Idle\|MPos:1-,2>'"):
        table.read()
    with pytest.raises(HardwareError, match=r"^it answers 'error:9'$"):
        table.set({"x": 1.0, "y": 2.5})
    with pytest.raises(BusError, match=r"^1000 lines have arrived, and none of them has 'MPos"):
        table.read()
    table.stop()
    set_, asks = [(b"G0 X1.000 Y-2.500\r\n", CHUNK)], [(b"?", CHUNK)]
    assert link.sent == [*[(b"", CHUNK)] * 2, (b"$H\r\n", CHUNK), (b"G21\r\n", CHUNK), (b"", CHUNK), *set_, *asks * 3,
                         (b"G0 X1.000 Y2.500\r\n", CHUNK), *asks, (b"", CHUNK), (b"!\r\n", 0)]  # fmt: skip
    silent = TextDrive(
        stated.replaced(greeting=None, start=(), accepted=None, stop=None, read_alone=False), link := Lines()
    )
    silent.set({"x": 1.0, "y": -2.5})
    silent.stop()
    with pytest.raises(BusError):
        silent.read()
    assert link.sent == [(set_[0][0], 0), (b"?\r\n", CHUNK), (b"", CHUNK)]


@pytest.mark.parametrize(
    ("readings", "reading", "found"),
    [
        ({"other": {"value": 1.5}}, None, 1.5),
        ({"axis": {"value": "2.5"}, "other": {"value": 1.5}}, None, 2.5),
        ({"axis": {"value": 2.5}, "other": {"value": 1.5}}, "other", 1.5),
        ({"other": {"value": 1.5}, "more": {"value": 2}}, None, "x reads .*: no value of 'axis'; say reading: NAME"),
        ({}, None, "x reads {}: no value of 'axis'"),
        ({"axis": {"value": "far"}}, None, "no value of 'axis'"),
        (None, None, r"x reads None: no value"),
    ],
)
def test_what_an_object_tells_of_where_it_is(
    readings: Any, reading: str | None, found: float | str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And whether it moves: until all that was set is done; without ``done`` at once, and stopped where it can be."""
    status, stopped = SimpleNamespace(done=False), list[str]()
    axis = SimpleNamespace(
        name="axis", read=lambda: readings, set=lambda value: status, stop=lambda: stopped.append("x")
    )
    monkeypatch.setitem(sys.modules, "rig", SimpleNamespace(axis=lambda: axis))  # type: ignore[arg-type]
    objects = {"x": MachineObject(address="python:rig:axis", reading=reading)}
    drive = ObjectDrive(Machine(kind="object", limits={"x": (-9, 9)}, tolerance=1.0, objects=objects))
    if isinstance(found, str):
        with pytest.raises(HardwareError, match=found):
            drive.read()
        return
    assert drive.read() == ({"x": found}, True)
    drive.set({"x": 3.0})
    assert drive.read() == ({"x": found}, False)
    status.done = True
    assert drive.read() == ({"x": found}, True)
    drive.stop()
    del axis.stop
    drive.stop()
    assert stopped == ["x"]
    axis.set = SimpleNamespace
    with pytest.raises(HardwareError, match=r"set of x failed \(TypeError: "):
        drive.set({"x": 3.0})


SENSOR = '  - {serial: S-1, model: sca100t-d02, address: "sim:?seed=1"}\n'
QUICK = ("--bench", "bench.yaml", "--operator", "json", "--samples", "5", "--settle", "0.5")


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
    table = VirtualTable(np.random.default_rng(1), lambda: 0.1)
    facts = {"chamber": "modbus:tcp://127.0.0.1:9", "sensors": SENSOR.replace("sim:?seed=1", "spi:///dev/none")}
    monkeypatch.setattr("tiltcal.bench.dry_run.session_clock", lambda began, virtual: VirtualClock())
    with serving(table.line) as place:
        bench = BENCH.format(table=place, **facts).replace("thermometer: {", "#")
        (tmp_path / "bench.yaml").write_text(bench)
        done = tiltcal("measure", "plane", "--bench", "bench.yaml", "--dry-run", cwd=tmp_path, code=0)
        found = re.findall(r"(\d)/4  (\S+) +x (\S+)°, y (\S+)°   (\d+) s\n", done.stdout)
        assert [(number, name) for number, name, *_ in found] == [
            *zip("1234", ("x-tilt1", "x-tilt2", "y-tilt1", "y-tilt2"), strict=True)
        ]
        reached = [(float(x), float(y)) for _, _, x, y, _ in found]
        assert reached == [pytest.approx(pair, abs=0.05) for pair in ((30, 0), (-30, 0), (0, 30), (0, -30))]
        assert re.search(r"went from -30\S* to (30|29.9)\S* in x; its limits are -95 and 95\n", done.stdout)
        assert list(tmp_path.iterdir()) == [tmp_path / "bench.yaml"]
        table.speed = 0.0
        (tmp_path / "bench.yaml").write_text(bench.replace("timeout: 30", "timeout: 1"))
        stalled = tiltcal("measure", "plane", "--bench", "bench.yaml", "--dry-run", cwd=tmp_path)
    assert stalled.returncode == 3
    assert "x-tilt1: table: it is at" in stalled.stderr
    tiltcal("measure", "plane", "--sensor", "sca100t-d02", "--dry-run", cwd=tmp_path, code=2)
    (tmp_path / "bench.yaml").write_text(f"tiltcal: 1\nkind: bench\nsensors:\n{SENSOR}")
    still = tiltcal("measure", "plane", "--bench", "bench.yaml", "--dry-run", cwd=tmp_path, code=2)
    assert "a dry run moves the table or the chamber of a bench file, and there is none to move" in still.stderr


def test_an_object_with_set_and_read_moves_the_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What it reads back is the angle that was set; one that fails stops the session until it is mended.

    A file from elsewhere imports nothing of the present folder that nobody named.
    """
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "tilt_rig.py").write_text(RIG.format(success=False))
    (tmp_path / "bench.yaml").write_text(f"tiltcal: 1\nkind: bench\njig: 0.05\nsensors:\n{SENSOR}{OBJECTS}")
    stopped = tiltcal("measure", "plane", *QUICK, "--python", "tilt_rig", cwd=tmp_path, code=130).stderr
    assert "x-tilt1 failed 3 times in a row: table: x has not got there" in stopped
    assert "continue with: tiltcal measure --resume bench.journal.jsonl" in stopped
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
    tiltcal(*resume, "--python", "tilt_rig", cwd=tmp_path, code=0)
    told = [tuple(one["tilt"].values()) for one in answers(tmp_path)]
    # The tilt of the axis that is carried is asin(cos 30.02° sin 0.02°), 0.017°.
    expected = [(30.02, 0.017), (-29.98, 0.017), (0.02, 30.02), (0.02, -29.98)]
    assert told == [pytest.approx(pair, abs=1e-3) for pair in expected]


def test_a_position_beyond_the_limits_is_refused_before_anything_is_opened(tmp_path: Path) -> None:
    bench = BENCH.format(table="serial:///dev/none", chamber="modbus:tcp://127.0.0.1:9", sensors=SENSOR)
    (tmp_path / "bench.yaml").write_text(bench.replace("x: [-95, 95]", "x: [-31, 95]"))
    refused = tiltcal("measure", "plane", *QUICK, cwd=tmp_path, code=2)
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

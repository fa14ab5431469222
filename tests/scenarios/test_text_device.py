"""Devices that are known by their manual alone: what is sent, what is a reading, and what is none."""

import re
from collections.abc import Iterable, Mapping
from functools import reduce
from math import asin, degrees
from operator import xor
from pathlib import Path
from random import Random
from typing import Any

import pytest
import yaml
from support.arriving_pieces import ArrivingPieces
from support.command import tiltcal
from support.pty_device import answering, printing

from tiltcal import TiltcalError, measure
from tiltcal.bench.devices import open_sensor
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.model import Sensor
from tiltcal.drivers.text_device import answer_with
from tiltcal.drivers.virtual import Fixture
from tiltcal.errors import BusError, HardwareError
from tiltcal.files.device import model_named

pytest.importorskip("serial", reason="the pyserial package is not installed")

FILE = """\
tiltcal: 1
kind: device
name: tilt-box
title: Tilt box
unit: deg
ask: "R\\r"
answer: 'X=(?P<x>[-+][0-9]{2}\\.[0-9]{3}) Y=(?P<y>[-+][0-9]{2}\\.[0-9]{3})'
timeout: 0.3
"""

SUMMED = FILE.replace("answer: 'X=", "answer: '(?P<checked>X=").replace("{3})'", "{3}))\\*(?P<checksum>[0-9A-F]{2})'")
SUMMED += "checksum: xor\n"

# What the makers' manuals and public drivers show: the question, an answer, and what it says.
SUM = b"\x02-1.25 0.5\x17"
MANUALS: Mapping[str, tuple[str, bytes, tuple[float, ...], float | None]] = {
    "leica-nivel210": (
        "16 02 4E 30 43 30 20 47 20 41 03 0D 0A",
        b"\x16\x02C5N7 X:-12.43 Y:587.54 T: 23.3\x03\x02\xd1",
        (-12.43, 587.54),
        23.3,
    ),
    "bei-rs232": ("", b"-00.001\r\nX=+00.430\r\nY=-00.084\r\n", (0.430, -0.084), None),
    "meas-dpg": ("", b"0.01\r\nX=+01.234\r\nY=-00.007\r\n", (1.234, -0.007), None),
    "seika-ng360": ("B1 05", b"\x02359,99\x1706$", (-0.01,), None),
    "jewell-tuff-tilt": (
        "2A 39 39 30 30 58 59 0D 0A",
        b"$YXXDR,A,000.034,D,N,A,-00.625,D,E,C,021.651,C,T-N0000*47\r\n",
        (-0.625, 0.034),
        21.651,
    ),
    "das-rs485": ("23 44 41 54 41 0D 0A", SUM + b"%02X$" % reduce(xor, SUM), (-1.25, 0.5), None),
}


@pytest.mark.parametrize("name", MANUALS)
def test_a_shipped_file_reads_the_example_of_the_manual(name: str) -> None:
    question, answer, values, celsius = MANUALS[name]
    line = ArrivingPieces(answer[:5], answer[5:])
    reading = model_named(name).driver(line, VirtualClock()).read()
    assert b"".join(line.heard) == bytes.fromhex(question)
    assert (reading.values, reading.temperature) == (pytest.approx(values), celsius)


class Unsound:
    """A device whose answers are late, doubled, foreign, damaged, too short or torn; its tilt always differs."""

    letter = "r"

    def __init__(self, summed: bool, kinds: Iterable[str]) -> None:
        self.summed, self.kinds, self.asked, self.late = summed, iter(kinds), 0, b""
        self.clock, self.waiting, self.chance = VirtualClock(), b"", Random(5)

    @property
    def tilt(self) -> tuple[float, float]:
        return self.asked % 97 / 8, -(self.asked % 97) / 4

    def answer(self, question: bytes) -> bytes:
        assert question == b"R\r"
        self.asked += 1
        body = "X={:+07.3f} Y={:+07.3f}".format(*self.tilt).encode()
        whole = body + (b"*%02X" % reduce(xor, body) if self.summed else b"") + b"\r\n"
        before, self.late, kind, place = self.late, b"", next(self.kinds), self.chance.randrange(len(body))
        # A device that is always one answer behind cannot be told from one that is not.
        if kind == "late" and not before:
            self.late = whole
            return b""
        flipped = whole[place] ^ (1 << self.chance.randrange(7) if self.summed else 0x40)
        return before + {
            "doubled": whole + whole,
            "foreign": whole.replace(b"X", b"U"),
            "damaged": whole[:place] + bytes([flipped]) + whole[place + 1 :],
            "lost": whole[:place] + whole[place + 1 :],
            "torn": whole[:place],
        }.get(kind, whole)

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        if out or not count:
            self.waiting = self.answer(out) if out else b""
        if count and not self.waiting:
            self.clock.sleep(0.3)
            raise BusError("silent")
        arrived, self.waiting = self.waiting[: min(count, 9)], self.waiting[min(count, 9) :]
        return arrived

    def agrees(self, sensor: Sensor) -> bool:
        """Whether the sensor reads; it fails where that is no answer to the last question."""
        try:
            values = sensor.read().values
        except HardwareError:
            return False
        assert values == pytest.approx(self.tilt, abs=6e-4)
        return True


@pytest.mark.parametrize("text", [FILE, SUMMED])
def test_no_damaged_late_doubled_or_foreign_answer_becomes_a_reading(tmp_path: Path, text: str) -> None:
    (tmp_path / "box.yaml").write_text(text)
    kinds = ("right", "right", "late", "doubled", "foreign", "damaged", "lost", "torn")
    chance = Random(3)
    line = Unsound(text is SUMMED, iter(lambda: chance.choice(kinds), ""))
    sensor = model_named(str(tmp_path / "box.yaml")).driver(line, line.clock)
    assert sum(line.agrees(sensor) for _ in range(200)) > 60
    assert sensor.link_statistics()["damaged"] > 30


def test_a_device_is_probed_measured_and_replayed_by_its_file_alone(tmp_path: Path) -> None:
    (tmp_path / "box.yaml").write_text(FILE)
    pose = {"x": 0.0, "y": 0.0}

    def answer(question: bytes) -> bytes:
        return f"X={pose['x']:+07.3f} Y={pose['y']:+07.3f}\r\n".encode()

    class Rig:
        def position(self, ask: Mapping[str, Any]) -> dict[str, str]:
            pose.update(x=degrees(asin(ask["gravity"][0])) + 0.5, y=degrees(asin(ask["gravity"][1])) - 0.25)
            return {"answer": "ready"}

    with answering(answer) as path:
        probed = tiltcal("probe", tmp_path / "box.yaml", "--address", f"serial://{path}", code=0)
        assert "came         'X=+00.000 Y=+00.000\\r\\n'" in probed.stdout
        assert "beside it    '\\r\\n'\n" in probed.stdout
        wrong = tmp_path / "wrong.yaml"
        wrong.write_text(FILE.replace("Y=", "V="))
        refused = tiltcal("probe", wrong, "--address", f"serial://{path}", code=3)
        assert "matches only 'X=+00.000 ' of it, and next it needs 'V=" in refused.stderr
        options = {"sensor": str(tmp_path / "box.yaml"), "address": f"serial://{path}", "serial": "B-1", "jig": 0.1}
        measure("plane", operator=Rig(), output=tmp_path / "B-1.yaml", samples=5, settle=0.2, **options)
        (tmp_path / "box.yaml").unlink()
        tiltcal("live", tmp_path / "B-1.yaml", "--address", f"serial://{path}", "--for", "0.1", "--rate", "20", code=0)
    file = yaml.safe_load((tmp_path / "B-1.yaml").read_text())
    assert (file["sensor"]["model"], file["sensor"]["unit"], file["sensor"]["reads"]) == ("tilt-box", "deg", "angle")
    # A box without noise: what it rounds to a thousandth of a degree is uncertain by 0.001° / √12.
    assert [one["u"]["x"] for one in file["positions"]] == pytest.approx([0.001 / 12**0.5] * 4, rel=1e-3)
    tiltcal("replay", "B-1.journal.jsonl", "--golden", "B-1.yaml", cwd=tmp_path, code=0)
    bench = tmp_path / "bench.yaml"
    bench.write_text('tiltcal: 1\nkind: bench\nsensors: [{serial: N, model: box.yaml, address: "sim:"}]\n')
    (tmp_path / "box.yaml").write_text(FILE)
    tiltcal("record", "--bench", bench, "--rows", "3", "-o", tmp_path / "log.csv", cwd="/", code=0)


def test_a_check_sum_of_one_byte_and_what_is_no_number(tmp_path: Path) -> None:
    """The characters of X=+01.250 add up to 0x1E6, those of Q=-02.500 to 0x1E0."""
    summed = FILE.replace("X=(?P<x>[-+][0-9]{2}\\.[0-9]{3}) Y=(?P<y>", "(?P<checked>(?:X|Q)=(?P<x>")
    summed = summed.replace("[-+][0-9]{2}\\.[0-9]{3})'", "[-+0-9.]+))(?P<checksum>.)'\nchecksum: sum")
    (tmp_path / "box.yaml").write_text(summed)
    model = model_named(str(tmp_path / "box.yaml"))
    line = ArrivingPieces(
        b"X=+01.250\xe6\r\n", b"Q=-02.500\xe1\r\n", b"Q=-02.500\xe0\r\n", *[b"X=+.-\xd2\r\n" * 50] * 3
    )
    sensor = model.driver(line, VirtualClock())
    assert [sensor.read().values for _ in range(2)] == [(1.25,), (-2.5,)]
    heard, torn = repr(("X=+.-\xd2\r\n" * 50)[-120:]), ArrivingPieces(*[b"X=+01.250\xe6", b""] * 9)
    for driver, why in (
        (sensor, f"only {heard}: x is '+.-', no number with a decimal point"),
        (model.driver(torn, VirtualClock()), "of it, and a line end that ends it is missing; is the baud rate right?"),
    ):
        with pytest.raises(BusError, match=re.escape(why)):
            driver.read()
    assert sensor.link_statistics() == {"answers": 2, "damaged": 151}
    part = model.twin(model.default_truth(1), Fixture(clock := VirtualClock()), clock)
    assert abs(model.driver(part, clock).read().values[0]) < 45.0


def test_the_virtual_part_writes_a_number_as_its_pattern_has_it(tmp_path: Path) -> None:
    """Filled up with zeros or spaces or not at all, with a sign or as degrees to 360, with up to six decimals."""
    for pattern, number, text in (
        (r"[-+.0-9]+", -1.25, "-01.250"),
        (r"[0-9.]+", -1.25, "358.750"),
        (r"[0-9]{2}\.[0-9]{3}", 1.25, "01.250"),
        (r"[0-9]\.[0-9]{3}", 1.25, "1.250"),
        (r"[-+][0-9]{3}\.[0-9]{3}", 1.25, "+001.250"),
        (r"[-+][0-9]{4}\.[0-9]{3}", -1.25, "-0001.250"),
        (r" [-+][0-9]\.[0-9]{3}", -1.25, " -1.250"),
        (r" {2}[-+][0-9]\.[0-9]{3}", 1.25, "  +1.250"),
        (r" {4}[0-9]\.[0-9]{3}", 1.25, "    1.250"),
        *((rf"[-+][0-9]\.[0-9]{{{places}}}", 1.25, f"+1.25{'0' * (places - 2)}") for places in (2, 4, 5, 6)),
        (r"[0-9]\.[0-9]", 1.375, "1.4"),
        (r"[0-9]", 1.375, "1"),
    ):
        (tmp_path / "box.yaml").write_text(f"{FILE.partition('answer')[0]}answer: '(?P<x>{pattern})'\n")
        device = model_named(str(tmp_path / "box.yaml")).driver.args[0]
        assert answer_with(device, {"x": number}) == f"{text}\r\n", pattern


@pytest.mark.parametrize("kept", [0, 1])
def test_x_and_y_on_lines_of_their_own_are_one_reading_and_a_lost_line_none(kept: int) -> None:
    lines = iter(b"X=+%06.3f\r\nY=-%06.3f\r\n" % (n, n) for n in range(1, 99))
    chance = Random(2)

    def printed() -> bytes:
        both = next(lines)
        return chance.choice([both, both, both.splitlines(keepends=True)[kept]])

    with (
        printing(printed, 200.0, waits=True) as path,
        open_sensor("bei-rs232", f"serial://{path}?timeout=0.2&parity=N") as sensor,
    ):
        readings = [sensor.read().values for _ in range(40)]
    assert all(x == -y for x, y in readings)
    assert len(set(readings)) == 40


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ("(?P<x>", "(?P<tilt>", "the group 'tilt' is no reading"),
        ("X=(", "X=((", "this is no regular expression"),
        ('ask: "R\\r"', "ask: 'R\\r'", "write it in double quotes"),
        ("timeout: 0.3", "checksum: xor", "nothing reads checked"),
        ("timeout: 0.3", "low: 2\nhigh: 1", "low=2 is not below high=1"),
        ("X=(", r"(.)\1X=(", "the virtual part can make no answer"),
        ("[0-9]{2}", "[a-f]{2}", "the virtual part can make no answer"),
        ("unit: deg", "units: deg", r"did you mean 'unit'\?"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused_at_its_key(tmp_path: Path, old: str, new: str, why: str) -> None:
    (tmp_path / "box.yaml").write_text(FILE.replace(old, new))
    with pytest.raises(TiltcalError, match=rf"box\.yaml:\d+: .*{why}"):
        model_named(str(tmp_path / "box.yaml"))

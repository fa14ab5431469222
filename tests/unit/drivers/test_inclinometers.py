"""Inclinometers: the self-test of the SCA100T family, and the SCL3300 on lines that damage its frames.

The SCL3300 here is a part that was written apart from driver and twin.
"""

from __future__ import annotations

from dataclasses import asdict, replace
from math import hypot, radians, sin
from statistics import fmean, stdev

import pytest
from support.emulated.bench import Scl3300 as PartFacts
from support.scl3300_part import ALLOWED, Scl3300Part
from support.scripted_link import Script

from tiltcal.drivers import find_model
from tiltcal.drivers import scl3300_frames as frames
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.device import Model, Sensor
from tiltcal.drivers.sca100t import Sca100t
from tiltcal.drivers.twin.fixture import Fixture
from tiltcal.drivers.twin.truth import Truth
from tiltcal.errors import BusError, DeviceFault, UsageError

D01, D02, PAIR, SINGLE = map(find_model, ("sca100t-d01", "sca100t-d02", "sca103t-d05", "sca61t-fahh1g"))


def driver(*frames: str) -> tuple[Sca100t, Script]:
    clock = VirtualClock()
    script = Script("s", clock, *frames)
    return Sca100t(script, clock), script


def self_test_frames(before: int, deflected: int, after: int) -> tuple[str, ...]:
    words = [f"10 00 00 / 3d {(word << 5).to_bytes(2, 'big').hex()}" for word in (before, deflected, after)]
    return words[0], "0E / xx", words[1], "00 / xx", words[2]


@pytest.mark.parametrize(
    ("before", "deflected", "after", "passed"),
    [
        (1024, 2047, 1024, (True, True)),
        # 95 % of the supply is word 1944.65; 5 % of 1024 is 51.2.
        (1024, 1945, 1075, (True, True)),
        (1024, 1944, 1024, (False, True)),
        (1024, 2047, 1076, (True, False)),
        (1024, 2047, 972, (True, False)),
    ],
)
def test_self_test_limits(before: int, deflected: int, after: int, passed: tuple[bool, bool]) -> None:
    sensor, script = driver(*self_test_frames(before, deflected, after))
    result = sensor.self_test("x")
    assert (result.before, result.deflected, result.after) == (before, deflected, after)
    assert (result.deflection_passed, result.recovery_passed, result.passed) == (*passed, all(passed))
    script.close()
    _, start, push, end, settled = script.rests
    assert start >= 15e-6
    assert 20e-3 <= push + end <= 100e-3, "length of the pulse"
    assert push >= 25e-3, "typical saturation time"
    assert settled >= 55e-3, "typical time until stable"


def test_a_self_test_of_one_axis_sends_its_command_alone_and_always_ends_the_push() -> None:
    sensor, script = driver("11 00 00 / xx 80 00", "0F / xx", "11 00 00 / xx FF E0", "00 / xx", "11 00 00 / xx 80 00")
    assert sensor.self_test("y").passed
    script.close()
    sensor, script = driver("10 00 00 / xx 80 00", "0E / xx", "10 00 00 / unplugged", "00 / xx")
    with pytest.raises(BusError, match="unplugged"):
        sensor.self_test("x")
    script.close()
    sensor, script = driver("10 00 00 / xx 40 00")
    with pytest.raises(UsageError, match=r"x reads 512 count.*lay the sensor level"):
        sensor.self_test("x")
    with pytest.raises(UsageError, match="channels x and y, not 'z'"):
        sensor.self_test("z")
    script.close()


def test_probe_tells_what_the_part_said_and_doubts_what_no_part_says() -> None:
    sensor, script = driver("00 / xx", "10 00 00 / xx 80 40", "11 00 00 / xx 81 20", "08 00 / xx A4")
    assert sensor.probe() == {"x": "1026 count", "y": "1033 count", "temperature": "30.5 °C (not trimmed)"}
    script.close()
    sensor, _ = driver("00 / xx", "10 00 00 / xx 80 00", "11 00 00 / xx 80 00", "08 00 / xx 00")
    with pytest.raises(DeviceFault, match=r"reports 182 °C.*is another device on this chip select"):
        sensor.probe()
    clock = VirtualClock()
    script = Script("s", clock, "00 / xx", "10 00 00 / xx 87 20", "11 00 00 / xx 78 E0", "08 00 / xx AA")
    said = PAIR.driver(script, clock).probe()
    assert (said["x"], said["elements"][:32]) == ("114 count", "1081 and 967 count, together 204")


def test_virtual_parts_test_themselves() -> None:
    """The data sheet: to at least 95 % of the supply, or by 1 g from below; MEAS ends it."""
    assert not hasattr(SINGLE.driver(None, VirtualClock()), "self_test"), "its limits are not known"
    for model in (D01, D02, PAIR):
        for seed in range(5):
            clock = VirtualClock()
            sensor = model.driver(model.twin(model.default_truth(seed), Fixture(clock), clock), clock)
            for channel in model.channels:
                assert sensor.self_test(channel).passed
    clock = VirtualClock()
    truth = Truth(("x", "y"), {"x": 1024.0, "y": 1030.0}, {"x": {"x": 819.0}, "y": {"y": 819.0}})
    fixture = Fixture(clock)
    twin = D02.twin(truth, fixture, clock)
    twin.exchange(b"\x0e")
    clock.sleep(1.0)
    assert D02.driver(twin, clock).read().values[0] >= 0.95 * 2047
    assert D02.driver(twin, clock).probe()["x"] == "1024 count", "a self-test that was left running is ended"


@pytest.mark.parametrize(("model", "bend_limit", "range_g"), [(D01, 0.11, 0.5), (D02, 0.57, 1.0)], ids=["±30°", "±90°"])
def test_drawn_parts_bend_and_drift_as_the_population_does(model: Model, bend_limit: float, range_g: float) -> None:
    parts = [model.default_truth(seed) for seed in range(300)]
    for part in parts[:100]:
        row = part.sensitivity["x"]
        assert hypot(row["y"], row["z"]) <= 0.04 * row["x"]
        quadratic, cubic = part.nonlinearity["x"]
        assert abs(quadratic) * range_g**2 + abs(cubic) * range_g**3 <= sin(radians(bend_limit))
    for t in (-25.0, 85.0):
        # Mean offset of the population, degrees: the data sheet's curve.
        hot, cold = (-0.0000006 * c**3 + 0.0001 * c**2 - 0.0039 * c + 0.0522 for c in (t, 25.0))
        drifts = [(part.reading("x", (0, 0, 0), t) - part.offset["x"]) / model.sensitivity for part in parts]
        # The slopes are even within ±0.008 °/°C, so the mean of 300 is known to 0.0046 / 17 °/°C.
        assert fmean(drifts) == pytest.approx(radians(hot - cold), abs=radians(0.0014 * abs(t - 25.0)))
        assert max(abs(one - radians(hot - cold)) for one in drifts) <= radians(0.86)
    spread = stdev(part.offset["x"] for part in parts) / model.sensitivity
    assert spread == pytest.approx(model.offset_spread, rel=0.1)


# SCL3300


SCL = find_model("scl3300")
MODE_3, MODE_4 = (SCL.at(parse_address(f"sim:range=mode{number}")) for number in (3, 4))


class PartLink:
    """The independent part as a link, 20 µs to a frame."""

    letter = "s"

    def __init__(self, **changes: object) -> None:
        self.clock = VirtualClock()
        self.clock.sleep(1.0)
        self.part = Scl3300Part(**asdict(replace(PartFacts(), jig=0.0, noise=0.0, **changes)))
        self.asked: list[bytes] = []
        self.before = self.after = lambda answer: answer

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        self.clock.sleep(20e-6)
        self.asked.append(out)
        self.before(b"")
        return self.after(self.part.transfer(out, self.clock.now_ns(), self.clock.now_ns()))

    def expected(self, model: Model) -> tuple[float, ...]:
        return tuple(float(round(one * model.sensitivity)) for one in self.part.measured(self.clock.now_ns()))


def bench(model: Model, **changes: object) -> tuple[Sensor, PartLink]:
    link = PartLink(**changes)
    return model.driver(link, link.clock), link


def test_the_driver_sends_the_frames_of_the_data_sheet_alone() -> None:
    """No others are allowed: they may block the part. And each has the CRC of the data sheet."""
    ours = {value.hex().upper() for value in vars(frames).values() if isinstance(value, bytes)}
    assert ours | {mode.hex().upper() for mode in frames.MODES} <= ALLOWED
    assert all(frames.crc8(frame[:3]) == frame[3] for frame in map(bytes.fromhex, ALLOWED))
    # A write is answered with its own data: bank 1 by bank 1, and not by bank 0.
    answers = [frames.decode(bytes.fromhex(frame)) for frame in ("FD0001E1", "FD0000FC")]
    assert [answer.answers(frames.BANK_1) for answer in answers] == [True, False]


@pytest.mark.parametrize("model", [SCL, MODE_3, find_model("sca3300-d01")], ids=lambda model: model.title)
@pytest.mark.parametrize("left", [{}, {"bank": 1}, {"asleep": True}], ids=["at rest", "bank 1", "power-down"])
def test_a_part_as_another_program_left_it_is_read_and_named(model: Model, left: dict[str, object]) -> None:
    sensor, link = bench(model, identity=0x51 if model.name == "sca3300-d01" else 0xC1)
    vars(link.part).update(left)
    link.part.pose([0.6, 0.0, -0.8], 31.0)
    assert sensor.read().values == link.expected(model)
    said = dict(sensor.probe())
    # SERIAL1 F7DA and SERIAL2 3CE5, as the data sheet's example has them.
    assert (said["part"], said["serial"]) == (model.title.split()[1], "1021704154B33")
    assert sensor.read().values == link.expected(model), "the part is left in bank 0"
    assert link.part.counts["forbidden"] == 0
    set_up, link.asked[:] = len(link.asked), []
    sensor.read()
    assert (set_up > 5, len(link.asked)) == (True, 5), "the part is set up once"


def test_another_part_and_wires_alone_are_named() -> None:
    sensor, _ = bench(SCL, identity=0x51)
    with pytest.raises(DeviceFault, match=r"WHOAMI reads 0x51.* the part is an SCA3300-D01: name it with --sensor"):
        sensor.read()
    sensor, link = bench(SCL)
    link.after = lambda answer: link.asked[-1]
    with pytest.raises(BusError, match="MISO is connected to MOSI"):
        sensor.read()


@pytest.mark.parametrize(("damage", "noticed"), [(0.02, 0.7), (0.1, 0.5)])
def test_no_damaged_frame_becomes_a_reading_and_all_are_counted(damage: float, noticed: float) -> None:
    for seed in range(5):
        sensor, link = bench(SCL, damage=damage, seed=seed)
        assert {sensor.read().values for _ in range(400)} == {link.expected(SCL)}
        counted, part = sensor.link_statistics(), link.part.counts
        assert (counted["samples"], counted["restarts"], counted["out of step"]) == (400, 0, 0)
        # What is damaged during the start, or in the last frame, is not all told from the flags of the start.
        assert part["answers_damaged"] - 5 <= counted["damaged"] <= part["answers_damaged"]
        assert noticed * part["requests_damaged"] - 3 <= counted["refused"] <= part["requests_damaged"]


@pytest.mark.parametrize("place", [None, 0, 1, 2])
def test_a_fault_that_stays_is_told_over_a_damaged_status(place: int | None) -> None:
    """Of three answers to STATUS one is damaged; the other two have the same flags, with an error."""
    sensor, link = bench(SCL)
    sensor.read()
    link.part.broken = True
    link.asked.clear()
    damaged = -1 if place is None else 2 + place
    link.after = lambda answer: b"\x00" * 4 if link.asked.count(frames.STATUS) == damaged else answer
    with pytest.raises(DeviceFault, match="reports a fault: memory"):
        sensor.read()
    link.after = lambda answer: answer
    with pytest.raises(DeviceFault, match=r"a fault that its start does not clear: memory \(MEM\).* replace the part"):
        sensor.read()


def test_a_reset_in_mid_session_is_told_and_the_part_is_set_up_anew() -> None:
    sensor, link = bench(MODE_4, damage=0.02)
    told = 0
    for _ in range(100):
        assert sensor.read().values == link.expected(MODE_4)
        link.part.restart()
        # Until it has started it cannot be spoken to; between two samples a bench waits longer than this.
        link.clock.sleep(0.005)
        try:
            assert sensor.read().values == link.expected(MODE_4)
        except DeviceFault as fault:
            told += "was reset or its supply failed" in str(fault)
    assert sensor.link_statistics()["restarts"] == told >= 95


@pytest.mark.parametrize("after", range(5))
def test_a_reset_within_a_sample_is_no_reading(after: int) -> None:
    sensor, link = bench(MODE_4)
    truth = sensor.read().values

    def restart(_: bytes) -> bytes:
        if len(link.asked) == 1 + after:
            link.part.restart()
            link.part.ready_ns = 0
        return b""

    link.asked.clear()
    link.before = restart
    with pytest.raises((DeviceFault, BusError)):
        sensor.read()
    link.before = lambda answer: answer
    assert sensor.read().values == truth

"""The SCA100T family: the self-test, what the probe says, and the tolerances of virtual parts."""

from dataclasses import replace

import pytest
from support.scripted_link import Script

from tiltcal.drivers import find_model
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.sca100t import Sca100t
from tiltcal.drivers.virtual import Fixture, Truth
from tiltcal.errors import BusError, DeviceFault, UsageError

D01, D02, PAIR, SINGLE = map(find_model, ("sca100t-d01", "sca100t-d02", "sca103t-d05", "sca61t-fahh1g"))


def driver(*frames: str) -> tuple[Sca100t, Script]:
    clock = VirtualClock()
    script = Script("s", clock, *frames)
    return Sca100t(script, clock), script


def self_test_frames(before: int, deflected: int, after: int) -> tuple[str, ...]:
    words = [f"10 00 00 / 3d {(word << 5).to_bytes(2, 'big').hex()}" for word in (before, deflected, after)]
    return words[0], "0E / xx", words[1], "00 / xx", words[2]


def test_self_test_limits() -> None:
    # 95 % of the supply is word 1944.65; 5 % of 1024 is 51.2.
    passing, failing = ((2047, 1024), (1945, 1075)), ((1944, 1024), (2047, 1076), (2047, 972))
    for deflected, after in passing + failing:
        sensor, script = driver(*self_test_frames(1024, deflected, after))
        result = sensor.self_test("x")
        assert (result.before, result.deflected, result.after) == (1024, deflected, after)
        assert result.passed == ((deflected, after) in passing)
        assert str(result) == f"1024 count at rest, {deflected} while pushed, {after} after the recovery"
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
    with pytest.raises(UsageError, match="no self-test"):
        SINGLE.driver(None, VirtualClock()).self_test("x")  # its limits are not known
    with pytest.raises(UsageError, match="an SCA103T has channel x, no 'y'"):
        PAIR.driver(None, VirtualClock()).self_test("y")
    for model in (D01, D02, PAIR):
        for seed in range(5):
            clock = VirtualClock()
            sensor = model.driver(model.twin(model.default_truth(seed), Fixture(clock), clock), clock)
            for channel in model.channels:
                assert sensor.self_test(channel).passed
    for ambient, byte in ((-60.0, 0xFF), (24.0, 0xAB), (190.0, 0x00)):  # 197 - 1.083 T
        clock = VirtualClock()
        part = D02.twin(replace(D02.default_truth(1), thermometer_error=0.0), Fixture(clock, ambient=ambient), clock)
        assert part.exchange(b"\x08\x00")[1] == byte
    clock = VirtualClock()
    truth = Truth(("x", "y"), {"x": 1024.0, "y": 1030.0}, {"x": {"x": 819.0}, "y": {"y": 819.0}})
    fixture = Fixture(clock)
    twin = D02.twin(truth, fixture, clock)
    assert twin.exchange(b"\x55\x00") == b"\xff\xff", "no command of its own: the line floats"
    twin.exchange(b"\x0e")
    clock.sleep(1.0)
    assert D02.driver(twin, clock).read().values[0] >= 0.95 * 2047
    assert D02.driver(twin, clock).probe()["x"] == "1024 count", "a self-test that was left running is ended"

"""The SCA100T driver against the datasheet: its frames, its words, its waits and its faults.

Frames are written as in the datasheet, out / in, in hexadecimal; ``xx`` stands for a byte that means nothing.
"""

from __future__ import annotations

from math import asin, degrees

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.scripted_link import Script

from tiltcal.drivers import find_model
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.sca100t import Sca100t, decode_temperature, decode_word
from tiltcal.drivers.twin.fixture import Fixture
from tiltcal.drivers.twin.truth import Truth
from tiltcal.errors import BusError, DeviceFault, UsageError

D01, D02 = find_model("sca100t-d01"), find_model("sca100t-d02")


def driver(*frames: str) -> tuple[Sca100t, Script]:
    clock = VirtualClock()
    script = Script("s", clock, *frames)
    return Sca100t(script, clock), script


def sample(x: str, y: str, t: str) -> tuple[str, str, str]:
    return f"10 00 00 / {x}", f"11 00 00 / {y}", f"08 00 / {t}"


@pytest.mark.parametrize(
    ("answer", "word", "d01", "d02"),
    [
        ("xx 80 00", 1024, 0.0, 0.0),
        ("xx E6 60", 1843, 0.5, 1.0),
        ("xx E6 7F", 1843, 0.5, 1.0),
        ("xx 5C 80", 740, -0.173382, None),
        ("xx 19 A0", 205, -0.5, -1.0),
        ("xx C8 60", 1603, None, 0.706960),
        ("xx E6 80", 1844, None, 1.001221),
        ("xx FF E0", 2047, 0.624542, None),
        ("xx 80 40", 1026, None, 0.002442),
        ("xx 81 20", 1033, None, 0.010989),
    ],
)
def test_words_of_the_fact_sheet(answer: str, word: int, d01: float | None, d02: float | None) -> None:
    assert decode_word(bytes.fromhex(answer.replace("xx", "3d"))) == word
    for model, g in ((D01, d01), (D02, d02)):
        if g is not None:
            assert (word - model.offset) / model.sensitivity == pytest.approx(g, abs=5e-7)


@pytest.mark.parametrize(
    ("answer", "celsius"), [("xx C5", 0.0), ("xx AA", 24.931), ("xx F0", -39.705), ("xx A4", 30.471)]
)
def test_temperatures_of_the_fact_sheet(answer: str, celsius: float) -> None:
    assert decode_temperature(bytes.fromhex(answer.replace("xx", "3d"))) == pytest.approx(celsius, abs=5e-4)


def test_the_angles_of_a_published_sample() -> None:
    """A D02 module's published bytes: X 0x402, Y 0x409, T 0xA4."""
    sensor, _ = driver(*sample("xx 80 40", "xx 81 20", "xx A4"))
    reading = sensor.read()
    angles = [degrees(asin((value - D02.offset) / D02.sensitivity)) for value in reading.values]
    assert reading.values == (1026.0, 1033.0)
    assert angles == pytest.approx([0.1399, 0.6296], abs=5e-5)
    assert reading.temperature == pytest.approx(30.471, abs=5e-4)


@given(word=st.integers(0, 2047), slot=st.integers(0, 255), filler=st.integers(0, 31))
def test_only_the_eleven_bits_count(word: int, slot: int, filler: int) -> None:
    bits = f"{slot:08b}{word:011b}{filler:05b}"
    assert decode_word(int(bits, 2).to_bytes(3, "big")) == word


def test_every_read_waits_150_us_with_chip_select_high() -> None:
    sensor, script = driver(*sample("xx 80 00", "xx 80 00", "xx AA") * 2)
    sensor.read()
    sensor.read()
    assert script.rests == pytest.approx([150e-6] * 6)


@pytest.mark.parametrize(
    ("x", "y", "channel", "word"), [("xx 0C A0", "xx 80 00", "x", 101), ("xx 80 00", "xx 00 20", "y", 1)]
)
def test_a_word_below_102_is_the_parts_fault_signal(x: str, y: str, channel: str, word: int) -> None:
    sensor, _ = driver(*sample(x, y, "xx AA"))
    with pytest.raises(DeviceFault, match=f"{channel} reads {word} count, and words below 102"):
        sensor.read()


def test_word_102_is_a_reading() -> None:
    sensor, _ = driver(*sample("xx 0C C0", "xx 80 00", "xx AA"))
    assert sensor.read().values == (102.0, 1024.0)


@pytest.mark.parametrize(("byte", "level"), [("FF", "high"), ("00", "low")])
def test_a_sample_of_equal_bits_is_a_dead_wire(byte: str, level: str) -> None:
    sensor, _ = driver(*sample(*[f"{byte} {byte} {byte}"] * 2, f"{byte} {byte}"))
    with pytest.raises(BusError, match=f"data line is stuck {level} .* check the data line .MISO"):
        sensor.read()


def test_one_word_at_the_rail_is_a_reading() -> None:
    sensor, _ = driver(*sample("FF FF FF", "xx 80 00", "xx AA"))
    assert sensor.read().values == (2047.0, 1024.0)
    assert D02.rails == (101.0, 2047.0)


def test_a_short_answer_is_a_bus_error() -> None:
    sensor, _ = driver("10 00 00 / 80 00")
    with pytest.raises(BusError, match="a frame of 3 bytes was answered with 2"):
        sensor.read()


def test_probe_tells_what_the_part_said() -> None:
    sensor, script = driver("00 / xx", *sample("xx 80 40", "xx 81 20", "xx A4"))
    assert sensor.probe() == {"x": "1026 count", "y": "1033 count", "temperature": "30.5 °C (not trimmed)"}
    script.close()


def test_probe_doubts_a_temperature_at_which_no_part_works() -> None:
    sensor, _ = driver("00 / xx", *sample("xx 80 00", "xx 80 00", "xx 00"))
    with pytest.raises(DeviceFault, match=r"reports 182 °C.*is another device on this chip select"):
        sensor.probe()


def test_a_self_test_that_was_left_running_is_ended_before_the_first_sample() -> None:
    """The data sheet: the output goes to at least 95 % of the supply, MEAS ends it, stable again after 55 ms."""
    clock = VirtualClock()
    truth = Truth(("x", "y"), {"x": 1024.0, "y": 1030.0}, {"x": {"x": 819.0}, "y": {"y": 819.0}})
    twin = D02.twin(truth, Fixture(clock), clock)
    twin.exchange(bytes.fromhex("0E"))
    clock.sleep(1.0)
    assert D02.driver(twin, clock).read().values[0] >= 0.95 * 2047
    assert D02.driver(twin, clock).probe()["x"] == "1024 count"
    assert D02.driver(twin, clock).read().values == (1024.0, 1030.0)


def self_test_frames(before: int, deflected: int, after: int) -> tuple[str, ...]:
    words = [f"10 00 00 / 3d {(word << 5).to_bytes(2, 'big').hex()}" for word in (before, deflected, after)]
    return words[0], "0E / xx", words[1], "00 / xx", words[2]


@pytest.mark.parametrize(
    ("before", "deflected", "after", "deflection_passed", "recovery_passed"),
    [
        (1024, 2047, 1024, True, True),
        # 95 % of the supply is word 1944.65; 5 % of 1024 is 51.2.
        (1024, 1945, 1075, True, True),
        (1024, 1944, 1024, False, True),
        (1024, 2047, 1076, True, False),
        (1024, 1024, 1024, False, True),
    ],
)
def test_self_test_limits(
    before: int, deflected: int, after: int, deflection_passed: bool, recovery_passed: bool
) -> None:
    sensor, script = driver(*self_test_frames(before, deflected, after))
    result = sensor.self_test("x")
    assert (result.before, result.deflected, result.after) == (before, deflected, after)
    assert (result.deflection_passed, result.recovery_passed) == (deflection_passed, recovery_passed)
    assert result.passed == (deflection_passed and recovery_passed)
    script.close()


def test_the_self_test_keeps_the_datasheets_times() -> None:
    sensor, script = driver(*self_test_frames(1024, 2047, 1024))
    sensor.self_test("x")
    _, start, push, end, settled = script.rests
    assert start >= 15e-6
    assert 20e-3 <= push + end <= 100e-3, "length of the pulse"
    assert push >= 25e-3, "typical saturation time"
    assert settled >= 55e-3, "typical time until stable"


def test_the_self_test_of_y_sends_the_command_of_y_alone() -> None:
    sensor, script = driver("11 00 00 / xx 80 00", "0F / xx", "11 00 00 / xx FF E0", "00 / xx", "11 00 00 / xx 80 00")
    assert sensor.self_test("y").passed
    script.close()


def test_a_self_test_that_breaks_off_still_ends_the_push() -> None:
    sensor, script = driver("10 00 00 / xx 80 00", "0E / xx", "10 00 00 / unplugged", "00 / xx")
    with pytest.raises(BusError, match="unplugged"):
        sensor.self_test("x")
    script.close()


def test_the_self_test_refuses_an_axis_that_points_down() -> None:
    sensor, script = driver("10 00 00 / xx 40 00")
    with pytest.raises(UsageError, match=r"x reads 512 count.*lay the sensor level"):
        sensor.self_test("x")
    script.close()


def test_the_self_test_knows_two_channels() -> None:
    sensor, _ = driver()
    with pytest.raises(UsageError, match="channels x and y, not 'z'"):
        sensor.self_test("z")


def test_nominal_facts_of_the_datasheet() -> None:
    assert (D01.offset, D01.sensitivity, D02.offset, D02.sensitivity) == (1024.0, 1638.0, 1024.0, 819.0)
    # ±0.11° and ±0.23° of offset are 1.92 mg and 4.01 mg; an even distribution has 1/1.732 of its limit.
    assert D01.offset_spread == pytest.approx(0.00111, abs=5e-6)
    assert D02.offset_spread == pytest.approx(0.00232, abs=5e-6)
    assert D01.sensitivity_spread == pytest.approx(0.00289, abs=5e-6)

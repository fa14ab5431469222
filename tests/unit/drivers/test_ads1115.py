"""The ADS1115 driver against the data sheet and the vectors of the fact sheet, and its twin against the registers.

Transactions are written out / in, in hexadecimal; a write has nothing after the stroke.
"""

from __future__ import annotations

from math import asin, degrees

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.scripted_link import Script

from tiltcal.drivers.ads1115 import RATES, Ads1115, config_word, decode_code, front_end
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.bus.link import Recalling
from tiltcal.drivers.converter import Supply
from tiltcal.drivers.twin.ads1115 import Ads1115Twin
from tiltcal.drivers.twin.analog import Wiring
from tiltcal.drivers.twin.truth import Fault, Truth
from tiltcal.errors import BusError, DeviceFault, UsageError


def driver(*lines: str, full_scale: float = 6.144, rate: int = 128) -> tuple[Ads1115, Script]:
    clock = VirtualClock()
    script = Script("i", clock, *lines)
    return Ads1115(script, clock, full_scale, rate), script


@pytest.mark.parametrize(
    ("number", "rate", "written", "done"),
    [
        (0, 128, "01 C1 83", "C1 83"),
        (1, 128, "01 D1 83", "D1 83"),
        (2, 128, "01 E1 83", "E1 83"),
        (3, 128, "01 F1 83", "F1 83"),
        (0, 8, "01 C1 03", "C1 03"),
    ],
)
def test_conversions_of_the_fact_sheet(number: int, rate: int, written: str, done: str) -> None:
    converter, script = driver(f"{written} /", f"01 / {done}", "00 / 34 15", rate=rate)
    assert converter.volts(number) == pytest.approx(2.4999375, abs=1e-12)
    script.close()


@pytest.mark.parametrize(
    ("answer", "code", "volts", "tilt"),
    [
        ("34 15", 13333, 2.4999375, -0.0009),
        ("42 8E", 17038, 3.1946250, 10.0005),
        ("68 2B", 26667, 5.0000625, None),
        ("FF FF", -1, -0.0001875, None),
    ],
)
def test_results_of_the_fact_sheet(answer: str, code: int, volts: float, tilt: float | None) -> None:
    converter, _ = driver("01 C1 83 /", "01 / C1 83", f"00 / {answer}")
    assert decode_code(bytes.fromhex(answer)) == code
    assert converter.volts(0) == pytest.approx(volts, abs=1e-12)
    if tilt is not None:
        # An SCA100T-D01 at a supply of 5 V: 2.5 V at 0 g, 4 V/g.
        assert degrees(asin((volts - 2.5) / 4.0)) == pytest.approx(tilt, abs=5e-5)


def test_a_result_is_not_an_smbus_word() -> None:
    """``read_word_data`` gives 0x8E42 for the bytes 42 8E, the low byte first."""
    assert decode_code(bytes.fromhex("42 8E")) != 0x8E42
    assert decode_code((0x8E42).to_bytes(2, "little")) == 17038


@given(
    number=st.integers(0, 3),
    full_scale=st.sampled_from(list(enumerate([6.144, 4.096, 2.048, 1.024, 0.512, 0.256]))),
    rate=st.sampled_from(list(enumerate([8, 16, 32, 64, 128, 250, 475, 860]))),
)
def test_the_config_word_bit_by_bit(number: int, full_scale: tuple[int, float], rate: tuple[int, int]) -> None:
    """OS, input against ground, full scale, single shot, rate, comparator off; codes are places in the data sheet."""
    (scale_code, volts), (rate_code, per_second) = full_scale, rate
    bits = f"1{4 + number:03b}{scale_code:03b}1{rate_code:03b}00011"
    assert config_word(number, volts, per_second) == int(bits, 2)


@pytest.mark.parametrize("rate", RATES)
def test_it_waits_for_a_converter_that_is_10_percent_slow(rate: int) -> None:
    word = f"{config_word(0, 6.144, rate):04X}"
    converter, script = driver(f"01 {word} /", f"01 / {word}", "00 / 00 00", rate=rate)
    converter.volts(0)
    start, poll, _ = script.times
    assert poll - start >= 1.1 / rate - 1e-9


def test_a_busy_converter_is_asked_again() -> None:
    converter, script = driver("01 C1 83 /", "01 / 41 83", "01 / 41 83", "01 / C1 83", "00 / 34 15")
    assert converter.volts(0) == pytest.approx(2.4999375)
    script.close()


def test_a_converter_that_hangs_is_given_up() -> None:
    converter, script = driver("01 C1 83 /", *["01 / 41 83"] * Ads1115.POLLS)
    with pytest.raises(BusError, match=r"still busy after 24.2 ms with a conversion that takes 7.81 ms"):
        converter.volts(0)
    script.close()


@pytest.mark.parametrize(("held", "level"), [("FF FF", "high"), ("00 00", "low")])
def test_a_stuck_bus(held: str, level: str) -> None:
    converter, _ = driver("01 C1 83 /", f"01 / {held}")
    with pytest.raises(BusError, match=f"data line is stuck {level}: check SDA"):
        converter.volts(0)


@pytest.mark.parametrize("held", ["85 83", "05 83"])
def test_a_converter_that_lost_its_supply(held: str) -> None:
    converter, _ = driver("01 C1 83 /", f"01 / {held}")
    with pytest.raises(DeviceFault, match="its supply failed for a moment"):
        converter.volts(0)


def test_a_converter_that_somebody_else_uses() -> None:
    converter, _ = driver("01 C1 83 /", "01 / D1 83")
    with pytest.raises(DeviceFault, match="reads D183 where C183 was written: does another program use"):
        converter.volts(0)


@pytest.mark.parametrize("answer", ["7F FF", "80 00"])
def test_an_input_beyond_the_full_scale_is_no_reading(answer: str) -> None:
    converter, _ = driver("01 C5 83 /", "01 / C5 83", f"00 / {answer}", full_scale=2.048)
    with pytest.raises(DeviceFault, match=r"input 0 is at or beyond ±2.048 V.*range=4.096"):
        converter.volts(0)


def test_a_short_answer_is_a_bus_error() -> None:
    converter, _ = driver("01 C1 83 /", "01 / C1")
    with pytest.raises(BusError, match="2 bytes were asked for and 1 came"):
        converter.volts(0)


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ("address=0x4c", "an ADS1115 is at 0x48, 0x49, 0x4a or 0x4b, not at 0x4c"),
        ("address=0x48&range=5", "range=5 is not a full scale of an ADS1115"),
        ("address=0x48&rate=100", "rate=100 is not a rate of an ADS1115"),
    ],
)
def test_settings_that_it_does_not_have(options: str, why: str) -> None:
    with pytest.raises(UsageError, match=why):
        front_end(parse_address(f"ads1115+i2c:///dev/i2c-1?{options}"))


class Terminals(Wiring):
    """These voltages at the inputs, from 0 on; a supply of 5 V."""

    def __init__(self, truth: Truth, clock: VirtualClock, volts: tuple[float, ...]) -> None:
        super().__init__(truth, clock, Supply(None, 5.0, 4.75, 5.25))
        self._volts = volts

    def share(self, number: int, now_ns: int) -> float:
        return self._volts[number] / 5.0 if number < len(self._volts) else 0.0


class Bench:
    """The twin with these voltages at its inputs."""

    def __init__(self, *volts: float, seed: int = 0, faults: tuple[Fault, ...] = ()) -> None:
        self.clock = VirtualClock()
        truth = Truth((), {}, {}, seed=seed, faults=faults)
        self.twin = Ads1115Twin(Terminals(truth, self.clock, volts), self.clock)

    def write(self, line: str) -> None:
        self.twin.exchange(bytes.fromhex(line))

    def read(self, pointer: str) -> str:
        return self.twin.exchange(bytes.fromhex(pointer), 2).hex(" ").upper()


def test_the_twin_wakes_up_with_the_data_sheets_config() -> None:
    assert Bench().read("01") == "85 83"
    assert Bench().read("00") == "00 00"


@pytest.mark.parametrize(
    ("config", "answer"),
    [
        ("C1 83", "34 15"),  # input 0, ±6.144 V: 2.5 / 187.5 µV = 13333.3
        ("D3 83", "63 D0"),  # input 1, ±4.096 V: 3.194 / 125 µV = 25552
        ("C5 83", "7F FF"),  # input 0, ±2.048 V: clipped
        ("81 83", "F1 8B"),  # input 0 - input 1: -0.694 / 187.5 µV = -3701.3 (0E 75, negated)
    ],
)
def test_the_twin_converts(config: str, answer: str) -> None:
    bench = Bench(2.5, 3.194)
    bench.write(f"01 {config}")
    bench.clock.sleep(0.1)
    assert bench.read("00") == answer


@pytest.mark.parametrize("seed", range(20))
def test_the_twin_takes_its_time(seed: int) -> None:
    bench = Bench(2.5, 1.0, seed=seed)
    bench.write("01 C1 83")
    bench.clock.sleep(0.1)
    bench.write("01 D1 83")
    # A poll takes six bytes of nine bits at 100 kHz, so the conversion is 0.9 to 1.1 of 1/128 s less that.
    bench.clock.sleep(0.9 / 128 - 1.0e-3)
    assert bench.read("01") == "51 83"
    assert bench.read("00") == "34 15", "the former result stays until the new one is there"
    bench.clock.sleep(0.2 / 128 + 1.0e-3)
    assert bench.read("01") == "D1 83"
    assert bench.read("00") == "14 D5"  # 1 / 187.5 µV = 5333.3


def test_a_transaction_takes_its_bits_at_100_khz() -> None:
    bench = Bench()
    bench.write("01 C1 83")
    assert bench.clock.now_ns() == 4 * 9 * 10_000
    bench.read("01")
    assert bench.clock.now_ns() == (4 + 2 + 3) * 9 * 10_000


def test_a_twin_made_anew_recalls_what_was_written() -> None:
    def started() -> Bench:
        bench = Bench(2.5, 1.0, seed=3)
        bench.write("01 D1 83")
        return bench

    kept, anew = started(), Bench(2.5, 1.0, seed=3)
    for bench in (kept, anew):
        bench.clock.seek(4_000_000)
    twin: object = anew.twin
    assert isinstance(twin, Recalling)
    twin.recall(bytes.fromhex("01 D1 83"), 360_000)
    assert anew.clock.now_ns() == 4_000_000
    polls = [(kept.read("01"), anew.read("01")) for _ in range(20)]
    assert all(one == other for one, other in polls)
    assert {one for one, _ in polls} == {"51 83", "D1 83"}
    assert kept.read("00") == anew.read("00") == "14 D5"


@pytest.mark.parametrize(("kind", "why"), [("silent", "no device acknowledges"), ("unplugged", "is unplugged")])
def test_faults_of_the_twin(kind: str, why: str) -> None:
    bench = Bench(faults=(Fault(kind, 0.0, 1.0),))
    with pytest.raises(BusError, match=why):
        bench.read("01")
    bench.clock.sleep(1.0)
    assert bench.read("01") == "85 83"


@given(volts=st.floats(0.0, 5.0), seed=st.integers(0, 99), place=st.sampled_from([0, 1, 2, 3]))
def test_the_driver_reads_what_is_at_the_twins_input(volts: float, seed: int, place: int) -> None:
    bench = Bench(*[volts if number == place else 0.0 for number in range(4)], seed=seed)
    assert Ads1115(bench.twin, bench.clock).volts(place) == pytest.approx(volts, abs=0.51 * 187.5e-6)

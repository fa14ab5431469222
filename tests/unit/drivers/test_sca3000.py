"""The SCA3000 driver against the fact sheet: its frames on both buses, its words, its status, and what it never sends.

Transactions are written out / in, in hexadecimal; ``xx`` stands for a byte that means nothing.
"""

from __future__ import annotations

from dataclasses import replace
from math import hypot
from statistics import fmean, stdev

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.emulated.bench import Sca3000 as PartFacts
from support.sca3000_part import Sca3000Part
from support.scripted_link import Script

from tiltcal.drivers import find_model
from tiltcal.drivers.bus import open_link
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.device import Model, Sensor
from tiltcal.drivers.sca3000 import decode_temperature, decode_word
from tiltcal.drivers.twin.fixture import Fixture
from tiltcal.drivers.twin.truth import Fault, Truth
from tiltcal.errors import BusError, DeviceFault, UsageError

D01, E02, E04, E05 = (find_model(f"sca3000-{variant}") for variant in ("d01", "e02", "e04", "e05"))
I2C = find_model("sca3000-i2c")
EVERY = (D01, E02, E04, E05, I2C)


def scripted(model: Model, letter: str, *transactions: str) -> tuple[Sensor, Script]:
    script = Script(letter, VirtualClock(), *transactions)
    return model.driver(script, VirtualClock()), script


def spi_sample(data: str = "06 90 05 48 29 F0", status: str = "00", mode: str = "00") -> list[str]:
    return [f"24 00 00 00 00 00 00 / xx {data}", f"08 00 / xx {status}", f"50 00 / xx {mode}"]


def i2c_sample(data: str = "06 90 05 48 29 F0", status: str = "00", mode: str = "00") -> list[str]:
    return [f"09 +6 / {data}", f"02 +1 / {status}", f"14 +1 / {mode}"]


def spi_probe(revid: str = "21", status: str = "00", mode: str = "00", data: str = "06 90 05 48 29 F0") -> list[str]:
    return [f"00 00 / xx {revid}", *spi_sample(data, status, mode)]


def i2c_probe(revid: str = "21", status: str = "00", mode: str = "00", data: str = "06 90 05 48 29 F0") -> list[str]:
    return [f"00 +1 / {revid}", *i2c_sample(data, status, mode)]


def at(name: str, address: str) -> Model:
    return find_model(name).at(parse_address(address))


@pytest.mark.parametrize(
    ("pair", "counts", "model", "g"),
    [
        ("29 F0", 1342, D01, 1.006752),
        ("05 48", 169, D01, 0.126782),
        ("06 90", 210, D01, 0.157539),
        ("29 A8", 1333, D01, 1.0),
        ("D6 58", -1333, D01, -1.0),
        ("FF F8", -1, D01, -0.000750),
        ("1F 40", 1000, E02, 1.0),
        ("E0 C0", -1000, E02, -1.0),
        ("0F A0", 500, E04, 1.0),
        ("F0 60", -500, E04, -1.0),
        ("05 00", 160, E05, 1.0),
        ("FB 00", -160, E05, -1.0),
        ("6B FF", 3455, None, None),
        ("94 00", -3456, None, None),
    ],
)
def test_words_of_the_fact_sheet(pair: str, counts: int, model: Model | None, g: float | None) -> None:
    assert decode_word(bytes.fromhex(pair)) == counts
    if model is not None:
        assert (counts - model.offset) / model.sensitivity == pytest.approx(g, abs=5e-7)


@pytest.mark.parametrize(("pair", "celsius"), [("20 00", 23.0), ("25 80", 47.44), ("19 00", -8.11)])
def test_temperatures_of_the_fact_sheet(pair: str, celsius: float) -> None:
    assert decode_temperature(bytes.fromhex(pair)) == pytest.approx(celsius, abs=5e-3)


@pytest.mark.parametrize(
    ("pair", "eleven_bits", "counts"), [("29 E0", 335, 1340), ("05 40", 42, 168), ("06 80", 52, 208)]
)
def test_a_ring_buffer_word_keeps_the_scale(pair: str, eleven_bits: int, counts: int) -> None:
    """Eleven bits are left-aligned too, so they decode to the same counts in steps of four."""
    assert decode_word(bytes.fromhex(pair)) == counts == 4 * eleven_bits


@given(count=st.integers(-4096, 4095), filler=st.integers(0, 7))
def test_only_the_thirteen_bits_count(count: int, filler: int) -> None:
    assert decode_word(((count % 8192) * 8 + filler).to_bytes(2, "big")) == count


@given(raw=st.integers(0, 511), above=st.integers(0, 3), below=st.integers(0, 31))
def test_only_the_nine_bits_of_the_thermometer_count(raw: int, above: int, below: int) -> None:
    bits = f"{above:02b}{raw:09b}{below:05b}"
    celsius = decode_temperature(int(bits, 2).to_bytes(2, "big"))
    # The scale and offset of the Linux driver: 0.555556 * (raw - 214.6).
    assert celsius == pytest.approx(0.555556 * (raw - 214.6), abs=2e-3)


def test_one_burst_counts_down_from_z_on_spi() -> None:
    sensor, script = scripted(E02, "s", *spi_sample())
    reading = sensor.read()
    assert reading.values == (1342.0, 169.0, 210.0)
    assert reading.temperature is None
    script.close()


def test_one_burst_counts_down_from_z_on_i2c() -> None:
    sensor, script = scripted(I2C, "i", *i2c_sample())
    assert sensor.read().values == (1342.0, 169.0, 210.0)
    script.close()


def test_the_d01_has_a_thermometer() -> None:
    sensor, script = scripted(D01, "s", "4C 00 00 / xx 25 80", *spi_sample())
    reading = sensor.read()
    assert hypot(*reading.values) / D01.sensitivity == pytest.approx(1.0269, abs=5e-5)
    assert reading.temperature == pytest.approx(47.44, abs=5e-3)
    script.close()
    assert [model.name for model in EVERY if model.thermometer] == ["sca3000-d01"]


def test_the_d01_is_read_over_i2c_as_well() -> None:
    sensor, script = scripted(D01, "i", "13 +2 / 20 00", *i2c_sample())
    assert sensor.read().temperature == 23.0
    script.close()


def test_the_pointer_may_be_the_spi_command() -> None:
    model = at("sca3000-i2c", "i2c:///dev/i2c-1?address=0x1d&counts_per_g=1000&pointer=command")
    sensor, _ = scripted(model, "i", "24 +6 / 06 90 05 48 29 F0", "08 +1 / 00", "50 +1 / 00")
    assert sensor.read().values == (1342.0, 169.0, 210.0)


@pytest.mark.parametrize(("status", "lock"), [("20", "unlocked"), ("00", "locked")])
def test_probe_tells_what_the_part_said(status: str, lock: str) -> None:
    said = {
        "revision": "2.1",
        "registers": lock,
        "mode": "normal",
        "x": "1342 count",
        "y": "169 count",
        "z": "210 count",
    }
    sensor, script = scripted(E02, "s", *spi_probe(status=status))
    assert sensor.probe() == said
    script.close()
    sensor, script = scripted(I2C, "i", *i2c_probe(status=status))
    assert sensor.probe() == said
    script.close()


@pytest.mark.parametrize(("letter", "probe"), [("s", spi_probe), ("i", i2c_probe)])
def test_a_checksum_error_of_the_eeprom_is_a_device_fault(letter: str, probe) -> None:
    sensor, _ = scripted(E02, letter, *probe(status="02"))
    with pytest.raises(DeviceFault, match=r"checksum error of its EEPROM .* switch its supply off and on"):
        sensor.probe()


def test_a_broken_spi_frame_asks_for_a_slower_clock() -> None:
    sensor, _ = scripted(E02, "s", *spi_probe(status="01"))
    with pytest.raises(BusError, match=r"previous SPI frame was damaged .* speed=100000"):
        sensor.probe()
    sensor, _ = scripted(I2C, "i", *i2c_probe(status="01"))
    assert sensor.probe()["mode"] == "normal", "on I2C the bit speaks of no frame of ours"


@pytest.mark.parametrize(
    ("mode", "told"),
    [("81", "option 1, not normal"), ("02", "option 2, not normal"), ("03", "motion detection, not normal")],
)
def test_a_mode_that_is_not_normal_is_told(mode: str, told: str) -> None:
    sensor, _ = scripted(E02, "s", *spi_probe(mode=mode))
    assert sensor.probe()["mode"].startswith(told)


def test_ring_buffer_and_free_fall_bits_leave_the_mode_normal() -> None:
    sensor, _ = scripted(E02, "s", *spi_probe(mode="D0"))
    assert sensor.probe()["mode"] == "normal"


@pytest.mark.parametrize(
    ("first", "then"),
    [(("00", "00"), ("00", "01")), (("00", "03"), ("00", "00")), (("20", "00"), ("00", "00"))],
    ids=["another mode", "a mode that was set before", "locked again"],
)
@pytest.mark.parametrize(("letter", "sample"), [("s", spi_sample), ("i", i2c_sample)])
def test_a_reset_in_mid_session_shows_in_mode_or_lock(letter: str, sample, first, then) -> None:
    """After a reset both registers are as the part's memory has them (fact sheet: check MODE before trusting data)."""
    data = "06 90 05 48 29 F0"
    sensor, _ = scripted(E02, letter, *sample(data, *first), *sample(data, *then), *sample(data, *first))
    before = sensor.read()
    with pytest.raises(DeviceFault, match=r"was reset, its supply failed, or another program has set it since .*: its"):
        sensor.read()
    assert sensor.read() == before, "it is as it was"


def test_a_damaged_frame_and_a_lost_memory_are_found_in_mid_session() -> None:
    sensor, _ = scripted(E02, "s", *spi_sample(), *spi_sample(status="01"), *spi_sample(status="02"))
    sensor.read()
    with pytest.raises(BusError, match="previous SPI frame was damaged"):
        sensor.read()
    with pytest.raises(DeviceFault, match="checksum error"):
        sensor.read()


@pytest.mark.parametrize(("byte", "level"), [("FF", "high"), ("00", "low")])
def test_a_sample_of_equal_bits_is_a_dead_wire(byte: str, level: str) -> None:
    same = " ".join([byte] * 6)
    for letter, sample in (("s", spi_sample), ("i", i2c_sample)):
        sensor, _ = scripted(E02, letter, *sample(same, byte, byte))
        with pytest.raises(BusError, match=f"stuck {level} .* check the data line"):
            sensor.read()


def test_a_dead_wire_is_told_before_the_status_that_it_fakes() -> None:
    sensor, _ = scripted(E02, "s", *spi_probe("FF", "FF", "FF", " ".join(["FF"] * 6)))
    with pytest.raises(BusError, match="stuck high"):
        sensor.probe()


def test_a_short_answer_is_a_bus_error() -> None:
    sensor, _ = scripted(E02, "s", "24 00 00 00 00 00 00 / 06 90 05")
    with pytest.raises(BusError, match="a transaction of 7 bytes was answered with 3"):
        sensor.read()
    sensor, _ = scripted(I2C, "i", "09 +6 / 06 90 05")
    with pytest.raises(BusError, match="a transaction of 6 bytes was answered with 3"):
        sensor.read()


@pytest.mark.parametrize(("pair", "value"), [("6B FF", 3455.0), ("94 00", -3456.0)])
def test_the_overflow_codes_are_the_rails(pair: str, value: float) -> None:
    sensor, _ = scripted(E02, "s", *spi_sample(f"{pair} 00 08 00 08"))
    z = sensor.read().values[2]
    assert z == value
    assert all(z in model.rails for model in EVERY)


# What the address says of the part


@pytest.mark.parametrize(
    ("name", "counts_per_g", "rate"),
    [("d01", 1333.0, 250.0), ("e02", 1000.0, 125.0), ("e04", 500.0, 100.0), ("e05", 160.0, 200.0)],
)
def test_the_parts_of_the_family(name: str, counts_per_g: float, rate: float) -> None:
    model = at(f"sca3000-{name}", "spi:///dev/spidev0.0")
    assert (model.offset, model.sensitivity, model.channels) == (0.0, counts_per_g, ("x", "y", "z"))
    assert model.interval == pytest.approx(1.0 / rate)


def test_any_part_by_its_sensitivity() -> None:
    spi = at("sca3000-e02", "spi:///dev/spidev0.0?counts_per_g=640&rate=400&thermometer=yes")
    assert (spi.sensitivity, spi.interval, spi.thermometer) == (640.0, 0.0025, True)
    i2c = at("sca3000-i2c", "i2c:///dev/i2c-1?address=0x1d&counts_per_g=900")
    assert (i2c.sensitivity, i2c.thermometer) == (900.0, False)


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ("address=0x1d", "option 'counts_per_g' is missing"),
        ("counts_per_g=0.5", "option counts_per_g=0.5 is too small"),
        ("counts_per_g=4000", "option counts_per_g=4000 is too large"),
        ("counts_per_g=1333&thermometer=maybe", "option thermometer=maybe is not one of no, yes"),
        ("counts_per_g=1333&pointer=8", "option pointer=8 is not one of register, command"),
    ],
)
def test_a_wrong_option_is_refused(options: str, why: str) -> None:
    with pytest.raises(UsageError) as error:
        at("sca3000-i2c", f"i2c:///dev/i2c-1?{options}")
    assert why in str(error.value)


def test_a_clock_that_lets_the_words_change_while_they_are_read_is_refused() -> None:
    """Seven bytes are 56 bits, and the D01 has a new word each 4 ms: at least 14,000 Hz."""
    address = parse_address("spi:///dev/spidev0.0?speed=13999")
    with pytest.raises(BusError, match=r"13999 Hz is too slow for sca3000-d01: .* at least speed=14000"):
        open_link(address, D01.at(address))


@pytest.mark.parametrize("speed", ["4294967300", "99999999999999999999"])
def test_a_clock_that_spidev_would_take_for_another_is_refused(speed: str) -> None:
    """It has 32 bits for the clock: 2**32 + 4 Hz would be 4 Hz."""
    address = parse_address(f"spi:///dev/spidev0.0?speed={speed}")
    with pytest.raises(UsageError, match=r"is too large \(at most 100000000\)"):
        open_link(address, D01.at(address))


def test_a_virtual_part_needs_no_option() -> None:
    assert at("sca3000-i2c", "sim:").sensitivity == 1333.0
    assert at("sca3000-i2c", "sim:counts_per_g=500").default_truth(1).sensitivity["x"]["x"] == pytest.approx(
        500, rel=0.03
    )


# The twin


def truth_of(**changes: object) -> Truth:
    """A part that reads the real capture of the fact sheet whatever its pose."""
    truth = Truth(
        channels=("x", "y", "z"),
        offset={"x": 1342.0, "y": 169.0, "z": 210.0},
        sensitivity={channel: {channel: 1e-9} for channel in "xyz"},
        ambient=23.0,
        seed=5,
    )
    return replace(truth, **changes)


class Bench:
    """One twin, the clock and the fixture that it lives by, and its driver."""

    def __init__(self, model: Model, truth: Truth, now_ns: int = 0) -> None:
        self.clock = VirtualClock()
        self.clock.seek(now_ns)
        self.fixture = Fixture(self.clock, ambient=truth.ambient)
        self.twin = model.twin(truth, self.fixture, self.clock)
        self.sensor = model.driver(self.twin, self.clock)


@pytest.mark.parametrize(
    ("out", "answer"),
    [
        ("14 00 00", "29 F0"),
        ("1C 00 00", "05 48"),
        ("24 00 00", "06 90"),
        ("14 00 00 00 00 00 00", "29 F0 06 90 05 48"),
        ("24 00 00 00 00 00 00", "06 90 05 48 29 F0"),
        ("4C 00 00", "20 00"),
        ("08 00", "00"),
    ],
)
def test_the_twin_answers_the_frames_of_the_fact_sheet(out: str, answer: str) -> None:
    assert Bench(D01, truth_of()).twin.exchange(bytes.fromhex(out))[1:] == bytes.fromhex(answer)


def test_the_twin_answers_on_i2c_as_on_spi() -> None:
    twin = Bench(I2C, truth_of()).twin
    assert twin.letter == "i"
    assert twin.exchange(b"\x09", 6) == bytes.fromhex("06 90 05 48 29 F0")
    assert twin.exchange(b"\x05", 6) == bytes.fromhex("29 F0 06 90 05 48")


def test_transfers_take_their_bits() -> None:
    spi = Bench(D01, truth_of())
    spi.twin.exchange(bytes(7))
    assert spi.clock.now_ns() == 112_000, "56 bits at 500 kHz"
    i2c = Bench(I2C, truth_of())
    i2c.twin.exchange(b"\x09", 6)
    assert i2c.clock.now_ns() == 810_000, "9 bytes with their acknowledges at 100 kHz"


def test_a_word_lasts_until_the_next_conversion() -> None:
    bench = Bench(E04, truth_of(noise={"x": 30.0}))
    first = bench.sensor.read()
    bench.clock.seek(9_900_000)
    assert bench.sensor.read() == first
    fresh = set()
    for number in range(1, 20):
        bench.clock.seek(number * 10_000_000)
        fresh.add(bench.sensor.read().values[0])
    assert len(fresh) > 10


def test_noise_is_as_large_as_the_truth_says() -> None:
    bench = Bench(D01, truth_of(noise={"x": 1.5}, offset={"x": 12.3, "y": 0.0, "z": 5.0}))
    x = []
    for number in range(4000):
        bench.clock.seek(number * 4_000_000)
        x.append(bench.sensor.read().values[0])
    # Rounding adds 1/12 count²; the bounds are four standard deviations of 4000 samples.
    assert fmean(x) == pytest.approx(12.3, abs=4 * 1.53 / 4000**0.5)
    assert stdev(x) == pytest.approx((1.5**2 + 1 / 12) ** 0.5, rel=4 / 8000**0.5)


def test_an_overloaded_channel_sends_its_overflow_code() -> None:
    bench = Bench(D01, truth_of(offset={"x": 5000.0, "y": -5000.0, "z": 1.0}))
    assert bench.sensor.read().values == (3455.0, -3456.0, 1.0)


@given(
    counts=st.tuples(*[st.integers(-3000, 3000)] * 3),
    row=st.tuples(*[st.floats(-300.0, 300.0)] * 3).filter(lambda row: abs(row[0]) > 1.0),
    temperature=st.floats(-40.0, 125.0),
    direction=st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda d: hypot(*d) > 0.1),
)
def test_the_twins_agree_with_the_part_that_was_written_apart_from_them(
    counts: tuple[int, ...], row: tuple[float, ...], temperature: float, direction: tuple[float, ...]
) -> None:
    g = [component / hypot(*direction) for component in direction]
    rows = [list(row), [0.0, 700.0, 0.0], [1.0, 2.0, 650.0]]
    part = Sca3000Part(list(counts), rows, noise=0.0, jig=0.0, seed=1, rate=250.0, thermometer=True)
    part.pose(g, temperature)
    truth = truth_of(
        offset=dict(zip("xyz", map(float, counts), strict=True)),
        sensitivity={channel: dict(zip("xyz", one, strict=True)) for channel, one in zip("xyz", rows, strict=True)},
        ambient=temperature,
    )
    for model in (D01, at("sca3000-i2c", "sim:thermometer=yes")):
        bench = Bench(model, truth)
        bench.fixture.gravity = (g[0], g[1], g[2])
        ours = bench.sensor.read()
        theirs = model.driver(PartLink(part, bench.twin.letter), bench.clock).read()
        # A value that lies between two counts, or at a half, may be rounded either way.
        assert ours.values == pytest.approx(theirs.values, abs=1.0)
        assert ours.temperature == pytest.approx(theirs.temperature, abs=0.6)


class PartLink:
    """The independent part as a link."""

    def __init__(self, part: Sca3000Part, letter: str) -> None:
        self.part, self.letter = part, letter

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        return self.part.transfer(out, 0, 0) if self.letter == "s" else self.part.message(out, count, 0)

    def close(self) -> None:
        assert self.part.writes == 0


@pytest.mark.parametrize("model", EVERY, ids=lambda model: model.name)
def test_nothing_is_ever_written(model: Model) -> None:
    facts = PartFacts()
    rows = [list(row) for row in facts.sensitivity]
    for letter in ("s", "i"):
        part = Sca3000Part(list(facts.offset), rows, noise=1.5, jig=0.0, seed=1, rate=250.0, thermometer=True)
        sensor = model.driver(PartLink(part, letter), VirtualClock())
        sensor.probe()
        sensor.read()
        sensor.discard()
        assert part.writes == 0


@pytest.mark.parametrize("model", [D01, I2C], ids=["spi", "i2c"])
def test_a_killed_session_goes_on_with_the_bytes_it_would_have_had(model: Model) -> None:
    truth = model.default_truth(3)
    whole = Bench(model, truth)
    readings = [whole.sensor.read() for _ in range(30)]
    for cut in (1, 7, 29):
        before = Bench(model, truth)
        first = [before.sensor.read() for _ in range(cut)]
        after = Bench(model, truth, before.clock.now_ns())
        assert first + [after.sensor.read() for _ in range(30 - cut)] == readings


@pytest.mark.parametrize("model", [D01, I2C], ids=["spi", "i2c"])
@pytest.mark.parametrize(
    ("kind", "error", "why"),
    [
        ("parity", DeviceFault, "EEPROM"),
        ("silent", BusError, "stuck high|no device acknowledges"),
        ("unplugged", BusError, "unplugged"),
    ],
)
def test_a_fault_comes_and_goes(model: Model, kind: str, error: type[Exception], why: str) -> None:
    bench = Bench(model, truth_of(faults=(Fault(kind, 1.0, 2.0),)))
    bench.sensor.probe()
    bench.clock.seek(1_000_000_000)
    with pytest.raises(error, match=why):
        bench.sensor.probe()
    bench.clock.seek(2_000_000_000)
    assert bench.sensor.probe()["x"] == "1342 count"


def test_a_stuck_reading_does_not_even_have_noise() -> None:
    bench = Bench(D01, truth_of(noise={"x": 30.0}, faults=(Fault("stuck", 1.0, 2.0),)))
    held = set()
    for number in range(10):
        bench.clock.seek(1_000_000_000 + number * 4_000_000)
        held.add(bench.sensor.read().values)
    assert len(held) == 1


@pytest.mark.parametrize("model", EVERY, ids=lambda model: model.name)
def test_every_drawn_part_is_in_range_and_of_its_own(model: Model) -> None:
    parts = [model.default_truth(seed) for seed in range(100)]
    for part in parts:
        for channel in "xyz":
            own = part.sensitivity[channel][channel]
            assert abs(own / model.sensitivity - 1.0) <= 0.03
            assert abs(part.offset[channel]) <= 0.05 * model.sensitivity
            assert hypot(*(k for axis, k in part.sensitivity[channel].items() if axis != channel)) <= 0.0201 * own
    assert len({part.offset["x"] for part in parts}) == 100
    assert model.default_truth(7) == parts[7]

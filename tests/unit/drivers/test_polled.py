"""ADXL355 and IIS2ICLX: the bytes of the fact sheet, their twins, and parts written apart from both, on either bus."""

from __future__ import annotations

from dataclasses import asdict, replace

import pytest
from support.adxl355_part import Adxl355Part
from support.emulated.bench import Adxl355, Iis2iclx
from support.iis2iclx_part import Iis2iclxPart
from support.part_link import PartLink
from support.scripted_link import Script

from tiltcal.drivers import adxl355, find_model, iis2iclx
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.device import Model, Sensor
from tiltcal.drivers.twin.fixture import Fixture
from tiltcal.drivers.twin.truth import Fault, Truth
from tiltcal.errors import BusError, DeviceFault, UsageError

ADXL, ICLX = find_model("adxl355"), find_model("iis2iclx")
PARTS = {"adxl355": (Adxl355Part, Adxl355()), "iis2iclx": (Iis2iclxPart, Iis2iclx())}


def at(name: str, options: str, bus: str = "spi:///dev/spidev0.0") -> Model:
    return find_model(name).at(parse_address(f"{bus}?{options}"))


def bench(model: Model, letter: str = "s", **changes: object) -> tuple[Sensor, PartLink]:
    part, facts = PARTS[model.name]
    clock = VirtualClock()
    clock.sleep(1.0)
    link = PartLink(part(**asdict(replace(facts, **{"jig": 0.0, "noise": 0.0, **changes}))), clock, letter)
    return model.driver(link, clock), link


def expected(link: PartLink, model: Model) -> tuple[float, ...]:
    return tuple(float(round(one * model.sensitivity)) for one in link.part.measured(link.clock.now_ns()))


# Bytes of the fact sheet


@pytest.mark.parametrize(
    ("data", "options", "count", "g"),
    [
        ("3E 80 00", "range=2g", 256000, 1.0),
        ("C1 80 00", "range=2g", -256000, -1.0),
        ("3E 80 0F", "range=2g", 256000, 1.0),
        ("1F 40 00", "range=2g", 128000, 0.5),
        ("1F 40 00", "range=4g", 128000, 1.0),
        ("1F 40 00", "range=8", 128000, 2.0),
        ("0F A0 00", "", 64000, 0.25),
        ("0A DA 60", "", 44454, 0.173648),
        ("00 00 10", "", 1, 3.90625e-6),
        ("FF FF F0", "", -1, -3.90625e-6),
        ("7F FF F0", "", 524287, 2.047996),
        ("80 00 00", "", -524288, -2.048),
    ],
)
def test_words_of_the_adxl355(data: str, options: str, count: int, g: float) -> None:
    assert adxl355.decode_word(bytes.fromhex(data)) == count
    assert count / at("adxl355", options).sensitivity == pytest.approx(g, abs=5e-7)


@pytest.mark.parametrize(
    ("data", "celsius"),
    [("07 5D", 25.0), ("F7 5D", 25.0), ("08 3F", 0.03), ("09 A9", -39.97), ("05 3E", 85.0)],
)
def test_temperatures_of_the_adxl355(data: str, celsius: float) -> None:
    assert adxl355.decode_temperature(bytes.fromhex(data)) == pytest.approx(celsius, abs=0.005)


@pytest.mark.parametrize(
    ("data", "options", "count", "g"),
    [
        ("01 3F", "range=1g", 16129, 0.5),
        ("7F E0", "range=1g", -8065, -0.25),
        ("02 7E", "range=1", 32258, 1.0),
        ("FE 81", "range=1", -32258, -1.0),
        ("09 40", "range=2g", 16393, 1.0),
        ("F7 BF", "", -16393, -1.0),
        ("05 20", "", 8197, 0.5),
        ("05 20", "range=3g", 8197, 1.0),
        ("E5 BE", "range=0.5g", -16667, -0.25),
        ("FF 7F", "range=0.5", 32767, 0.4915),
        ("00 80", "range=0.5", -32768, -0.49152),
    ],
)
def test_words_of_the_iis2iclx(data: str, options: str, count: int, g: float) -> None:
    assert iis2iclx.decode_word(bytes.fromhex(data)) == count
    assert count / at("iis2iclx", options).sensitivity == pytest.approx(g, abs=4e-5)


@pytest.mark.parametrize(("data", "celsius"), [("00 00", 25.0), ("00 01", 26.0), ("80 FF", 24.5), ("00 BF", -40.0)])
def test_temperatures_of_the_iis2iclx(data: str, celsius: float) -> None:
    assert iis2iclx.decode_temperature(bytes.fromhex(data)) == celsius


def test_the_rails_are_no_readings() -> None:
    assert (ADXL.rails, ICLX.rails) == ((-524288.0, 524287.0), (-32768.0, 32767.0))
    assert ICLX.channels == ("x", "y")


@pytest.mark.parametrize(
    ("first", "second", "celsius"),
    [("07 5D", "07 5D", 25.0), ("07 00", "07 FF", 35.276), ("07 FF", "06 FF", 35.387)],
    ids=["at rest", "0x6FF comes within the second pair", "0x6FF comes within the first pair"],
)
def test_the_frames_of_the_adxl355_on_spi(first: str, second: str, celsius: float) -> None:
    clock = VirtualClock()
    script = Script(
        *("s", clock),
        *("01 00 00 00 / xx AD 1D ED", "A1 00 00 00 00 00 / xx 01 02 03 04 05", "5E 52 / xx xx"),
        *("A1 00 00 00 00 00 / xx 01 02 03 04 05", "50 05 / xx xx", "58 82 / xx xx", "51 00 / xx 05"),
        *("59 00 / xx 82", "5A 00 / xx xx", "5B 00 / xx 00", "09 00 / xx 00", "09 00 / xx 01"),
        "11 00 00 00 00 00 00 00 00 00 / xx 3E 80 00 C1 80 0F 00 00 10",
        *(f"0D 00 00 / xx {first}", f"0D 00 00 / xx {second}"),
    )
    reading = at("adxl355", "range=4g").driver(script, clock).read()
    assert reading.values == (256000.0, -256000.0, 1.0)
    assert reading.temperature == pytest.approx(celsius, abs=5e-4)
    script.close()


def test_the_frames_of_the_iis2iclx_on_i2c() -> None:
    clock = VirtualClock()
    unsettled = ("1E / 01", "28 / 00 00 00 00") * 3
    script = Script(
        *("i", clock, "0F / 6B", "12 01 /", "18 E2 /", "12 44 /", "10 48 /", "18 / E2", "12 / 44", "10 / 48"),
        *unsettled,
        *("1E / 01", "28 / 01 3F 7F E0", "20 / 00 01"),
    )
    reading = at("iis2iclx", "range=1g").driver(script, clock).read()
    assert (reading.values, reading.temperature) == ((16129.0, -8065.0), 26.0)
    script.close()


# The drivers and parts written apart from them


@pytest.mark.parametrize("letter", ["s", "i"])
@pytest.mark.parametrize(
    "model",
    [
        *(at("adxl355", options) for options in ("", "range=4g&rate=62.5", "range=8g&rate=500")),
        *(at("iis2iclx", options) for options in ("", "range=3g&rate=12.5", "range=1g&rate=833")),
    ],
    ids=lambda model: f"{model.name} {model.sensitivity:.0f} count/g",
)
def test_every_range_reads_what_the_part_measures(model: Model, letter: str) -> None:
    sensor, link = bench(model, letter)
    for gravity in ([0.6, 0.0, -0.8], [-0.36, 0.48, 0.8]):
        link.part.pose(gravity, 31.0)
        reading = sensor.read()
        assert reading.values == expected(link, model)
        assert reading.temperature == pytest.approx(31.0, abs=0.06)
    link.close()


@pytest.mark.parametrize("model", [ADXL, ICLX], ids=lambda model: model.name)
def test_each_sample_is_read_once(model: Model) -> None:
    sensor, link = bench(model, noise=0.1, corner=1000.0)
    readings = [sensor.read().values for _ in range(200)]
    assert len(set(readings)) == 200
    link.close()


@pytest.mark.parametrize("model", [ADXL, ICLX], ids=lambda model: model.name)
def test_a_reset_in_mid_session_is_told_and_the_part_is_set_up_anew(model: Model) -> None:
    sensor, link = bench(at(model.name, "range=1g" if model is ICLX else "range=8g"))
    before = sensor.read().values
    link.part.restart()
    with pytest.raises(DeviceFault, match=r"was reset or its supply failed since it was set up .register 0x.* holds"):
        sensor.read()
    assert sensor.read().values == before
    link.close()


def test_a_reset_that_does_not_load_the_trim_is_repeated() -> None:
    sensor, link = bench(ADXL, races=3)
    assert sensor.read().values == expected(link, ADXL)
    link.part.races = 20
    link.part.restart()
    with pytest.raises(DeviceFault, match="was reset"):
        sensor.read()
    for _ in range(2):
        with pytest.raises(DeviceFault, match="does not load its factory trim"):
            sensor.read()
    link.part.races = 0
    assert sensor.read().values == expected(link, ADXL)


@pytest.mark.parametrize(
    ("model", "answer", "error", "why"),
    [
        (ADXL, "FF", BusError, "stuck high"),
        (ADXL, "00", BusError, "stuck low"),
        (ADXL, "AD", DeviceFault, "says that it is AD AD AD, where an ADXL355 says AD 1D ED"),
        (ICLX, "FF", BusError, "stuck high"),
        (ICLX, "6C", DeviceFault, "says that it is 6C, where an IIS2ICLX says 6B"),
    ],
)
def test_what_is_not_the_part_is_refused(model: Model, answer: str, error: type[Exception], why: str) -> None:
    class Wire:
        letter = "s"

        def exchange(self, out: bytes, count: int = 0) -> bytes:
            return bytes.fromhex(answer) * len(out)

    with pytest.raises(error, match=why):
        model.driver(Wire(), VirtualClock()).read()


@pytest.mark.parametrize(
    ("name", "options", "bus", "why"),
    [
        ("adxl355", "rate=100", "spi:///dev/spidev0.0", "rate=100 is none of 4000"),
        ("adxl355", "address=0x1d&rate=1000", "i2c:///dev/i2c-1", "rate=1000 is too fast for I2C"),
        ("adxl355", "range=3g", "spi:///dev/spidev0.0", "range=3g is not one of 2g, 4g, 8g"),
        ("iis2iclx", "rate=1666", "spi:///dev/spidev0.0", "rate=1666 is none of 12.5"),
        ("iis2iclx", "range=4g", "spi:///dev/spidev0.0", "range=4g is not one of 0.5g"),
    ],
)
def test_a_wrong_option_is_refused(name: str, options: str, bus: str, why: str) -> None:
    with pytest.raises(UsageError, match=why):
        at(name, options, bus)


# The twins


def truth_of(model: Model, **changes: object) -> Truth:
    facts = PARTS[model.name][1]
    truth = Truth(
        channels=model.channels,
        offset={c: model.sensitivity * one for c, one in zip(model.channels, facts.offset, strict=True)},
        sensitivity={
            c: {axis: model.sensitivity * one for axis, one in zip("xyz", row, strict=True)}
            for c, row in zip(model.channels, facts.sensitivity, strict=True)
        },
        ambient=-12.0,
    )
    return replace(truth, **changes)


@pytest.mark.parametrize("letter", ["s", "i"])
@pytest.mark.parametrize(
    "model", [at("adxl355", "range=8g&rate=250"), at("iis2iclx", "range=3g")], ids=lambda m: m.name
)
def test_the_twin_agrees_with_the_part_that_was_written_apart_from_it(model: Model, letter: str) -> None:
    """The twin is on SPI, the part on either bus."""
    other, link = bench(model, letter)
    link.part.pose([0.48, -0.6, 0.64], -12.0)
    clock = VirtualClock()
    fixture = Fixture(clock, ambient=-12.0)
    fixture.gravity = (0.48, -0.6, 0.64)
    twin = model.twin(truth_of(model), fixture, clock)
    ours, theirs = model.driver(twin, clock).read(), other.read()
    assert ours.values == pytest.approx(theirs.values, abs=1.0)
    assert ours.temperature == pytest.approx(theirs.temperature, abs=0.06)


@pytest.mark.parametrize("model", [ADXL, ICLX], ids=lambda model: model.name)
def test_a_twin_of_a_resumed_session_is_as_it_was(model: Model) -> None:
    truth = model.default_truth(2)
    clock = VirtualClock()
    link = Recorder(model.twin(truth, Fixture(clock), clock), clock)
    sensor = model.driver(link, clock)
    for _ in range(20):
        sensor.read()
    resumed = VirtualClock()
    resumed.seek(clock.now_ns())
    fresh = model.twin(truth, Fixture(resumed), resumed)
    for out, now_ns in link.sent[-32:]:
        fresh.recall(out, now_ns)
    old = [out for out, _ in link.sent[-8:]]
    assert [fresh.exchange(out)[1:] for out in old] == [link.exchange(out)[1:] for out in old]


class Recorder:
    """A link that notes what passes."""

    letter = "s"

    def __init__(self, link, clock: VirtualClock) -> None:
        self.link, self.clock = link, clock
        self.sent: list[tuple[bytes, int]] = []

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        answer = self.link.exchange(out, count)
        self.sent.append((out, self.clock.now_ns()))
        return answer


@pytest.mark.parametrize("model", [ADXL, ICLX], ids=lambda model: model.name)
def test_a_fault_comes_and_goes(model: Model) -> None:
    clock = VirtualClock()
    truth = truth_of(model, faults=(Fault("silent", 1.0, 2.0), Fault("unplugged", 2.0, 3.0)))
    sensor = model.driver(model.twin(truth, Fixture(clock), clock), clock)
    before = sensor.read().values
    clock.seek(1_000_000_000)
    with pytest.raises(BusError, match="stuck high"):
        sensor.read()
    clock.seek(2_000_000_000)
    with pytest.raises(BusError, match="unplugged"):
        sensor.read()
    clock.seek(3_000_000_000)
    assert sensor.read().values == before

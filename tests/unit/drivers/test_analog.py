"""Analog sensors: what they read is referred to a supply of 5 V, whatever the supply is."""

from __future__ import annotations

from dataclasses import replace
from math import asin, degrees, radians, sin
from statistics import fmean, stdev

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiltcal.drivers import find_model
from tiltcal.drivers.bus import link_letter
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.converter import Supply
from tiltcal.drivers.twin.fixture import Fixture
from tiltcal.drivers.twin.truth import Fault, Truth
from tiltcal.errors import DeviceFault, UsageError

D01, D02 = find_model("sca100t-d01-analog"), find_model("sca100t-d02-analog")
ANALOG = [D01, D02, *(find_model(f"{name}-analog") for name in ("adxl202", "adxl202e", "adxl210"))]
WIRED = "ads1115+i2c:///dev/i2c-1?address=0x48&x=0&y=1&supply=2"


class Inputs:
    """A converter whose inputs have these voltages at its first conversion, and those later."""

    def __init__(self, *at_first: float, later: tuple[float, ...] = ()) -> None:
        self._volts = [at_first, later or at_first]
        self.asked: list[int] = []

    def volts(self, number: int) -> float:
        """Every conversion takes as long: what moves, moves a third of the way from one of four to the next."""
        at_first, later = self._volts
        share = len(self.asked) / 3.0
        self.asked.append(number)
        return at_first[number] + share * (later[number] - at_first[number])


def tilt(share: float, share_per_g: float) -> float:
    return degrees(asin((share - 0.5) / share_per_g))


@pytest.mark.parametrize(("supply", "output"), [(5.000, 3.194593), (4.900, 3.130701)])
def test_ten_degrees_of_the_fact_sheet(supply: float, output: float) -> None:
    """An SCA100T-D01 at 10°, at two supplies."""
    for wired in (Supply(2, 5.0, 4.75, 5.25), Supply(None, supply, 4.75, 5.25)):
        (share,), measured = wired.shares(Inputs(output, 0.0, supply), [0])
        assert tilt(share, 0.8) == pytest.approx(10.0, abs=5e-5)
        assert measured == pytest.approx(supply)


def test_the_error_of_assuming_5_volts() -> None:
    (share,), _ = Supply(None, 5.0, 4.75, 5.25).shares(Inputs(3.130701), [0])
    assert tilt(share, 0.8) == pytest.approx(9.072, abs=5e-4)


def test_the_supply_is_measured_before_and_after() -> None:
    inputs = Inputs(2.5, 2.5, 5.0)
    Supply(2, 5.0, 4.75, 5.25).shares(inputs, [0, 1])
    assert inputs.asked == [2, 0, 1, 2]


@given(before=st.floats(4.75, 5.25), after=st.floats(4.75, 5.25), x=st.floats(0.05, 0.95), y=st.floats(0.05, 0.95))
def test_a_supply_that_drifts_during_the_sample_is_no_tilt(before: float, after: float, x: float, y: float) -> None:
    inputs = Inputs(x * before, y * before, before, later=(x * after, y * after, after))
    shares, supply = Supply(2, 5.0, 4.75, 5.25).shares(inputs, [0, 1])
    assert shares == pytest.approx((x, y), abs=1e-12)
    assert supply == pytest.approx((before + after) / 2.0)


@pytest.mark.parametrize("supply", [0.0, 3.3, 4.69, 5.31])
def test_a_supply_that_the_sensor_cannot_work_with(supply: float) -> None:
    with pytest.raises(DeviceFault, match=r"supply at input 2 reads .* V, where the sensor needs 4.75 to 5.25 V"):
        Supply(2, 5.0, 4.75, 5.25).shares(Inputs(2.5, 2.5, supply), [0, 1])


def test_a_supply_beyond_the_converters_full_scale_is_not_known() -> None:
    """At a reference of 5 V the uppermost of 4096 steps stands for 4.9988 V and all above, 5.2 V as well."""
    with pytest.raises(DeviceFault, match=r"reads 4.999 V, the full scale of this converter"):
        Bench(nominal(supply=5.2), "sim:adc=mcp3208&vref=5.0&supply=7").sensor.read()


@pytest.mark.parametrize(
    ("address", "why"),
    [
        ("ads1115+i2c:///dev/i2c-1?address=0x48&y=1&supply=2", "option 'x' is missing"),
        ("ads1115+i2c:///dev/i2c-1?address=0x48&x=0&y=4&supply=2", "y=4 is too large .at most 3"),
        ("ads1115+i2c:///dev/i2c-1?address=0x48&x=0&y=0&supply=2", "'x' and 'y' name the same input 0"),
        ("ads1115+i2c:///dev/i2c-1?address=0x48&x=0&y=1&supply=1", "'y' and 'supply' name the same input 1"),
        ("ads1115+i2c:///dev/i2c-1?address=0x48&x=0&y=1", "wire it to an input and add supply=N, or state"),
        (f"{WIRED}&vdd=5", "'supply' and 'vdd' exclude each other"),
        (f"{WIRED}&range=4.096", r"ADS1115, ±4.096 V.* cannot measure a supply of 4.75 V or more"),
        ("ads1115+i2c:///dev/i2c-1?address=0x48&x=0&y=1&vdd=3.3", "vdd=3.3 is too small"),
        ("mcp3208+spi:///dev/spidev0.1?x=0&y=1", "option 'vref' is missing"),
        ("mcp3208+spi:///dev/spidev0.1?x=0&y=1&vref=4.096", "reference of 4.096 V is not its supply"),
        ("i2c:///dev/i2c-1?address=0x48&x=0&y=1", r"'i2c' is not a known converter .*ads1115\+i2c: or"),
        ("sim:adc=ads1015", "'ads1015' is not a known converter"),
    ],
)
def test_a_wiring_that_cannot_be(address: str, why: str) -> None:
    with pytest.raises(UsageError, match=why):
        D02.at(parse_address(address))


@pytest.mark.parametrize(
    ("address", "letter", "step"),
    [
        (WIRED, "i", 187.5e-6),
        ("ads1115+i2c:///dev/i2c-1?address=0x48&x=0&y=1&vdd=4.8", "i", 187.5e-6 * 5.0 / 4.8),
        ("mcp3208+spi:///dev/spidev0.1?x=0&y=1&vref=5.0", "s", 5.0 / 4096),
        ("mcp3208+spi:///dev/spidev0.1?x=0&y=1&vref=4.9", "s", 5.0 / 4096),
        ("sim:", "i", 187.5e-6),
        ("sim:adc=mcp3208", "s", 5.0 / 4096),
    ],
)
def test_the_address_settles_bus_and_step(address: str, letter: str, step: float) -> None:
    where = parse_address(address)
    model = D02.at(where)
    assert link_letter(where, model) == letter
    assert model.resolution == pytest.approx(step)
    assert model.at(where).resolution == model.resolution, "telling it twice changes nothing"


@pytest.mark.parametrize("name", ["adxl202", "adxl202e", "adxl210"])
def test_an_adxl202_at_a_converter_is_the_analog_model(name: str) -> None:
    """The same part by its own name: behind an RC filter it reads volts, and its calibration says so."""
    model = find_model(name).at(parse_address(WIRED))
    assert (model.name, model.unit) == (f"{name}-analog", "V")
    assert model.schemes[0] == "ads1115+i2c"


def test_nominal_facts_of_the_data_sheets() -> None:
    """4 and 2 V/g at 5 V; 12.5 and 4 % of the supply per g."""
    assert [model.offset for model in ANALOG] == [2.5] * 5
    assert [model.sensitivity for model in ANALOG] == pytest.approx([4.0, 2.0, 0.625, 0.625, 0.2])
    assert D01.rails == D02.rails == (0.25, 4.75)


class Bench:
    """A sensor with its twin, clock and fixture."""

    def __init__(self, truth: Truth, address: str = "sim:", model: str = "sca100t-d02-analog") -> None:
        self.clock = VirtualClock()
        self.fixture = Fixture(self.clock, ambient=truth.ambient)
        fitted = find_model(model).at(parse_address(address))
        self.sensor = fitted.driver(fitted.twin(truth, self.fixture, self.clock), self.clock)

    def tilt(self, x: float = 0.0, y: float = 0.0) -> Bench:
        gx, gy = sin(radians(x)), sin(radians(y))
        self.fixture.move((gx, gy, (1.0 - gx * gx - gy * gy) ** 0.5))
        return self


def nominal(**changes: object) -> Truth:
    truth = Truth(("x", "y"), {"x": 2.5, "y": 2.5}, {"x": {"x": 2.0}, "y": {"y": 2.0}}, seed=5)
    return replace(truth, **changes)


CONVERTERS = [
    *("sim:", "sim:vdd=4.9", "sim:x=3&y=0&supply=1"),
    *("sim:adc=mcp3208", "sim:adc=mcp3208&vref=5.2&vdd=4.9", "sim:adc=mcp3208&vref=5.2&supply=7"),
]


@pytest.mark.parametrize("address", CONVERTERS)
def test_the_twin_at_4_9_volts_reads_as_at_5(address: str) -> None:
    bench = Bench(nominal(supply=4.9), address).tilt(x=30.0, y=-45.0)
    # 2.5 + 2 sin 30° and 2.5 - 2 sin 45°; two steps of the coarser converter.
    assert bench.sensor.read().values == pytest.approx((3.5, 1.085786), abs=2.5e-3)


def test_a_supply_stated_wrongly_is_wrong_by_as_much() -> None:
    reading = Bench(nominal(supply=4.9), "sim:vdd=5.0").tilt(x=30.0).sensor.read()
    assert reading.values[0] == pytest.approx(3.5 * 4.9 / 5.0, abs=5e-4)


def test_the_twins_noise_is_that_of_the_truth() -> None:
    bench = Bench(nominal(noise={"x": 2e-3, "y": 0.0}, supply=4.9))
    x, y = zip(*(bench.sensor.read().values for _ in range(2000)), strict=True)
    # A deviation is known to 1.6 % from 2000 samples, a mean to 0.045 mV.
    assert stdev(x) == pytest.approx(2e-3, rel=0.08)
    assert fmean(x) == pytest.approx(2.5, abs=3e-4)
    assert max(y) - min(y) < 4e-4


def test_probe_tells_outputs_supply_and_converter() -> None:
    said = Bench(nominal(supply=4.9), "sim:vdd=4.9").tilt(x=30.0).sensor.probe()
    # 3.43 V are 18293 steps and 2.45 V are 13067, referred to 5 V:
    assert said == {
        "x": "3.4999 V, referred to 5 V",
        "y": "2.5001 V, referred to 5 V",
        "supply": "4.9000 V, stated",
        "converter": "ADS1115, ±6.144 V, 128 conversions per second",
    }
    assert Bench(nominal()).sensor.probe()["supply"] == "5.0001 V, measured at input 2"


def test_both_outputs_below_0_25_volts_are_the_parts_fault_signal() -> None:
    bench = Bench(nominal(faults=(Fault("parity", 0.0, 1.0),)))
    with pytest.raises(DeviceFault, match=r"both outputs are below 0.25 V, the part's fault signal"):
        bench.sensor.read()


def test_a_stuck_sensor_holds_its_reading() -> None:
    bench = Bench(nominal(faults=(Fault("stuck", 0.0, 100.0),)))
    assert bench.tilt(x=10.0).sensor.read() == bench.tilt(x=-20.0).sensor.read()


@pytest.mark.parametrize("seed", range(10))
def test_an_analog_part_is_the_part_of_its_digital_port(seed: int) -> None:
    """11 bits span the supply, so each reading is 5/2048 V of the other (1638 count/g are 4 V/g to 0.02 %)."""
    for name in ("sca100t-d01", "sca100t-d02"):
        digital, analog = find_model(name).default_truth(seed), find_model(f"{name}-analog").default_truth(seed)
        for gravity, celsius in (((0.0, 0.0, 1.0), 25.0), ((0.5, 0.0, 0.866), 5.0), ((0.0, -0.4, 0.9165), 60.0)):
            for channel in "xy":
                counts, volts = (truth.reading(channel, gravity, celsius) for truth in (digital, analog))
                assert volts == pytest.approx(counts * 5.0 / 2048.0, abs=1e-3)


@pytest.mark.parametrize("seed", range(20))
def test_a_drawn_adxl202_is_within_its_data_sheet(seed: int) -> None:
    truth = find_model("adxl202-analog").default_truth(seed)
    for channel in "xy":
        assert 0.10 * 5.0 <= truth.sensitivity[channel][channel] <= 0.15 * 5.0
        # 2 mg/°C of 0.625 V/g
        assert abs(truth.drift[channel][0]) <= 1.25e-3
    # 500 µg/√Hz over 1.57 * 10 Hz are the fact sheet's 1.98 mg, of 0.625 V/g.
    assert truth.noise["x"] == pytest.approx(1.98e-3 * 0.625, rel=2e-3)

"""Converters and register parts: supplies, waits, and set-ups that fail."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.scripted_link import Script

from tiltcal.drivers import find_model
from tiltcal.drivers.ads1115 import RATES, Ads1115, config_word
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.converter import Supply
from tiltcal.drivers.device import Sensor
from tiltcal.drivers.thermistor import Curve
from tiltcal.drivers.twin.fixture import Fixture
from tiltcal.drivers.twin.truth import Truth
from tiltcal.errors import BusError, DeviceFault, UsageError


def sensor_at(name: str, address: str, **truth: Any) -> tuple[Sensor, Fixture]:
    model, clock = find_model(name).at(parse_address(address)), VirtualClock()
    fixture = Fixture(clock, ambient=24.0)
    return model.driver(model.twin(replace(model.default_truth(3), noise={}, **truth), fixture, clock), clock), fixture


@given(before=st.floats(4.75, 5.25), after=st.floats(4.75, 5.25), x=st.floats(0.05, 0.95), y=st.floats(0.05, 0.95))
def test_a_supply_that_drifts_during_the_sample_is_no_tilt(before: float, after: float, x: float, y: float) -> None:
    """Every conversion takes as long: the supply moves a third of the way from one of four to the next."""
    asked: list[int] = []

    class Drifting:
        def volts(self, number: int) -> float:
            now = before + len(asked) / 3.0 * (after - before)
            asked.append(number)
            return now * {0: x, 1: y, 2: 1.0}[number]

    shares, supply = Supply(2, 5.0, 4.75, 5.25).shares(Drifting(), [0, 1])
    assert shares == pytest.approx((x, y), abs=1e-12)
    assert (supply, asked) == (pytest.approx((before + after) / 2.0), [2, 0, 1, 2])


@pytest.mark.parametrize(
    "options",
    ["", "vdd=4.9", "x=3&y=0&supply=1", "adc=mcp3208", "adc=mcp3208&vref=5.2&vdd=4.9", "adc=mcp3208&vref=5.2&supply=7"],
)
def test_a_sensor_at_4_9_volts_reads_as_at_5(options: str) -> None:
    part = {"offset": {"x": 2.5, "y": 2.5}, "sensitivity": {"x": {"x": 2.0}, "y": {"y": 2.0}}, "supply": 4.9}
    sensor, fixture = sensor_at("sca100t-d02-analog", f"sim:{options}", **part, nonlinearity={}, drift={}, gain={})
    fixture.move((0.5, -(0.5**0.5), 0.5))
    # Two steps of the coarser converter.
    assert sensor.read().values == pytest.approx((3.5, 1.085786), abs=2.5e-3)
    thermometer, _ = sensor_at("thermistor", f"sim:{options.replace('x=3&y=0&supply=1', 'supply=1')}", supply=4.9)
    assert thermometer.read().temperature == pytest.approx(24.0, abs=0.05)


def test_the_address_of_an_analog_sensor_settles_step_model_and_limits() -> None:
    wired = "ads1115+i2c:///dev/i2c-1?address=0x48&x=0&y=1"
    model = find_model("sca100t-d02-analog").at(parse_address(f"{wired}&vdd=4.8"))
    assert model.resolution == pytest.approx(187.5e-6 * 5.0 / 4.8)
    for name in ("adxl202", "adxl202e", "adxl210"):
        model = find_model(name).at(parse_address(f"{wired}&supply=2"))
        assert (model.name, model.unit, model.schemes[0]) == (f"{name}-analog", "V", "ads1115+i2c")
    sensor, _ = sensor_at("sca100t-d02-analog", "sim:adc=mcp3208&vref=5.0&supply=7", supply=5.2)
    with pytest.raises(DeviceFault, match=r"reads 4.999 V, the full scale of this converter"):
        sensor.read()
    for supply in (0.0, 3.3, 4.69, 5.31):
        sensor, _ = sensor_at("sca100t-d02-analog", "sim:", supply=supply)
        with pytest.raises(DeviceFault, match=r"supply at input 2 reads .* V, where the sensor needs 4.75 to 5.25 V"):
            sensor.read()
    for address in ("i2c:///dev/i2c-1?address=0x48&x=0&y=1", "sim:adc=ads1015"):
        with pytest.raises(UsageError, match="is not a known converter"):
            find_model("sca100t-d02-analog").at(parse_address(address))


def test_an_analog_part_is_the_part_of_its_digital_port() -> None:
    """11 bits span the supply, so each reading is 5/2048 V of the other (1638 count/g are 4 V/g to 0.02 %)."""
    for name in ("sca100t-d01", "sca100t-d02"):
        for seed in range(10):
            digital, analog = (find_model(one).default_truth(seed) for one in (name, f"{name}-analog"))
            for gravity, celsius in (((0.0, 0.0, 1.0), 25.0), ((0.5, 0.0, 0.866), 5.0), ((0.0, -0.4, 0.9165), 60.0)):
                counts, volts = (truth.reading("x", gravity, celsius) for truth in (digital, analog))
                assert volts == pytest.approx(counts * 5.0 / 2048.0, abs=1e-3)


@given(celsius=st.floats(-80.0, 250.0), a=st.floats(0.5e-3, 1.5e-3), b=st.floats(2e-4, 3e-4), c=st.floats(1e-9, 3e-7))
def test_resistance_and_temperature_of_a_thermistor_are_inverse(celsius: float, a: float, b: float, c: float) -> None:
    for curve in (Curve(a, b, c), Curve(a, b, 0.0)):
        assert curve.celsius(curve.ohms(celsius)) == pytest.approx(celsius, abs=1e-6)
    with pytest.raises(DeviceFault, match="curve has no temperature at 1 Ω"):
        Curve(-a, b, c).celsius(1.0)


def ads1115(*lines: str, rate: int = 128) -> tuple[Ads1115, Script]:
    clock = VirtualClock()
    script = Script("i", clock, *lines)
    return Ads1115(script, clock, 6.144, rate), script


@given(
    number=st.integers(0, 3),
    full_scale=st.sampled_from(list(enumerate([6.144, 4.096, 2.048, 1.024, 0.512, 0.256]))),
    rate=st.sampled_from(list(enumerate([8, 16, 32, 64, 128, 250, 475, 860]))),
)
def test_the_config_word_bit_by_bit(number: int, full_scale: tuple[int, float], rate: tuple[int, int]) -> None:
    """OS, input against ground, full scale, single shot, rate, comparator off; codes are places in the data sheet."""
    bits = f"1{4 + number:03b}{full_scale[0]:03b}1{rate[0]:03b}00011"
    assert config_word(number, full_scale[1], rate[1]) == int(bits, 2)


def test_it_waits_for_a_converter_that_is_slow_or_busy_and_gives_up_one_that_hangs() -> None:
    for rate in RATES:
        word = f"{config_word(0, 6.144, rate):04X}"
        converter, script = ads1115(f"01 {word} /", f"01 / {word}", "00 / 00 00", rate=rate)
        converter.volts(0)
        assert script.times[1] - script.times[0] >= 1.1 / rate - 1e-9
    converter, script = ads1115("01 C1 83 /", "01 / 41 83", "01 / 41 83", "01 / C1 83", "00 / 34 15")
    assert converter.volts(0) == pytest.approx(2.4999375)
    script.close()
    converter, script = ads1115("01 C1 83 /", *["01 / 41 83"] * Ads1115.POLLS)
    with pytest.raises(BusError, match=r"still busy after 24.2 ms with a conversion that takes 7.81 ms"):
        converter.volts(0)
    script.close()


TRIM, OTHER = ("A1 00 00 00 00 00 / xx 01 02 03 04 05", "A1 00 00 00 00 00 / xx 00 00 00 00 00")
WHO, RESET = "01 00 00 00 / xx AD 1D ED", "5E 52 / xx xx"


@pytest.mark.parametrize(
    ("lines", "kind", "why"),
    [
        (["01 00 00 00 / xx AD 1D E9"], DeviceFault, "says that it is AD 1D E9, where an ADXL355 says AD 1D ED"),
        ([WHO, TRIM, *[RESET, OTHER] * 5], DeviceFault, "does not load its factory trim after a reset"),
        (
            [WHO, TRIM, RESET, OTHER, RESET, TRIM, "50 05 / xx xx", "58 81 / xx xx", "51 00 / xx 05", "59 00 / xx 01"],
            BusError,
            "does not keep what is written to it .register 0x2C holds 0x01, not 0x81",
        ),
    ],
)
def test_an_adxl355_that_cannot_be_set_up_is_no_part(lines: list[str], kind: type[Exception], why: str) -> None:
    clock = VirtualClock()
    with pytest.raises(kind, match=why):
        find_model("adxl355").driver(Script("s", clock, *lines), clock).read()


def test_a_part_that_measures_nothing_is_told() -> None:
    for name, zero in (("adxl355", 2), ("iis2iclx", 3)):
        model, clock = find_model(name), VirtualClock()
        part = model.twin(model.default_truth(1), Fixture(clock), clock)
        sensor = model.driver(part, clock)
        sensor.read()
        part._registers._held.update({0x2D: 1, 0x10: 0})  # standby; power-down
        with pytest.raises(
            DeviceFault, match=rf"was reset or its supply failed since it was set up .register 0x.{zero}?"
        ):
            sensor.read()
        sensor.read()


def test_an_adxl202_draws_the_noise_of_its_data_sheet() -> None:
    """500 µg/√Hz over 1.57 * 10 Hz are the fact sheet's 1.98 mg, of 0.625 V/g; 2 mg/°C at most."""
    for seed in range(20):
        truth: Truth = find_model("adxl202-analog").default_truth(seed)
        assert truth.noise["x"] == pytest.approx(1.98e-3 * 0.625, rel=2e-3)
        assert abs(truth.drift["x"][0]) <= 1.25e-3
    assert find_model("adxl202e").default_truth(1).noise["x"] < find_model("adxl202").default_truth(1).noise["x"]

"""Analog sensors behind converters: their supply, their wiring, their waits."""

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
from tiltcal.errors import DeviceFault, UsageError


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


@pytest.mark.parametrize("rate", RATES)
def test_it_waits_for_a_converter_that_is_10_percent_slow(rate: int) -> None:
    word, clock = f"{config_word(0, 6.144, rate):04X}", VirtualClock()
    script = Script("i", clock, f"01 {word} /", f"01 / {word}", "00 / 00 00")
    Ads1115(script, clock, 6.144, rate).volts(0)
    assert script.times[1] - script.times[0] >= 1.1 / rate - 1e-9


def test_an_adxl202_draws_the_noise_of_its_data_sheet() -> None:
    """500 µg/√Hz over 1.57 * 10 Hz are the fact sheet's 1.98 mg, of 0.625 V/g; 2 mg/°C at most."""
    for seed in range(20):
        truth = find_model("adxl202-analog").default_truth(seed)
        assert truth.noise["x"] == pytest.approx(1.98e-3 * 0.625, rel=2e-3)
        assert abs(truth.drift["x"][0]) <= 1.25e-3

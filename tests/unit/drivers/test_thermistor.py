"""The thermistor: its curve, its divider, its wiring, and its twin in the chamber."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

import tiltcal
from tiltcal.drivers import find_model
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.thermistor import Curve, Divider
from tiltcal.drivers.twin.fixture import Fixture
from tiltcal.drivers.twin.truth import Fault, Truth
from tiltcal.errors import BusError, DeviceFault, UsageError

HART = Curve(1.40e-3, 2.37e-4, 9.90e-8)
"""The typical coefficients for a thermistor of 3 kΩ that textbooks print."""
BETA = Curve.from_beta(3950.0, 10_000.0, 25.0)

REAL = "ads1115+i2c:///dev/i2c-1?address=0x48&channel=3"


@pytest.mark.parametrize(
    ("curve", "ohms", "celsius"),
    [
        # ln 3000 = 8.006368: 1/T = 1.4e-3 + 1.897509e-3 + 5.08079e-5 = 3.348317e-3
        (HART, 3000.0, 25.507),
        (BETA, 10_000.0, 25.0),
        # 10000 exp(3950 (1/273.15 - 1/298.15)) and so on
        (BETA, 33_620.6, 0.0),
        (BETA, 3_588.18, 50.0),
        (BETA, 401_859.7, -40.0),
    ],
)
def test_points_of_the_curve(curve: Curve, ohms: float, celsius: float) -> None:
    assert curve.celsius(ohms) == pytest.approx(celsius, abs=1e-3)
    assert curve.ohms(celsius) == pytest.approx(ohms, rel=5e-5)


@given(
    celsius=st.floats(-80.0, 250.0),
    a=st.floats(0.5e-3, 1.5e-3),
    b=st.floats(2.0e-4, 3.0e-4),
    c=st.one_of(st.just(0.0), st.floats(1e-9, 3e-7)),
)
def test_resistance_and_temperature_are_inverse(celsius: float, a: float, b: float, c: float) -> None:
    curve = Curve(a, b, c)
    assert curve.celsius(curve.ohms(celsius)) == pytest.approx(celsius, abs=1e-6)


@pytest.mark.parametrize("a", [0.0, -1e-3])
def test_a_curve_without_a_temperature_there(a: float) -> None:
    """1/T is a + b ln 1 = a, in 1/K."""
    with pytest.raises(DeviceFault, match="curve has no temperature at 1 Ω: check its coefficients"):
        Curve(a, 2.4e-4, 0.0).celsius(1.0)


@pytest.mark.parametrize(("grounded", "share"), [(True, 1.0 / 3.0), (False, 2.0 / 3.0)])
def test_a_divider_whose_thermistor_has_half_the_fixed_resistance(grounded: bool, share: float) -> None:
    divider = Divider(BETA, 20_000.0, grounded)
    assert divider.share(25.0) == pytest.approx(share)
    assert divider.celsius(share) == pytest.approx(25.0)


@pytest.mark.parametrize(
    ("grounded", "share", "found"),
    [(True, 0.0, "shorted"), (True, 1.0, "open"), (False, 0.0, "open"), (False, 1.0, "shorted")],
)
def test_a_broken_divider(grounded: bool, share: float, found: str) -> None:
    with pytest.raises(DeviceFault, match=f"so the thermistor is {found}"):
        Divider(BETA, 10_000.0, grounded).celsius(share)


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ("supply=2&fixed=10000", "the thermistor's curve is missing .add beta="),
        ("supply=2&fixed=10000&beta=3950", "option 'r0' is missing"),
        ("supply=2&beta=3950&r0=10000", "option 'fixed' is missing"),
        ("supply=2&fixed=10000&a=1.4e-3&b=2.4e-4", "option 'c' is missing"),
        ("supply=2&fixed=10000&a=1.4e-3&b=-2.4e-4&c=1e-7", "have b above 0"),
        ("supply=2&fixed=10000&a=1.4e-3&b=2.4e-4&c=1e-7&beta=3950", "exclude each other: give one curve"),
        ("supply=3&fixed=10000&beta=3950&r0=10000", "'channel' and 'supply' name the same input 3"),
        ("fixed=10000&beta=3950&r0=10000", "add supply=N, or state"),
        ("supply=2&fixed=10000&beta=3950&r0=10000&to=vcc", "to=vcc is neither ground nor supply"),
    ],
)
def test_a_wiring_that_cannot_be(options: str, why: str) -> None:
    with pytest.raises(UsageError, match=why):
        find_model("thermistor").at(parse_address(f"{REAL}&{options}"))


@pytest.mark.parametrize(
    "options",
    [
        "supply=2&beta=3950&r0=10000&t0=25&fixed=10000",
        "vdd=3.3&a=1.4e-3&b=2.37e-4&c=9.9e-8&fixed=3000&to=supply&rate=8",
    ],
)
def test_wirings_of_the_documentation(options: str) -> None:
    model = find_model("thermistor").at(parse_address(f"{REAL}&{options}"))
    assert (model.channels, model.thermometer) == ((), True)


@pytest.mark.parametrize(
    "options",
    [
        "channel=3&supply=2&beta=3950&r0=10000&t0=25&fixed=10000&range=6.144&rate=8",
        "channel=3&vdd=3.3&a=1.4e-3&b=2.37e-4&c=9.9e-8&fixed=3000&to=supply",
    ],
)
def test_a_bus_takes_the_options_of_its_thermistor(options: str) -> None:
    """What is missing is the bus, and no option is unknown to it; the virtual one takes the same."""
    bus = "ads1115+i2c:///dev/i2c-99?address=0x48"
    with pytest.raises(BusError, match="/dev/i2c-99"), tiltcal.open_sensor("thermistor", f"{bus}&{options}"):
        pass
    with pytest.raises(UsageError, match="'gain'"), tiltcal.open_sensor("thermistor", f"{bus}&{options}&gain=2"):
        pass
    with tiltcal.open_sensor("thermistor", f"sim:{options}") as thermometer:
        assert thermometer.read().temperature is not None


def sensor(address: str, celsius: float, **truth: object):
    clock = VirtualClock()
    fixture = Fixture(clock, ambient=celsius)
    model = find_model("thermistor").at(parse_address(address))
    return model.driver(model.twin(Truth((), {}, {}, **truth), fixture, clock), clock)


@pytest.mark.parametrize("celsius", [-20.0, 5.5, 24.0, 60.0])
@pytest.mark.parametrize(
    "address",
    ["sim:", "sim:to=supply", "sim:a=1.40e-3&b=2.37e-4&c=9.90e-8&fixed=3000", "sim:adc=mcp3208", "sim:vdd=4.9"],
)
def test_the_twin_follows_the_chamber(address: str, celsius: float) -> None:
    reading = sensor(address, celsius, supply=4.9).read()
    assert reading.values == ()
    # A step of the 12-bit converter is 0.03 °C here, or less.
    assert reading.temperature == pytest.approx(celsius, abs=0.05)


def test_the_thermometers_error_is_seen() -> None:
    assert sensor("sim:", 20.0, thermometer_error=1.5).read().temperature == pytest.approx(21.5, abs=0.02)


def test_a_stuck_thermometer_shows_the_ambient_temperature() -> None:
    held = sensor("sim:", 5.0, ambient=24.0, faults=(Fault("stuck", 0.0, 9.0),)).read()
    assert held.temperature == pytest.approx(24.0, abs=0.02)


def test_probe_tells_temperature_supply_and_converter() -> None:
    said = sensor("sim:vdd=4.9", 25.0, supply=4.9).probe()
    assert said == {
        "temperature": "25.00 °C",
        "supply": "4.9000 V, stated",
        "converter": "ADS1115, ±6.144 V, 128 conversions per second",
    }

"""Addresses: every form of the specification is understood, and every slip is named."""

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiltcal.drivers.bus.address import parse_address
from tiltcal.errors import UsageError

UNDERSTOOD = (
    ("spi:///dev/spidev0.0", "spi", "/dev/spidev0.0", {}),
    ("spi:/dev/spidev0.0", "spi", "/dev/spidev0.0", {}),
    ("ads1115+i2c:///dev/i2c-1?address=0x48&x=0", "ads1115+i2c", "/dev/i2c-1", {"address": "0x48", "x": "0"}),
    ("serial:rfc2217://host:4000?columns=x,y", "serial", "rfc2217://host:4000", {"columns": "x,y"}),
    ("vcd:my%20run%3F.vcd", "vcd", "my run?.vcd", {}),
    ("sim:", "sim", "", {}),
    ("sim:?twin=truth.yaml&seed=7", "sim", "", {"twin": "truth.yaml", "seed": "7"}),
    ("sim:twin=a%26b/50%25+1.yaml", "sim", "", {"twin": "a&b/50%+1.yaml"}),
)

MALFORMED = {
    "": "no scheme before a colon (such as spi:///dev/spidev0.0)",
    "/dev/spidev0.0": "no scheme before a colon (did you mean 'spi:///dev/spidev0.0'?)",
    "spo:///dev/spidev0.0": "unknown scheme 'spo' (did you mean 'spi'?)",
    "http://host/": "unknown scheme 'http' (known: spi, i2c, serial, gpio, vcd, modbus, iio, python, ",
    "ads1115+:///dev/i2c-1": "unknown scheme 'ads1115+'",
    "spi:": "no device after 'spi:'",
    "spi://dev/spidev0.0": "'dev' after '//' names a host (did you mean 'spi:///dev/spidev0.0'?)",
    "spi:///dev/spidev0.0?mode": "option 'mode' is not of the form name=value",
    "spi:///dev/spidev0.0?mode=0&mode=0": "option 'mode' is given twice",
    "sim:///dev/spidev0.0?seed=1": "a simulated sensor has no place",
    "spi:///dev/spi\ndev0.0": "it contains a control character",
    "serial:///dev/ttyUSB0?columns=x%0A": "it contains a control character",
}

WRONG_INTEGERS = {
    "speed=fast": "option speed=fast is not a whole number",
    "speed=5e5": "option speed=5e5 is not a whole number",
    "speed=٣": "option speed=٣ is not a whole number",
    "speed=" + "9" * 5000: "is not a whole number",
    "speed=": "option 'speed' is empty",
    "speed=0": "option speed=0 is too small (at least 1)",
    "speed=11": "option speed=11 is too large (at most 10)",
    "other=1": "option 'speed' is missing (add &speed=...)",
}


def test_an_address_of_the_specification_is_understood() -> None:
    for written, *expected in UNDERSTOOD:
        address = parse_address(written)
        assert [address.scheme, address.path, address.options] == expected, written
        assert str(address) == written
        assert address.simulated == (address.scheme == "sim")


def test_a_slip_is_named_with_the_address() -> None:
    for written, why in MALFORMED.items():
        with pytest.raises(UsageError) as error:
            parse_address(written)
        assert str(error.value).startswith(f"address {written!r}: "), written
        assert why in str(error.value), written


def test_numbers_and_text() -> None:
    address = parse_address("i2c:///dev/i2c-1?address=0x1D&count=010&shift=-3&vref=4.98&small=5e-3&x=D0")
    assert [address.integer(name) for name in ("address", "count", "shift")] == [29, 10, -3]
    assert [address.number("vref"), address.number("small"), address.text("x")] == [4.98, 0.005, "D0"]
    assert (address.integer("absent", 5), address.number("absent", 2.5), address.text("absent", "D7")) == (5, 2.5, "D7")


def test_a_wrong_number_is_refused() -> None:
    for option, why in WRONG_INTEGERS.items():
        with pytest.raises(UsageError) as error:
            parse_address(f"spi:///dev/spidev0.0?{option}").integer("speed", low=1, high=10)
        assert why in str(error.value), option
    for text in ("five", "nan", "inf", "1e999", "0x10", "1,5", "."):
        with pytest.raises(UsageError, match="is not a finite number"):
            parse_address(f"vcd:f.vcd?vref={text}").number("vref")


@given(st.sampled_from(["", "spi:", "sim:", "serial:", "i2c://"]), st.text() | st.text("/?&=%+:ab\x00\t1", max_size=20))
def test_any_text_is_an_address_or_a_usage_error(scheme: str, text: str) -> None:
    with suppress(UsageError):
        assert parse_address(scheme + text).written == scheme + text

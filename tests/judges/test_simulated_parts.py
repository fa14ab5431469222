"""Our drivers read parts that other hands simulate."""

from __future__ import annotations

from typing import Any

import pytest

from tiltcal.drivers import find_model
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import VirtualClock

from .boards import foreign


class Adxl355OnSpi:
    """The simulated ADXL355 of the package adxl355, which takes registers, behind the frames of SPI."""

    letter = "s"

    def __init__(self, part: Any) -> None:
        self.part = part

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        register = out[0] >> 1
        if out[0] & 1:
            return b"\0" + bytes(self.part.read_register(register, len(out) - 1))
        self.part.write_register(register, out[1:])
        return bytes(len(out))

    def close(self) -> None:
        pass


@pytest.mark.parametrize(("word", "counts"), [("2g", 256_000), ("4g", 128_000), ("8g", 64_000)])
def test_an_adxl355(word: str, counts: int) -> None:
    with foreign("adxl355.testing") as testing:
        part = testing.MockTransport()
        part.set_identity_ok()
        part.set_xyz_raw(x=counts // 2, y=-counts, z=-1)
        # A sample is there; 1885 is 25 °C, by the maker's answer to users.
        for register, content in ((0x04, 0x01), (0x06, 0x07), (0x07, 0x5D)):
            part.set_register(register, content)
        model = find_model("adxl355").at(parse_address(f"spi:///dev/spidev0.0?range={word}"))
        reading = model.driver(Adxl355OnSpi(part), VirtualClock()).read()
        assert part.register(0x2C) & 0x03 == {"2g": 1, "4g": 2, "8g": 3}[word]
    assert reading.values == (counts / 2, -counts, -1.0)
    assert [value / model.sensitivity for value in reading.values[:2]] == [0.5, -1.0]
    assert reading.temperature == pytest.approx(25.0)

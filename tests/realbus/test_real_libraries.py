"""Two parts behind the real python-spidev and the real smbus2.

One suite runs over both buses: what a driver asks of a link holds on each.
"""

import errno
import sys
from dataclasses import dataclass, replace
from itertools import pairwise

import pytest
from support import ROOT
from support.emulated.bench import DEVICE, I2C_BUS, SCA3000, Message, run_on

READ = [sys.executable, str(ROOT / "tests" / "support" / "emulated" / "read_sensor.py")]
SCA100T = [*READ, "sca100t-d02", f"spi://{DEVICE}"]
QUIET = replace(SCA3000, noise={}, jig=0.0)


@dataclass(frozen=True)
class Wiring:
    """A program that reads an SCA3000, its model and address, what a sample sends, and the bytes before its data."""

    program: list[str]
    part: tuple[str, int | None]
    sample: list[str]
    unknown: int
    device: str


SPI = Wiring(
    [*READ, "sca3000-d01", f"spi://{DEVICE}"],
    ("sca3000-d01", None),
    ["4c0000", "24000000000000", "0800", "5000"],
    1,
    DEVICE,
)
I2C = Wiring(
    [*READ, "sca3000-i2c", f"i2c://{I2C_BUS}?address=0x1d&counts_per_g=1333&thermometer=yes"],
    ("sca3000-i2c?thermometer=yes", 0x1D),
    ["13", "09", "02", "14"],
    0,
    I2C_BUS,
)


@pytest.fixture(params=["spi", "i2c"])
def wiring(request: pytest.FixtureRequest) -> Wiring:
    pytest.importorskip({"spi": "spidev", "i2c": "smbus2"}[request.param])
    return {"spi": SPI, "i2c": I2C}[request.param]


def words(wiring: Wiring, message: Message) -> list[int]:
    """X, Y and Z of the six bytes that the part sent, by arithmetic on the whole."""
    z, y, x = (int(message.answer[wiring.unknown + at : wiring.unknown + at + 2].hex(), 16) for at in (0, 2, 4))
    return [(word - 65536 if word >= 32768 else word) // 8 for word in (x, y, z)]


def test_the_driver_reads_the_words_that_the_part_sent_and_never_writes(wiring: Wiring) -> None:
    with run_on(wiring.program, SCA3000, *wiring.part) as bench:
        bench.pose((0.48, -0.6, 0.64), 30.0)
        read = bench.ask("read 5")
        messages = bench.messages()
        said = bench.ask("probe")
        sent = [message.out for message in bench.messages()]
    assert [message.out.hex() for message in messages] == wiring.sample * 5
    assert read["values"] == [words(wiring, message) for message in messages[1::4]]
    # 1.8 * (30 - 23) + 256 rounds to 269, which is 30.22 °C.
    assert read["temperatures"] == pytest.approx([30.2222] * 5, abs=1e-3)
    assert bench.exit_code == 0
    assert (said["revision"], said["registers"], said["mode"]) == ("2.1", "locked", "normal")
    # The pointer and the data are one transaction: no other master can move the pointer between them.
    assert {len(out) for out in sent} == ({2, 3, 7} if wiring is SPI else {1})
    assert all(out[0] & 0b11 == 0 for out in sent) or wiring is I2C


def test_a_failed_transfer_is_a_bus_error_and_a_new_link_may_work(wiring: Wiring) -> None:
    with run_on(wiring.program, QUIET, *wiring.part) as bench:
        before = bench.ask("read 1")
        bench.fail(errno.ENODEV)
        failed = bench.ask("read 1")
        bench.fail(0)
        bench.ask("reopen")
        assert bench.ask("read 1") == before
        bench.break_part()
        broken = bench.ask("probe")
    assert failed["error"] == "BusError"
    assert wiring.device in failed["message"]
    assert broken["error"] == "DeviceFault"
    assert "checksum error of its EEPROM" in broken["message"]


def test_the_address_sets_mode_and_speed_of_spi() -> None:
    pytest.importorskip("spidev")
    for options, settings in (
        ("", {"mode": 0, "bits": 8, "speed": 500_000}),
        ("?mode=3&speed=125000", {"mode": 3, "bits": 8, "speed": 125_000}),
    ):
        with run_on([*SCA100T[:3], f"spi://{DEVICE}{options}"]) as bench:
            bench.ask("probe")
            assert bench.settings() == settings


def test_an_sca100t_has_150_us_before_every_read() -> None:
    pytest.importorskip("spidev")

    def gaps(messages: list[Message]) -> list[int]:
        """Time between the end of a message and the start of the next, ns."""
        return [after.start_ns - before.end_ns for before, after in pairwise(messages)]

    with run_on(SCA100T) as bench:
        bench.pose((0.5, 0.0, 0.75**0.5), 30.0)
        read = bench.ask("read 50")
        messages = bench.messages()
        bench.break_part()
        failed = bench.ask("probe")
    assert [message.out.hex() for message in messages] == ["100000", "110000", "0800"] * 50
    bits = (f"{int.from_bytes(message.answer, 'big'):024b}" for message in messages if len(message.out) == 3)
    assert [word for values in read["values"] for word in values] == [int(answer[8:19], 2) for answer in bits]
    assert min(gaps(messages)) >= 150_000
    assert failed["error"] == "DeviceFault"
    assert "words below 102" in failed["message"]

"""The SCA3000 driver through the real python-spidev and the real smbus2, against a part that was written apart from it.

One suite runs over both buses: what a driver asks of a link holds on each.
"""

from __future__ import annotations

import errno
import json
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from statistics import fmean, stdev

import pytest
from support import ROOT
from support.emulated.bench import DEVICE, I2C_BUS, Bench, Message, PartFacts, Sca3000, run_on_i2c, run_on_spi

READ = [sys.executable, str(ROOT / "tests" / "support" / "emulated" / "read_sensor.py")]
CHIP = 0x1D

Run = Callable[[list[str], PartFacts], AbstractContextManager[Bench]]


@dataclass(frozen=True)
class Wiring:
    """One way to connect the part.

    Attributes
    ----------
    program : list of str
        Reads it.
    run : callable
        Starts a program where the part is connected so.
    sample : list of str
        What one sample sends, in hexadecimal.
    unknown : int
        Bytes before the data of an answer.
    device : str
    """

    program: list[str]
    run: Run
    sample: list[str]
    unknown: int
    device: str


def _on_i2c(program: list[str], part: PartFacts) -> AbstractContextManager[Bench]:
    return run_on_i2c(program, part, CHIP)


SPI = Wiring(
    [*READ, "sca3000-d01", f"spi://{DEVICE}"], run_on_spi, ["4c0000", "24000000000000", "0800", "5000"], 1, DEVICE
)
I2C = Wiring(
    [*READ, "sca3000-i2c", f"i2c://{I2C_BUS}?address=0x1d&counts_per_g=1333&thermometer=yes"],
    _on_i2c,
    ["13", "09", "02", "14"],
    0,
    I2C_BUS,
)
QUIET = Sca3000(noise=0.0, jig=0.0)


@pytest.fixture(params=["spi", "i2c"])
def wiring(request: pytest.FixtureRequest) -> Wiring:
    library = {"spi": "spidev", "i2c": "smbus2"}[request.param]
    pytest.importorskip(library, reason=f"the {library} package is not installed")
    return {"spi": SPI, "i2c": I2C}[request.param]


def words(wiring: Wiring, message: Message) -> list[int]:
    """X, Y and Z of the six bytes that the part sent, by arithmetic on the whole."""
    z, y, x = (int(message.answer[wiring.unknown + at : wiring.unknown + at + 2].hex(), 16) for at in (0, 2, 4))
    return [(word - 65536 if word >= 32768 else word) // 8 for word in (x, y, z)]


def test_the_driver_reads_the_words_that_the_part_sent(wiring: Wiring) -> None:
    with wiring.run(wiring.program, Sca3000()) as bench:
        bench.pose((0.48, -0.6, 0.64), 30.0)
        read = bench.ask("read 5")
        messages = bench.messages()

    assert [message.out.hex() for message in messages] == wiring.sample * 5
    assert read["values"] == [words(wiring, message) for message in messages[1::4]]
    # 1.8 * (30 - 23) + 256 rounds to 269, which is 30.22 °C.
    assert read["temperatures"] == pytest.approx([30.2222] * 5, abs=1e-3)
    assert bench.exit_code == 0


def test_the_readings_follow_the_pose(wiring: Wiring) -> None:
    with wiring.run(wiring.program, replace(Sca3000(), jig=0.0, rate=1e6)) as bench:
        bench.pose((0.6, 0.0, -0.8))
        read = bench.ask("read 100")

    for place, values in enumerate(zip(*read["values"], strict=True)):
        row = Sca3000().sensitivity[place]
        expected = Sca3000().offset[place] + 0.6 * row[0] - 0.8 * row[2]
        # Five standard deviations of the mean of 100 samples of 1.5 count.
        assert fmean(values) == pytest.approx(expected, abs=0.76)
        assert 1.0 < stdev(values) < 2.1


def test_probe_reads_and_never_writes(wiring: Wiring) -> None:
    with wiring.run(wiring.program, QUIET) as bench:
        said = bench.ask("probe")
        sent = [message.out for message in bench.messages()]

    assert (said["revision"], said["registers"], said["mode"]) == ("2.1", "locked", "normal")
    assert said["z"] == f"{round(44.2 + 1338.7)} count"
    assert {len(out) for out in sent} == ({2, 3, 7} if wiring is SPI else {1})
    assert all(out[0] & 0b11 == 0 for out in sent) or wiring is I2C


def test_the_adapter_is_set_as_the_part_needs_it() -> None:
    pytest.importorskip("spidev", reason="the spidev package is not installed")
    with run_on_spi(SPI.program, QUIET) as bench:
        bench.ask("probe")
        assert bench.settings() == {"mode": 0, "bits": 8, "speed": 500_000}
    with run_on_spi([*SPI.program[:3], f"spi://{DEVICE}?speed=4000000"], QUIET) as bench:
        bench.ask("probe")
        assert bench.settings()["speed"] == 4_000_000


def test_the_pointer_and_the_data_are_one_transaction() -> None:
    """Six registers in one I2C_RDWR: no other master can move the pointer between them."""
    pytest.importorskip("smbus2", reason="the smbus2 package is not installed")
    with run_on_i2c(I2C.program, QUIET, CHIP) as bench:
        bench.ask("read 1")
        temperature, data, *_ = bench.messages()
        assert bench.settings() == {"address": CHIP}
    assert (len(data.out), len(data.answer)) == (1, 6)
    assert (len(temperature.out), len(temperature.answer)) == (1, 2)


@pytest.mark.parametrize("number", [errno.EIO, errno.ETIMEDOUT, errno.ENODEV])
def test_a_failed_transfer_is_a_bus_error_and_a_new_link_may_work(wiring: Wiring, number: int) -> None:
    with wiring.run(wiring.program, QUIET) as bench:
        before = bench.ask("read 1")
        bench.fail(number)
        failed = bench.ask("read 1")
        bench.fail(0)
        bench.ask("reopen")
        after = bench.ask("read 1")

    assert failed["error"] == "BusError"
    assert wiring.device in failed["message"]
    assert after == before


def test_a_checksum_error_is_a_device_fault(wiring: Wiring) -> None:
    with wiring.run(wiring.program, QUIET) as bench:
        bench.break_part()
        failed = bench.ask("probe")
    assert failed["error"] == "DeviceFault"
    assert "checksum error of its EEPROM" in failed["message"]


def test_nobody_acknowledges_at_another_address() -> None:
    pytest.importorskip("smbus2", reason="the smbus2 package is not installed")
    with run_on_i2c([*I2C.program[:3], I2C.program[3].replace("0x1d", "0x1e")], QUIET, CHIP) as bench:
        failed = bench.ask("probe")
    assert failed["error"] == "BusError"
    assert f"no device acknowledges at address 0x1e on {I2C_BUS}" in failed["message"]


def test_a_bus_that_does_not_exist_names_the_one_that_does() -> None:
    pytest.importorskip("smbus2", reason="the smbus2 package is not installed")
    with run_on_i2c([*I2C.program[:3], I2C.program[3].replace("i2c-1", "i2c-7")], QUIET, CHIP) as bench:
        assert bench.exit_code != 0
        assert f"/dev/i2c-7 does not exist (present: {I2C_BUS})" in bench.errors()


SMBUS_CALLS = """
import json, smbus2
with smbus2.SMBus("/dev/i2c-1") as bus:
    print(json.dumps([
        bus.read_byte_data(0x1d, 0x09), bus.read_word_data(0x1d, 0x09), bus.read_i2c_block_data(0x1d, 0x09, 2),
        bus.write_byte(0x1d, 0x00), bus.read_byte(0x1d),
    ]))
    try:
        bus.read_byte_data(0x1e, 0x09)
    except OSError as error:
        print(error.errno)
"""


def test_the_node_answers_smbus_calls_like_an_adapter_with_plain_i2c() -> None:
    """SMBus words have their low byte first, so Z_MSB and Z_LSB come swapped."""
    pytest.importorskip("smbus2", reason="the smbus2 package is not installed")
    with run_on_i2c([sys.executable, "-c", SMBUS_CALLS], QUIET, CHIP) as bench:
        answers, missing = bench.process.stdout.read().splitlines()
    # Level: 44.2 + 1338.7 rounds to 1383, left-aligned 0x2B38.
    assert json.loads(answers) == [0x2B, 0x382B, [0x2B, 0x38], None, 0x21]
    assert int(missing) == errno.EREMOTEIO

"""The SCA100T driver through the real python-spidev, against a part that was written apart from it."""

from __future__ import annotations

import errno
import sys
from itertools import pairwise
from statistics import median

import pytest
from support import ROOT
from support.emulated.bench import DEVICE, Message, run_on_spi

PROGRAM = [
    sys.executable,
    str(ROOT / "tests" / "support" / "emulated" / "read_sensor.py"),
    "sca100t-d02",
    f"spi://{DEVICE}",
]

pytest.importorskip("spidev", reason="the spidev package is not installed")


def gaps(messages: list[Message]) -> list[int]:
    """Time between the end of a message and the start of the next, ns."""
    return [after.start_ns - before.end_ns for before, after in pairwise(messages)]


def test_the_driver_reads_the_words_that_the_part_sent() -> None:
    with run_on_spi(PROGRAM) as bench:
        bench.pose((0.5, 0.0, 0.75**0.5), 30.0)
        read = bench.ask("read 5")
        messages = bench.messages()

    assert [message.out.hex() for message in messages] == ["100000", "110000", "0800"] * 5
    sent = [
        int(f"{int.from_bytes(message.answer, 'big'):024b}"[8:19], 2) for message in messages if len(message.out) == 3
    ]
    assert [word for values in read["values"] for word in values] == sent
    temperatures = [(message.answer[1] - 197) / -1.083 for message in messages if len(message.out) == 2]
    assert read["temperatures"] == pytest.approx(temperatures)
    assert bench.exit_code == 0


def test_chip_select_is_high_for_150_us_before_every_read() -> None:
    with run_on_spi(PROGRAM) as bench:
        bench.ask("exchange 50 100000")
        bare = gaps(bench.messages())
        bench.ask("read 50")
        kept = gaps(bench.messages()[50:])

    assert len(kept) == 149
    assert min(kept) >= 150_000
    # The emulated node alone may be slower than that, so the wait is also seen as a difference.
    assert median(kept) - median(bare) >= 150_000


def test_the_address_sets_mode_and_speed() -> None:
    with run_on_spi([*PROGRAM[:3], f"spi://{DEVICE}?mode=3&speed=125000"]) as bench:
        bench.ask("probe")
        assert bench.settings() == {"mode": 3, "bits": 8, "speed": 125_000}


def test_an_unplugged_adapter_can_be_opened_again() -> None:
    with run_on_spi(PROGRAM) as bench:
        bench.ask("read 1")
        bench.fail(errno.ENODEV)
        gone = bench.ask("read 1")
        bench.fail(0)
        bench.ask("reopen")
        back = bench.ask("read 1")

    assert gone["error"] == "BusError"
    assert "plug the SPI adapter in again" in gone["message"]
    assert len(back["values"]) == 1


def test_the_parts_fault_signal_is_a_device_fault() -> None:
    with run_on_spi(PROGRAM) as bench:
        bench.break_part()
        failed = bench.ask("probe")

    assert failed["error"] == "DeviceFault"
    assert "words below 102" in failed["message"]


def test_a_node_that_does_not_exist_names_the_one_that_does() -> None:
    with run_on_spi([*PROGRAM[:3], "spi:///dev/spidev7.1"]) as bench:
        assert bench.exit_code != 0
        assert "/dev/spidev7.1 does not exist (present: /dev/spidev0.0)" in bench.errors()

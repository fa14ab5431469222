"""The MCP3208 driver against the data sheet and the vectors of the fact sheet, and its twin bit by bit.

Frames are written out / in, in hexadecimal; ``xx`` stands for a byte that means nothing.
"""

from __future__ import annotations

from math import asin, degrees

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.scripted_link import Script

from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.converter import Supply
from tiltcal.drivers.mcp3208 import Mcp3208, command_frame, decode_code, front_end
from tiltcal.drivers.twin.analog import Wiring
from tiltcal.drivers.twin.mcp3208 import Mcp3208Twin
from tiltcal.drivers.twin.truth import Fault, Truth
from tiltcal.errors import BusError, UsageError


def driver(*lines: str, reference: float = 5.0) -> Mcp3208:
    clock = VirtualClock()
    return Mcp3208(Script("s", clock, *lines), clock, reference)


@pytest.mark.parametrize(
    ("number", "frame"),
    [(0, "06 00 00"), (1, "06 40 00"), (2, "06 80 00"), (3, "06 C0 00"), (4, "07 00 00"), (7, "07 C0 00")],
)
def test_commands_of_the_fact_sheet(number: int, frame: str) -> None:
    assert command_frame(number) == bytes.fromhex(frame)


@pytest.mark.parametrize(
    ("answer", "code", "volts", "tilt"),
    [
        ("xx 08 00", 2048, 2.500000, 0.0),
        ("xx 0A 39", 2617, 3.194580, 9.9998),
        ("xx FA 39", 2617, 3.194580, 9.9998),
        ("xx 0E 66", 3686, 4.499512, 29.9919),
        ("xx 01 9A", 410, 0.500488, -29.9919),
    ],
)
def test_results_of_the_fact_sheet(answer: str, code: int, volts: float, tilt: float) -> None:
    measured = driver(f"06 00 00 / {answer}").volts(0)
    assert decode_code(bytes.fromhex(answer.replace("xx", "a5"))) == code
    assert measured == pytest.approx(volts, abs=5e-7)
    # An SCA100T-D01 at the reference: half of it at 0 g, 0.8 of it per g.
    assert degrees(asin((measured / 5.0 - 0.5) / 0.8)) == pytest.approx(tilt, abs=5e-5)


@given(code=st.integers(0, 4095), before=st.integers(0, 4095))
def test_what_stands_before_the_result_means_nothing(code: int, before: int) -> None:
    assert decode_code(int(f"{before:012b}{code:012b}", 2).to_bytes(3, "big")) == code


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        ("FF FF FF", "stuck high .input 3 reads ones alone.*check MISO"),
        ("00 00 00", "stuck low, or input 3 is shorted to ground"),
    ],
)
def test_an_answer_of_equal_bits_is_a_dead_wire(answer: str, why: str) -> None:
    with pytest.raises(BusError, match=why):
        driver(f"06 C0 00 / {answer}").volts(3)


def test_a_result_at_the_reference_is_a_result() -> None:
    """The bit before the result is 0, so 4095 on a line that floats high is not a dead wire."""
    assert driver("06 00 00 / FF EF FF").volts(0) == pytest.approx(5.0 * 4095 / 4096)


def test_a_short_answer_is_a_bus_error() -> None:
    with pytest.raises(BusError, match="a frame of 3 bytes was answered with 2"):
        driver("06 00 00 / 08 00").volts(0)


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ("x=0", "option 'vref' is missing"),
        ("vref=0.2", "vref=0.2 is too small"),
        ("vref=12", "vref=12 is too large"),
    ],
)
def test_the_reference_must_be_stated(options: str, why: str) -> None:
    with pytest.raises(UsageError, match=why):
        front_end(parse_address(f"mcp3208+spi:///dev/spidev0.1?{options}"))


class Terminals(Wiring):
    """These voltages at the inputs, from 0 on; reference and supply are 5 V."""

    def __init__(self, truth: Truth, clock: VirtualClock, volts: tuple[float, ...]) -> None:
        super().__init__(truth, clock, Supply(None, 5.0, 4.75, 5.25))
        self._volts = volts

    def share(self, number: int, now_ns: int) -> float:
        return self._volts[number] / 5.0


def twin(*volts: float, faults: tuple[Fault, ...] = ()) -> tuple[Mcp3208Twin, VirtualClock]:
    clock = VirtualClock()
    return Mcp3208Twin(Terminals(Truth((), {}, {}, faults=faults), clock, volts), clock), clock


def bits(answer: bytes) -> str:
    return f"{int.from_bytes(answer, 'big'):024b}"


def test_both_frames_of_the_fact_sheet_find_the_result_where_they_look_for_it() -> None:
    """Frame B ``06 40 00`` has it in the last 12 bits, frame A ``64 00 00`` four bits earlier."""
    part, _ = twin(0.0, 3.19458)
    for _ in range(50):
        late, early = part.exchange(bytes.fromhex("06 40 00")), part.exchange(bytes.fromhex("64 00 00"))
        assert int(bits(late)[12:], 2) == 2617
        assert early[1] << 4 | early[2] >> 4 == 2617
        assert bits(late)[11] == bits(early)[7] == "0", "the null bit"


def test_bits_that_the_part_does_not_drive_are_left_to_chance() -> None:
    part, _ = twin(2.5)
    answers = {part.exchange(bytes.fromhex("06 00 00"))[0] for _ in range(200)}
    assert len(answers) > 50


def test_a_frame_takes_its_bits_at_1_mhz() -> None:
    part, clock = twin(2.5)
    part.exchange(bytes.fromhex("06 00 00"))
    assert clock.now_ns() == 24_000


def test_a_silent_part_leaves_the_line_high() -> None:
    part, _ = twin(2.5, faults=(Fault("silent", 0.0, 1.0),))
    assert part.exchange(bytes.fromhex("06 00 00")) == b"\xff\xff\xff"


def test_an_unplugged_part_fails_every_frame() -> None:
    part, _ = twin(2.5, faults=(Fault("unplugged", 0.0, 1.0),))
    with pytest.raises(BusError, match="is unplugged"):
        part.exchange(bytes.fromhex("06 00 00"))


@given(volts=st.floats(0.001, 4.999), number=st.integers(0, 7))
def test_the_driver_reads_what_is_at_the_twins_input(volts: float, number: int) -> None:
    part, clock = twin(*[volts if place == number else 0.0 for place in range(8)])
    assert Mcp3208(part, clock, 5.0).volts(number) == pytest.approx(volts, abs=5.0 / 4096)

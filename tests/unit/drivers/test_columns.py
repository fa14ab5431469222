"""Devices that print numbers on a line, and DFRobot's module: what is a reading, and what is only counted."""

from __future__ import annotations

from math import asin, degrees, inf, isfinite

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.arriving_pieces import ArrivingPieces

from tiltcal.drivers import find_model
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.device import Sensor
from tiltcal.drivers.dfrobot import DfrobotSca100t, checksum, parse_answer
from tiltcal.drivers.twin.fixture import Fixture
from tiltcal.errors import BusError, DeviceFault, UsageError

SERIAL_COLUMNS, DFROBOT = find_model("serial-columns"), find_model("dfrobot-sca100t")


def printing(options: str, *pieces: bytes) -> Sensor:
    model = SERIAL_COLUMNS.at(parse_address(f"serial:///dev/ttyUSB0?{options}"))
    # The first line may be the tail of one whose head nobody heard, and is never used.
    return model.driver(ArrivingPieces(b"0.99\r\n", *pieces), VirtualClock())


@pytest.mark.parametrize(
    ("options", "line", "values", "temperature"),
    [
        ("columns=x,y,temperature", b"0.5,-0.25,23.5\r\n", (0.5, -0.25), 23.5),
        ("columns=x,y", b"0.5 -0.25\n", (0.5, -0.25), None),
        ("columns=x,y", b"0.5;\t-2.5e-1\r", (0.5, -0.25), None),
        ("columns=x,y", b"0.5 , -0.25\n", (0.5, -0.25), None),
        ("columns=-,z,y,x&separator=semicolon", b"12:30:01; 3 ;2;1\r\n", (1.0, 2.0, 3.0), None),
        ("columns=,x,&separator=tab", b"a\t.5\tb\n", (0.5,), None),
        ("columns=temperature,x&separator=space", b"  -4   +7.  \n", (7.0,), -4.0),
        ("columns=time,theta,a2,a1", b"0.02,359.1,-2.5e-3,3\r\n", (359.1, -0.0025, 3.0), None),
        ("columns=field,z,temperature,y", b"7,1,20,-1\r\n", (-1.0, 1.0, 7.0), 20.0),
        ("columns=time,x", b"12:30:01,5\n", (5.0,), None),
    ],
)
def test_columns_are_named_in_the_order_they_are_printed(options, line, values, temperature) -> None:
    reading = printing(options, line).read()
    assert (reading.values, reading.temperature) == (values, temperature)


@pytest.mark.parametrize(
    ("line", "step"),
    [
        (b"0.50,-1.00,23.55\n", 0.01),
        (b"0.5,-1.25,23.5\n", 0.01),
        (b".5,3.,23.555\n", 0.1),
        (b"823,-4,23.5\n", 1.0),
        (b"1.25e-3,2E+2,23\n", 1e-5),
        (b"0e999,0e999,23\n", inf),
    ],
)
def test_the_step_of_a_line_is_its_last_digit(line: bytes, step: float) -> None:
    assert printing("columns=x,y,temperature", line).read().step == pytest.approx(step)


def test_a_line_that_is_not_the_numbers_is_counted_and_never_a_reading() -> None:
    driver = printing(
        "columns=x,y&separator=comma",
        b"1,2\r\n",
        b"booting v1.2\r\n3\r\n3,4,5\r\n3,nan\r\n3,inf\r\n3,1e999\r\n3,0x10\r\n3,\r\n3,\xff\r\n",
        b"5,",
        b"6\r\n",
    )
    assert [driver.read().values for _ in range(2)] == [(1.0, 2.0), (5.0, 6.0)]
    assert driver.link_statistics() == {"lines": 2, "damaged": 9}


def test_after_a_discard_half_a_line_is_no_reading() -> None:
    driver = printing("columns=x", b"1\r\n2\r\n", b"34\r\n", b"5678\r\n")
    driver.read()
    driver.discard()
    assert driver.read().values == (5678.0,)
    assert driver.link_statistics() == {"lines": 2, "damaged": 0}


class Metronome(ArrivingPieces):
    """A device that prints a line every ``period`` seconds, byte by byte at about 9600 baud.

    What nobody reads waits in the port, until it is discarded.
    """

    def __init__(self, clock: VirtualClock, period: float) -> None:
        super().__init__()
        self._clock, self._period, self._taken = clock, round(period * 2000), 0

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        now = self._clock.now_ns() // 500_000
        # In half milliseconds: byte b of line n comes at n * period + 2 (b + 1).
        sent = [
            (number * self._period + 2 * (place + 1), bytes([byte]))
            for number in range(1, now // self._period + 3)
            for place, byte in enumerate(b"%d.5000\n" % number)
        ]
        arrived = sum(time <= now for time, _ in sent)
        if not count:
            self._taken = arrived
            return b""
        if arrived == self._taken:
            arrived += 1
            self._clock.sleep((sent[self._taken][0] - now) * 0.5e-3)
        taken, self._taken = self._taken, arrived
        return b"".join(byte for _, byte in sent[taken:arrived])


@pytest.mark.parametrize(
    ("period", "pause", "numbers"),
    [
        (0.5, 0.0, [1.5, 2.5]),
        (60.0, 0.0, [1.5, 2.5]),
        (0.5, 0.4955, [2.5, 4.5, 6.5, 8.5]),
        (0.05, 0.0, [2.5, 4.5, 6.5, 8.5]),
    ],
    ids=["silence", "a line a minute", "discarded within a line", "no silence"],
)
def test_a_line_after_silence_is_whole_after_a_discard(period: float, pause: float, numbers: list[float]) -> None:
    clock = VirtualClock()
    model = SERIAL_COLUMNS.at(parse_address("serial:///dev/ttyUSB0?columns=x"))
    driver = model.driver(Metronome(clock, period), clock)
    readings = []
    for _ in numbers:
        clock.sleep(pause)
        driver.discard()
        readings.append(driver.read().values[0])
    assert readings == numbers


def test_half_a_line_before_a_failure_does_not_join_what_comes_after_it() -> None:
    driver = printing("columns=x", b"1\r\n12", b"", b"34\r\n5678\r\n")
    assert driver.read().values == (1.0,)
    with pytest.raises(BusError, match="unplugged"):
        driver.read()
    assert driver.read().values == (5678.0,)


def test_a_device_that_prints_something_else_is_named() -> None:
    with pytest.raises(BusError, match=r"50 lines .* numbers x,y; the last was 'a,b,c'.*columns="):
        printing("columns=x,y", b"a,b,c\r\n" * 60).read()


@given(st.lists(st.binary(min_size=1, max_size=60), max_size=20))
def test_any_bytes_end_in_finite_readings_or_a_bus_error(pieces: list[bytes]) -> None:
    driver = printing("columns=x,y", *pieces)
    for _ in range(1000):
        try:
            values = driver.read().values
        except BusError:
            return
        assert all(isfinite(value) for value in values)
    pytest.fail("more readings than bytes")


@given(st.lists(st.tuples(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6)), min_size=1, max_size=20), st.integers(1, 30))
def test_numbers_come_through_however_the_bytes_are_cut(rows: list[tuple[float, float]], size: int) -> None:
    said = b"".join(f"{x!r},{y!r}\r\n".encode() for x, y in rows)
    driver = printing("columns=x,y", *(said[n : n + size] for n in range(0, len(said), size)))
    assert [driver.read().values for _ in rows] == rows


@pytest.mark.parametrize(
    ("options", "unit", "offset", "sensitivity", "scaled"),
    [
        ("columns=x,y&unit=g", "g", 0.0, 1.0, True),
        ("columns=x,y&unit=m/s2", "m/s2", 0.0, 9.80665, True),
        ("columns=x,y&unit=V&offset=2.5&sensitivity=2", "V", 2.5, 2.0, True),
    ],
)
def test_the_address_says_what_such_a_device_nominally_has(options, unit, offset, sensitivity, scaled) -> None:
    model = SERIAL_COLUMNS.at(parse_address(f"serial:///dev/ttyUSB0?{options}"))
    assert (model.unit, model.offset, model.sensitivity, model.scaled) == (unit, offset, sensitivity, scaled)


def test_where_nothing_says_what_1_g_is_the_device_still_reads() -> None:
    model = SERIAL_COLUMNS.at(parse_address("serial:///dev/ttyUSB0?columns=x,y,temperature"))
    assert not model.scaled
    assert (model.channels, model.thermometer) == (("x", "y"), True)


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ("baudrate=9600", "option 'columns' is missing"),
        ("columns=x,pitch-1", "column 'pitch-1' is neither a name of letters and digits"),
        ("columns=x,1a", "column '1a' is neither a name"),
        ("columns=x,temprature", "did you mean 'temperature'"),
        ("columns=x,Temperature", "did you mean 'temperature'"),
        ("columns=time,temperature", "names no reading"),
        ("columns=x,x", "names 'x' twice"),
        ("columns=temperature", "names no reading: x, y, z"),
        ("columns=x&separator=pipe", "not one of comma"),
        ("columns=x&sensitivity=0", "not respond to tilt"),
        ("columns=x&low=2&high=1", "not below"),
    ],
)
def test_wrong_addresses(options: str, why: str) -> None:
    with pytest.raises(UsageError, match=why):
        SERIAL_COLUMNS.at(parse_address(f"serial:///dev/ttyUSB0?{options}"))


def test_the_twin_prints_what_its_truth_says() -> None:
    model = SERIAL_COLUMNS.at(parse_address("sim:columns=temperature,-,z,x&unit=count&sensitivity=1000&offset=5000"))
    truth, clock = model.default_truth(3), VirtualClock()
    fixture = Fixture(clock, ambient=30.0)
    fixture.move((0.0, 0.6, 0.8))
    driver = model.driver(model.twin(truth, fixture, clock), clock)
    readings = [driver.read() for _ in range(100)]

    for place, channel in enumerate("xz"):
        mean = sum(reading.values[place] for reading in readings) / 100
        assert mean == pytest.approx(truth.reading(channel, (0.0, 0.6, 0.8), 30.0), abs=0.5)
    assert readings[0].temperature == 30.0


FRAME = bytes.fromhex("55 AA 04 02 04 09 A4 50")
"""The answer that the maker publishes."""


def test_the_published_frame() -> None:
    driver = DfrobotSca100t(link := ArrivingPieces(FRAME), VirtualClock())
    reading = driver.read()

    assert link.heard == [bytes.fromhex("55 AA 02 FD")]
    assert reading.values == (1026.0, 1033.0)
    assert reading.temperature == pytest.approx(30.471, abs=5e-4)
    g = [(word - DFROBOT.offset) / DFROBOT.sensitivity for word in reading.values]
    assert [degrees(asin(component)) for component in g] == pytest.approx([0.1399, 0.6296], abs=5e-5)


@pytest.mark.parametrize(("payload", "stated"), [("02", 0xFD), ("04 02 04 09 A4", 0x50)])
def test_published_checksums(payload: str, stated: int) -> None:
    assert checksum(bytes.fromhex(payload)) == stated


def test_a_damaged_answer_is_counted_and_asked_for_again() -> None:
    driver = DfrobotSca100t(
        ArrivingPieces(FRAME.replace(b"\x09", b"\x0b"), b"\x55" + FRAME[:4], FRAME[4:]), VirtualClock()
    )
    assert driver.read().values == (1026.0, 1033.0)
    assert driver.link_statistics() == {"answers": 1, "damaged": 1}


def test_an_answer_that_lost_a_byte_is_asked_for_again() -> None:
    driver = DfrobotSca100t(link := ArrivingPieces(FRAME[:3], FRAME[4:], b"", FRAME), VirtualClock())
    assert driver.read().values == (1026.0, 1033.0)
    assert driver.link_statistics() == {"answers": 1, "damaged": 1}
    assert len(link.heard) == 2
    with pytest.raises(BusError, match="silent"):
        driver.read()


@given(st.binary(max_size=30).filter(lambda garbage: b"\x55" not in garbage))
def test_an_answer_behind_garbage_is_found(garbage: bytes) -> None:
    assert parse_answer(garbage + FRAME) == parse_answer(FRAME)


@given(st.integers(2, 7), st.integers(1, 255))
def test_one_changed_byte_is_no_answer(place: int, change: int) -> None:
    changed = bytearray(FRAME)
    changed[place] ^= change
    assert parse_answer(bytes(changed)) is None


def test_faults_of_the_module() -> None:
    with pytest.raises(DeviceFault, match="x reads 5 count"):
        DfrobotSca100t(
            ArrivingPieces(bytes([0x55, 0xAA, 0, 5, 4, 9, 0xA4, checksum(b"\x00\x05\x04\x09\xa4")])), VirtualClock()
        ).read()
    with pytest.raises(BusError, match=r"10 requests .* 6e 6f 20 73 65 6e 73 6f"):
        DfrobotSca100t(ArrivingPieces(*[b"no sensor"] * 10), VirtualClock()).read()
    with pytest.raises(UsageError, match="option 'baudrate' is missing"):
        DFROBOT.at(parse_address("serial:///dev/ttyUSB0"))


def test_the_virtual_module_answers_with_the_words_of_its_sensor() -> None:
    truth, clock = DFROBOT.default_truth(1), VirtualClock()
    driver = DFROBOT.driver(DFROBOT.twin(truth, Fixture(clock), clock), clock)
    readings = [driver.read() for _ in range(100)]

    mean = sum(reading.values[0] for reading in readings) / 100
    assert mean == pytest.approx(truth.reading("x", (0.0, 0.0, 1.0), 24.0), abs=0.35)
    assert readings[0].temperature == pytest.approx(24.0 + truth.thermometer_error, abs=0.5)


def test_channels_have_the_names_of_the_address_axes_first() -> None:
    model = SERIAL_COLUMNS.at(parse_address("serial:///dev/ttyUSB0?columns=time,theta,y,a1,x,-,temperature"))
    assert model.channels == ("x", "y", "theta", "a1")
    assert model.thermometer
    assert not model.senses_tilt
    assert SERIAL_COLUMNS.at(parse_address("serial:///dev/ttyUSB0?columns=z,x")).senses_tilt


def test_the_virtual_device_has_no_other_readings() -> None:
    with pytest.raises(UsageError, match="the model gradiometer"):
        SERIAL_COLUMNS.at(parse_address("sim:columns=theta,a1"))


def test_a_device_that_drips_bytes_is_given_up() -> None:
    """A digit every four seconds, and never a line: no transaction is silent, and yet nothing comes."""
    clock = VirtualClock()

    class Dripping:
        letter = "r"

        def exchange(self, out: bytes, count: int = 0) -> bytes:
            clock.sleep(4.0)
            return b"1"

        def close(self) -> None:
            pass

    model = find_model("serial-columns").at(parse_address("serial:///dev/null?columns=x"))
    with pytest.raises(BusError, match="no whole line came in 10 s, only '1111'"):
        model.driver(Dripping(), clock).read()
    assert clock.now_ns() == 16_000_000_000


def test_a_device_that_sends_line_ends_alone_is_given_up() -> None:
    class Endless:
        letter = "r"

        def exchange(self, out: bytes, count: int = 0) -> bytes:
            return b"\r\n"

    address = parse_address("serial:/dev/ttyUSB0?columns=x,y")
    with pytest.raises(BusError, match="50 lines arrived and all were empty"):
        find_model("serial-columns").at(address).driver(Endless(), VirtualClock()).read()

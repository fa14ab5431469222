"""The ADXL202 drivers against the fact sheet's vectors: sentences, pulses, and what goes wrong with either."""

from __future__ import annotations

from math import asin, degrees

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.arriving_pieces import ArrivingPieces

from tiltcal.core.closed_forms import sensitivity_from_upright_pair
from tiltcal.drivers import find_model
from tiltcal.drivers.adxl202 import Adxl202Edges, Adxl202Sentences, parse_sentence
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.bus.edges import Edge, pack_edges
from tiltcal.drivers.pulses import Pulse, PulseTrains, centred_cycle
from tiltcal.drivers.sentences import checksum, content, missing
from tiltcal.drivers.twin.adxl202 import EdgesTwin, sentences_twin
from tiltcal.drivers.twin.fixture import Fixture
from tiltcal.errors import BusError, DeviceFault, UsageError

ADXL202, ADXL210 = find_model("adxl202"), find_model("adxl210")


def framed(body: str) -> bytes:
    """A sentence with its checksum, by the letter of NMEA 0183."""
    parity = 0
    for character in body.encode():
        parity = parity ^ character
    return f"${body}*{parity:02X}\r\n".encode()


def sentence(number: int, t1x: float = 500, t1y: float = 500, t2: float = 1000) -> bytes:
    return framed(f"PTCDC,{number},{t1x},{t1y},{t2},{t2},24.5")


def sentences(*pieces: bytes) -> Adxl202Sentences:
    return Adxl202Sentences(ArrivingPieces(*pieces), VirtualClock())


def read_all(driver: Adxl202Sentences) -> list[float]:
    """The x duty of every reading until the line is silent."""
    found = []
    with pytest.raises(BusError, match=r"^silent$"):
        found.extend(iter(lambda: driver.read().values[0], None))
    return found


def g_of(duty: float) -> float:
    return (duty - ADXL202.offset) / ADXL202.sensitivity


@pytest.mark.parametrize(
    ("t1", "t2", "g", "tilt"),
    [
        (500, 1000, 0.0, 0.0),
        (562.5, 1000, 0.5, 30.0),
        (536, 1000, 0.288, 16.7383),
        (5217, 10000, 0.1736, 9.9972),
        (6300, 10000, 1.04, None),
    ],
)
def test_vectors_of_the_fact_sheet(t1: float, t2: float, g: float, tilt: float | None) -> None:
    reading = sentences(framed(f"PTCDC,1,{t1},{t1},{t2},{t2}")).read()

    for duty in reading.values:
        assert g_of(duty) == pytest.approx(g, abs=1e-12)
        if tilt is not None:
            assert degrees(asin(g_of(duty))) == pytest.approx(tilt, abs=5e-5)
    assert reading.temperature is None


def test_nothing_is_ever_sent_to_the_microcontroller() -> None:
    line = ArrivingPieces(*(sentence(number) for number in range(1, 4)))
    driver = Adxl202Sentences(line, VirtualClock())
    driver.read()
    driver.read()
    assert line.heard == []


def test_a_calibrated_part_of_the_fact_sheet() -> None:
    up, down, duty = 0.653, 0.389, 0.560
    scale = sensitivity_from_upright_pair(up, down)
    zero = (up + down) / 2

    assert (zero, scale) == pytest.approx((0.521, 0.132))
    assert (duty - zero) / scale == pytest.approx(0.295455, abs=5e-7)
    assert degrees(asin((duty - zero) / scale)) == pytest.approx(17.1848, abs=5e-5)
    assert g_of(duty) == pytest.approx(0.48)
    assert degrees(asin(g_of(duty))) == pytest.approx(28.6854, abs=5e-5)


def test_edges_of_the_fact_sheet() -> None:
    cycle = centred_cycle(Pulse(0, 18000), Pulse(33500, 48500))

    assert cycle == (18000, 15000, 32000)
    x, y = map(g_of, cycle.duty)
    assert (x, y) == pytest.approx((0.5, -0.25))
    assert degrees(asin(y)) == pytest.approx(-14.4775, abs=5e-5)


def test_the_duty_is_of_its_own_period_and_not_of_t1_alone() -> None:
    reading = sentences(framed("PTCDC,7,5050,3030,10100,10100,-12.25")).read()

    assert reading.values == pytest.approx((0.5, 0.3))
    assert reading.temperature == -12.25


# Sentences as every account of NMEA 0183 prints them.
@pytest.mark.parametrize(
    ("line", "inside"),
    [
        (b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47", b"GPGGA"),
        (b"$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W*6A", b"GPRMC"),
    ],
)
def test_the_frame_of_published_sentences(line: bytes, inside: bytes) -> None:
    assert content(line).startswith(inside)
    assert content(line[:-1] + b"0") is None
    assert parse_sentence(line) is None


def test_garbage_and_half_lines_are_counted_and_never_a_reading() -> None:
    driver = sentences(
        b"3,500,1000,1000*5A\r\n",  # the tail of a sentence whose head nobody heard: no fault of the line
        sentence(1, 510) + sentence(2, 520)[:17],
        sentence(2, 520)[17:] + b"\x00\xff garbage \x81\r\n",
        sentence(3, 530).replace(b"530", b"930"),  # a changed digit
        sentence(4, 540)[:-2] + sentence(5, 550),  # the line end is lost
        sentence(6, 560)[:25] + sentence(7, 570),  # half a sentence, then a whole one
        framed("PTCDC,8,500,500"),  # too few fields
        framed("PTCDC,9,1200,500,1000,1000"),  # a pulse longer than its period
        framed("PTCDC,10,0,0,0,0"),  # no pulses at all
        sentence(11, 580),
    )

    assert read_all(driver) == pytest.approx([0.51, 0.52, 0.55, 0.57, 0.58])
    assert driver.link_statistics() == {"sentences": 5, "damaged": 7, "lost": 0, "restarts": 0}


@pytest.mark.parametrize(
    ("times", "duty"),
    [("10,20,10,20", (1.0, 1.0)), ("11,20,10,20", None), ("10,21,10,20", None), ("0,0,0,20", None), ("0,0,10,0", None)],
)
def test_a_pulse_is_as_long_as_its_period_at_most(times: str, duty: tuple[float, float] | None) -> None:
    found = parse_sentence(framed(f"PTCDC,1,{times}")[:-2])
    assert (found and found.duty) == duty


def test_gaps_in_the_sequence_are_lost_sentences() -> None:
    driver = sentences(*(sentence(number) for number in (254, 255, 0, 1, 4, 4, 5, 1000, 3, 4)))

    # 255 to 0 is a counter of eight bits; 2 and 3 are lost; 4 came twice; 994 are lost; then the device began again.
    assert len(read_all(driver)) == 9
    assert driver.link_statistics() == {"sentences": 9, "damaged": 0, "lost": 2 + 994, "restarts": 1}


def test_what_is_discarded_is_not_lost() -> None:
    driver = sentences(sentence(1), sentence(90))
    driver.read()
    driver.discard()
    driver.read()

    assert driver.link_statistics()["lost"] == 0


@pytest.mark.parametrize(("before", "now", "lost"), [(1, 2, 0), (1, 5, 3), (255, 0, 0), (65534, 1, 2), (9999, 0, 0)])
def test_missing_sentences(before: int, now: int, lost: int) -> None:
    assert missing(before, now) == lost


def test_a_device_that_says_something_else_is_named() -> None:
    with pytest.raises(BusError, match=r"50 lines .* the last was 'hello'.*baud rate"):
        sentences(b"hello\r\n" * 60).read()
    with pytest.raises(BusError, match=r"without a line end.*baud rate"):
        sentences(b"\xf0" * 2000).read()


@given(st.lists(st.binary(max_size=80), max_size=20))
def test_any_bytes_end_in_readings_between_the_rails_or_a_bus_error(pieces: list[bytes]) -> None:
    driver = sentences(*(piece for piece in pieces if piece))

    assert all(0.0 <= duty <= 1.0 for duty in read_all(driver))


@given(
    st.lists(st.integers(min_value=1, max_value=40), min_size=1, max_size=30),
    st.integers(min_value=0, max_value=90_000),
)
def test_sentences_arrive_whole_however_they_are_cut(cuts: list[int], start: int) -> None:
    said = b"".join(sentence(start + number, 400 + number) for number in range(5))
    pieces = []
    while said:
        size = cuts[len(pieces) % len(cuts)]
        pieces.append(said[:size])
        said = said[size:]
    driver = sentences(*pieces)

    assert read_all(driver) == pytest.approx([0.400, 0.401, 0.402, 0.403, 0.404])
    assert driver.link_statistics() == {"sentences": 5, "damaged": 0, "lost": 0, "restarts": 0}


@given(st.integers(0, 39), st.integers(1, 255))
def test_one_changed_byte_is_never_a_reading(place: int, change: int) -> None:
    line = framed("PTCDC,4711,51234,48321,100001,100001,24")[:-2]
    damaged = bytearray(line)
    damaged[place] ^= change

    changed = parse_sentence(bytes(damaged))
    # Only the two digits of the checksum may be written in another way.
    assert changed is None or (place >= len(line) - 2 and bytes(damaged).upper() == line)


def trains(period: int, pulses: list[tuple[int, int]], *, centred: bool, start: int = 0) -> list[Edge]:
    """Edges of both lines, the pulse lengths of x and y given for each period."""
    moments = []
    for number, lengths in enumerate(pulses):
        for line, length in enumerate(lengths):
            rise = start + number * period + ((period - length) // 2 if centred else 0)
            moments += [(rise, line, True), (rise + length, line, False)]
    return [Edge(time, line, rising, 1 + n) for n, (time, line, rising) in enumerate(sorted(moments))]


@pytest.mark.parametrize("centred", [True, False])
def test_both_arrangements_of_the_pulses_give_the_same_duty(centred: bool) -> None:
    # At 2**60 ns, where a float has lost the last hundred nanoseconds.
    edges = trains(10_000_000, [(6_000_000, 4_500_000)] * 5, centred=centred, start=1 << 60)
    found = [cycle for cycle in map(PulseTrains().take, edges) if cycle]

    assert [cycle.period for cycle in found] == [10_000_000] * 4
    assert [cycle.duty for cycle in found] == [pytest.approx((0.6, 0.45), abs=1e-12)] * 4


@pytest.mark.parametrize("centred", [True, False])
def test_the_period_holds_while_the_sensor_moves(centred: bool) -> None:
    moving = [(3_000_000 + 200_000 * n, 6_000_000 - 150_000 * n) for n in range(10)]
    found = [cycle for cycle in map(PulseTrains().take, trains(10_000_000, moving, centred=centred)) if cycle]

    assert [cycle.period for cycle in found] == [10_000_000] * 9
    assert [cycle.x for cycle in found] == [x for x, _ in moving[:9]]


@given(st.integers(0, 23), st.integers(1, 6))
def test_lost_edges_are_counted_and_spoil_no_period(first: int, count: int) -> None:
    edges = trains(1_000_000, [(600_000, 300_000)] * 8, centred=True)
    heard = edges[:first] + edges[first + count :]
    collector = PulseTrains()
    found = [cycle for cycle in map(collector.take, heard) if cycle]

    assert all(cycle == (600_000, 300_000, 1_000_000) for cycle in found)
    assert len(found) >= 8 - 1 - 4
    assert collector.lost == (count if first else 0)


def test_edges_are_numbered_anew_once_the_lines_are_had_again() -> None:
    class Replugged(ArrivingPieces):
        def exchange(self, out: bytes, count: int = 0) -> bytes:
            answer = super().exchange(out, count)
            if answer == b"unplugged":
                raise BusError("unplugged")
            return answer

    edges = pack_edges(trains(1000, [(500, 250)] * 3, centred=False))
    driver = Adxl202Edges(Replugged(edges, b"unplugged", edges), VirtualClock())
    assert [driver.read().values for _ in range(2)] == [(0.5, 0.25)] * 2
    with pytest.raises(BusError, match="unplugged"):
        driver.read()
    assert [driver.read().values for _ in range(2)] == [(0.5, 0.25)] * 2
    assert driver.link_statistics() == {"periods": 4, "lost edges": 0, "torn periods": 0}


def test_a_pulse_that_never_came_gives_no_period() -> None:
    whole = trains(1000, [(500, 250)] * 6, centred=False)
    without = [edge for edge in whole if not (edge.line == 1 and 2000 <= edge.time_ns < 3000)]
    renumbered = [edge._replace(number=n) for n, edge in enumerate(without)]
    collector = PulseTrains()
    found = [cycle for cycle in map(collector.take, renumbered) if cycle]

    assert {cycle.duty for cycle in found} == {(0.5, 0.25)}
    assert collector.torn >= 1


def test_a_dead_line_two_sensors_and_equal_times_are_named() -> None:
    only_x = [edge for edge in trains(1000, [(500, 500)] * 20, centred=True) if edge.line == 0]
    renumbered = [edge._replace(number=n) for n, edge in enumerate(only_x)]
    strangers = [
        Edge(time, line, rising, n)
        for n, (time, line, rising) in enumerate(
            sorted(
                (1000 * k + shift + width * (not rising), line, rising)
                for k in range(10)
                for line, shift, width in ((0, 0, 100), (1, 300, 150))
                for rising in (True, False)
            )
        )
    ]
    at_one_time = [edge._replace(time_ns=0) for edge in trains(1000, [(500, 250)] * 3, centred=False)]
    for edges, why in (
        (renumbered, "x pulses and y does not"),
        (strangers, "both lines of one sensor"),
        (at_one_time, "two pulses of x rise at one time"),
    ):
        driver = Adxl202Edges(ArrivingPieces(pack_edges(edges)), VirtualClock())
        with pytest.raises(DeviceFault, match=why):
            driver.read()


def test_twins_give_what_their_truth_says_by_either_wiring() -> None:
    truth = ADXL202.default_truth(5)
    clock = VirtualClock()
    fixture = Fixture(clock, ambient=20.0)
    fixture.move((0.6, 0.0, 0.8))
    for link, make in (
        (sentences_twin(truth, fixture, clock), Adxl202Sentences),
        (EdgesTwin(truth, fixture, clock), Adxl202Edges),
    ):
        driver = make(link, clock)
        read = [driver.read().values for _ in range(200)]
        for place, channel in enumerate("xy"):
            mean = sum(values[place] for values in read) / len(read)
            expected = truth.reading(channel, (0.6, 0.0, 0.8), 20.0)
            assert mean == pytest.approx(expected, abs=5 * truth.noise[channel] / 200**0.5)
        assert "0 lost" in dict(driver.probe())["link"]


def test_a_twin_answers_by_the_time_alone() -> None:
    for wiring in ("sentences", "edges"):
        model = ADXL202.at(parse_address(f"sim:wiring={wiring}"))
        answers = []
        for pauses in ((0.0, 0.1234), (0.1234,)):
            clock = VirtualClock()
            twin = model.twin(model.default_truth(1), Fixture(clock), clock)
            for pause in pauses[:-1]:
                clock.sleep(pause)
                twin.exchange(b"", 4096)
            clock.seek(500_000_000)
            answers.append((twin.exchange(b"", 4096), clock.now_ns()))
        assert answers[0] == answers[1]


def test_models() -> None:
    assert (ADXL202.offset, ADXL202.sensitivity, ADXL210.sensitivity) == (0.5, 0.125, 0.04)
    assert find_model("adxl202e").default_truth(1).noise["x"] < ADXL202.default_truth(1).noise["x"]
    assert ADXL202.at(parse_address("gpio:///dev/gpiochip0?x=1&y=2")).driver is Adxl202Edges
    assert ADXL202.at(parse_address("serial:///dev/ttyUSB0")).driver is Adxl202Sentences
    for wrong in ("serial:///dev/ttyUSB0?wiring=edges", "sim:wiring=wireless"):
        with pytest.raises(UsageError, match="wiring"):
            ADXL202.at(parse_address(wrong))


def test_checksum_of_nothing_is_nothing() -> None:
    assert checksum(b"") == 0
    assert content(b"$*00") == b""

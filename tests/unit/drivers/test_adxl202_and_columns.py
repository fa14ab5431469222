"""Devices that send on their own: sentences, lines of numbers and edges, whole or damaged."""

from functools import reduce
from operator import xor

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.arriving_pieces import ArrivingPieces

from tiltcal.drivers import find_model
from tiltcal.drivers.adxl202 import Adxl202Edges, Adxl202Sentences, Cycle, PulseTrains, missing
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.bus.gpio import Edge, pack_edges
from tiltcal.drivers.model import Sensor
from tiltcal.errors import BusError, DeviceFault

ADXL202, COLUMNS = map(find_model, ("adxl202", "serial-columns"))


def framed(body: str) -> bytes:
    """A sentence with its checksum, by the letter of NMEA 0183."""
    return f"${body}*{reduce(xor, body.encode()):02X}\r\n".encode()


def sentence(number: int, t1x: float = 500) -> bytes:
    return framed(f"PTCDC,{number},{t1x},500,1000,1000,24.5")


def sentences(*pieces: bytes) -> Sensor:
    return ADXL202.driver(ArrivingPieces(*pieces), VirtualClock())


def printing(columns: str, *pieces: bytes) -> Sensor:
    model = COLUMNS.at(parse_address(f"serial:///dev/ttyUSB0?columns={columns}&separator=comma"))
    # The first line may be the tail of one whose head nobody heard, and is never used.
    return model.driver(ArrivingPieces(b"0.99\r\n", *pieces), VirtualClock())


def read_all(sensor: Sensor) -> list[tuple[float, ...]]:
    """Every reading until the line is silent."""
    found = []
    with pytest.raises(BusError, match=r"^silent$"):
        found.extend(iter(lambda: sensor.read().values, None))
    return found


def test_garbage_and_half_sentences_are_counted_and_never_a_reading() -> None:
    line = ArrivingPieces(
        b"3,500,1000,1000*5A\r\n",  # the tail of a sentence whose head nobody heard: no fault of the line
        sentence(1, 510) + sentence(2, 520)[:17],
        sentence(2, 520)[17:] + b"\x00\xff garbage \x81\r\n",
        sentence(3, 530).replace(b"530", b"930"),  # a changed digit
        sentence(4, 540)[:-2] + sentence(5, 550),  # the line end is lost
        sentence(6, 560)[:25] + sentence(7, 570),  # half a sentence, then a whole one
        framed("PTCDC,8,500,500"),  # too few fields
        framed("PTCDC,9,1200,500,1000,1000"),  # a pulse longer than its period
        framed("PTCDC,10,500,1001,1000,1000"),
        framed("PTCDC,11,0,0,0,0"),  # no pulses at all
        sentence(12, 580),
    )
    sensor = Adxl202Sentences(line, VirtualClock())
    assert [x for x, _ in read_all(sensor)] == pytest.approx([0.51, 0.52, 0.55, 0.57, 0.58])
    assert sensor.link_statistics() == {"sentences": 5, "damaged": 8, "lost": 0, "restarts": 0}
    assert line.heard == [], "nothing is ever sent to the microcontroller"


def test_gaps_in_the_sequence_are_lost_sentences_and_what_is_discarded_is_not() -> None:
    sensor = sentences(*(sentence(number) for number in (254, 255, 0, 1, 4, 4, 5, 1000, 3, 4)))
    # 255 to 0 is a counter of eight bits; 2 and 3 are lost; 4 came twice; 994 are lost; then the device began again.
    assert len(read_all(sensor)) == 9
    assert sensor.link_statistics() == {"sentences": 9, "damaged": 0, "lost": 2 + 994, "restarts": 1}
    for before, now, lost in ((1, 2, 0), (1, 5, 3), (255, 0, 0), (65534, 1, 2), (9999, 0, 0), (700, 3, None)):
        assert missing(before, now) == lost
    sensor = sentences(sentence(1), sentence(90))
    sensor.read()
    sensor.discard()
    sensor.read()
    assert sensor.link_statistics()["lost"] == 0


@pytest.mark.parametrize(
    ("sensor", "why"),
    [
        (sentences(b"hello\r\n" * 60), r"50 lines .* the last was 'hello'.*baud rate"),
        (sentences(b"\xf0" * 2000), r"without a line end.*baud rate"),
        (printing("x,y", (b"a,b," + b"c" * 60 + b"\r\n") * 60), r"50 lines .* x,y; the last was 'a,b,c{56}': does col"),
        (printing("x,y", b"\r\n", *[b"\r\n"] * 60), "50 lines arrived and all were empty"),
    ],
)
def test_a_device_that_says_something_else_is_named(sensor: Sensor, why: str) -> None:
    with pytest.raises(BusError, match=why):
        sensor.read()


@given(st.lists(st.binary(min_size=1, max_size=80), max_size=20))
def test_any_bytes_end_in_readings_between_the_rails_or_a_bus_error(pieces: list[bytes]) -> None:
    assert all(0.0 <= duty <= 1.0 for values in read_all(sentences(*pieces)) for duty in values)
    assert all(abs(value) < float("inf") for values in read_all(printing("x,y", *pieces)) for value in values)


def test_a_line_that_is_not_the_numbers_is_counted_and_never_a_reading() -> None:
    sensor = printing(
        "x,y",
        b"1,2\r\n",
        b"booting v1.2\r\n3\r\n3,4,5\r\n3,nan\r\n3,inf\r\n3,1e999\r\n3,0x10\r\n3,\r\n3,\xff\r\n",
        *(b"5,", b"6\r\n7,8\r\n7", b"", b",9\r\n8,9\r\n"),
    )
    assert [sensor.read().values for _ in range(3)] == [(1.0, 2.0), (5.0, 6.0), (7.0, 8.0)]
    with pytest.raises(BusError, match="unplugged"):
        sensor.read()
    assert sensor.read().values == (8.0, 9.0), "half a line before a failure does not join what comes after it"
    assert sensor.link_statistics() == {"lines": 4, "damaged": 9}
    sensor = printing("x", b"1\r\n2\r\n", b"34\r\n", b"5678\r\n")
    sensor.read()
    sensor.discard()
    assert sensor.read().values == (5678.0,), "after a discard half a line is no reading"


class Timed(ArrivingPieces):
    """A line on which each piece comes some seconds after the one before; what waits in the port is discarded."""

    def __init__(self, clock: VirtualClock, *pieces: tuple[float, bytes]) -> None:
        super().__init__(*(piece for _, piece in pieces))
        self._clock, self._pauses = clock, [pause for pause, _ in pieces]

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        self._clock.sleep(self._pauses.pop(0) if count and self._pauses else 0.0)
        return super().exchange(out, count)


def test_a_line_after_silence_is_whole_after_a_discard() -> None:
    clock = VirtualClock()
    line = Timed(clock, (0.5, b"1.5\n"), (0.05, b"2.5\n"), (0.5, b"3.5\n"), (60.0, b"4.5\n"))
    model = COLUMNS.at(parse_address("serial:///dev/ttyUSB0?columns=x"))
    sensor, readings = model.driver(line, clock), []
    for _ in range(3):
        sensor.discard()
        readings.append(sensor.read().values[0])
    assert readings == [1.5, 3.5, 4.5], "what comes at once may be the tail of a line"
    # A digit every four seconds, and never a line: no transaction is silent, and yet nothing comes.
    with pytest.raises(BusError, match="no whole line came in 10 s, only '1"):
        model.driver(Timed(clock, *[(4.0, b"1")] * 9), clock).read()


# Edges


def trains(period: int, pulses: list[tuple[int, int]], *, centred: bool, start: int = 0) -> list[Edge]:
    """Edges of both lines, the pulse lengths of x and y given for each period."""
    moments = []
    for number, lengths in enumerate(pulses):
        for line, length in enumerate(lengths):
            rise = start + number * period + ((period - length) // 2 if centred else 0)
            moments += [(rise, line, True), (rise + length, line, False)]
    return [Edge(time, line, rising, 1 + n) for n, (time, line, rising) in enumerate(sorted(moments))]


def cycles(edges: list[Edge], collector: PulseTrains | None = None) -> list[Cycle]:
    return [cycle for cycle in map((collector or PulseTrains()).take, edges) if cycle]


def renumbered(edges: list[Edge]) -> list[Edge]:
    return [edge._replace(number=n) for n, edge in enumerate(edges)]


@pytest.mark.parametrize("centred", [True, False])
def test_the_duty_holds_in_both_arrangements_while_the_sensor_moves(centred: bool) -> None:
    # At 2**60 ns, where a float has lost the last hundred nanoseconds.
    moving = [(3_000_000 + 200_000 * n, 6_000_000 - 150_000 * n) for n in range(10)]
    came = cycles(trains(10_000_000, moving, centred=centred, start=1 << 60))
    assert [(cycle.x, cycle.period) for cycle in came] == [(x, 10_000_000) for x, _ in moving[:9]]


@given(st.integers(0, 23), st.integers(1, 6))
def test_lost_edges_are_counted_and_spoil_no_period(first: int, count: int) -> None:
    edges, collector = trains(1_000_000, [(600_000, 300_000)] * 8, centred=True), PulseTrains()
    came = cycles(edges[:first] + edges[first + count :], collector)
    assert set(came) == {(600_000, 300_000, 1_000_000)}
    assert len(came) >= 8 - 1 - 4
    assert collector.lost == (count if first else 0)


def test_a_pulse_that_never_came_gives_no_period() -> None:
    whole, collector = trains(1000, [(500, 250)] * 6, centred=False), PulseTrains()
    without = [edge for edge in whole if not (edge.line == 1 and 2000 <= edge.time_ns < 3000)]
    assert {cycle.duty for cycle in cycles(renumbered(without), collector)} == {(0.5, 0.25)}
    assert collector.torn >= 1


def test_edges_are_numbered_anew_once_the_lines_are_had_again() -> None:
    edges = pack_edges(trains(1000, [(500, 250)] * 3, centred=False))
    sensor = Adxl202Edges(ArrivingPieces(edges, b"", edges), VirtualClock())
    sensor.discard()  # which takes nothing of what comes later
    for _ in range(2):
        assert [sensor.read().values for _ in range(2)] == [(0.5, 0.25)] * 2
        with pytest.raises(BusError, match=r"unplugged|silent"):
            sensor.read()
    assert sensor.link_statistics() == {"periods": 4, "lost edges": 0, "torn periods": 0}


def test_a_dead_line_two_sensors_and_equal_times_are_named() -> None:
    pulses = trains(1000, [(500, 250)] * 20, centred=False)
    shifted = [edge._replace(time_ns=edge.time_ns + 300 * edge.line) for edge in pulses]
    for edges, why in (
        (renumbered([edge for edge in pulses if edge.line == 0]), "x pulses and y does not"),
        (renumbered(sorted(shifted)), "both lines of one sensor"),
        ([edge._replace(time_ns=0) for edge in pulses], "two pulses of x rise at one time"),
    ):
        with pytest.raises(DeviceFault, match=why):
            Adxl202Edges(ArrivingPieces(pack_edges(edges)), VirtualClock()).read()

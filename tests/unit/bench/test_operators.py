"""What a program or a person types line by line, and what the virtual jig says."""

import io
import os
import select
from collections.abc import Mapping
from typing import Any

import pytest

from tiltcal.bench.devices import SensorSet
from tiltcal.bench.messages import Accepted, Begin, Lost, Measured, Refused, RotationQuestion, ShownSensor, StagePair
from tiltcal.bench.operators import LineReader, VirtualJig
from tiltcal.drivers.model import Reading
from tiltcal.errors import BusError, SensorError, Stopped
from tiltcal.files.bench import BenchSensor
from tiltcal.journal.header import THERMOMETER


@pytest.mark.parametrize("threaded", [False, True])
def test_whole_lines_wait_half_ones_do_not_and_the_rest_at_the_end_is_a_line(
    threaded: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where select takes sockets alone, as on Windows: there a thread reads, which has them a moment later."""
    if threaded:
        monkeypatch.delattr(select, "poll")
    source, sink = os.pipe()
    with open(source, encoding="utf-8") as stream:
        lines, arrived = LineReader(stream), list[str]()
        assert lines.waiting() == []
        for piece, line in ((b"one\ntw", "one\n"), ("o\nthr\u00e9".encode(), "two\n")):
            os.write(sink, piece)
            arrived.append(line)
            while threaded and lines.waiting() != arrived:
                select.select([], [], [], 0.001)
            assert lines.waiting() == arrived
        os.close(sink)
        assert [lines.next() for _ in range(4)] == ["one\n", "two\n", "thr\u00e9", ""]
        assert lines.waiting() == []
    lines = LineReader(io.StringIO("a\nb"))  # without a descriptor
    assert [lines.waiting(), *(lines.next() for _ in range(3))] == [[], "a\n", "b", ""]


def test_what_the_virtual_jig_says() -> None:
    """Of two sensors, one of which has a thermometer; a position that a resumed session reports is numbered too."""
    said: list[str] = []
    operator, sensors = VirtualJig(said.append), {name: ShownSensor("count", 0.0, 1.0) for name in ("S-1", "S-2")}
    names = [*(f"p{n}" for n in range(9)), "level"]
    begin: Any = {"positions": names, "attitudes": {}, "headings": False, "accepted": ["level"]}
    operator.tell(Begin(title="A title", length="2 positions", sensors=sensors, **begin))
    both = {"S-1": Measured({"x": 1045.25}, {"x": 0.65}, 20, 24.93), "S-2": Measured({"x": 1.5}, {"x": 0.5}, 20)}
    operator.tell(Accepted("level", {"x": 1045.25}, {"x": 0.65}, 20, 24.93, reference={"x": -29.9984}, sensors=both))
    operator.tell(Begin(title="A title", sensors={"S-1": sensors["S-1"]}, **begin))
    operator.tell(Accepted("p8", {"x": 1045.25, "y": -1.0}, {"x": 0.65, "y": 0.7}, 20))
    operator.tell(Refused("p8", "it moved"))
    operator.tell(Lost("S-2", "silent"))
    assert operator.ask(RotationQuestion([StagePair(("a1", "a2"), "a4")], 12, "")) == {"answer": "ready"}
    assert said == [
        "A title: 2 positions",
        "  10/10 level        S-1  x 1045.25 ± 0.65 count  at 24.9 °C  x set -29.9984°",
        "  10/10 level        S-2  x 1.5 ± 0.5 count  x set -29.9984°",
        "A title",
        "   9/10 p8           x 1045.25 ± 0.65  y -1 ± 0.7 count",
        "  p8 refused: it moved",
        "  S-2 is dropped, the others continue: silent",
        "1 pairs, up to 12 turns of the virtual stage",
    ]
    with pytest.raises(Stopped, match=r"^it does not turn$"):
        operator.tell(Refused("rotation", "it does not turn"))


class Reads:
    """A driver that fails or reads, and keeps what it is asked."""

    def __init__(self, *fails: str) -> None:
        self.fails, self.asked = list(fails), list[str]()

    def discard(self) -> None:
        self.asked.append("discard")

    def read(self) -> Reading:
        self.asked.append("read")
        if self.fails:
            raise BusError(self.fails.pop(0))
        return Reading((1.0,), 20.0)

    def link_statistics(self) -> Mapping[str, int]:
        return {"sentences": len(self.asked)}


def test_a_sensor_that_fails_five_times_in_a_row_is_given_up_where_others_remain() -> None:
    """Then another one too, which is the fault of all; what is needed, or a device of the bench, ends the session."""
    devices = [BenchSensor(name, "sca100t-d02", "sim:") for name in ("A", "B")]
    drivers: Any = [Reads(*9 * ["dead"]), Reads()]
    thermometer: Any = Reads()
    both = SensorSet(devices, drivers, {THERMOMETER: thermometer})
    for count in range(9):
        with pytest.raises(SensorError, match=r"^A: dead$") as failed:
            both.read(fresh=True)
        both.failed(failed.value)
        assert both.lost == ({} if count < 8 else {"A": "A: dead"})
        if count == 3:
            both.succeeded()
    assert drivers[1].asked == 9 * ["discard"]
    assert both.read() == {"B": Reading((1.0,), 20.0)}
    assert list(both.models) == ["B"]
    assert both.link_statistics() == {"B": {"sentences": 10}, THERMOMETER: {"sentences": 10}}
    error = SensorError("B", ("dead",))
    for _ in range(4):
        both.failed(error)
    with pytest.raises(SensorError, match=r"^dead; before it A failed: is a supply"):
        both.failed(error)
    for name, needed in (("A", True), (THERMOMETER, False)):
        other = SensorSet(devices, drivers)
        for _ in range(4):
            other.failed(error := SensorError(name, ("gone",)), needed=needed)
        with pytest.raises(SensorError, match=r"^gone$"):
            other.failed(error, needed=needed)

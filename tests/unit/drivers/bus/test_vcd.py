"""Logic analyser captures: files of sigrok-cli, of pyvcd's writer and by hand, read to the right duty cycle."""

import os
import shutil
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest

from tiltcal.bench.devices import RecordedLink, Recorder
from tiltcal.drivers import find_model
from tiltcal.drivers.bus import open_link
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.bus.gpio import Edge, unpack_edges
from tiltcal.errors import BusError, HardwareError, UsageError

pytest.importorskip("vcd", reason="the pyvcd package is not installed")

ADXL202 = find_model("adxl202").at(parse_address("vcd:capture.vcd?x=D0&y=D1"))

HAND_WRITTEN = """$date today $end
$timescale 10 us $end
$scope module top $end
$var wire 1 ! D0 $end
$var wire 1 " D1 $end
$var wire 8 # bus $end
$upscope $end
$enddefinitions $end
$dumpvars 0! x" b0 # $end
#0 1! 0"
#50 0!
#52 1" b101 #
#60 0"
#100 1!
"""


def opened(path: Path, x: str = "D0", y: str = "D1"):
    return open_link(parse_address(f"vcd:{path}?x={x}&y={y}"), ADXL202)


def pwm(periods: int, period: int, x: int, y: int) -> bytes:
    """Samples of two lines, one byte each, bit 0 for x and bit 1 for y; the pulses rise together."""
    return bytes((place < x) | (place < y) << 1 for place in range(period)) * periods


@pytest.fixture
def hand_written(tmp_path: Path) -> Path:
    path = tmp_path / "capture.vcd"
    path.write_text(HAND_WRITTEN)
    return path


def test_changes_are_edges_at_their_times_and_first_values_are_not(hand_written: Path) -> None:
    link = opened(hand_written)
    assert list(unpack_edges(link.exchange(b"", 4096))) == [
        Edge(0, 0, True, 1),
        Edge(500_000, 0, False, 2),
        Edge(520_000, 1, True, 3),
        Edge(600_000, 1, False, 4),
        Edge(1_000_000, 0, True, 5),
    ]
    with pytest.raises(BusError, match="the capture is at its end"):
        link.exchange(b"", 4096)
    link.close()
    link.close()
    for unit, ns in (("1 s", 1e9), ("1 ms", 1e6), ("100 us", 1e5), ("10 ns", 10), ("100 ps", 0.1), ("10 fs", 1e-5)):
        hand_written.write_text(HAND_WRITTEN.replace("10 us", unit))
        with closing(opened(hand_written)) as link:
            times = [edge.time_ns for edge in unpack_edges(link.exchange(b"", 4096))]
        assert times == [round(ns * step) for step in (0, 50, 52, 60, 100)], unit


@pytest.mark.skipif(shutil.which("sigrok-cli") is None, reason="sigrok-cli is not installed")
def test_a_file_of_sigrok_gives_the_duty_cycle_that_was_generated(tmp_path: Path) -> None:
    rate, samples, capture = 8_000_000, tmp_path / "pwm.bin", tmp_path / "capture.vcd"
    samples.write_bytes(pwm(20, 4000, 2250, 1500))
    source = ["-i", samples, "-I", f"binary:numchannels=2:samplerate={rate}"]
    with capture.open("wb") as output:
        subprocess.run(["sigrok-cli", *source, "-O", "vcd"], check=True, stdout=output)
    with closing(opened(capture, "0", "1")) as link:
        driver = ADXL202.driver(link, VirtualClock())
        assert [driver.read().values for _ in range(18)] == [(0.5625, 0.375)] * 18
        assert driver.link_statistics()["lost edges"] == 0


def recorded(capture: Path) -> RecordedLink:
    return RecordedLink(Recorder(VirtualClock()), lambda: opened(capture), "e", 0)


def numbers(records: bytes) -> list[int]:
    return [edge.number for edge in unpack_edges(records)]


def test_a_capture_at_its_end_starts_again_once_it_is_written_anew(hand_written: Path) -> None:
    with closing(recorded(hand_written)) as link:
        assert numbers(link.exchange(b"", 4096)) == [1, 2, 3, 4, 5]
        for _ in range(2):
            with pytest.raises(BusError, match="at its end"):
                link.exchange(b"", 4096)
            link.exchange(b"", 0)
        replacement = hand_written.with_suffix(".new")
        replacement.write_text(HAND_WRITTEN.replace("#100 1!", "#200 1!"))
        os.replace(replacement, hand_written)
        link.exchange(b"", 0)
        *_, last = unpack_edges(link.exchange(b"", 4096))
        assert last == Edge(2_000_000, 0, True, 5)


UNREADABLE = (
    ("time,x,y\n1,2,3\n", "not a value change dump"),
    ("$timescale 1 ns $end $scope module m $end", "header does not end"),
    (HAND_WRITTEN.replace("D1", "CLK"), r"no signal is called 'D1' \(it has D0, CLK\)"),
    (
        HAND_WRITTEN.replace(
            "module top $end", "module top $end $var wire 1 % D1 $end $upscope $end $scope module a $end"
        ),
        r"'D1' is in several scopes: name one of top\.D1, a\.D1",
    ),
    ("", "not a value change dump"),
    (HAND_WRITTEN.replace('" D1', "! D1"), "signals D0 and D1 are one and the same wire"),
    (HAND_WRITTEN.replace("10 us", "0 ms"), "its time scale is 0"),
)


def test_what_cannot_be_read_is_named(hand_written: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for text, why in UNREADABLE:
        hand_written.write_text(text)
        with pytest.raises(BusError, match=why):
            opened(hand_written)
    for time, why in (("&&&", "damaged"), ("#99999999999999999", "is its time scale right")):
        hand_written.write_text(HAND_WRITTEN.replace("#60", time))
        with closing(opened(hand_written)) as link, pytest.raises(BusError, match=why):
            link.exchange(b"", 4096)
    os.mkfifo(tmp_path / "pipe.vcd")
    writer = os.open(tmp_path / "pipe.vcd", os.O_RDWR)
    try:
        os.write(writer, HAND_WRITTEN.encode())
        with pytest.raises(BusError, match="no file that can be read from its start"):
            opened(tmp_path / "pipe.vcd")
    finally:
        os.close(writer)
    with pytest.raises(BusError, match=r"gone\.vcd cannot be read \(No such file"):
        opened(tmp_path / "gone.vcd")
    with pytest.raises(UsageError, match="both signal 'D0'"):
        opened(tmp_path / "gone.vcd", "D0", "D0")
    monkeypatch.setitem(sys.modules, "vcd.reader", None)
    with pytest.raises(HardwareError, match=r"pip install 'tiltcal\[vcd\]'"):
        opened(hand_written)

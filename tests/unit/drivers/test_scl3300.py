"""The SCL3300 where it differs from other parts: its frames, banks, serial number, and resets within a sample."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tiltcal.bench import devices
from tiltcal.bench.devices import BenchDevice, VirtualBench
from tiltcal.bench.sensors import Recorder, connected
from tiltcal.drivers import find_model
from tiltcal.drivers import scl3300 as frames
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.model import Model, Sensor
from tiltcal.drivers.virtual import Fixture
from tiltcal.errors import BusError, DeviceFault, SensorError

SCL, SCA = find_model("scl3300"), find_model("sca3300-d01")
MODE_4 = SCL.at(parse_address("sim:range=mode4"))
ALLOWED = frozenset(
    {
        *("040000F7", "080000FD", "0C0000FB", "100000E9", "140000EF", "180000E5", "1C0000E3", "200000C1"),
        *("240000C7", "280000CD", "2C0000CB", "340000DF", "40000091", "B400001F", "B4000102", "B4000225"),
        *("B4000338", "B400046B", "B4002098", "B0001F6F", "640000A7", "680000AD", "7C0000B3", "FC000073", "FC00016E"),
    }
)
"""Every frame that the data sheet lists."""


class Line:
    """The link to a virtual part, which may be changed before a frame passes, and its answer behind it."""

    letter = "s"

    def __init__(self, model: Model, seed: int = 1) -> None:
        self.clock, self.model = VirtualClock(), model
        self.truth = model.default_truth(seed)
        self.sent: list[bytes] = []
        self.before: Callable[[], object] = lambda: None
        self.after: Callable[[bytes, bytes], bytes] = lambda out, answer: answer
        self.restart()

    def restart(self) -> None:
        """Lose the supply for a moment."""
        self.part = self.model.twin(self.truth, Fixture(self.clock), self.clock)

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        self.sent.append(out)
        self.before()
        return self.after(out, self.part.exchange(out))

    def close(self) -> None:
        self.before = pulled_out


def pulled_out() -> None:
    raise BusError("the adapter was pulled out")


def bench(model: Model, part: Model | None = None) -> tuple[Sensor, Line]:
    line = Line(part or model)
    return model.driver(line, line.clock), line


def answering(register: int, data: int) -> bytes:
    """An answer without error, with the CRC of the data sheet."""
    head = bytes([register << 2 | 0b01, data >> 8, data & 0xFF])
    return head + bytes([frames.crc8(head)])


def test_the_driver_sends_the_frames_of_the_data_sheet_alone() -> None:
    """No others are allowed: they may block the part. And each has the CRC of the data sheet."""
    ours = {value.hex().upper() for value in vars(frames).values() if isinstance(value, bytes)}
    assert ours | {mode.hex().upper() for mode in frames.MODES} <= ALLOWED
    assert all(frames.crc8(frame[:3]) == frame[3] for frame in map(bytes.fromhex, ALLOWED))
    # A write is answered with its own data: bank 1 by bank 1, and not by bank 0.
    answers = [frames.decode(bytes.fromhex(frame)) for frame in ("FD0001E1", "FD0000FC")]
    assert [answer.answers(frames.BANK_1) for answer in answers] == [True, False]


@pytest.mark.parametrize("model", [SCL, MODE_4, SCA], ids=lambda model: model.title)
def test_a_part_that_another_program_left_in_bank_1_is_read_and_named(model: Model) -> None:
    sensor, line = bench(model)
    line.part.exchange(frames.BANK_1)
    # SERIAL1 F7DA and SERIAL2 3CE5, as the data sheet's example has them.
    serial = {0x65: answering(25, 0xF7DA), 0x69: answering(26, 0x3CE5)}
    line.after = lambda out, answer: serial.get(answer[0], answer)
    said = dict(sensor.probe())
    assert (said["part"], said["serial"]) == (model.title.split()[1], "1021704154B33")
    line.sent.clear()
    sensor.read()
    assert len(line.sent) == 5, "the part is set up once, and left in bank 0"


def test_another_part_and_wires_alone_are_named() -> None:
    sensor, _ = bench(SCL, SCA)
    with pytest.raises(DeviceFault, match=r"WHOAMI reads 0x51.* the part is an SCA3300-D01: name it with --sensor"):
        sensor.read()
    sensor, line = bench(SCL)
    line.after = lambda out, answer: out
    with pytest.raises(BusError, match="MISO is connected to MOSI"):
        sensor.read()


@pytest.mark.parametrize("place", [None, 1, 2, 3])
def test_a_fault_that_stays_is_told_over_a_damaged_status(place: int | None) -> None:
    """Of three answers to STATUS one is damaged; the other two have the same flags, with an error."""
    sensor, line = bench(SCL)
    sensor.read()
    line.sent.clear()

    def faulty(out: bytes, answer: bytes) -> bytes:
        line.part._raise(frames.MEMORY)
        damaged = place is not None and line.sent.count(frames.STATUS) == 1 + place
        return b"\x00" * 4 if damaged else answer

    line.after = faulty
    with pytest.raises(DeviceFault, match="reports a fault: memory"):
        sensor.read()
    with pytest.raises(DeviceFault, match=r"a fault that its start does not clear: memory \(MEM\).* replace the part"):
        sensor.read()


@pytest.mark.parametrize("after", range(5))
def test_a_reset_within_a_sample_is_no_reading(after: int) -> None:
    sensor, line = bench(MODE_4)
    line.truth.noise.clear()
    truth = sensor.read().values
    line.sent.clear()
    line.before = lambda: line.restart() if len(line.sent) == 1 + after else None
    with pytest.raises((DeviceFault, BusError)):
        sensor.read()
    line.before = lambda: None
    assert sensor.read().values == truth


def test_another_part_after_the_bus_was_opened_again_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """The adapter is pulled out twice: the same part is read on, the other one is not."""
    clock, device = VirtualClock(), BenchDevice(model="scl3300", serial="A-1", address="spi:///dev/spidev0.0")
    same, again, other, back = links = [Line(SCL), Line(SCL), Line(SCL, seed=2), Line(SCL)]
    for line in links:
        line.truth.noise.clear()
        line.clock = clock
        line.restart()
    opened = iter(links)
    monkeypatch.setattr(devices, "open_link", lambda *_: next(opened))
    live = []
    with connected([device], None, Recorder(clock), VirtualBench(clock, [device])) as bench:
        for pulled in (None, same, None, again, None, None):
            if pulled is not None:
                pulled.before = pulled_out
            try:
                live.append(str(bench.read()[0].values))
            except SensorError as error:
                live.append(str(error))
    reading, out, said = live[0], "the adapter was pulled out", live[4]
    assert live == [reading, out, reading, out, said, reading]
    assert said.startswith("another part answers: its serial number is ")
    with pytest.raises(BusError, match="pulled out"):
        other.exchange(b"")  # it was closed
    assert back.sent

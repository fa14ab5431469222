"""The SCL3300 on lines that damage its frames, against a part that was written apart from driver and twin."""

from __future__ import annotations

from dataclasses import asdict, replace

import pytest
from support.emulated.bench import Scl3300 as PartFacts
from support.scl3300_part import ALLOWED, Scl3300Part

from tiltcal.bench import devices
from tiltcal.bench.devices import BenchDevice, VirtualBench
from tiltcal.bench.sensors import Recorder, connected
from tiltcal.drivers import find_model
from tiltcal.drivers import scl3300 as frames
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.model import Model, Sensor
from tiltcal.errors import BusError, DeviceFault, SensorError

SCL = find_model("scl3300")
MODE_3, MODE_4 = (SCL.at(parse_address(f"sim:range=mode{number}")) for number in (3, 4))


def broken(answer: bytes) -> bytes:
    raise BusError("the adapter was pulled out")


class PartLink:
    """The independent part as a link, 20 µs to a frame."""

    letter = "s"

    def __init__(self, **changes: object) -> None:
        self.clock = VirtualClock()
        self.clock.sleep(1.0)
        self.part = Scl3300Part(**asdict(replace(PartFacts(), jig=0.0, noise=0.0, **changes)))
        self.asked: list[bytes] = []
        self.before = self.after = lambda answer: answer

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        self.clock.sleep(20e-6)
        self.asked.append(out)
        self.before(b"")
        return self.after(self.part.transfer(out, self.clock.now_ns(), self.clock.now_ns()))

    def close(self) -> None:
        self.before = broken

    def expected(self, model: Model) -> tuple[float, ...]:
        return tuple(float(round(one * model.sensitivity)) for one in self.part.measured(self.clock.now_ns()))


def bench(model: Model, **changes: object) -> tuple[Sensor, PartLink]:
    link = PartLink(**changes)
    return model.driver(link, link.clock), link


def test_the_driver_sends_the_frames_of_the_data_sheet_alone() -> None:
    """No others are allowed: they may block the part. And each has the CRC of the data sheet."""
    ours = {value.hex().upper() for value in vars(frames).values() if isinstance(value, bytes)}
    assert ours | {mode.hex().upper() for mode in frames.MODES} <= ALLOWED
    assert all(frames.crc8(frame[:3]) == frame[3] for frame in map(bytes.fromhex, ALLOWED))
    # A write is answered with its own data: bank 1 by bank 1, and not by bank 0.
    answers = [frames.decode(bytes.fromhex(frame)) for frame in ("FD0001E1", "FD0000FC")]
    assert [answer.answers(frames.BANK_1) for answer in answers] == [True, False]


@pytest.mark.parametrize("model", [SCL, MODE_3, find_model("sca3300-d01")], ids=lambda model: model.title)
@pytest.mark.parametrize("left", [{}, {"bank": 1}, {"asleep": True}], ids=["at rest", "bank 1", "power-down"])
def test_a_part_as_another_program_left_it_is_read_and_named(model: Model, left: dict[str, object]) -> None:
    sensor, link = bench(model, identity=0x51 if model.name == "sca3300-d01" else 0xC1)
    vars(link.part).update(left)
    link.part.pose([0.6, 0.0, -0.8], 31.0)
    assert sensor.read().values == link.expected(model)
    said = dict(sensor.probe())
    # SERIAL1 F7DA and SERIAL2 3CE5, as the data sheet's example has them.
    assert (said["part"], said["serial"]) == (model.title.split()[1], "1021704154B33")
    assert sensor.read().values == link.expected(model), "the part is left in bank 0"
    assert link.part.counts["forbidden"] == 0
    set_up, link.asked[:] = len(link.asked), []
    sensor.read()
    assert (set_up > 5, len(link.asked)) == (True, 5), "the part is set up once"


def test_another_part_and_wires_alone_are_named() -> None:
    sensor, _ = bench(SCL, identity=0x51)
    with pytest.raises(DeviceFault, match=r"WHOAMI reads 0x51.* the part is an SCA3300-D01: name it with --sensor"):
        sensor.read()
    sensor, link = bench(SCL)
    link.after = lambda answer: link.asked[-1]
    with pytest.raises(BusError, match="MISO is connected to MOSI"):
        sensor.read()


@pytest.mark.parametrize(("damage", "noticed"), [(0.02, 0.7), (0.1, 0.5)])
def test_no_damaged_frame_becomes_a_reading_and_all_are_counted(damage: float, noticed: float) -> None:
    for seed in range(5):
        sensor, link = bench(SCL, damage=damage, seed=seed)
        assert {sensor.read().values for _ in range(400)} == {link.expected(SCL)}
        counted, part = sensor.link_statistics(), link.part.counts
        assert (counted["samples"], counted["restarts"], counted["out of step"]) == (400, 0, 0)
        # What is damaged during the start, or in the last frame, is not all told from the flags of the start.
        assert part["answers_damaged"] - 5 <= counted["damaged"] <= part["answers_damaged"]
        assert noticed * part["requests_damaged"] - 3 <= counted["refused"] <= part["requests_damaged"]


@pytest.mark.parametrize("place", [None, 0, 1, 2])
def test_a_fault_that_stays_is_told_over_a_damaged_status(place: int | None) -> None:
    """Of three answers to STATUS one is damaged; the other two have the same flags, with an error."""
    sensor, link = bench(SCL)
    sensor.read()
    link.part.broken = True
    link.asked.clear()
    damaged = -1 if place is None else 2 + place
    link.after = lambda answer: b"\x00" * 4 if link.asked.count(frames.STATUS) == damaged else answer
    with pytest.raises(DeviceFault, match="reports a fault: memory"):
        sensor.read()
    link.after = lambda answer: answer
    with pytest.raises(DeviceFault, match=r"a fault that its start does not clear: memory \(MEM\).* replace the part"):
        sensor.read()


def test_a_reset_in_mid_session_is_told_and_the_part_is_set_up_anew() -> None:
    sensor, link = bench(MODE_4, damage=0.02)
    told = 0
    for _ in range(100):
        assert sensor.read().values == link.expected(MODE_4)
        link.part.restart()
        # Until it has started it cannot be spoken to; between two samples a bench waits longer than this.
        link.clock.sleep(0.005)
        try:
            assert sensor.read().values == link.expected(MODE_4)
        except DeviceFault as fault:
            told += "was reset or its supply failed" in str(fault)
    assert sensor.link_statistics()["restarts"] == told >= 95


@pytest.mark.parametrize("after", range(5))
def test_a_reset_within_a_sample_is_no_reading(after: int) -> None:
    sensor, link = bench(MODE_4)
    truth = sensor.read().values

    def restart(_: bytes) -> bytes:
        if len(link.asked) == 1 + after:
            link.part.restart()
            link.part.ready_ns = 0
        return b""

    link.asked.clear()
    link.before = restart
    with pytest.raises((DeviceFault, BusError)):
        sensor.read()
    link.before = lambda answer: answer
    assert sensor.read().values == truth


def test_another_part_after_the_bus_was_opened_again_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """The adapter is pulled out twice: the same part is read on, the other one is not."""
    clock, device = VirtualClock(), BenchDevice(model="scl3300", serial="A-1", address="spi:///dev/spidev0.0")
    same, again, other, back = links = [PartLink(), PartLink(), PartLink(serial=1), PartLink()]
    for link in links:
        link.clock = clock
    opened = iter(links)
    monkeypatch.setattr(devices, "open_link", lambda *_: next(opened))
    live = []
    with connected([device], None, Recorder(clock), VirtualBench(clock, [device])) as bench:
        for pulled in (None, same, None, again, None, None):
            if pulled is not None:
                pulled.before = broken
            try:
                live.append(str(bench.read()[0].values))
            except SensorError as error:
                live.append(str(error))
    reading, out = live[0], "the adapter was pulled out"
    said = "another part answers: its serial number is 1B33, it was 1021704154B33; connect that one"
    assert live == [reading, out, reading, out, said, reading]
    with pytest.raises(BusError, match="pulled out"):
        other.exchange(b"")  # it was closed
    assert back.part.counts["forbidden"] == 0

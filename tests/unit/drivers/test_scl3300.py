"""The SCL3300 where it differs from other parts: its frames, banks, serial number, and resets within a sample."""

import re

import pytest
from support.virtual_device import VirtualDevice

from tiltcal.bench import devices
from tiltcal.bench.devices import Recorder, VirtualBench, connected
from tiltcal.drivers import find_model
from tiltcal.drivers import scl3300 as frames
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.errors import BusError, DeviceFault, SensorError
from tiltcal.files.bench import BenchSensor

SCL, SCA = find_model("scl3300"), find_model("sca3300-d01")
ALLOWED = frozenset(
    {
        *("040000F7", "080000FD", "0C0000FB", "100000E9", "140000EF", "180000E5", "1C0000E3", "200000C1"),
        *("240000C7", "280000CD", "2C0000CB", "340000DF", "40000091", "B400001F", "B4000102", "B4000225"),
        *("B4000338", "B400046B", "B4002098", "B0001F6F", "640000A7", "680000AD", "7C0000B3", "FC000073", "FC00016E"),
    }
)
"""Every frame that the data sheet lists."""


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


@pytest.mark.parametrize(("model", "options"), [(SCL, ""), (SCL, "range=mode4"), (SCA, "")])
def test_a_part_that_another_program_left_in_bank_1_is_read_and_named(model, options: str) -> None:
    device = VirtualDevice(model, options)
    device.line.link.exchange(frames.BANK_1)
    # SERIAL1 F7DA and SERIAL2 3CE5, as the data sheet's example has them.
    serial = {0x65: answering(25, 0xF7DA), 0x69: answering(26, 0x3CE5)}
    device.line.change = lambda out, answer: serial.get(answer[0], answer)
    said = dict(device.sensor.probe())
    assert (said["part"], said["serial"]) == (model.title.split()[1], "1021704154B33")
    device.line.sent.clear()
    device.sensor.read()
    assert len(device.line.sent) == 5, "the part is set up once, and left in bank 0"


def test_another_part_and_wires_alone_are_named() -> None:
    device = VirtualDevice(SCL)
    device.line.link = VirtualDevice(SCA).part()
    with pytest.raises(DeviceFault, match=r"WHOAMI reads 0x51.* the part is an SCA3300-D01: name it with sensor"):
        device.sensor.read()
    device = VirtualDevice(SCL)
    device.line.change = lambda out, answer: out
    with pytest.raises(BusError, match="MISO is connected to MOSI"):
        device.sensor.read()


@pytest.mark.parametrize("place", [None, 1, 2, 3])
def test_a_fault_that_stays_is_told_over_a_damaged_status(place: int | None) -> None:
    """Of three answers to STATUS one is damaged; the other two have the same flags, with an error."""
    device, asked = VirtualDevice(SCL), 0
    device.sensor.read()

    def faulty(out: bytes, answer: bytes) -> bytes:
        nonlocal asked
        device.line.link._raise(frames.MEMORY)
        asked += out == frames.STATUS
        return b"\x00" * 4 if place is not None and asked == 1 + place else answer

    device.line.change = faulty
    with pytest.raises(DeviceFault, match="reports a fault: memory"):
        device.sensor.read()
    with pytest.raises(DeviceFault, match=r"a fault that its start does not clear: memory \(MEM\).* replace the part"):
        device.sensor.read()


def test_an_error_whose_flags_are_damaged_sets_the_part_up_anew() -> None:
    device = VirtualDevice(SCL, "range=mode4", noise={})
    truth, sent = device.sensor.read(), len(device.line.sent)
    device.line.link._raise(frames.MEMORY)
    answers = iter([b"\x00" * 4] * 3)

    def damaged(out: bytes, answer: bytes) -> bytes:
        return next(answers, answer) if answer[0] >> 2 == frames.STATUS[0] >> 2 else answer

    device.line.change = damaged
    assert device.sensor.read() == truth
    assert frames.RESET in [out for out, _, _ in device.line.sent[sent:]]
    assert device.sensor.link_statistics() == {"samples": 2, "damaged": 1, "saturated": 0, "restarts": 0}


FLAGS = (  # by their bits, the lowest first
    "internal connection (PIN_CONTINUITY)", "mode change (MODE_CHANGE)", "power-down (PD)", "memory (MEM)",
    "supply (PWR)", "temperature path saturated (TEMP_SAT)", "signal path saturated (SAT)", "clock (CLK)",
    "digital block (DIGI2)", "digital block (DIGI1)",
)  # fmt: skip


def test_each_flag_of_the_status_is_a_restart_a_saturation_or_a_fault() -> None:
    """Bits 1, 2 and 4 are those of a part that was set up by nobody; of 5 or 6 the sample is repeated."""
    for place, name in enumerate(FLAGS):
        device = VirtualDevice(SCL)
        device.sensor.read()
        device.line.link._raise(1 << place)
        if place in (5, 6):
            device.sensor.read()
            assert device.sensor.link_statistics()["saturated"] == 1
            continue
        restarted = f"was reset or its supply failed since it was set up ({name}):"
        with pytest.raises(DeviceFault, match=re.escape(restarted if place in (1, 2, 4) else f"a fault: {name}: it")):
            device.sensor.read()


def test_a_part_that_is_shaken_and_wires_that_damage_a_frame_are_told_apart() -> None:
    device = VirtualDevice(SCL)
    device.sensor.read()

    def shaken(out: bytes, answer: bytes) -> bytes:
        device.line.link._raise(0x040)
        return answer

    device.line.change = shaken
    with pytest.raises(DeviceFault, match="signal path is saturated"):
        device.sensor.read()
    assert device.sensor.link_statistics() == {"samples": 1, "damaged": 0, "saturated": 12, "restarts": 0}
    device.line.mend()
    device.sensor.read()
    # Only what reads x has a wrong checksum.
    device.line.change = lambda out, answer: answer[:3] + b"?" if answer[0] >> 2 == frames.ACC_X[0] >> 2 else answer
    with pytest.raises(BusError, match="12 samples in a row were damaged"):
        device.sensor.read()


@pytest.mark.parametrize("after", range(5))
def test_a_reset_within_a_sample_is_no_reading(after: int) -> None:
    device = VirtualDevice(SCL, "range=mode4", noise={})
    truth = device.sensor.read().values
    device.line.sent.clear()
    device.line.link = device.part() if after == 0 else device.line.link

    def reset(out: bytes, answer: bytes) -> bytes:
        if 1 + len(device.line.sent) == after:
            device.line.link = device.part()
        return answer

    device.line.change = reset
    with pytest.raises((DeviceFault, BusError)):
        device.sensor.read()
    assert device.sensor.read().values == truth


def test_another_part_after_the_bus_was_opened_again_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """The adapter is pulled out twice: the same part is read on, the other one is not."""
    device = BenchSensor("A-1", "scl3300", "spi:///dev/spidev0.0")
    parts = [VirtualDevice(SCL, noise={}, seed=seed) for seed in (3, 3, 4, 3)]
    opened, live = iter(parts), []
    monkeypatch.setattr(devices, "open_link", lambda *_: next(opened).line)

    def pulled_out(out: bytes, answer: bytes) -> bytes:
        raise BusError("the adapter was pulled out")

    clock = VirtualClock()
    with connected([device], {}, Recorder(clock), VirtualBench(clock, [device])) as bench:
        for pulled in (None, parts[0], None, parts[1], None, None):
            if pulled is not None:
                pulled.line.change = pulled_out
            try:
                live.append(str(bench.read()["A-1"].values))
            except SensorError as error:
                live.append(str(error))
    reading, out, said = live[0], "the adapter was pulled out", live[4]
    assert live == [reading, out, reading, out, said, reading]
    assert said.startswith("another part answers: its serial number is ")
    assert [part.line.closed for part in parts] == [True] * 4


def test_a_read_is_its_operation_alone() -> None:
    """Linux's sca3300.c leaves the bytes that it wrote last in a read, with a CRC that fits."""
    part = VirtualDevice(SCL).part()
    said = {}
    for head in ("B40001", *3 * ("180001",), "400001", "340001"):
        request = bytes.fromhex(head)
        part.exchange(request + bytes([frames.crc8(request)]))
        said[head] = part.exchange(bytes(4)).hex().upper()
    assert (said["180001"], said["400001"], said["340001"][:6]) == ("1900006A", "4100C136", "350001")

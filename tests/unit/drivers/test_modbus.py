"""``modbus-columns`` through pymodbus on a serial line, with units that answer by the letter, late, busy or not at all.

A server of TCP moves the table of ``test_machines``.
"""

import os
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, nullcontext
from types import SimpleNamespace

import pytest

from tiltcal.drivers import find_model
from tiltcal.drivers.bus import modbus, open_link
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.model import Sensor
from tiltcal.errors import BusError, DeviceFault, UsageError

pytest.importorskip("pymodbus", reason="the pymodbus package is not installed")

from support.scripted_link import Script

REGISTERS = {0: b"\xfe\x0c", 1: b"\x00\xfa", 4: b"\x00\xeb", 10: b"\x3e\x00", 11: b"\0\0", 12: b"\xbf\x40", 13: b"\0\0"}
"""-500, 250 and 235 of 16 bits, 0.125 and -0.75 of 32 bits by IEEE 754."""

Answer = Callable[[bytes, int], list[tuple[float, bytes]]]
"""The n-th request, unit first, is answered by these frames without checksum, each after a delay in seconds."""


def by_the_letter(request: bytes, count: int) -> list[tuple[float, bytes]]:
    """Unit 7, with exception 2 for a register that it does not have; other units are silent."""
    first, number = int.from_bytes(request[2:4], "big"), int.from_bytes(request[4:6], "big")
    if request[0] != 7:
        return []
    try:
        data = b"".join(REGISTERS[first + place] for place in range(number))
    except KeyError:
        return [(0.0, request[:1] + bytes([request[1] | 0x80, 2]))]
    return [(0.0, request[:2] + bytes([len(data)]) + data)]


@contextmanager
def unit(place: str, options: str, lines: dict | None = None) -> Iterator[Sensor]:
    """The driver of one unit at a place, whose link is closed at the end."""
    address = parse_address(f"modbus:{place}?{options}")
    model = find_model("modbus-columns").at(address)
    with closing(open_link(address, model, lines)) as link:
        yield model.driver(link, VirtualClock())


@pytest.mark.parametrize("code", ["05", "06"])
def test_a_busy_unit_is_asked_again_and_for_five_seconds_at_most(code: str) -> None:
    """Modbus Application Protocol V1.1b3, 7: after exceptions 5 and 6 the same request is to be sent later."""
    model = find_model("modbus-columns").at(parse_address("modbus:///dev/null?columns=x@0"))
    ask, busy, clock = "03 0000 0001 /", f"03 0000 0001 / 83 {code}", VirtualClock()
    script = Script("m", clock, busy, busy, busy, f"{ask} 03 02 0007", f"{ask} 83 02")
    sensor = model.driver(script, clock)
    assert sensor.read().values == (7.0,)
    assert min(script.rests[1:4]) >= 0.1
    assert script.times[3] <= 1.0
    with pytest.raises(DeviceFault, match="it has no such register"):
        sensor.read()
    script.close()
    clock = VirtualClock()
    with pytest.raises(DeviceFault, match=r"refuses to read 1 registers from 0: it (is busy|needs more time)"):
        model.driver(Script("m", clock, *[busy] * 1000), clock).read()
    assert 3.0 <= clock.now_ns() / 1e9 <= 6.0


def test_registers_are_written_one_or_several() -> None:
    """Modbus Application Protocol V1.1b3, 6.6 and 6.12: functions 6 and 16; -12.5 is c148 0000 by IEEE 754."""
    model = find_model("modbus-columns").at(parse_address("modbus:///dev/null?columns=x@100:int16*0.1,y@200:float32"))
    script = Script("m", VirtualClock(), "06 0064 ff85 / 06", "10 00c8 c148 0000 / 10", "06 0064 0001 / 86 02")
    unit = model.driver(script, VirtualClock())
    unit.write("x", -12.3)
    unit.write("y", -12.5)
    with pytest.raises(DeviceFault, match=r"x = 4000 does not fit the type of register 100"):
        unit.write("x", 4000.0)
    with pytest.raises(DeviceFault, match="refuses to write x to register 100: it has no such register"):
        unit.write("x", 0.1)
    script.close()


def test_a_unit_that_refuses_or_is_silent_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(modbus, "SILENCE", 0.1)
    with serial_line(by_the_letter) as place:
        for options, error, why in (
            ("unit=7&columns=x@500", DeviceFault, "no such register"),
            ("unit=8&timeout=0.05&columns=x@0", BusError, "no answer of unit 8"),
        ):
            with pytest.raises(error, match=why), unit(place, options) as sensor:
                sensor.read()


def test_units_on_one_line_share_its_port() -> None:
    lines: dict = {}
    with serial_line(by_the_letter) as place:
        with (
            unit(place, "unit=7&columns=x@0*0.001,temperature@4*0.1", lines) as first,
            unit(place, "unit=7&columns=x@1", lines) as other,
        ):
            assert first.probe() == {"x": "-0.5", "temperature": "23.5 °C"}
            for _ in range(2):
                first._link.close()
                assert (first.read().values, other.read().values) == ((-0.5,), (250.0,))
        with (
            pytest.raises(UsageError, match=r"another unit on /dev/.* has another baudrate"),
            unit(place, "unit=8&baudrate=19200&columns=x@0", lines),
        ):
            pass


@contextmanager
def serial_line(answer: Answer) -> Iterator[str]:
    """Yield the place of a serial line with units on it."""
    master, end = os.openpty()
    tty.setraw(end)

    def serve() -> None:
        count = 0
        while True:
            try:
                request = os.read(master, 8)
            except OSError:
                return  # the line is cut
            count += 1
            for delay, frame in answer(request[:-2], count):
                time.sleep(delay)
                os.write(master, frame + crc16(frame))

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield os.ttyname(end)
    finally:
        os.close(end)
        thread.join(10.0)
        os.close(master)


def crc16(frame: bytes) -> bytes:
    """CRC of Modbus over serial line, V1.02, 6.2.2: 0xA001 reflected, start 0xFFFF, low byte first (02 07: 41 12)."""
    crc = 0xFFFF
    for byte in frame:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ 0xA001 if crc & 1 else crc >> 1
    return crc.to_bytes(2, "little")


def frame_of(unit: int, value: int) -> bytes:
    return bytes([unit, 3, 2]) + value.to_bytes(2, "big")


def test_a_late_answer_is_never_that_of_another_register(monkeypatch: pytest.MonkeyPatch) -> None:
    """x in register 0 is 111 and y in register 9 is 222; x answers once in time, once late, while nothing else may."""
    monkeypatch.setattr(modbus, "SILENCE", 0.3)

    def answer(request: bytes, count: int) -> list[tuple[float, bytes]]:
        late = frame_of(1, {0: 111, 9: 222}[request[3]])
        return [(0.22, late), (0.1, late)] if count == 3 else [(0.0, late)]

    lines: dict = {}
    with (
        serial_line(answer) as place,
        unit(place, "unit=1&timeout=0.15&columns=x@0,y@9", lines) as both,
        unit(place, "unit=1&timeout=0.15&columns=y@9", lines) as other,
    ):
        for _ in range(2):
            assert both.read().values == (111.0, 222.0)
            assert other.read().values == (222.0,)


def test_a_line_is_awaited_until_it_is_silent_for_three_seconds() -> None:
    """Half a second without a byte each; a line on which twenty pieces come is never silent."""
    for heard, pieces in (("", 6), ("......", 6), ("x", 7), (".....x", 12), ("x" * 19, 25), ("x" * 20, 20)):
        arriving, asked = iter(heard), list[object]()

        def recv(size: object, arriving: Iterator[str] = arriving, asked: list[object] = asked) -> bytes:
            asked.append(size)
            return b"x" if next(arriving, ".") == "x" else b""

        client = SimpleNamespace(comm_params=SimpleNamespace(timeout_connect=0.5), recv=recv)
        with pytest.raises(BusError, match="port is never silent") if pieces == 20 else nullcontext():
            modbus.ModbusLine("port", client).await_silence()
        assert len(asked) == pieces


def test_an_answer_of_another_function_or_length_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(modbus, "SILENCE", 0.1)
    frames = [bytes.fromhex("01 04 02 0001"), bytes.fromhex("01 03 04 0001 0002"), frame_of(1, 333)]
    with (
        serial_line(lambda _, count: [(0.0, frames[count - 1])]) as place,
        unit(place, "unit=1&timeout=0.1&columns=x@0") as sensor,
    ):
        with pytest.raises(BusError, match=r"no answer of unit 1 .* answers within timeout="):
            sensor.read()
        assert sensor.read().values == (333.0,)

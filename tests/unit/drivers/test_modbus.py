"""``modbus-columns``: registers of the address, through pymodbus against its own server, RTU and TCP."""

from __future__ import annotations

import os
import struct
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from tiltcal.drivers import find_model
from tiltcal.drivers.bus import link_letter, modbus, open_link
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.device import Model, Sensor
from tiltcal.drivers.twin.fixture import Fixture
from tiltcal.drivers.twin.truth import Fault
from tiltcal.errors import BusError, DeviceFault, UsageError

pytest.importorskip("pymodbus", reason="the pymodbus package is not installed")

from pymodbus.simulator import DataType, SimData
from support.modbus_slave import slave

ANYWHERE = "tcp://127.0.0.1:502"


def at(options: str, place: str = ANYWHERE) -> tuple[Model, str]:
    written = f"modbus:{place}?{options}"
    return find_model("modbus-columns").at(parse_address(written)), written


def scripted(options: str, **answers: str) -> Sensor:
    """A driver whose requests, in hexadecimal, have these answers."""

    class Link:
        letter = "m"

        def exchange(self, out: bytes, count: int = 0) -> bytes:
            return bytes.fromhex(answers["r" + out.hex()])

    return at(options)[0].driver(Link(), VirtualClock())


def test_the_address_names_registers_types_factors_and_order() -> None:
    model, _ = at("columns=y@1,x@0:int16*0.001,temperature@0x10:uint16*0.1&measured_in=g&sensitivity=1&rate=4")
    assert (model.channels, model.thermometer, model.unit, model.interval) == (("x", "y"), True, "g", 0.25)
    sensor = scripted(
        "columns=y@1,x@0:int16*0.001,temperature@0x10:uint16*0.1",
        r0300000002="03 04 FE0C 0007",
        r0300100001="03 02 00EB",
    )
    assert sensor.read().values == pytest.approx((-0.5, 7.0))
    assert sensor.read().temperature == pytest.approx(23.5)
    assert sensor.read().step == 0.001


def test_a_column_that_is_skipped_is_no_reading() -> None:
    """As in ``serial-columns``; its registers are not asked for."""
    columns = "columns=-@0,x@1,-@2:float32,y@4"
    assert at(columns)[0].channels == ("x", "y")
    sensor = scripted(columns, r0300010001="03 02 0007", r0300040001="03 02 0009")
    assert sensor.read().values == (7.0, 9.0)
    assert not at(columns)[0].thermometer
    assert find_model("modbus-columns").at(parse_address(f"sim:{columns}")).channels == ("x", "y")


@pytest.mark.parametrize(
    ("order", "registers"),
    [("abcd", "3F00 0000"), ("cdab", "0000 3F00"), ("badc", "003F 0000"), ("dcba", "0000 003F")],
)
def test_a_half_in_every_order(order: str, registers: str) -> None:
    """0.5 is 3F 00 00 00 as a float of four bytes (IEEE 754)."""
    sensor = scripted(f"columns=x@8:float32&order={order}&table=input", r0400080002=f"04 04 {registers}")
    assert sensor.read().values == (0.5,)


@pytest.mark.parametrize(
    ("word", "code", "number"),
    [
        ("int16", "h", -12345),
        ("uint16", "H", 54321),
        ("int32", "i", -123456789),
        ("uint32", "I", 4000000000),
        ("float32", "f", -1.5),
        ("int64", "q", -(2**40)),
        ("float64", "d", 0.1),
    ],
)
def test_every_type(word: str, code: str, number: float) -> None:
    data = struct.pack(f">{code}", number)
    request = f"r030000{len(data) // 2:04x}"
    sensor = scripted(f"columns=x@0:{word}", **{request: f"03 {len(data):02x} {data.hex()}"})
    assert (sensor.read().values, sensor.read().step) == ((number,), 0.0 if word.startswith("float") else 1.0)


def test_registers_without_a_gap_are_one_request() -> None:
    model, _ = at("columns=x@0:float32,y@2:float32,temperature@100:int16,z@4")
    requests = [request.hex() for request in model.driver(None, VirtualClock())._layout.requests]
    assert requests == ["0300000005", "0300640001"]


@pytest.mark.parametrize(
    ("answer", "error", "why"),
    [
        ("83 02", DeviceFault, "refuses to read 2 registers from 0: it has no such register"),
        ("83 0B", DeviceFault, "the gateway got no answer from it"),
        ("83 FF", DeviceFault, "exception 255"),
        ("03 04 7FC0 0000", DeviceFault, "x is nan: the device has no reading"),
        ("03 02 0000", BusError, "2 registers were answered with 2 bytes"),
    ],
)
def test_what_is_no_number_is_no_reading(answer: str, error: type[Exception], why: str) -> None:
    with pytest.raises(error, match=why):
        scripted("columns=x@0:float32", r0300000002=answer).read()


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ("columns=x", "column 'x' is not of the form name@register:type.factor"),
        ("columns=x@0:int8", "type 'int8' of column x is not one of int16"),
        ("columns=x@0*0", "factor '0' of column x is no number other than 0"),
        ("columns=x@0*1e", "factor '1e' of column x"),
        ("columns=x@" + "9" * 5000, "is not of the form name@register"),
        ("columns=x@65535:float32", "register 65535 of column x is beyond 65535"),
        ("columns=x@0,x@1", "names 'x' twice"),
        ("columns=temperature@0", "names no reading"),
        ("columns=x@0&order=acbd", "order=acbd is not one of abcd, cdab, badc, dcba"),
        ("columns=x@0&table=coils", "table=coils is not one of holding, input"),
        ("", "option 'columns' is missing"),
    ],
)
def test_a_wrong_option_is_refused(options: str, why: str) -> None:
    with pytest.raises(UsageError, match=why):
        at(options)


# Against pymodbus' own server


BLOCKS = [
    SimData(0, values=[-500, 250], datatype=DataType.INT16),
    SimData(4, values=[235], datatype=DataType.INT16),
    SimData(10, values=[0.125, -0.75], datatype=DataType.FLOAT32),
]


@pytest.mark.parametrize("rtu", [False, True], ids=["tcp", "rtu"])
def test_a_simulated_slave_is_read(rtu: bool) -> None:
    with slave(7, BLOCKS, rtu=rtu) as place:
        bracketed = place.replace("127.0.0.1", "[127.0.0.1]")  # as an IPv6 address is written
        model, written = at("unit=7&columns=x@0*0.001,y@10:float32,z@12:float32,temperature@4*0.1", bracketed)
        link = open_link(parse_address(written), model)
        sensor = model.driver(link, VirtualClock())
        assert sensor.probe() == {"x": "-0.5", "y": "0.125", "z": "-0.75", "temperature": "23.5 °C"}
        reading = sensor.read()
        assert (reading.values, reading.temperature) == ((-0.5, 0.125, -0.75), 23.5)
        assert link.letter == "m" == link_letter(parse_address(written), model)
        link.close()
        link.close()


def test_devices_on_one_line_share_its_port() -> None:
    with slave(7, BLOCKS, rtu=True) as place:
        model, written = at("unit=7&columns=x@0*0.001", place)
        other, written_too = at("unit=7&columns=x@10:float32", place)
        lines: dict = {}
        first, second = (
            open_link(parse_address(one), which, lines) for one, which in ((written, model), (written_too, other))
        )
        for _ in range(2):
            first.close()
            assert model.driver(first, VirtualClock()).read().values == (-0.5,)
            assert other.driver(second, VirtualClock()).read().values == (0.125,)
        _, contrary = at("unit=8&baudrate=19200&columns=x@0", place)
        with pytest.raises(UsageError, match=r"another unit on /dev/.* has another baudrate"):
            open_link(parse_address(contrary), model, lines)
        first.close()
        second.close()


# Against a slave whose answers come when the test says


@pytest.fixture
def soon_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    """A line that counts as silent after 0.3 s in place of three."""
    monkeypatch.setattr(modbus, "SILENCE", 0.3)


@contextmanager
def late_slave(answer: Callable[[bytes, int], list[tuple[float, bytes]]]) -> Iterator[str]:
    """Yield a serial line on which the n-th request is answered by these frames, each after a delay in seconds.

    Frames have no checksum here; it is added by the polynomial of the protocol's specification.
    """
    master, end = os.openpty()
    tty.setraw(end)

    def serve() -> None:
        count = 0
        while request := received(master):
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


def received(master: int) -> bytes:
    """Return the next request; nothing when the line is cut."""
    try:
        return os.read(master, 8)
    except OSError:
        return b""


def crc16(frame: bytes) -> bytes:
    """CRC of Modbus over serial line, V1.02, 6.2.2: 0xA001 reflected, start 0xFFFF, low byte first."""
    crc = 0xFFFF
    for byte in frame:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ 0xA001 if crc & 1 else crc >> 1
    return crc.to_bytes(2, "little")


def frame_of(unit: int, value: int) -> bytes:
    return bytes([unit, 3, 2]) + value.to_bytes(2, "big")


def test_crc_of_the_specification() -> None:
    """The example of Modbus over serial line, figure 31: device 2, function 7 has the CRC 0x1241, low byte first."""
    assert crc16(bytes.fromhex("02 07")) == bytes.fromhex("41 12")


@pytest.mark.usefixtures("soon_silent")
def test_a_late_answer_is_never_that_of_another_register() -> None:
    """x in register 0 is 111 and y in register 9 is 222; the first request is answered three time-outs late."""

    def answer(request: bytes, count: int) -> list[tuple[float, bytes]]:
        if count == 1:
            return []
        own = frame_of(1, {0: 111, 9: 222}[request[3]])
        # The answer to the repetition, and later that to the first request, which was for x.
        return [(0.0, own), (0.15, own)] if count == 2 else [(0.0, own)]

    with late_slave(answer) as place:
        model, written = at("unit=1&timeout=0.05&columns=x@0,y@9", place)
        with closing(open_link(parse_address(written), model)) as link:
            sensor = model.driver(link, VirtualClock())
            assert [sensor.read().values for _ in range(2)] == [(111.0, 222.0)] * 2


@pytest.mark.usefixtures("soon_silent")
def test_a_late_answer_is_never_that_of_another_link() -> None:
    """After an error the link is opened anew, and the answers to the three requests before are still to come."""

    def answer(request: bytes, count: int) -> list[tuple[float, bytes]]:
        late = frame_of(1, 111)
        return {3: [(0.22, late), (0.1, late), (0.1, late)]}.get(count, [(0.0, frame_of(1, 222))] if count > 3 else [])

    with late_slave(answer) as place:
        lines: dict = {}
        first, written = at("unit=1&timeout=0.15&columns=x@0", place)
        second, written_too = at("unit=1&timeout=0.15&columns=x@9", place)
        with (
            closing(open_link(parse_address(written), first, lines)) as link,
            pytest.raises(BusError, match=r"no answer of unit 1 .* answers within timeout="),
        ):
            first.driver(link, VirtualClock()).read()
        with closing(open_link(parse_address(written_too), second, lines)) as link:
            assert second.driver(link, VirtualClock()).read().values == (222.0,)


def test_a_dead_unit_does_not_silence_the_line_for_another() -> None:
    """Unit 2 is read at once, although a late answer of unit 1 comes before its first one."""

    def answer(request: bytes, count: int) -> list[tuple[float, bytes]]:
        late = [(0.0, frame_of(1, 111))] if count == 4 else []
        return [*late, (0.0, frame_of(2, 222))] if request[0] == 2 else []

    with late_slave(answer) as place:
        lines: dict = {}
        model, written = at("unit=1&timeout=0.05&columns=x@0", place)
        other, written_too = at("unit=2&timeout=0.05&columns=x@9", place)
        with (
            closing(open_link(parse_address(written), model, lines)) as first,
            closing(open_link(parse_address(written_too), other, lines)) as second,
        ):
            with pytest.raises(BusError, match="no answer of unit 1"):
                model.driver(first, VirtualClock()).read()
            begun = time.monotonic()
            assert other.driver(second, VirtualClock()).read().values == (222.0,)
            assert time.monotonic() - begun < modbus.SILENCE


def test_an_answer_of_another_function_or_length_is_none() -> None:
    def answer(request: bytes, count: int) -> list[tuple[float, bytes]]:
        wrong = [bytes.fromhex("01 04 02 0001"), bytes.fromhex("01 03 04 0001 0002")]
        return [(0.0, wrong[count - 1] if count < 3 else frame_of(1, 333))]

    with late_slave(answer) as place:
        model, written = at("unit=1&timeout=0.1&columns=x@0", place)
        with closing(open_link(parse_address(written), model)) as link:
            assert model.driver(link, VirtualClock()).read().values == (333.0,)


def test_a_register_that_the_slave_lacks_and_a_unit_that_is_not_there() -> None:
    with slave(7, BLOCKS, rtu=True) as place:
        for options, error, why in (
            ("unit=7&columns=x@500", DeviceFault, "no such register"),
            ("unit=8&timeout=0.05&columns=x@0", (BusError, DeviceFault), "unit 8|refuses"),
        ):
            model, written = at(options, place)
            link = open_link(parse_address(written), model)
            with pytest.raises(error, match=why):
                model.driver(link, VirtualClock()).read()
            link.close()


def test_a_server_that_has_ended_is_named() -> None:
    with slave(1, BLOCKS, rtu=False) as place:
        model, written = at("unit=1&timeout=0.1&columns=x@0", place)
        link = open_link(parse_address(written), model)
        sensor = model.driver(link, VirtualClock())
        sensor.read()
        link.close()
    with pytest.raises(BusError, match="no Modbus server answers at tcp://"):
        sensor.read()


def test_nobody_at_the_other_end() -> None:
    model, written = at("columns=x@0&timeout=0.1", "tcp://127.0.0.1:1")
    with pytest.raises(BusError, match=r"no Modbus server answers at tcp://127.0.0.1:1"):
        open_link(parse_address(written), model)
    for place in ("tcp://[::1]:1", "tcp://a..b:1", f"tcp://{'a' * 64}:1"):
        model, written = at("columns=x@0&timeout=0.1", place)
        with pytest.raises(BusError, match=r"no Modbus server answers at tcp://"):
            open_link(parse_address(written), model)
    model, written = at("columns=x@0", "/dev/ttyNONE")
    with pytest.raises(BusError, match=r"/dev/ttyNONE does not exist"):
        open_link(parse_address(written), model)


@pytest.mark.parametrize(
    ("place", "options", "why"),
    [
        ("tcp://host:99999", "columns=x@0", "'99999' is no port number"),
        ("tcp://host:²", "columns=x@0", "'²' is no port number"),
        ("tcp://host:" + "9" * 5000, "columns=x@0", "'99999999999999999999' is no port number"),
        ("tcp://:502", "columns=x@0", "names no host"),
        ("tcp://host:502", "columns=x@0&baudrate=9600", "unknown option 'baudrate'"),
        ("/dev/ttyUSB0", "columns=x@0&unit=300", "unit=300 is too large"),
        ("/dev/ttyUSB0", "columns=x@0&parity=Q", "parity=Q is not one of N, E, O"),
    ],
)
def test_a_wrong_place_is_refused(place: str, options: str, why: str) -> None:
    model, written = at(options, place)
    with pytest.raises(UsageError, match=why):
        open_link(parse_address(written), model)


def test_only_handlers_that_open_a_line_and_nothing_else_are_used(tmp_path: Path) -> None:
    """pyserial's spy:// opens any file for writing before anything is known of the port."""
    kept = tmp_path / "kept"
    kept.write_text("mine")
    model, written = at("columns=x@0", f"spy://loop://%3Ffile={kept}")
    with pytest.raises(UsageError, match="spy:// cannot be used: name a port, or socket://"):
        open_link(parse_address(written), model)
    assert kept.read_text() == "mine"


# The twin


@pytest.mark.parametrize("order", ["abcd", "dcba"])
def test_the_twin_answers_the_columns_of_the_address(order: str) -> None:
    options = f"columns=x@0:float64,y@9:int32*1e-6,temperature@4:int16*0.1&order={order}"
    model = find_model("modbus-columns").at(parse_address(f"sim:{options}"))
    clock = VirtualClock()
    truth = replace(model.default_truth(3), noise={}, faults=(Fault("silent", 1.0, 2.0),))
    sensor = model.driver(model.twin(truth, Fixture(clock, ambient=20.04), clock), clock)
    reading = sensor.read()
    expected = [truth.reading(channel, (0.0, 0.0, 1.0), 20.04) for channel in "xy"]
    assert reading.values == pytest.approx(expected, abs=6e-7)
    assert reading.temperature == pytest.approx(20.0)
    clock.seek(1_000_000_000)
    with pytest.raises(BusError, match="does not answer"):
        sensor.read()

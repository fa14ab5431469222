"""The SCL3300 and SCA3300 against the frames of the fact sheet, their twin, and a part written apart from both."""

from __future__ import annotations

from dataclasses import asdict, replace

import pytest
from support.emulated.bench import Scl3300 as PartFacts
from support.scl3300_part import ALLOWED, Scl3300Part

from tiltcal.drivers import find_model
from tiltcal.drivers import scl3300_frames as frames
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.device import Model, Sensor
from tiltcal.drivers.scl3300_frames import crc8, decode, decode_temperature
from tiltcal.drivers.twin.fixture import Fixture
from tiltcal.drivers.twin.truth import Fault, Truth
from tiltcal.errors import BusError, DeviceFault, UsageError

SCL, SCA = find_model("scl3300"), find_model("sca3300-d01")
IDENTITIES = {"scl3300": 0xC1, "sca3300-d01": 0x51}


def at(name: str, options: str) -> Model:
    return find_model(name).at(parse_address(f"spi:///dev/spidev0.0?{options}"))


# Frames


@pytest.mark.parametrize("request_frame", sorted(ALLOWED))
def test_the_requests_of_the_data_sheet_have_our_crc(request_frame: str) -> None:
    frame = bytes.fromhex(request_frame)
    assert crc8(frame[:3]) == frame[3]


def test_the_driver_has_no_other_frames() -> None:
    ours = {value.hex().upper() for value in vars(frames).values() if isinstance(value, bytes)}
    assert ours | {mode.hex().upper() for mode in frames.MODES} <= ALLOWED


@pytest.mark.parametrize(
    ("frame", "status", "data"),
    [
        ("0500DC1C", 1, 220),
        ("0517706C", 1, 6000),
        ("05E8909F", 1, -6000),
        ("0904B033", 1, 1200),
        ("0D2EE05C", 1, 12000),
        ("0DFFFFF1", 1, -1),
        ("050A8C00", 1, 2700),
        ("05EAE8B6", 1, -5400),
        ("05FFE6C5", 1, -26),
        ("09008DD5", 1, 141),
        ("0D2E70B7", 1, 11888),
        ("2520003D", 1, 8192),
        ("29EAABB8", 1, -5461),
        ("2D4000AE", 1, 16384),
        ("1100017B", 1, 1),
        ("1107096A", 1, 1801),
        ("4100C136", 1, 0xC1),
        ("410051DD", 1, 0x51),
        ("FD0001E1", 1, 1),
        ("65F7DA19", 1, 0xF7DA - 0x10000),
        ("693CE54F", 1, 0x3CE5),
        ("1B00129E", 3, 0x12),
        ("1900129D", 1, 0x12),
        ("1900006A", 1, 0),
        ("1B00407A", 3, 0x40),
        ("19004079", 1, 0x40),
        ("0717706F", 3, 6000),
        ("040000F7", 0, 0),
    ],
)
def test_answers_of_the_fact_sheet(frame: str, status: int, data: int) -> None:
    answer = decode(bytes.fromhex(frame))
    assert (answer.intact, answer.status, answer.signed) == (True, status, data)
    assert answer.operation == int(frame[:2], 16) >> 2


@pytest.mark.parametrize(
    ("frame", "celsius"), [("15161E0A", 26.58), ("151614D8", 26.05), ("15160061", 24.99), ("151134A6", -39.98)]
)
def test_temperatures_of_the_fact_sheet(frame: str, celsius: float) -> None:
    assert decode_temperature(decode(bytes.fromhex(frame)).signed) == pytest.approx(celsius, abs=0.005)


@pytest.mark.parametrize("frame", ["0517706C", "1B00129E", "4100C136", "00000000", "FFFFFFFF"])
def test_no_single_bit_error_passes(frame: str) -> None:
    whole = int(frame, 16)
    good = decode(whole.to_bytes(4, "big")).intact
    assert good is (frame not in ("00000000", "FFFFFFFF"))
    if good:
        assert not any(decode((whole ^ 1 << bit).to_bytes(4, "big")).intact for bit in range(32))


# Ranges


@pytest.mark.parametrize(
    ("name", "word", "counts_per_g", "interval"),
    [
        ("scl3300", "", 6000, 0.0125),
        ("scl3300", "range=1.2g", 6000, 0.0125),
        ("scl3300", "range=2.4", 3000, 1 / 140),
        ("scl3300", "range=inclination", 12000, 0.05),
        ("scl3300", "range=low-noise", 12000, 0.05),
        ("scl3300", "range=mode4", 12000, 0.05),
        ("sca3300-d01", "", 2700, 1 / 140),
        ("sca3300-d01", "range=6", 1350, 1 / 140),
        ("sca3300-d01", "range=1.5g", 5400, 1 / 140),
        ("sca3300-d01", "range=1.5g-10hz", 5400, 0.05),
    ],
)
def test_the_range_decides_the_scale(name: str, word: str, counts_per_g: float, interval: float) -> None:
    model = at(name, word)
    assert (model.sensitivity, model.interval) == (counts_per_g, pytest.approx(interval))


def test_the_spi_mode_is_no_range() -> None:
    with pytest.raises(UsageError, match=r"range=3 is not one of 1.2g, 2.4g, inclination, low-noise, mode1"):
        at("scl3300", "range=3")


# The driver and a part


class PartLink:
    """The independent part as a link, 20 µs to a frame."""

    letter = "s"

    def __init__(self, clock: VirtualClock, **changes: object) -> None:
        facts = asdict(replace(PartFacts(), jig=0.0, **changes))
        self.clock = clock
        self.part = Scl3300Part(**facts)
        self.out: list[bytes] = []

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        self.clock.sleep(20e-6)
        self.out.append(out)
        return self.part.transfer(out, self.clock.now_ns(), self.clock.now_ns())

    def close(self) -> None:
        assert self.part.counts["forbidden"] == 0


def bench(model: Model, **changes: object) -> tuple[Sensor, PartLink]:
    clock = VirtualClock()
    clock.sleep(1.0)
    link = PartLink(clock, **{"identity": IDENTITIES[model.name], "noise": 0.0, **changes})
    return model.driver(link, clock), link


def expected(link: PartLink, model: Model) -> tuple[float, ...]:
    return tuple(float(round(one * model.sensitivity)) for one in link.part.measured(link.clock.now_ns()))


@pytest.mark.parametrize(
    "model",
    [SCL, at("scl3300", "range=2.4g"), at("scl3300", "range=mode3"), SCA, at("sca3300-d01", "range=1.5g-10hz")],
    ids=lambda model: model.title,
)
def test_every_range_reads_what_the_part_measures(model: Model) -> None:
    sensor, link = bench(model)
    for gravity in ([0.6, 0.0, -0.8], [-0.36, 0.48, 0.8]):
        link.part.pose(gravity, 31.0)
        reading = sensor.read()
        assert reading.values == expected(link, model)
        assert reading.temperature == pytest.approx(31.0, abs=0.5 / 18.9)
    link.close()


def test_the_start_up_is_that_of_the_data_sheet() -> None:
    sensor, link = bench(at("scl3300", "range=mode3"))
    sensor.read()
    sent = " ".join(frame.hex().upper() for frame in link.out)
    start = "B4002098 B4000225 180000E5 180000E5 180000E5 40000091 40000091"
    assert sent == f"{start} 040000F7 080000FD 0C0000FB 140000EF 040000F7"
    link.out.clear()
    sensor.read()
    assert len(link.out) == 5, "the part is set up once"


def test_probe_says_which_part_it_is() -> None:
    sensor, link = bench(SCL)
    said = dict(sensor.probe())
    assert (said["part"], said["serial"]) == ("SCL3300-D01", "1021704154B33")
    assert said["range"] == "±1.2 g (mode 1), 6000 count/g, 40 Hz"
    sensor.read()
    assert link.part.bank == 0, "in bank 1 it has no reset"
    link.close()


@pytest.mark.parametrize("model", [SCL, at("scl3300", "range=mode3")], ids=["mode 1", "mode 3"])
@pytest.mark.parametrize("left", [{"bank": 1}, {"asleep": True}], ids=["bank 1", "power-down"])
def test_a_part_that_another_program_left_otherwise_is_set_up(model: Model, left: dict[str, object]) -> None:
    """DS-33, table 15: reset, mode and WHOAMI are in bank 0 alone, acceleration in both."""
    sensor, link = bench(model)
    vars(link.part).update(left)
    assert sensor.read().values == expected(link, model)
    link.close()


def test_the_wrong_sibling_is_named() -> None:
    sensor, _ = bench(SCL, identity=0x51)
    with pytest.raises(DeviceFault, match=r"WHOAMI reads 0x51.* the part is an SCA3300-D01: name it with --sensor"):
        sensor.read()


def test_no_damaged_frame_becomes_a_reading_and_all_are_counted() -> None:
    """One bit in one frame of fifty, in either direction; the truth is constant, so a wrong word is seen."""
    sensor, link = bench(SCL, damage=0.02)
    values = {sensor.read().values for _ in range(3000)}
    counted = dict(sensor.link_statistics())
    assert values == {expected(link, SCL)}
    part = link.part.counts
    assert (counted["samples"], counted["restarts"], counted["out of step"]) == (3000, 0, 0)
    # A request that is damaged during the start, or in the last frame, is not told from the flags of the start.
    assert counted["damaged"] == part["answers_damaged"] > 120
    assert 0.9 * part["requests_damaged"] <= counted["refused"] <= part["requests_damaged"]
    link.close()


def test_a_line_that_damages_a_tenth_of_the_frames_makes_no_fault() -> None:
    """A damaged request of STATUS is answered with any data, taken for flags: of 8000 samples 16 were faults."""
    values = set()
    for seed in range(10):
        sensor, link = bench(SCL, damage=0.1, seed=seed)
        values |= {sensor.read().values for _ in range(200)}
        assert sensor.link_statistics()["restarts"] == 0
    assert values == {expected(link, SCL)}


@pytest.mark.parametrize("place", range(3))
def test_a_fault_that_stays_is_told_over_a_damaged_status(place: int) -> None:
    """Of three answers to STATUS one is damaged; the other two have the same flags, with an error."""
    sensor, link = bench(SCL)
    sensor.read()
    link.part.broken = True
    plain, asked = link.part.transfer, []

    def transfer(out: bytes, start_ns: int, end_ns: int) -> bytes:
        answer = plain(out, start_ns, end_ns)
        asked.append(out == frames.STATUS)
        return b"\x00" * 4 if asked.count(True) == 2 + place else answer

    link.part.transfer = transfer
    with pytest.raises(DeviceFault, match="reports a fault: memory"):
        sensor.read()


def test_a_reset_in_mid_session_is_told_and_the_part_is_set_up_anew() -> None:
    """Where the line damages its status it is set up anew all the same, and what it reads is right."""
    model = at("scl3300", "range=mode4")
    sensor, link = bench(model, damage=0.02)
    told = 0
    for _ in range(100):
        assert sensor.read().values == expected(link, model)
        link.part.restart()
        # Until it has started it cannot be spoken to; between two samples a bench waits longer than this.
        link.clock.sleep(0.005)
        try:
            assert sensor.read().values == expected(link, model)
        except DeviceFault as fault:
            told += "was reset or its supply failed" in str(fault)
    assert sensor.link_statistics()["restarts"] == told >= 95


@pytest.mark.parametrize("after", range(5))
def test_a_reset_within_a_sample_is_no_reading(after: int) -> None:
    """Whichever frame of the five it comes before: told, or the sample was complete before it."""
    model = at("scl3300", "range=mode4")
    sensor, link = bench(model)
    truth = sensor.read().values
    plain = link.part.transfer

    def transfer(out: bytes, start_ns: int, end_ns: int) -> bytes:
        if len(link.out) == 1 + after:
            link.part.restart()
            link.part.ready_ns = 0
        return plain(out, start_ns, end_ns)

    link.out.clear()
    link.part.transfer = transfer
    with pytest.raises((DeviceFault, BusError)):
        sensor.read()
    link.part.transfer = plain
    assert sensor.read().values == truth


def test_a_fault_of_the_part_is_told_in_words() -> None:
    sensor, link = bench(SCL)
    sensor.read()
    link.part.broken = True
    with pytest.raises(DeviceFault, match=r"reports a fault: memory \(MEM\)"):
        sensor.read()
    with pytest.raises(DeviceFault, match=r"a fault that its start does not clear: memory \(MEM\).* replace the part"):
        sensor.read()


class Wire:
    """A link of wires alone."""

    letter = "s"

    def __init__(self, answer) -> None:
        self.exchange = lambda out, count=0: answer(out)


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        (lambda out: out, "MISO is connected to MOSI"),
        (lambda out: b"\xff" * 4, "stuck high"),
        (lambda out: bytes(4), "stuck low"),
        (lambda out: out[:2], "a frame of 4 bytes was answered with 2"),
    ],
)
def test_wires_are_no_part(answer, why: str) -> None:
    sensor = SCL.driver(Wire(answer), VirtualClock())
    with pytest.raises(BusError, match=why):
        sensor.read()


def test_noise_on_the_line_is_no_reading() -> None:
    """Random frames: one in 256 has a CRC that fits, and then its operation, status and four neighbours do not."""
    import random

    chance = random.Random(4)
    sensor = SCL.driver(Wire(lambda out: chance.randbytes(4)), VirtualClock())
    for _ in range(20):
        with pytest.raises((BusError, DeviceFault)):
            sensor.read()
    assert sensor.link_statistics()["samples"] == 0


# The twin


def truth_of(model: Model, **changes: object) -> Truth:
    """Reads -26, 141, 11888 whatever its pose, as the captured part did, at 26.05 °C."""
    truth = Truth(
        channels=("x", "y", "z"),
        offset={"x": -26.0, "y": 141.0, "z": 11888.0},
        sensitivity={channel: {channel: 1e-9} for channel in "xyz"},
        ambient=5652 / 18.9 - 273,
    )
    return replace(truth, **changes)


def twin_of(model: Model, truth: Truth, clock: VirtualClock):
    return model.twin(truth, Fixture(clock, ambient=truth.ambient), clock)


def test_the_twin_answers_the_captured_start_up_byte_for_byte() -> None:
    model = at("scl3300", "range=mode3")
    twin = twin_of(model, truth_of(model), VirtualClock())
    requests = "B4002098 B4000225 B0001F6F 180000E5 180000E5 180000E5 40000091 FC000073 040000F7 080000FD 0C0000FB"
    answers = "0300007D 0300007D B70002A9 B3001FE3 1B00129E 1900129D 1900006A 4100C136 FD0000FC 05FFE6C5 09008DD5"
    requests += " 140000EF FC00016E 040000F7"
    answers += " 0D2E70B7 151614D8 FD0001E1"
    sent = [twin.exchange(bytes.fromhex(request)).hex().upper() for request in requests.split()]
    assert sent == answers.split()


def test_the_twin_computes_the_captured_angles() -> None:
    """The capture's own angles, in 16384 to 90°: they are of the moment after its accelerations, so one count apart."""
    model = at("scl3300", "range=mode3")
    twin = twin_of(model, truth_of(model), VirtualClock())
    requests = "B4000225 B0001F6F 240000C7 280000CD 2C0000CB 040000F7"
    sent = [decode(twin.exchange(bytes.fromhex(request))).signed for request in requests.split()]
    captured = [decode(bytes.fromhex(frame)).signed for frame in ("25FFE94E", "29007BD4", "2D3F811D")]
    assert sent[-3:] == pytest.approx(captured, abs=1)


def test_the_twin_refuses_a_damaged_request_with_a_clean_status() -> None:
    twin = twin_of(SCL, truth_of(SCL), VirtualClock())
    for frame in frames.MODES[:1] + (frames.STATUS,) * 4:
        twin.exchange(frame)
    twin.exchange(bytes(4))
    assert decode(twin.exchange(frames.STATUS)).status == frames.ERROR
    assert twin.exchange(frames.STATUS) == bytes.fromhex("1900006A")


def test_the_twin_agrees_with_the_part_that_was_written_apart_from_it() -> None:
    for model in (SCL, at("scl3300", "range=2.4g"), at("sca3300-d01", "range=mode4")):
        other, link = bench(model)
        link.part.pose([0.48, -0.6, 0.64], -12.0)
        facts = PartFacts()
        truth = Truth(
            channels=("x", "y", "z"),
            offset={c: model.sensitivity * one for c, one in zip("xyz", facts.offset, strict=True)},
            sensitivity={
                c: {axis: model.sensitivity * one for axis, one in zip("xyz", row, strict=True)}
                for c, row in zip("xyz", facts.sensitivity, strict=True)
            },
            ambient=-12.0,
        )
        clock = VirtualClock()
        fixture = Fixture(clock, ambient=-12.0)
        fixture.gravity = (0.48, -0.6, 0.64)
        ours, theirs = model.driver(model.twin(truth, fixture, clock), clock).read(), other.read()
        assert ours.values == pytest.approx(theirs.values, abs=1.0)
        assert ours.temperature == pytest.approx(theirs.temperature, abs=0.06)


def test_a_twin_of_a_resumed_session_is_as_it_was() -> None:
    model = at("scl3300", "range=mode4")
    truth = model.default_truth(2)
    clock = VirtualClock()
    twin = twin_of(model, truth, clock)
    sensor = model.driver(twin, clock)
    for _ in range(8):
        sensor.read()
    fresh = twin_of(model, truth, clock)
    fresh.recall(frames.ACC_X, clock.now_ns())
    assert twin.exchange(frames.ACC_Y) == fresh.exchange(frames.ACC_Y)


@pytest.mark.parametrize(
    ("kind", "error", "why"),
    [("parity", DeviceFault, "memory"), ("silent", BusError, "stuck high"), ("unplugged", BusError, "unplugged")],
)
def test_a_fault_comes_and_goes(kind: str, error: type[Exception], why: str) -> None:
    clock = VirtualClock()
    sensor = SCL.driver(twin_of(SCL, truth_of(SCL, faults=(Fault(kind, 1.0, 2.0),)), clock), clock)
    sensor.probe()
    clock.seek(1_000_000_000)
    with pytest.raises(error, match=why):
        sensor.probe()
    clock.seek(2_000_000_000)
    assert sensor.probe()["x"] == "-26 count"


@pytest.mark.parametrize("model", [SCL, SCA], ids=lambda model: model.name)
def test_drawn_parts_differ_and_stay_within_their_limits(model: Model) -> None:
    parts = [model.default_truth(seed) for seed in range(50)]
    assert len({part.offset["x"] for part in parts}) == 50
    assert all(abs(part.offset["z"]) <= 0.020 * model.sensitivity for part in parts)

"""One contract over every device: what holds for each of them, on its virtual part and on lines that fail.

A package of a third party can run it over a model of its own: the example package is one of the devices here.
"""

from collections.abc import Callable
from dataclasses import replace
from math import hypot
from random import Random
from statistics import stdev
from typing import Any

import pytest
from support.virtual_device import VirtualDevice
from tiltcal_dfrobot import DFROBOT_SCA100T

from tiltcal.drivers import models
from tiltcal.drivers.accelerometers import MODELS as ACCELEROMETERS
from tiltcal.drivers.bus import link_letter, open_link
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.virtual import Fault
from tiltcal.errors import DeviceFault, HardwareError, UsageError
from tiltcal.files.device import model_named, shipped_devices

BY_MANUAL = [model_named(name) for name in shipped_devices()]
DEVICES = {model.name: model for model in (*models(), DFROBOT_SCA100T, *BY_MANUAL)}

OPTIONS = {
    "adxl202": ["wiring=edges"],
    "adxl345": ["range=16g&rate=1600"],
    "adxl355": ["range=4g", "range=8g&rate=1000", "rate=3.90625"],
    "bmi160": ["range=16g&rate=1600"],
    "icm20948": ["range=8g&rate=225"],
    "iis2iclx": ["range=0.5g&rate=833", "range=3g"],
    "lis3dh": ["range=16g&rate=400"],
    "mma8451": ["range=8g&rate=400"],
    "modbus-columns": [
        "columns=x@0:int16*0.001,y@8:int32*0.0001,temperature@0x20:float64&order=cdab&table=input&measured_in=g",
        "columns=x@0:float64,y@9:int32*1e-6,temperature@4:int16*0.1&order=dcba",
    ],
    "sca100t-d02-analog": ["vdd=4.9", "x=3&y=0&supply=1&rate=860"],
    "sca3000-i2c": ["counts_per_g=500&thermometer=yes&pointer=command"],
    "sca3300-d01": ["range=6g", "range=1.5g-10hz"],
    "scl3300": ["range=low-noise", "range=2.4g"],
    "serial-columns": ["columns=-,x,y,z,temperature&separator=semicolon&unit=V&offset=2.5&sensitivity=2"],
    "thermistor": ["a=1.129e-3&b=2.341e-4&c=8.775e-8&to=supply", "vdd=4.9"],
}

TILTED = (0.2, -0.25, 0.8975**0.5)
"""Within ±15°, the narrowest range."""

NAMES_THE_REQUEST = ("scl3300", "sca3300-d01", "modbus-columns")
"""Their answers say which request they belong to, or of what length it was."""
HAS_A_CHECKSUM = (
    *("scl3300", "sca3300-d01", "dfrobot-sca100t", "adxl202", "adxl202e", "adxl210", "witmotion"),
    *("das-rs485", "seika-ng360", "jewell-tuff-tilt"),
)
TELLS_A_RESET = ("scl3300", "sca3300-d01", "adxl355", "iis2iclx", *ACCELEROMETERS)
HAS_A_SHAPE = (
    *HAS_A_CHECKSUM,
    *(model.name for model in BY_MANUAL),
    "serial-columns",
    "gradiometer",
    "modbus-columns",
    "iio",
    "python",
)


class Bench(VirtualDevice):
    """A device by its name and options."""

    def __init__(self, device: str, **truth: Any) -> None:
        self.device = device
        name, _, options = device.partition(" ")
        super().__init__(DEVICES[name], options, **truth)


EVERY = [f"{name} {options}".strip() for name in DEVICES for options in ("", *OPTIONS.get(name, ()))]


def every(applies: Callable[[Bench], bool] = lambda bench: True) -> Any:
    """Make a test of each device that something applies to."""
    return pytest.mark.parametrize("device", [device for device in EVERY if applies(Bench(device))])


def named(names: tuple[str, ...]) -> Callable[[Bench], bool]:
    """Whether a device has one of these names, and is not read edge by edge."""
    return lambda bench: bench.device.partition(" ")[0] in names and bench.line.letter != "e"


@every()
def test_a_reading_is_the_truth(device: str) -> None:
    """Either way up: an axis that points up reads more, where its sensitivity is positive."""
    bench = Bench(device)
    assert all(bench.sensor.probe().values())
    for gravity, celsius in ((TILTED, 30.0), (tuple(-one for one in TILTED), -7.0)):
        bench.fixture.move(gravity, celsius)
        readings = [bench.fresh() for _ in range(16)]
        bench.agrees(readings[-1])
        assert len(readings[0].values) == len(bench.model.channels)
        assert (readings[0].temperature is not None) == bench.model.thermometer
        for place, channel in enumerate(bench.channels):
            mean = sum(reading.values[place] for reading in readings) / 16
            assert mean == pytest.approx(bench.expected(channel), abs=bench.tolerance / 2)
            assert bench.model.rails[0] < mean < bench.model.rails[1]


@every(lambda bench: bool(bench.channels and bench.truth.noise))
def test_each_sample_is_new_and_has_the_noise_of_the_part(device: str) -> None:
    bench = Bench(device)
    for channel, column in zip(
        bench.channels, zip(*(bench.fresh().values for _ in range(300)), strict=True), strict=True
    ):
        # Rounding adds the variance of an even distribution one step wide, or of two in a difference.
        step, noise = max(bench.model.resolution, bench.sensor.read().step) / 12**0.5, bench.truth.noise[channel]
        assert 0.8 * hypot(noise, 0.5 * step) <= stdev(column) <= 1.2 * hypot(noise, 1.5 * step)


@every()
def test_a_line_that_is_stuck_is_no_reading(device: str) -> None:
    for byte in (b"\x00", b"\xff"):
        bench = Bench(device)
        bench.sensor.read()
        bench.line.change = lambda out, answer, byte=byte: byte * len(answer)
        bench.fails()
        bench.line.mend()
        bench.agrees(bench.after_errors())


@every()
def test_a_part_that_is_gone_is_said_and_comes_back(device: str) -> None:
    for kind in ("unplugged", "silent"):
        bench = Bench(device, faults=(Fault(kind, 10.0, 90.0),))
        bench.sensor.read()
        bench.clock.seek(20_000_000_000)
        bench.fails()
        bench.clock.seek(100_000_000_000)
        bench.agrees(bench.after_errors())


@every()
def test_a_memory_fault_is_no_reading(device: str) -> None:
    """And where the part has no such fault, nothing changes, and its description says so."""
    bench = Bench(device, faults=(Fault("parity", 10.0, 90.0),))
    assert ("a fault of a memory (parity)" in bench.model.omissions) != bench.model.memory_fault
    bench.sensor.read()
    bench.clock.seek(20_000_000_000)
    if bench.model.memory_fault:
        bench.fails(DeviceFault)
    else:
        bench.agrees(bench.fresh())


@every()
def test_a_stuck_reading_does_not_follow_the_jig(device: str) -> None:
    bench, came = Bench(device, faults=(Fault("stuck", 0.0, 90.0),)), set()
    for gravity in (TILTED, (0.0, 0.0, -1.0)):
        bench.fixture.move(gravity)
        came.add(bench.fresh().values)
    assert len(came) == 1


# A pulse ends before the next one begins, and a printed number has no rails.
@every(lambda bench: bool(bench.channels) and bench.line.letter != "e" and bench.model.rails[1] < 1e9)
def test_a_reading_beyond_the_range_is_at_a_rail_or_an_error(device: str) -> None:
    for sign in (1, -1):
        bench = Bench(device)
        low, high = bench.model.rails
        beyond = bench.model.offset + sign * 2 * (high - low)
        bench.truth = replace(bench.truth, offset=dict.fromkeys(bench.channels, beyond))
        bench.line.link = bench.part()
        try:
            values = bench.after_errors().values
        except HardwareError:
            continue
        assert all(value >= high if sign > 0 else value <= low for value in values)


@every(lambda bench: bench.line.letter not in "re")
def test_an_answer_of_another_length_is_no_reading(device: str) -> None:
    for cut in (slice(0), slice(1), slice(-1), None):
        bench = Bench(device)
        bench.sensor.read()
        bench.line.change = lambda out, answer, cut=cut: answer and (answer + b"\x01" if cut is None else answer[cut])
        with pytest.raises(HardwareError):
            bench.sensor.read()
        bench.line.mend()
        bench.agrees(bench.after_errors())


@every(named(NAMES_THE_REQUEST))
def test_an_answer_to_another_request_is_no_reading(device: str) -> None:
    """At one place after another the answer before comes once more, or from there on all come one request late."""
    whole = Bench(device, noise={})
    whole.fixture.move(TILTED, 30.0)
    said, truth = whole.sensor.probe(), whole.sensor.read()
    for place in range(len(whole.line.sent)):
        for last in (place, len(whole.line.sent)):
            bench, answers = Bench(device, noise={}), [b""]
            bench.fixture.move(TILTED, 30.0)

            def late(out: bytes, answer: bytes, answers: list = answers, first: int = place, last: int = last) -> bytes:
                answers.append(answer)
                return answers[-2] or answer if first <= len(answers) - 2 <= last else answer

            bench.line.change = late
            try:
                assert {**bench.sensor.probe(), "link": ""} == {**said, "link": ""}
                assert bench.sensor.read() == truth
            except HardwareError:
                continue


@every(named(HAS_A_CHECKSUM))
def test_a_damaged_answer_is_no_other_reading(device: str) -> None:
    """One bit in each fifth answer; the truth does not change, so a wrong word is seen."""
    bench, chance, came = Bench(device, noise={}), Random(7), []
    bench.sensor.read()

    def damaged(out: bytes, answer: bytes) -> bytes:
        flipped = 1 << chance.randrange(8 * len(answer)) if answer and chance.random() < 0.2 else 0
        return (int.from_bytes(answer, "big") ^ flipped).to_bytes(len(answer), "big")

    bench.line.change = damaged
    for _ in range(200):
        try:
            came.append(bench.sensor.read())
        except HardwareError:
            continue
    assert len(came) > 100
    for reading in came:
        bench.agrees(reading)


@every(named(HAS_A_SHAPE))
def test_noise_on_the_line_is_no_reading(device: str) -> None:
    bench, chance = Bench(device), Random(4)
    bench.line.change = lambda out, answer: chance.randbytes(len(answer))
    for _ in range(5):
        bench.fails()


@every()
def test_a_driver_reads_the_same_from_the_bytes_of_a_journal(device: str) -> None:
    bench, again = Bench(device), Bench(device)
    said, readings = bench.sensor.probe(), [bench.sensor.read() for _ in range(3)]
    played = iter(bench.line.sent)

    def exchange(out: bytes, count: int = 0) -> bytes:
        sent, answer, now_ns = next(played)
        assert sent == out
        again.clock.seek(now_ns)
        return answer

    again.line.exchange = exchange
    assert (again.sensor.probe(), [again.sensor.read() for _ in range(3)]) == (said, readings)


@every()
def test_a_part_that_was_reset_is_set_up_again(device: str) -> None:
    """Its settings are lost with its supply: no reading of another range, and right ones after an error or two."""
    bench = Bench(device)
    bench.sensor.read()
    for _ in range(3):
        bench.line.link = bench.part()
        bench.clock.sleep(1.0)
        if named(TELLS_A_RESET)(bench):
            with pytest.raises(DeviceFault, match="was reset or its supply failed since it was set up"):
                bench.sensor.read()
        for _ in range(3):
            bench.agrees(bench.after_errors())


@every()
def test_a_model_is_described_and_refuses_an_address_of_another(device: str) -> None:
    model = DEVICES[device.partition(" ")[0]]
    assert model.title
    assert model.rails[0] < model.offset < model.rails[1]
    for written in model.addresses:
        address = parse_address(written)
        assert link_letter(address, model.at(address)) in "siremn"
        nonsense = parse_address(f"{written}{'&' if '?' in written else '?'}nonsense=1")
        with pytest.raises(UsageError, match="unknown option 'nonsense'"):
            open_link(nonsense, model.at(address))
    foreign = "vcd:x.vcd?x=D0&y=D1" if "vcd" not in model.schemes else "modbus:/dev/x"
    for written in (foreign, "sim:"):
        with pytest.raises(UsageError, match="is reached by"):
            open_link(parse_address(written), model)


@every(lambda bench: bool(bench.channels))
def test_drawn_parts_differ_and_keep_their_tolerances(device: str) -> None:
    model = Bench(device).model
    parts = [model.default_truth(seed) for seed in range(60)]
    assert parts[:30] == [model.default_truth(seed) for seed in range(30)]
    for channel in model.channels:
        offsets = [(part.offset[channel] - model.offset) / model.sensitivity for part in parts]
        gains = [part.sensitivity[channel][channel] / model.sensitivity - 1.0 for part in parts]
        for errors, spread in ((offsets, model.offset_spread), (gains, model.sensitivity_spread)):
            assert len(set(errors)) == 60
            # A rectangular distribution ends at 1.73 of its standard deviation.
            assert max(map(abs, errors)) <= 1.74 * spread
            assert min(errors) < 0.0 < max(errors)


@pytest.mark.parametrize(
    "name", ["adxl345", "adxl355", "icm20948", "iis2iclx", "lis3dh", "lsm6ds3", "mma8451", "mpu6050", "msa311"]
)
def test_a_part_that_nobody_has_woken_measures_nothing(name: str) -> None:
    sensor = VirtualDevice(DEVICES[name]).sensor
    assert set(sensor.registers(*sensor.part.bursts[0]).values()) == {0}


def test_a_number_without_a_sign_uses_all_of_its_bits_and_a_part_tells_its_mode() -> None:
    bench = Bench("modbus-columns columns=x@0:float32,temperature@4:uint16*0.0005")
    bench.fixture.move(TILTED, 30.0)
    assert bench.fresh().temperature == pytest.approx(30.0, abs=1.0)
    device = VirtualDevice(DEVICES["sca3000-d01"])
    assert device.sensor.probe()["mode"] == "normal"
    device.line.link.exchange(b"\x52\x03")
    assert device.sensor.probe()["mode"].startswith("motion detection, not normal: bandwidth and data rate differ")


@pytest.mark.parametrize("name", ["adxl355", "iis2iclx"])
def test_a_part_that_does_not_measure_is_named_after_six_sample_periods(name: str) -> None:
    """At its first sample and later, where its registers are as they were set."""
    device = VirtualDevice(DEVICES[name])
    ask = {"adxl355": 0x04 << 1 | 1, "iis2iclx": 0x1E | 0x80}[name]  # for the status, on SPI
    for _ in range(2):
        device.line.change = lambda out, answer: bytes(len(answer)) if out[0] == ask else answer
        began, period = device.clock.now_ns(), 1.0 / device.sensor.part.sampling.rate
        with pytest.raises(
            DeviceFault, match=f"no sample came for {6 * period:.3g} s: the {name.upper()} does not meas"
        ):
            device.sensor.read()
        assert 6 * period <= (device.clock.now_ns() - began) / 1e9 <= 6 * period + 0.1
        device.line.mend()
        device.agrees(device.after_errors())


def test_a_row_of_bytes_is_written_to_a_row_of_registers() -> None:
    """As other programs write the offsets of an ADXL345."""
    link = VirtualDevice(DEVICES["adxl345"]).line.link
    link.exchange(b"\x1e\x01\x02\x03")
    assert link.exchange(b"\x1e", 3) == b"\x01\x02\x03"

"""Linux's own drivers of accelerometers read our virtual parts, over its own I2C, SPI and regmap.

Needs root and a kernel with the module of ``answered_bus.c``; ``make test-kernel`` boots one. Its bus does not judge
the frequency and edges of the clock, setup times, waits, and the SPI mode.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import chain
from pathlib import Path
from threading import Thread
from time import sleep
from typing import Any, NamedTuple

from tiltcal.drivers import find_model
from tiltcal.drivers.bus import open_link
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.virtual import Fixture

G = 9.80665
COLD = -20.0
"""Far from where thermometers have their zeros, °C."""
UP = (0.36, -0.288, (1.0 - 0.36**2 - 0.288**2) ** 0.5)
"""Within ±0.49 g of x and y, where the narrowest range of an IIS2ICLX ends."""


class Judged(NamedTuple):
    """A driver of Linux that reads one of our parts.

    name: of the part in Linux.
    bus: its address on I2C; 0 is SPI.
    ranges: of ours, which Linux sets by its scale; an empty one is the only one that it has.
    unit: 1 g in its unit of acceleration.
    near: largest relative difference of its scale, beside the rounding.
    """

    model: str
    name: str
    bus: int
    ranges: tuple[str, ...] = ("2g", "4g", "8g", "16g")
    unit: float = G
    near: float = 2.5e-3


LSM6DS = [Judged(name, name, bus) for name in ("lsm6ds3", "lsm6ds3tr-c", "lsm6dsox") for bus in (0x6A, 0)]
MPU = [Judged(name, name, 0x68) for name in ("mpu6050", "mpu6500", "mpu9250")]
SCA3000 = [Judged(f"sca3000-{name}", f"sca3000_{name}", 0, ("",)) for name in ("d01", "e02", "e04", "e05")]

JUDGED = (
    Judged("adxl345", "adxl345", 0x53, ("16g",)),
    Judged("adxl345", "adxl345", 0, ("16g",)),
    Judged("adxl355", "adxl355", 0x1D, ("2g",)),
    Judged("adxl355", "adxl355", 0, ("2g",)),
    Judged("bmi160", "bmi160", 0x69),
    # Linux has no driver of it, but one of its sibling with the same registers, identity and codes, and four times the
    # digit, where 31 µg are 30.5.
    Judged("iis2iclx", "ism330dhcx", 0x6A, ("0.5g", "1g", "2g", "3g"), 4.0 * G, 0.02),
    Judged("iis2iclx", "ism330dhcx", 0, ("0.5g", "1g", "2g", "3g"), 4.0 * G, 0.02),
    Judged("lis3dh", "lis3dh", 0x18),
    Judged("lis3dh", "lis3dh", 0),
    *LSM6DS,
    Judged("mma8451", "mma8451", 0x1D, ("2g", "4g", "8g")),
    *MPU,
    Judged("msa311", "msa311", 0x62),
    *SCA3000,
    Judged("sca3300-d01", "sca3300", 0, ("3g", "6g", "1.5g"), 1.0),
    # It sets mode 4 where our range has mode 3, with the same sensitivity.
    Judged("scl3300", "sca3300", 0, ("1.2g", "2.4g", "inclination"), 1.0),
)


class WithCompass:
    """An MPU-9250 whose compass says who it is, in place of all else; Linux does not take the part without one."""

    def __init__(self, part: Any) -> None:
        self._part = part

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        said: bytes = self._part.exchange(out, count)
        return b"\x48" * count if out == b"\x49" else said


class AnsweredBus:
    """The bus of ``answered_bus.c`` with one part, which answers in a thread."""

    def __init__(self) -> None:
        self.part: Any = None
        self._device = os.open("/dev/answered", os.O_RDWR)
        self._clock = VirtualClock()
        Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        while True:
            asked = os.read(self._device, 1024)
            try:
                answer = b"\1" + self.part.exchange(asked[4:], int.from_bytes(asked[2:4], "little"))
            except Exception as failure:
                print(f"test-kernel: the part fails: {failure!r}", flush=True)
                answer = b"\0"
            # The kernel waits in its own time.
            self._clock.sleep(0.01)
            os.write(self._device, answer)

    @contextmanager
    def driven(self, judged: Judged, part: Any, clock: VirtualClock) -> Iterator[Path]:
        """Let the kernel's driver take a part; yields the folder of its IIO device."""
        self.part, self._clock = part, clock
        control = Path("/sys/module/answered_bus/parameters", "i2c_device" if judged.bus else "spi_device")
        control.write_text(f"{judged.name} {judged.bus:#x}\n")
        try:
            found = [one for one in Path("/sys/bus/iio/devices").glob("iio:device*") if any(one.glob("in_accel*"))]
            if not found:
                raise AssertionError(f"Linux's driver of {judged.name} does not take the part")
            yield found[0]
        finally:
            control.write_text("\n")


def number(folder: Path, *names: str) -> float:
    """The first of the files that is there."""
    return float(next(path for name in names for path in folder.glob(name)).read_text())


def check(bus: AnsweredBus, judged: Judged, span: str) -> str:
    """The kernel's raw values are the truth, digit by digit; its scale and its temperature are near ours."""
    model = find_model(judged.model)
    model = model.at(parse_address(f"sim:{f'range={span}' * bool(span)}"))
    clock = VirtualClock()
    fixture, truth = Fixture(clock, ambient=COLD), replace(model.default_truth(3), noise={})
    fixture.move(UP)
    part = model.twin(truth, fixture, clock)
    part.letter = "i" if judged.bus else "s"
    asked = WithCompass(part) if model.name == "mpu9250" else part
    with bus.driven(judged, asked, clock) as folder:
        if judged in SCA3000:
            # A write of its own arrives, though our driver never writes to that part; it takes each fourth word.
            assert 0x18 in part._held
            assert number(folder, *RATES) == part._part.sampling.rate // 4
        scale = next(path for path in (folder / "in_accel_scale", folder / "in_accel_x_scale") if path.exists())
        known = [*folder.glob("in_accel_scale_available"), *folder.glob("in_accel_x_scale_available")]
        scales = known[0].read_text().split() if known else []
        if scales:
            wanted = judged.unit / model.sensitivity
            scale.write_text(min(scales, key=lambda one: abs(float(one) / wanted - 1.0)))
        raw = [number(folder, f"in_accel_{channel}_raw") for channel in model.channels]
        expected = [truth.reading(channel, UP, COLD) for channel in model.channels]
        assert all(abs(one - other) < 0.51 for one, other in zip(raw, expected, strict=True)), (raw, expected)
        factor = number(scale.parent, scale.name) * model.sensitivity / judged.unit
        # Linux rounds its scales to a digit of 1e-6.
        assert abs(factor - 1.0) < judged.near + 0.5e-6 * model.sensitivity / judged.unit, factor
        said = f"{', '.join(f'{value:.0f}' for value in raw)}, scale {100 * (factor - 1):+.2f} %"
        if model.thermometer and any(folder.glob("in_temp*_scale")):
            counts, offset, degree = (number(folder, f"in_temp_{one}", f"in_temp0_{one}") for one in THERMOMETER)
            # The scale of the SCA3000 is in °C, and those of the others in m°C.
            celsius = (counts + offset) * degree / (1.0 if judged in SCA3000 else 1000.0)
            assert abs(celsius - COLD - truth.thermometer_error) < 0.06 + 0.51 * model.thermometer_step, celsius
            said += f", {celsius:.2f} °C"
        # So does our driver for any accelerometer that Linux has a driver of.
        address = parse_address(f"{folder.name}?sensitivity={model.sensitivity:g}")
        iio = find_model("iio").at(address)
        link = open_link(address, iio)
        assert list(iio.driver(link, clock).read().values)[: len(raw)] == raw
        link.close()
        biases = [folder / f"in_accel_{channel}_calibbias" for channel in model.channels]
        if model.name in USER_OFFSETS:
            for bias in biases:
                bias.write_text("8")
        ours = model.driver(part, clock).read()
        assert list(ours.values) == raw, (ours, raw)
        # What another program left behind is gone, and what ours has set up the kernel reads.
        assert all(int(bias.read_text()) == 0 for bias in biases if model.name in USER_OFFSETS)
        assert [number(folder, f"in_accel_{channel}_raw") for channel in model.channels] == raw
    return said


THERMOMETER = ("raw", "offset", "scale")
USER_OFFSETS = ("adxl345", "mma8451")
"""Parts that nothing but our driver or a loss of supply resets, and that have offsets of the user."""
RATES_OF_LINUX = {
    "adxl345": 10,
    "adxl355": 11,
    "iis2iclx": 7,
    "bmi160": 8,
    "lis3dh": 7,
    "lsm6dsox": 7,
    "mma8451": 8,
    "msa311": 9,
} | dict.fromkeys(("lsm6ds3", "lsm6ds3tr-c", "mpu6050", "mpu6500", "mpu9250"), 6)
"""How many of our rates it has."""


def check_rates(bus: AnsweredBus, judged: Judged) -> str:
    """For each rate that both have, the kernel writes the code of our row into its register."""
    model, clock = find_model(judged.model), VirtualClock()
    part = model.twin(model.default_truth(3), Fixture(clock), clock)
    part.letter = "i" if judged.bus else "s"
    row, written = part._part, []
    setting = next(write for write in chain(*row.start_up.set_up) if write.rate)
    keep = part._write
    part._write = lambda register, content: (written.append((register, content)), keep(register, content))[-1]
    asked, said = WithCompass(part) if model.name == "mpu9250" else part, 0
    with bus.driven(judged, asked, clock) as folder:
        # It has reset the part as our driver does; of a value of one bit it keeps the others.
        if reset := row.start_up.reset:
            bit = reset.value if reset.value.bit_count() == 1 else 0xFF
            assert reset.value in [content & bit for register, content in written if register == reset.register], (
                written
            )
        files = [path for name in RATES for path in folder.glob(name)]
        known = Path(f"{files[0]}_available")
        offered = (known if known.exists() else folder / "sampling_frequency_available").read_text().split()
        bits = (1 << max(row.sampling.rates.values()).bit_length()) - 1
        for rate, code in row.sampling.rates.items():
            nearest = min(offered, key=lambda one: abs(float(one) - rate))
            if abs(float(nearest) - rate) > 0.004 * rate:
                continue
            written.clear()
            files[0].write_text(nearest)
            number(folder, "in_accel_x_raw")
            codes = {content // setting.rate & bits for register, content in written if register == setting.register}
            # It does not write a rate that it takes to be set.
            assert code in (codes or {row.virtual.held.get(setting.register, 0) // setting.rate & bits}), (rate, codes)
            said += 1
    assert said == RATES_OF_LINUX[model.name], said
    return f"{said} rates"


RATES = ("in_accel_sampling_frequency", "sampling_frequency")


def main() -> int:
    """Judge each part on its buses and ranges, or those whose names are given; return the number of failures."""
    bus, failures = AnsweredBus(), 0
    for judged in JUDGED:
        if sys.argv[1:] and judged.model not in sys.argv[1:]:
            continue
        for span in (*judged.ranges, *(["rates"] if judged.model in RATES_OF_LINUX else [])):
            try:
                said = check_rates(bus, judged) if span == "rates" else check(bus, judged, span)
            except (AssertionError, OSError, StopIteration) as failure:
                said, failures = f"FAILED: {type(failure).__name__} {failure}", failures + 1
            sleep(0.01)
            line = f"{judged.model} {'I2C' if judged.bus else 'SPI'} {span}".strip()
            print(f"test-kernel: {line}: {said}", flush=True)
    return min(failures, 100)


if __name__ == "__main__":
    raise SystemExit(main())

"""Linux's own drivers of accelerometers read what our virtual parts have in their registers.

Needs root and a kernel with i2c-stub at the addresses of :data:`PARTS`; ``make test-kernel`` boots one.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from threading import Event, Thread
from time import sleep
from typing import Any

from smbus2 import SMBus

from tiltcal.drivers import find_model
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.virtual import Fixture

PARTS = {
    "adxl345": 0x53,
    "lis3dh": 0x18,
    "lsm6ds3": 0x6A,
    "lsm6ds3tr-c": 0x6A,
    "lsm6dsox": 0x6B,
    "mma8451": 0x1D,
    "bmi160": 0x69,
    "mpu6050": 0x68,
    "mpu6500": 0x68,
}
"""Not the MPU-9250, whose compass would have to answer, and what Linux 6.1 has no driver for (ICM-20948, MSA311)."""

G = 9.80665
UP = (0.48, -0.6, 0.64)


class StubBus:
    """The bus of i2c-stub: chips of 256 registers that hold what is written to them, and do nothing."""

    def __init__(self) -> None:
        self.adapter = next(
            path for path in Path("/sys/bus/i2c/devices").glob("i2c-*") if "stub" in (path / "name").read_text()
        )
        self.bus = SMBus(int(self.adapter.name.removeprefix("i2c-")))

    def fill(self, address: int, contents: dict[int, int]) -> None:
        for register in range(256):
            self.bus.write_byte_data(address, register, contents.get(register, 0), force=True)

    @contextmanager
    def driven(self, name: str, address: int) -> Iterator[Path | None]:
        """Let the kernel's driver of a part take a chip; yields the folder of its IIO device, if it does."""
        done = Event()

        def out_of_reset() -> None:
            # The MMA8451 ends its reset by itself.
            while not done.is_set():
                self.bus.write_byte_data(address, 0x2B, 0x00, force=True)
                sleep(1e-5)

        clearing = Thread(target=out_of_reset)
        if name == "mma8451":
            clearing.start()
        (self.adapter / "new_device").write_text(f"{name} {address:#x}\n")
        done.set()
        try:
            number = self.adapter.name.removeprefix("i2c-")
            yield next(Path(f"/sys/bus/i2c/devices/{number}-{address:04x}").glob("iio:device*"), None)
        finally:
            (self.adapter / "delete_device").write_text(f"{address:#x}\n")


def registers_of(name: str) -> tuple[dict[int, int], Any, Any]:
    """Return the registers of our virtual part in one attitude, our reading of them, and the model."""
    model, clock = find_model(name), VirtualClock()
    fixture = Fixture(clock, ambient=24.0)
    fixture.move(UP)
    part = model.twin(replace(model.default_truth(3), noise={}), fixture, clock)
    part.letter = "i"
    reading = model.driver(part, clock).read()
    contents = {register: part.exchange(bytes([register]), 1)[0] for register in range(0x80)}
    return contents, reading, model


def check_raw(stub: StubBus, name: str) -> str:
    """The kernel's raw values are our readings, digit by digit; its scale, and its temperature, are near ours."""
    contents, reading, model = registers_of(name)
    address = PARTS[name]
    if name == "lis3dh":  # it counts on at the address with bit 7
        contents.update({register | 0x80: contents[register] for register in range(0x28, 0x2E)})
    if name == "mma8451":  # the kernel waits for a new sample, whose bits our part leaves out
        contents[0x00] = 0x0F
    stub.fill(address, contents)
    with stub.driven(name, address) as folder:
        if folder is None and name == "adxl345":
            return "not read: the driver of Linux 6.1 takes this part from a device tree alone"
        raw = tuple(float((folder / f"in_accel_{axis}_raw").read_text()) for axis in "xyz")
        assert raw == reading.values, (raw, reading.values)
        scale = next(path for path in (folder / "in_accel_scale", folder / "in_accel_x_scale") if path.exists())
        factor = float(scale.read_text()) * model.sensitivity / G
        assert abs(factor - 1.0) < 2.5e-3, factor
        said = f"{', '.join(f'{value:.0f}' for value in raw)}, scale {100 * (factor - 1):+.2f} %"
        if (folder / "in_temp_raw").exists() and model.thermometer:
            counts, offset, degree = (
                float((folder / f"in_temp_{one}").read_text()) for one in ("raw", "offset", "scale")
            )
            celsius = (counts + offset) * degree / 1000.0
            assert abs(celsius - reading.temperature) < 0.05, (celsius, reading.temperature)
            said += f", {celsius:.2f} °C"
    return said


if __name__ == "__main__":
    stub = StubBus()
    for name in PARTS:
        print(f"test-kernel: {name}: {check_raw(stub, name)}", flush=True)

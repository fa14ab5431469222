"""The devices of a bench: the model of each, where it is connected, and how it sits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from tiltcal.core.attitude import STRAIGHT, Orientation, orientation
from tiltcal.drivers import find_model
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.model import Model
from tiltcal.errors import UsageError
from tiltcal.files.bench import BenchFile, BenchSensor, BenchThermometer, bench_of
from tiltcal.files.document import Document
from tiltcal.files.journal_header import DeviceHeader
from tiltcal.stated_arguments import require_printable


@dataclass(frozen=True)
class DeviceSetup:
    """One device of a session; the output is its calibration file, relative to the journal's folder, or empty."""

    model_name: str
    serial: str
    address: str
    output: str = ""
    orientation: Orientation = STRAIGHT

    @cached_property
    def model(self) -> Model:
        """The model as it is wired at the address."""
        return find_model(self.model_name).at(parse_address(self.address))

    def header(self) -> DeviceHeader:
        """Return the device as a journal's header has it."""
        axes = None if self.orientation.straight else self.orientation.names
        return DeviceHeader(
            model=self.model_name, serial=self.serial, address=self.address, output=self.output, axes=axes
        )

    @classmethod
    def from_header(cls, device: DeviceHeader) -> DeviceSetup:
        """Return the setup of a device as a journal's header has it."""
        turned = STRAIGHT if device.axes is None else orientation(device.axes)
        return cls(device.model, device.serial, device.address, device.output, turned)


def known_bench(document: Document) -> BenchFile:
    """Return the bench of a document, whose models are known and addresses right; an InputError where one is not."""
    bench = bench_of(document)
    for number, sensor in enumerate(bench.sensors):
        with document.locating("sensors", number):
            find_model(sensor.model).at(parse_address(sensor.address))
    if bench.thermometer is not None:
        with document.locating("thermometer"):
            _thermometer(bench.thermometer)
    return bench


def devices_of(bench: BenchFile) -> tuple[tuple[DeviceSetup, ...], DeviceSetup | None]:
    """Return the devices of a bench where no calibration is made: its sensors, and its thermometer."""
    sensors = tuple(DeviceSetup(s.model, s.serial, s.address, orientation=s.orientation) for s in bench.sensors)
    return sensors, None if bench.thermometer is None else _thermometer(bench.thermometer)


def with_thermometer(sensors: Sequence[DeviceSetup], thermometer: DeviceSetup | None) -> tuple[DeviceSetup, ...]:
    """Return all devices of a bench, as a journal numbers them: the sensors, and the thermometer behind them."""
    return tuple(sensors) if thermometer is None else (*sensors, thermometer)


def all_virtual(devices: Sequence[DeviceSetup]) -> bool:
    """Return whether every device is a virtual twin; the clock of a session is virtual then too."""
    return all(parse_address(device.address).simulated for device in devices)


def single(model: str, serial: str, address: str, jig: float | None = None) -> BenchFile:
    """Return a bench of one sensor, which needs no file."""
    require_printable(serial, "the serial number")
    return BenchFile((BenchSensor(serial, model, address),), jig=jig)


def _thermometer(thermometer: BenchThermometer) -> DeviceSetup:
    device = DeviceSetup(thermometer.model, "thermometer", thermometer.address)
    if not device.model.thermometer:
        raise UsageError(f"{thermometer.model} reports no temperature: it cannot be the bench's thermometer")
    return device

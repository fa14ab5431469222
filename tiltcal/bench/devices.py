"""The devices of a bench, real or virtual: what they are, and how they are opened."""

from __future__ import annotations

from collections.abc import Callable, Iterator, MutableMapping, Sequence
from contextlib import closing, contextmanager
from datetime import UTC, datetime
from functools import cached_property, lru_cache
from math import radians
from typing import TYPE_CHECKING, Annotated

from msgspec import Meta

from tiltcal.core.attitude import STRAIGHT, Orientation, Vector, orientation
from tiltcal.drivers import find_model
from tiltcal.drivers.bus import Link, link_letter, open_link
from tiltcal.drivers.bus.address import Address, parse_address
from tiltcal.drivers.bus.clock import Clock, session_clock
from tiltcal.drivers.model import Model, Reading, Sensor
from tiltcal.errors import BusError, HardwareError
from tiltcal.files.record import Record, Text, about

if TYPE_CHECKING:
    from tiltcal.drivers.bus.modbus import ModbusLine
    from tiltcal.drivers.virtual import Fixture, Truth


class BenchDevice(Record, kw_only=True):
    """A sensor or the thermometer of a session."""

    always_written = ("output",)

    model: Annotated[Text, about("as `--sensor`")]
    serial: Annotated[str, about("serial number; empty of a thermometer")]
    address: Annotated[Text, about("as `--address`")]
    output: Annotated[str, about("calibration file, relative to the journal; empty where none is made")] = ""
    axes: Annotated[
        Annotated[tuple[Text, ...], Meta(min_length=3, max_length=3)] | None,
        about("how it sits, where it does not sit straight"),
    ] = None

    @property
    def wired(self) -> Model:
        """The model as it is wired at the address."""
        return _wired(self.model, self.address)

    @property
    def orientation(self) -> Orientation:
        """How it sits on the fixture."""
        return STRAIGHT if self.axes is None else orientation(self.axes)

    @property
    def simulated(self) -> bool:
        """Whether it is a virtual twin."""
        return parse_address(self.address).simulated

    @property
    def letter(self) -> str:
        """Its bus in a journal."""
        return link_letter(parse_address(self.address), self.wired)


@lru_cache(maxsize=64)
def _wired(model: str, address: str) -> Model:
    return find_model(model).at(parse_address(address))


class VirtualBench:
    """Makes the twins of a session and the fixture that holds them."""

    def __init__(self, clock: Clock, devices: Sequence[BenchDevice]) -> None:
        self._clock = clock
        self._first = next((device for device in devices if device.simulated), None)

    @cached_property
    def fixture(self) -> Fixture:
        """The jig and the chamber, with the errors that the truth of the first virtual sensor states."""
        from tiltcal.drivers.virtual import Fixture

        if self._first is None:
            return Fixture(self._clock)
        truth = truth_of(parse_address(self._first.address), self._first.wired)
        return Fixture(
            self._clock, seed=truth.seed, jig=truth.jig, ambient=truth.ambient, time_constant=truth.time_constant
        )

    def twin(self, device: BenchDevice) -> Link:
        """Return the virtual sensor behind a ``sim:`` address."""
        truth = truth_of(parse_address(device.address), device.wired)
        return device.wired.twin(truth, self.fixture.turned(_to_sensor(device, truth)), self._clock)


def _to_sensor(device: BenchDevice, truth: Truth) -> Callable[[Vector], Vector]:
    """Return the function that takes a vector of the fixture's frame into the sensor's."""
    if truth.mounting == (0.0, 0.0, 0.0):
        return device.orientation.seen
    from tiltcal.core.attitude import mounting_matrix
    from tiltcal.core.model import Mounting

    roll, pitch, yaw = map(radians, truth.mounting)
    to_sensor = mounting_matrix(Mounting(roll, pitch, yaw)).T

    def seen(vector: Vector) -> Vector:
        x, y, z = (to_sensor @ device.orientation.seen(vector)).tolist()
        return x, y, z

    return seen


def truth_of(address: Address, model: Model) -> Truth:
    """Return the truth of the virtual sensor behind a ``sim:`` address with ``twin=FILE`` and ``seed=N``.

    UsageError: an unknown option, or a twin file of another model or with too few channels.
    InputError: the twin file is wrong.
    """
    address.allow("twin", "seed", *model.options)
    seed = address.integer("seed", 0)
    if "twin" not in address.options:
        return model.default_truth(seed)
    from tiltcal.files.twin import read_twin

    named, truth = read_twin(address.text("twin"), seed if "seed" in address.options else None)
    if named is not None and named != model.name:
        address.refuse(f"the twin file is of a {named}, not of a {model.name}")
    missing = [channel for channel in model.channels if channel not in truth.channels]
    if missing:
        address.refuse(f"the twin file has no {' and no '.join(missing)}, which a {model.name} reads")
    return truth


def open_device(
    device: BenchDevice, virtual: VirtualBench, lines: MutableMapping[str, ModbusLine] | None = None
) -> Link:
    """Return the live link of one device; ``lines`` are those that the devices opened before share.

    HardwareError: it cannot be opened.
    """
    address = parse_address(device.address)
    return virtual.twin(device) if address.simulated else open_link(address, device.wired, lines)


def open_same(
    device: BenchDevice, virtual: VirtualBench, lines: MutableMapping[str, ModbusLine], clock: Clock, stated: list[str]
) -> Link:
    """Open a device, and refuse a part with another serial number than the one ``stated`` before.

    The journal has only the error.
    """
    link = open_device(device, virtual, lines)
    if device.simulated:
        return link
    try:
        stated.append(device.wired.driver(link, clock).serial_number())
        if stated[-1] != stated[0]:
            why = f"another part answers: its serial number is {stated.pop()}, it was {stated[0]}; connect that one"
            raise BusError(why)
    except HardwareError as error:
        link.close()
        raise BusError(str(error)) from error
    return link


def probe_devices(
    devices: Sequence[BenchDevice], virtual: VirtualBench, clock: Clock, *, read: bool = False
) -> list[Reading]:
    """Open one device after the other, check that it answers, and return a reading of each where it is to be read.

    UsageError: an option of an address is wrong, or contradicts that of another device on the same line.
    HardwareError: a device that cannot be opened, or does not answer.
    """
    lines: dict[str, ModbusLine] = {}
    readings = []
    for device in devices:
        with closing(open_device(device, virtual, lines)) as link:
            driver = device.wired.driver(link, clock)
            driver.probe()
            readings += [driver.read()] if read else []
    return readings


@contextmanager
def open_sensor(model: str, address: str) -> Iterator[Sensor]:
    """Open one sensor to be read, and close it at the end of the block.

    Parameters
    ----------
    model : str
        Such as ``sca100t-d02``.
    address : str
        Such as ``spi:///dev/spidev0.0``, or ``sim:`` for its virtual twin.

    Yields
    ------
    Sensor
        ``read()`` returns a reading: ``values`` by the model's channels in its unit, ``temperature`` in °C or None.

    Raises
    ------
    UsageError
        No such model, or a bad address.
    HardwareError
        It cannot be opened.
    """
    device = BenchDevice(model=model, serial="", address=address)
    clock = session_clock(datetime.now(UTC), virtual=device.simulated)
    with closing(open_device(device, VirtualBench(clock, [device]))) as link:
        yield device.wired.driver(link, clock)

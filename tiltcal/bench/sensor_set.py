"""The sensors of a bench, connected and read together, and the thermometer beside them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, MutableMapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

from tiltcal.bench.device_setup import DeviceSetup, with_thermometer
from tiltcal.bench.event_log import EventLog, RecordedLink
from tiltcal.bench.virtual_bench import VirtualBench
from tiltcal.core.attitude import STRAIGHT, Orientation
from tiltcal.drivers.bus import link_letter, open_link
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import Clock
from tiltcal.drivers.bus.link import Interruption, Link
from tiltcal.drivers.model import IdentifiedSensor, Model, Reading, Sensor, StreamingSensor
from tiltcal.errors import BusError, HardwareError, SensorError
from tiltcal.files.calibration import SensorIdentity

if TYPE_CHECKING:
    from tiltcal.drivers.bus.modbus import ModbusLine

Sample = tuple[Reading, ...]
"""One reading of each sensor of a set, in its order."""

Listener = Callable[[Mapping[str, Reading]], None]
"""Takes the readings of a sample by serial number."""

ATTEMPTS = 5
"""Failures in a row after which a sensor is given up."""

RECOVERY = 1.0
"""Seconds that a bus is left alone after an error."""


@dataclass(frozen=True)
class ConnectedSensor:
    """One sensor at the bench.

    Attributes
    ----------
    model : Model
        As it is wired.
    serial : str
        The serial number that goes on the calibration file.
    sensor : Sensor
        The driver on the recorded link.
    orientation : Orientation
        How it sits on the fixture.
    """

    model: Model
    serial: str
    sensor: Sensor
    orientation: Orientation = STRAIGHT

    @property
    def identity(self) -> SensorIdentity:
        """The identity of the sensor in its calibration file."""
        return SensorIdentity(self.model.name, self.serial, self.model.unit, self.model.channels)


class SensorSet:
    """Reads several sensors as one, and gives up those that fail for good.

    Parameters
    ----------
    thermometer : Sensor, optional
        Its temperature stands for that of every sensor.

    Attributes
    ----------
    lost : dict of str to str
        Why sensors were given up, by serial number.
    reopened : set of str
        Sensors whose bus failed and was opened again, by serial number.
    """

    THERMOMETER = ""
    """The thermometer of the bench among the names of its devices: no sensor has this serial number."""

    def __init__(self, connected: Sequence[ConnectedSensor], thermometer: Sensor | None = None) -> None:
        self._all = tuple(connected)
        self._listeners: list[Listener] = []
        self._thermometer = thermometer
        self._failures: dict[str, int] = {}
        self._just_lost: list[str] = []
        """The sensors that were given up since the last success."""
        self.lost: dict[str, str] = {}
        self.reopened: set[str] = set()

    @property
    def sensors(self) -> tuple[ConnectedSensor, ...]:
        """The sensors that were not given up."""
        return tuple(sensor for sensor in self._all if sensor.serial not in self.lost) if self.lost else self._all

    @property
    def models(self) -> tuple[Model, ...]:
        """The models of the same sensors."""
        return tuple(sensor.model for sensor in self.sensors)

    @property
    def _devices(self) -> list[tuple[str, Sensor]]:
        """What is read for a sample, by name: the sensors that were not given up, and the thermometer last."""
        devices = [(sensor.serial, sensor.sensor) for sensor in self.sensors]
        return devices if self._thermometer is None else [*devices, (self.THERMOMETER, self._thermometer)]

    @property
    def has_thermometer(self) -> bool:
        """Whether a thermometer of the bench gives the temperature of every sensor."""
        return self._thermometer is not None

    def link_statistics(self) -> dict[str, Mapping[str, int]]:
        """Return the link statistics of each device that counts them, by serial number, or model where it has none."""
        devices = [(name or self.models[0].name, device) for name, device in self._devices]
        return {name: device.link_statistics() for name, device in devices if isinstance(device, StreamingSensor)}

    def listen(self, listener: Listener) -> None:
        """Pass every sample that :meth:`read` takes from here on to a listener."""
        self._listeners.append(listener)

    def read(self, *, fresh: bool = False) -> Sample:
        """Take one sample of every sensor.

        Parameters
        ----------
        fresh : bool
            Whether what the sensors sent before is dropped first.

        Raises
        ------
        SensorError
            One of them failed.
        """
        if fresh:
            self.discard()
        readings: list[Reading] = []
        for name, device in self._devices:
            with self._named(name):
                readings.append(device.read())
        if self._thermometer is not None:
            temperature = readings.pop().temperature
            readings = [replace(reading, temperature=temperature) for reading in readings]
        for listener in self._listeners:
            listener(self.by_serial(readings))
        return tuple(readings)

    def by_serial(self, sample: Sequence[Reading]) -> dict[str, Reading]:
        """Return the readings of a sample by serial number."""
        return {sensor.serial: reading for sensor, reading in zip(self.sensors, sample, strict=True)}

    def read_available(self, *, fresh: bool = False) -> tuple[list[Reading | None], list[str]]:
        """Return one sample of every sensor that answers, None for the others, and why they did not.

        Parameters
        ----------
        fresh : bool
            Whether what the sensors sent before is dropped first, and again after the wait for one that fails.
        """
        devices = self._devices
        for _, device in devices if fresh else ():
            with suppress(HardwareError):  # its reading fails as well, and says why
                device.discard()
        readings: list[Reading | None] = []
        reasons: list[str] = []
        for name, device in devices:
            try:
                with self._named(name):
                    if fresh and reasons:
                        device.discard()
                    readings.append(device.read())
            except SensorError as error:
                readings.append(None)
                reasons.append(str(error))
        if self._thermometer is not None:
            last = readings.pop()
            temperature = None if last is None else last.temperature
            readings = [reading and replace(reading, temperature=temperature) for reading in readings]
        return readings, reasons

    def discard(self) -> None:
        """Drop what the sensors sent before now; SensorError where one of them failed."""
        for name, device in self._devices:
            with self._named(name):
                device.discard()

    def succeeded(self) -> None:
        """Note a success: failures from here on count anew."""
        self._failures.clear()
        self._just_lost.clear()

    def failed(self, error: SensorError, *, live: bool, needed: bool = False) -> None:
        """Count a failure; where the session cannot go on, raise the error that ends it.

        Parameters
        ----------
        live : bool
            Whether it happens now. A failure of a journal that is played ended the session before; it was resumed
            after a repair, so what was given up with it counts again.
        needed : bool
            Whether the session cannot go on without the sensor.
        """
        if self.count_failure(error, needed=needed):
            return
        if live:
            raise self._ending(error)
        for serial in self._just_lost:
            del self.lost[serial]
        self.succeeded()

    def count_failure(self, error: SensorError, *, needed: bool = False) -> bool:
        """Count a failure, and return whether the session can go on.

        A sensor that fails :data:`ATTEMPTS` times in a row is given up where others remain, and it is not ``needed``.
        """
        if isinstance(error.__cause__, BusError):
            self.reopened.add(error.serial)
        count = self._failures[error.serial] = self._failures.get(error.serial, 0) + 1
        if count < ATTEMPTS:
            return True
        if needed or error.serial == self.THERMOMETER or len(self.sensors) == 1:
            return False
        self.lost[error.serial] = str(error)
        self._just_lost.append(error.serial)
        return True

    def _ending(self, error: SensorError) -> SensorError:
        """Return the error that ends the session, with the sensors that were given up since the last success."""
        if not self._just_lost:
            return error
        return SensorError(
            error.serial,
            f"{error}; before it {', '.join(self._just_lost)} failed: is a supply, a line or an adapter of all of them "
            "down? After --resume they are measured again",
        )

    @contextmanager
    def _named(self, serial: str) -> Iterator[None]:
        """Name the device of an error; an interruption of the session is an error of none."""
        try:
            yield
        except Interruption:
            raise
        except HardwareError as error:
            alone = len(self._all) == 1 and serial != self.THERMOMETER
            raise SensorError(serial, str(error) if alone else f"{serial or 'thermometer'}: {error}") from error


def open_device(
    device: DeviceSetup, virtual: VirtualBench, lines: MutableMapping[str, ModbusLine] | None = None
) -> Link:
    """Return the live link of one device.

    Parameters
    ----------
    lines : mapping of str to ModbusLine, optional
        The lines of the devices that were opened before, which share them.

    HardwareError: it cannot be opened.
    """
    address = parse_address(device.address)
    return virtual.twin(device) if address.simulated else open_link(address, device.model, lines)


def _open_same(
    device: DeviceSetup,
    virtual: VirtualBench,
    lines: MutableMapping[str, ModbusLine],
    clock: Clock,
    serials: MutableMapping[str, str],
) -> Link:
    """Open a device as :func:`open_device`, and refuse a part with another serial number than it stated before.

    As with :func:`probe_devices` the journal has only the error.
    """
    link = open_device(device, virtual, lines)
    driver = device.model.driver(link, clock)
    if not isinstance(driver, IdentifiedSensor) or parse_address(device.address).simulated:
        return link
    try:
        serial = driver.serial_number()
        if serial != (first := serials.setdefault(device.serial, serial)):
            raise BusError(f"another part answers: its serial number is {serial}, it was {first}; connect that one")
    except HardwareError as error:
        link.close()
        raise BusError(str(error)) from error
    return link


def probe_devices(
    devices: Sequence[DeviceSetup], virtual: VirtualBench, clock: Clock, *, read: bool = False
) -> list[Reading]:
    """Open one device after the other, check that it answers, and return a reading of each where it is to be read.

    UsageError: an option of an address is wrong, or contradicts that of another device on the same line.
    HardwareError: a device that cannot be opened, or does not answer.
    """
    lines: dict[str, ModbusLine] = {}
    readings = []
    for device in devices:
        with closing(open_device(device, virtual, lines)) as link:
            driver = device.model.driver(link, clock)
            driver.probe()
            readings += [driver.read()] if read else []
    return readings


@contextmanager
def connected(
    sensors: Sequence[DeviceSetup], thermometer: DeviceSetup | None, log: EventLog, clock: Clock, virtual: VirtualBench
) -> Iterator[SensorSet]:
    """Connect the devices of a bench through an event log, and close their links at the end of the block.

    Parameters
    ----------
    log : EventLog
        Numbers the devices in their order, the thermometer last.
    clock : Clock
        What drivers wait on.
    virtual : VirtualBench
        Makes the twins of ``sim:`` addresses.
    """
    devices = with_thermometer(sensors, thermometer)
    lines: dict[str, ModbusLine] = {}
    links = [
        RecordedLink(
            log,
            partial(_open_same, device, virtual, lines, clock, {}),
            link_letter(parse_address(device.address), device.model),
            number,
        )
        for number, device in enumerate(devices)
    ]
    drivers = [device.model.driver(link, clock) for device, link in zip(devices, links, strict=True)]
    at_work = [
        ConnectedSensor(sensor.model, sensor.serial, driver, sensor.orientation)
        for sensor, driver in zip(sensors, drivers, strict=False)
    ]
    try:
        yield SensorSet(at_work, drivers[-1] if thermometer is not None else None)
    finally:
        for link in links:
            link.close()

"""The sensors of a bench, connected and read together, real or virtual; every transaction is recorded."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, MutableMapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cached_property, partial
from math import radians
from typing import TYPE_CHECKING, Any

from tiltcal.bench.setup import BenchDevice
from tiltcal.core.attitude import STRAIGHT, Orientation, Vector
from tiltcal.core.model import Mounting
from tiltcal.drivers.bus import link_letter, open_link
from tiltcal.drivers.bus.address import Address, parse_address
from tiltcal.drivers.bus.clock import Clock, session_clock
from tiltcal.drivers.bus.link import CaptureEnded, Continuing, Link
from tiltcal.drivers.model import IdentifiedSensor, Model, Reading, Sensor, StreamingSensor
from tiltcal.drivers.virtual import Fixture, Truth
from tiltcal.errors import BusError, HardwareError, SensorError
from tiltcal.files.calibration import SensorIdentity
from tiltcal.files.journal import HARDWARE_ERROR, JournalWriter
from tiltcal.files.twin import read_twin

if TYPE_CHECKING:
    from tiltcal.drivers.bus.modbus import ModbusLine

Sample = tuple[Reading, ...]
"""One reading of each sensor of a set, in its order."""

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
    """

    THERMOMETER = ""
    """The thermometer of the bench among the names of its devices: no sensor has this serial number."""

    def __init__(self, connected: Sequence[ConnectedSensor], thermometer: Sensor | None = None) -> None:
        self._all = tuple(connected)
        self._listeners: list[Callable[[Mapping[str, Reading]], None]] = []
        self._thermometer = thermometer
        self._failures: dict[str, int] = {}
        self._just_lost: list[str] = []
        """The sensors that were given up since the last success."""
        self.lost: dict[str, str] = {}

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

    def listen(self, listener: Callable[[Mapping[str, Reading]], None]) -> None:
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

    def give_up(self, lost: Mapping[str, str]) -> None:
        """Leave sensors out that a session before an interruption gave up, with the reasons by serial number."""
        self.lost.update(lost)

    def succeeded(self) -> None:
        """Note a success: failures from here on count anew."""
        self._failures.clear()
        self._just_lost.clear()

    def failed(self, error: SensorError, *, needed: bool = False) -> None:
        """Count a failure; where the session cannot go on, raise the error that ends it.

        ``needed`` says whether the session cannot go on without the sensor.
        """
        if not self.count_failure(error, needed=needed):
            raise self._ending(error)

    def count_failure(self, error: SensorError, *, needed: bool = False) -> bool:
        """Count a failure, and return whether the session can go on.

        A sensor that fails :data:`ATTEMPTS` times in a row is given up where others remain, and it is not ``needed``.
        """
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
        """Name the device of an error."""
        try:
            yield
        except HardwareError as error:
            raise named_error(serial, error, alone=len(self._all) == 1) from error


def named_error(serial: str, error: HardwareError, *, alone: bool) -> SensorError:
    """Return an error with the name of its device, unless that is the only sensor; empty is the thermometer."""
    text = str(error) if alone and serial != SensorSet.THERMOMETER else f"{serial or 'thermometer'}: {error}"
    return SensorError(serial, text)


class Recorder:
    """Appends what happens to a journal, with the time since the event before.

    Parameters
    ----------
    clock : Clock
        Stamps the events.
    writer : JournalWriter, optional
        Without one the events are only counted.
    now_ns : int
        When the last event of the journal was, in nanoseconds since the session began.
    """

    def __init__(self, clock: Clock, writer: JournalWriter | None = None, now_ns: int = 0) -> None:
        self._clock = clock
        self._writer = writer
        self.now_ns = now_ns
        self.line = 0 if writer is None else writer.line
        """The line of the last event."""

    def record(self, kind: str, *payload: Any) -> None:
        """Append what has just happened."""
        now_ns = max(self._clock.now_ns(), self.now_ns)
        if self._writer is not None:
            self._writer.append(now_ns - self.now_ns, kind, *payload)
        self.now_ns = now_ns
        self.line += 1

    def secure(self) -> None:
        """Wait until all that was recorded is on the disk."""
        if self._writer is not None:
            self._writer.secure()


class RecordedClock:
    """The clock of drivers: its time is that of the last event, so that a replay gives them the same times."""

    real = False

    def __init__(self, recorder: Recorder, clock: Clock) -> None:
        self._recorder = recorder
        self._clock = clock

    def now_ns(self) -> int:
        return self._recorder.now_ns

    def sleep(self, seconds: float) -> None:
        self._clock.sleep(seconds)

    def seek(self, now_ns: int) -> None:
        self._clock.seek(now_ns)


class RecordedLink:
    """A link whose transactions are recorded.

    Parameters
    ----------
    connect : callable
        Opens the real link; called when it is first needed, and again after an error.
    letter : str
        The bus in the journal.
    number : int
        The device in the journal.
    last_answer : bytes
        What the device answered last before the session was interrupted: recorded data go on behind it.
    """

    def __init__(
        self, recorder: Recorder, connect: Callable[[], Link], letter: str, number: int, last_answer: bytes = b""
    ) -> None:
        self.letter = letter
        self._recorder = recorder
        self._connect = connect
        self._device = (number,) if number else ()
        self._live: Link | None = None
        self._last_answer = last_answer

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Carry out one transaction; after an error the next one opens the bus anew, so a re-plugged sensor goes on."""
        try:
            if self._live is None:
                self._live = self._connect()
                if isinstance(self._live, Continuing) and self._last_answer:
                    self._live.go_on_after(self._last_answer)
            answer = self._live.exchange(out, count)
        except BusError as error:
            if not isinstance(error, CaptureEnded):
                self.close()
            self._recorder.record(HARDWARE_ERROR, out.hex(), str(error), *self._device)
            raise
        self._recorder.record(self.letter, out.hex(), answer.hex(), *self._device)
        self._last_answer = answer or self._last_answer
        return answer

    def close(self) -> None:
        if self._live is not None:
            self._live.close()
            self._live = None


def open_device(
    device: BenchDevice, virtual: VirtualBench, lines: MutableMapping[str, ModbusLine] | None = None
) -> Link:
    """Return the live link of one device.

    Parameters
    ----------
    lines : mapping of str to ModbusLine, optional
        The lines of the devices that were opened before, which share them.

    HardwareError: it cannot be opened.
    """
    address = parse_address(device.address)
    return virtual.twin(device) if address.simulated else open_link(address, device.wired, lines)


def _open_same(
    device: BenchDevice,
    virtual: VirtualBench,
    lines: MutableMapping[str, ModbusLine],
    clock: Clock,
    serials: MutableMapping[str, str],
) -> Link:
    """Open a device as :func:`open_device`, and refuse a part with another serial number than it stated before.

    As with :func:`probe_devices` the journal has only the error.
    """
    link = open_device(device, virtual, lines)
    driver = device.wired.driver(link, clock)
    if not isinstance(driver, IdentifiedSensor) or device.simulated:
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
def connected(
    devices: Sequence[BenchDevice],
    thermometer: bool,
    recorder: Recorder,
    clock: Clock,
    virtual: VirtualBench,
    last_answers: Mapping[int, bytes] | None = None,
) -> Iterator[SensorSet]:
    """Connect the devices of a bench, and close their links at the end of the block.

    Parameters
    ----------
    devices : sequence of BenchDevice
        In the order in which the journal numbers them.
    thermometer : bool
        Whether the last of them is the thermometer of all.
    clock : Clock
        What drivers wait on.
    virtual : VirtualBench
        Makes the twins of ``sim:`` addresses.
    last_answers : mapping of int to bytes, optional
        What each device answered last before the session was interrupted.
    """
    lines: dict[str, ModbusLine] = {}
    links = [
        RecordedLink(
            recorder,
            partial(_open_same, device, virtual, lines, clock, {}),
            letter_of(device),
            number,
            (last_answers or {}).get(number, b""),
        )
        for number, device in enumerate(devices)
    ]
    drivers = [device.wired.driver(link, clock) for device, link in zip(devices, links, strict=True)]
    at_work = [
        ConnectedSensor(device.wired, device.serial, driver, device.orientation)
        for device, driver in zip(devices, drivers, strict=True)
    ]
    try:
        yield SensorSet(at_work[:-1], drivers[-1]) if thermometer else SensorSet(at_work)
    finally:
        for link in links:
            link.close()


def letter_of(device: BenchDevice) -> str:
    """Return the bus of a device in a journal."""
    return link_letter(parse_address(device.address), device.wired)


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


class VirtualBench:
    """Makes the twins of a session and the fixture that holds them.

    Parameters
    ----------
    devices : sequence of BenchDevice
        The devices; ``sim:`` addresses take ``twin=FILE`` and ``seed=N``.
    """

    def __init__(self, clock: Clock, devices: Sequence[BenchDevice]) -> None:
        self._clock = clock
        self._first = next((device for device in devices if device.simulated), None)

    @cached_property
    def fixture(self) -> Fixture:
        """The jig and the chamber, with the errors that the truth of the first virtual sensor states."""
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

    roll, pitch, yaw = map(radians, truth.mounting)
    to_sensor = mounting_matrix(Mounting(roll, pitch, yaw)).T.tolist()

    def seen(vector: Vector) -> Vector:
        straight = device.orientation.seen(vector)
        x, y, z = (sum(a * b for a, b in zip(row, straight, strict=True)) for row in to_sensor)
        return x, y, z

    return seen


def truth_of(address: Address, model: Model) -> Truth:
    """Return the truth of the virtual sensor behind a ``sim:`` address.

    UsageError: an unknown option, or a twin file of another model or with too few channels.
    InputError: the twin file is wrong.
    """
    address.allow("twin", "seed", *model.options)
    seed = address.integer("seed", 0)
    if "twin" not in address.options:
        if model.default_truth is None:
            address.refuse(f"{model.name} has no default twin; name one with twin=FILE")
        return model.default_truth(seed)
    named, truth = read_twin(address.text("twin"), seed if "seed" in address.options else None)
    if named is not None and named != model.name:
        address.refuse(f"the twin file is of a {named}, not of a {model.name}")
    missing = [channel for channel in model.channels if channel not in truth.channels]
    if missing:
        address.refuse(f"the twin file has no {' and no '.join(missing)}, which a {model.name} reads")
    return truth

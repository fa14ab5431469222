"""The devices of a bench, real or virtual: opened, connected and read together; every transaction is recorded."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, MutableMapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from datetime import UTC, datetime
from functools import cached_property, partial
from math import radians
from typing import TYPE_CHECKING, Any

from tiltcal.core.attitude import Vector
from tiltcal.drivers.bus import CaptureEnded, Link, open_link
from tiltcal.drivers.bus.address import Address
from tiltcal.drivers.bus.clock import Clock, session_clock
from tiltcal.drivers.model import Model, Reading, Sensor
from tiltcal.errors import BusError, HardwareError, SensorError
from tiltcal.files.bench import BenchSensor, with_device_file
from tiltcal.journal.header import OF_THE_BENCH, THERMOMETER
from tiltcal.journal.lines import HARDWARE_ERROR, JournalWriter
from tiltcal.journal.playback import Sample, at_one_temperature, named_error

if TYPE_CHECKING:
    from tiltcal.drivers.bus.modbus import ModbusLine
    from tiltcal.drivers.virtual import Fixture, Truth


ATTEMPTS = 5  # failures in a row after which a sensor is given up
RECOVERY = 1.0  # seconds that a bus is left alone after an error


class VirtualBench:
    """Makes the twins of a session and the fixture that holds them."""

    def __init__(self, clock: Clock, devices: Sequence[BenchSensor]) -> None:
        self._clock, self._devices = clock, devices

    @cached_property
    def fixture(self) -> Fixture:
        """The jig and the chamber, with the errors that the truth of the first virtual sensor states."""
        from tiltcal.drivers.virtual import Fixture

        first = next(device for device in self._devices if device.simulated)
        truth = truth_of(first.parsed_address, first.wired)
        return Fixture(
            self._clock, seed=truth.seed, jig=truth.jig, ambient=truth.ambient, time_constant=truth.time_constant
        )

    def twin(self, device: BenchSensor) -> Link:
        """Return the virtual sensor behind a ``sim:`` address."""
        from tiltcal.drivers.virtual import Pose

        truth = truth_of(device.parsed_address, device.wired)
        return device.wired.twin(truth, Pose(self.fixture, _to_sensor(device, truth)), self._clock)


def _to_sensor(device: BenchSensor, truth: Truth) -> Callable[[Vector], Vector]:
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
    device: BenchSensor, virtual: VirtualBench, lines: MutableMapping[str, ModbusLine] | None = None
) -> Link:
    """Return the live link of one device; ``lines`` are those that the devices opened before share.

    HardwareError: it cannot be opened.
    """
    return virtual.twin(device) if device.simulated else open_link(device.parsed_address, device.wired, lines)


def open_same(
    device: BenchSensor, virtual: VirtualBench, lines: MutableMapping[str, ModbusLine], clock: Clock, stated: list[str]
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
        raise BusError(error.words) from error
    return link


def probe_devices(devices: Sequence[BenchSensor], clock: Clock) -> None:
    """Open one device after the other, and check that it answers.

    UsageError: an option of an address is wrong, or contradicts that of another device on the same line.
    HardwareError: a device that cannot be opened, or does not answer.
    """
    virtual, lines = VirtualBench(clock, devices), dict[str, "ModbusLine"]()
    for device in devices:
        with closing(open_device(device, virtual, lines)) as link:
            device.wired.driver(link, clock).probe()


class SensorSet:
    """Reads several sensors as one, and gives up those that fail for good.

    ``beside`` are a thermometer, whose temperature stands for that of every sensor, and a reference. ``lost`` says why
    sensors were given up, by serial number; ``sensors`` are the others, ``models`` those as they are wired.
    """

    def __init__(
        self, sensors: Sequence[BenchSensor], drivers: Sequence[Sensor], beside: Mapping[str, Sensor] | None = None
    ) -> None:
        self.beside = beside or {}
        self.lost: dict[str, str] = {}
        self._all = list(zip(sensors, drivers, strict=True))
        self._failures: dict[str, int] = {}
        self._just_lost: list[str] = []
        self.give_up({})

    def give_up(self, lost: Mapping[str, str]) -> None:
        """Leave sensors out, with the reasons by serial number."""
        self.lost.update(lost)
        at_work = [(sensor, driver) for sensor, driver in self._all if sensor.serial not in self.lost]
        self.sensors = [sensor for sensor, _ in at_work]
        self.models = {sensor.serial: sensor.wired for sensor in self.sensors}
        self._drivers = {sensor.serial: driver for sensor, driver in at_work}
        self._drivers |= self.beside

    @property
    def interval(self) -> float:
        """Seconds after which every sensor has a new reading."""
        return max(model.interval for model in self.models.values())

    def read(self, *, fresh: bool = False) -> Sample:
        """Take one sample of every sensor; where it is to be ``fresh``, what they sent before is dropped first.

        SensorError: one of them failed.
        """
        readings: dict[str, Reading] = {}
        for discards in (True, False) if fresh else (False,):
            for name, driver in self._drivers.items():
                try:
                    if discards:
                        driver.discard()
                    else:
                        readings[name] = driver.read()
                except HardwareError as error:
                    raise named_error(name, error, alone=len(self._all) == 1) from error
        return at_one_temperature(readings)

    def read_available(self, *, fresh: bool = False) -> tuple[Sample, list[str]]:
        """Return one sample of every sensor that answers, and why the others did not."""
        readings: dict[str, Reading] = {}
        reasons: list[str] = []
        for name, driver in self._drivers.items():
            try:
                if fresh:
                    driver.discard()
                readings[name] = driver.read()
            except HardwareError as error:
                reasons.append(str(named_error(name, error, alone=len(self._all) == 1)))
        if THERMOMETER in self.beside:
            readings.setdefault(THERMOMETER, Reading(()))
        return at_one_temperature(readings), reasons

    def link_statistics(self) -> dict[str, Mapping[str, int]]:
        """Return the link statistics of each device that counts them, by serial number, or model where it has none."""
        counted = {name: driver.link_statistics() for name, driver in self._drivers.items()}
        return {name or self.sensors[0].model: counts for name, counts in counted.items() if counts}

    def succeeded(self) -> None:
        """Note a success: failures from here on count anew."""
        self._failures.clear()
        self._just_lost.clear()

    def failed(self, error: SensorError, *, needed: bool = False) -> None:
        """Count a failure; one sensor too many, or that is ``needed``, ends the session with the error that is raised.

        A sensor that fails :data:`ATTEMPTS` times in a row is given up where others remain.
        """
        count = self._failures[error.serial] = self._failures.get(error.serial, 0) + 1
        if count < ATTEMPTS:
            return
        if not needed and error.serial not in OF_THE_BENCH and len(self.sensors) > 1:
            self._just_lost.append(error.serial)
            self.give_up({error.serial: str(error)})
        elif self._just_lost:
            raise SensorError(
                error.serial,
                (
                    *error.words,
                    f"; before it {', '.join(self._just_lost)} failed: is a supply, a line or an adapter of all of "
                    "them down? After --resume they are measured again",
                ),
            )
        else:
            raise error


class Recorder:
    """Appends what happens to a journal, and is the clock of drivers.

    Its time, ns since the session began, is that of the last event, so a replay gives the drivers the same times.
    Without a writer nothing is recorded.
    """

    def __init__(self, clock: Clock, writer: JournalWriter | None = None, now_ns: int = 0) -> None:
        self._clock = clock
        self._writer = writer
        self._now_ns = now_ns

    @property
    def line(self) -> int:
        """The line of the last event."""
        return 0 if self._writer is None else self._writer.line

    def now_ns(self) -> int:
        return self._now_ns

    def sleep(self, seconds: float) -> None:
        self._clock.sleep(seconds)

    def seek(self, now_ns: int) -> None:
        self._clock.seek(now_ns)

    def record(self, kind: str, *payload: Any) -> None:
        """Append what has just happened."""
        now_ns = max(self._clock.now_ns(), self._now_ns)
        if self._writer is not None:
            self._writer.append(now_ns - self._now_ns, kind, *payload)
        self._now_ns = now_ns

    def secure(self) -> None:
        """Wait until all that was recorded is on the disk."""
        if self._writer is not None:
            self._writer.secure()


class RecordedLink:
    """A link whose transactions are recorded.

    ``connect`` opens the real link when it is first needed, and again after an error, so a re-plugged sensor goes on.
    ``number`` is the device in the journal.
    """

    def __init__(self, recorder: Recorder, connect: Callable[[], Link], letter: str, number: int) -> None:
        self.letter = letter
        self._recorder = recorder
        self._connect = connect
        self._device = (number,) if number else ()
        self._live: Link | None = None

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Carry out one transaction."""
        try:
            if self._live is None:
                self._live = self._connect()
            answer = self._live.exchange(out, count)
        except BusError as error:
            if not isinstance(error, CaptureEnded):
                self.close()
            self._recorder.record(HARDWARE_ERROR, out.hex(), str(error), *self._device)
            raise
        self._recorder.record(self.letter, out.hex(), answer.hex(), *self._device)
        return answer

    def close(self) -> None:
        if self._live is not None:
            self._live.close()
            self._live = None


@contextmanager
def connected(
    sensors: Sequence[BenchSensor],
    beside: Mapping[str, BenchSensor],
    recorder: Recorder,
    virtual: VirtualBench,
) -> Iterator[SensorSet]:
    """Connect the devices of a bench, and close their links at the end of the block."""
    lines: dict[str, ModbusLine] = {}
    drivers = []
    with ExitStack() as stack:
        for number, device in enumerate((*sensors, *beside.values())):
            connect = partial(open_same, device, virtual, lines, recorder, [])
            link = RecordedLink(recorder, connect, device.letter, number)
            stack.callback(link.close)
            drivers.append(device.wired.driver(link, recorder))
        yield SensorSet(sensors, drivers[: len(sensors)], dict(zip(beside, drivers[len(sensors) :], strict=True)))


@contextmanager
def open_sensor(model: str, address: str) -> Iterator[Sensor]:
    """Open one sensor to be read, and close it at the end of the block.

    Parameters
    ----------
    model : str
        Such as ``sca100t-d02``, or a device file.
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
    device = with_device_file(BenchSensor("", model, address))
    clock = session_clock(datetime.now(UTC), virtual=device.simulated)
    with closing(open_device(device, VirtualBench(clock, [device]))) as link:
        yield device.wired.driver(link, clock)

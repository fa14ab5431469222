"""The sensors of a bench, connected and read together; every transaction is recorded."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from tiltcal.bench import devices as bench_devices
from tiltcal.bench.devices import BenchDevice, VirtualBench
from tiltcal.drivers.bus import CaptureEnded, Link
from tiltcal.drivers.bus.clock import Clock
from tiltcal.drivers.model import Model, Reading, Sensor
from tiltcal.errors import BusError, HardwareError, SensorError
from tiltcal.files.journal import HARDWARE_ERROR, JournalWriter

if TYPE_CHECKING:
    from tiltcal.drivers.bus.modbus import ModbusLine

Sample = tuple[Reading, ...]
"""One reading of each sensor of a set, in its order."""

ATTEMPTS = 5  # failures in a row after which a sensor is given up
RECOVERY = 1.0  # seconds that a bus is left alone after an error
THERMOMETER = ""  # the thermometer of the bench among the names of its devices: no sensor has this serial number


class SensorSet:
    """Reads several sensors as one, and gives up those that fail for good.

    The temperature of ``thermometer``, where there is one, stands for that of every sensor. ``lost`` says why sensors
    were given up, by serial number; ``sensors`` and ``models`` are the others. ``listeners`` get every sample that
    :meth:`read` takes, by serial number.
    """

    def __init__(
        self, sensors: Sequence[BenchDevice], drivers: Sequence[Sensor], thermometer: Sensor | None = None
    ) -> None:
        self.thermometer = thermometer
        self.lost: dict[str, str] = {}
        self.listeners: list[Callable[[Mapping[str, Reading]], None]] = []
        self._all = list(zip(sensors, drivers, strict=True))
        self._failures: dict[str, int] = {}
        self._just_lost: list[str] = []
        self.give_up({})

    def give_up(self, lost: Mapping[str, str]) -> None:
        """Leave sensors out, with the reasons by serial number."""
        self.lost.update(lost)
        at_work = [(sensor, driver) for sensor, driver in self._all if sensor.serial not in self.lost]
        self.sensors = tuple(sensor for sensor, _ in at_work)
        self.models: tuple[Model, ...] = tuple(sensor.wired for sensor in self.sensors)
        self._drivers = [(sensor.serial, driver) for sensor, driver in at_work]
        self._drivers += [] if self.thermometer is None else [(THERMOMETER, self.thermometer)]

    def read(self, *, fresh: bool = False) -> Sample:
        """Take one sample of every sensor; where it is to be ``fresh``, what they sent before is dropped first.

        SensorError: one of them failed.
        """
        if fresh:
            self.discard()
        readings: list[Reading] = []
        for name, driver in self._drivers:
            try:
                readings.append(driver.read())
            except HardwareError as error:
                raise self._named(name, error) from error
        if self.thermometer is not None:
            temperature = readings.pop().temperature
            readings = [replace(reading, temperature=temperature) for reading in readings]
        for listener in self.listeners:
            listener(self.by_serial(readings))
        return tuple(readings)

    def by_serial(self, sample: Sequence[Reading]) -> dict[str, Reading]:
        """Return the readings of a sample by serial number."""
        return {sensor.serial: reading for sensor, reading in zip(self.sensors, sample, strict=True)}

    def read_available(self, *, fresh: bool = False) -> tuple[list[Reading | None], list[str]]:
        """Return one sample of every sensor that answers, None for the others, and why they did not."""
        readings: list[Reading | None] = []
        reasons: list[str] = []
        for name, driver in self._drivers:
            try:
                if fresh:
                    driver.discard()
                readings.append(driver.read())
            except HardwareError as error:
                readings.append(None)
                reasons.append(str(self._named(name, error)))
        if self.thermometer is not None:
            last = readings.pop()
            temperature = None if last is None else last.temperature
            readings = [reading and replace(reading, temperature=temperature) for reading in readings]
        return readings, reasons

    def discard(self) -> None:
        """Drop what the sensors sent before now; SensorError where one of them failed."""
        for name, driver in self._drivers:
            try:
                driver.discard()
            except HardwareError as error:
                raise self._named(name, error) from error

    def _named(self, name: str, error: HardwareError) -> SensorError:
        return named_error(name, error, alone=len(self._all) == 1)

    def link_statistics(self) -> dict[str, Mapping[str, int]]:
        """Return the link statistics of each device that counts them, by serial number, or model where it has none."""
        drivers = [(name or self.models[0].name, driver) for name, driver in self._drivers]
        return {name: counts for name, driver in drivers if (counts := driver.link_statistics())}

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
        if not needed and error.serial != THERMOMETER and len(self.sensors) > 1:
            self._just_lost.append(error.serial)
            self.give_up({error.serial: str(error)})
        elif self._just_lost:
            raise SensorError(
                error.serial,
                f"{error}; before it {', '.join(self._just_lost)} failed: is a supply, a line or an adapter of all of "
                "them down? After --resume they are measured again",
            )
        else:
            raise error


def named_error(name: str, error: HardwareError, *, alone: bool) -> SensorError:
    """Return an error with the name of its device, unless that is the only sensor."""
    text = str(error) if alone and name != THERMOMETER else f"{name or 'thermometer'}: {error}"
    return SensorError(name, text)


class Recorder:
    """Appends what happens to a journal, and is the clock of drivers.

    Its time, ns since the session began, is that of the last event, so a replay gives the drivers the same times.
    ``line`` is the line of that event. Without a writer the events are only counted.
    """

    real = False

    def __init__(self, clock: Clock, writer: JournalWriter | None = None, now_ns: int = 0) -> None:
        self._clock = clock
        self._writer = writer
        self._now_ns = now_ns
        self.line = 0 if writer is None else writer.line

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
        self.line += 1

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
    sensors: Sequence[BenchDevice],
    thermometer: BenchDevice | None,
    recorder: Recorder,
    virtual: VirtualBench,
) -> Iterator[SensorSet]:
    """Connect the devices of a bench, and close their links at the end of the block."""
    lines: dict[str, ModbusLine] = {}
    drivers = []
    with ExitStack() as stack:
        for number, device in enumerate(sensors if thermometer is None else (*sensors, thermometer)):
            connect = partial(bench_devices.open_same, device, virtual, lines, recorder, [])
            link = RecordedLink(recorder, connect, device.letter, number)
            stack.callback(link.close)
            drivers.append(device.wired.driver(link, recorder))
        yield SensorSet(sensors, drivers[: len(sensors)], *drivers[len(sensors) :])

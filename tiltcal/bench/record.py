"""Recording a bench to a log: every sensor's readings, row by row, until someone stops it.

The operating system has a row as soon as it is written, and the disk has it within a second: Ctrl-C loses no row, and a
power cut those of a second.
"""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from tiltcal.bench.devices import VirtualBench, probe_devices
from tiltcal.bench.sensors import Recorder, SensorSet, connected
from tiltcal.bench.setup import column_name, sensors_of, thermometer_of
from tiltcal.drivers.bus.clock import VIRTUAL_START, Clock, session_clock
from tiltcal.drivers.model import Model, Reading, link_in_words
from tiltcal.errors import UsageError
from tiltcal.files.atomic import BINARY, append_whole, sync_data
from tiltcal.files.bench import BenchFile
from tiltcal.files.moments import moment_after, stamp

if TYPE_CHECKING:
    from tiltcal.bench.playback import RecordedSample
    from tiltcal.bench.setup import Setup

SECURE_NS = 1_000_000_000  # time that a row may wait for the disk, ns


@dataclass
class RecordingTally:
    """The content of a recording so far: rows, and readings that are missing, with the last reason.

    ``interrupted`` is whether it was stopped before its end; ``link_statistics`` are by device what was used, damaged
    and lost on its line.
    """

    rows: int = 0
    missing: int = 0
    why: str = ""
    interrupted: bool = False
    link_statistics: Mapping[str, Mapping[str, int]] = field(default_factory=dict)

    @property
    def losses_in_words(self) -> str:
        """The missing readings as the end of a line, and the link statistics as lines of text."""
        missing = f", {self.missing} readings missing ({self.why})" if self.missing else ""
        return missing + "".join(
            f"\n{device}: {link_in_words(counts)}" for device, counts in self.link_statistics.items()
        )


class CsvRecorder:
    """A CSV log that rows are appended to, made anew; ``rows`` are those below its header.

    UsageError: the file exists, or cannot be made.
    """

    def __init__(self, path: Path, header: Sequence[str]) -> None:
        try:
            self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | BINARY, 0o644)
        except FileExistsError:
            raise UsageError(f"{path} exists; a recording never replaces one: name another file") from None
        except OSError as error:
            raise UsageError(f"cannot write {path}: {error.strerror}") from None
        self._path = path
        self._size = self._appended = 0
        self.rows = -1
        self.write(header)

    def write(self, cells: Sequence[str]) -> None:
        """Append one row, whole or not at all; a UsageError where the disk is full or fails."""
        row = _row(cells)
        self._appended = len(row)
        try:
            append_whole(self._descriptor, row, self._size)
        except OSError as error:
            raise self._failed(error) from error
        self._count_row()

    def secure(self) -> None:
        """Wait until all rows are on the disk; a UsageError where it fails."""
        try:
            sync_data(self._descriptor)
        except OSError as error:
            if error.errno not in (errno.EINVAL, errno.EROFS):  # a pipe or a device has nothing to secure
                raise self._failed(error) from error

    def close(self) -> None:
        """Secure the rows and close the file.

        A row that Ctrl-C met after it was written and before it was counted counts; a part of a row is taken away.
        """
        try:
            beyond = os.fstat(self._descriptor).st_size - self._size
            if beyond == self._appended:
                self._count_row()
            elif beyond > 0:
                os.ftruncate(self._descriptor, self._size)
            self.secure()
        finally:
            os.close(self._descriptor)

    def _count_row(self) -> None:
        self._size, self.rows = self._size + self._appended, self.rows + 1

    def _failed(self, error: OSError) -> UsageError:
        return UsageError(
            f"cannot write {self._path}: {error.strerror}; the rows before are kept, go on with another file on a disk "
            "that has room"
        )


def _header(models: Mapping[str, Model], *, thermometer: bool) -> list[str]:
    """Return the columns: ``x``, ``y``, ``temperature`` of a single sensor, ``S-7_x`` and so on of several."""
    names = ["time"]
    for serial, model in models.items():
        beside = ["temperature"] if model.thermometer and not thermometer else []
        names += [column_name(serial, name, alone=len(models) == 1) for name in (*model.channels, *beside)]
    return names + (["temperature"] if thermometer else [])


def write_samples(stream: BinaryIO, setup: Setup, samples: Iterable[RecordedSample]) -> None:
    """Write the samples of a session as the rows of a log; a sensor that was given up leaves its cells empty."""
    models = {device.serial: device.wired for device in setup.sensors}
    thermometer = setup.thermometer is not None
    stream.write(_row(_header(models, thermometer=thermometer)))
    for sample in samples:
        moment = moment_after(setup.began, sample.now_ns)
        readings = [sample.readings.get(serial) for serial in models]
        stream.write(_row(_cells(list(models.values()), readings, moment, thermometer=thermometer)))


def record_bench(
    bench: BenchFile,
    log: Path,
    *,
    rate: float | None,
    rows: int | None,
    seconds: float | None,
    progress: Callable[[RecordingTally], None],
) -> RecordingTally:
    """Record the sensors of a bench to a CSV log, until the limit or Ctrl-C; ``progress`` is called after each row.

    ``rate`` is in rows per second; None is as fast as the sensors renew themselves. With neither ``rows`` nor
    ``seconds`` it goes on until Ctrl-C, which then is no interruption.

    UsageError: the log exists, an address is wrong, or there is no end on the virtual bench.
    HardwareError: a sensor does not answer.
    """
    sensors, thermometer = sensors_of(bench), thermometer_of(bench)
    devices = sensors if thermometer is None else (*sensors, thermometer)
    virtual = all(device.simulated for device in devices)
    interval = 1.0 / rate if rate else max(sensor.wired.interval for sensor in sensors)
    endless = rows is None and seconds is None
    if seconds is not None and interval:
        rows, seconds = min(rows or sys.maxsize, max(1, round(seconds / interval))), None
    if virtual and endless:
        raise UsageError("a recording on the virtual bench needs --rows or --for")
    started = VIRTUAL_START if virtual else datetime.now(UTC)
    clock = session_clock(started, virtual=virtual)
    twins = VirtualBench(clock, devices)
    probe_devices(devices, twins, clock)
    tally = RecordingTally()
    with connected(sensors, thermometer, Recorder(clock), twins) as opened:
        header = _header({one.serial: one.wired for one in sensors}, thermometer=thermometer is not None)
        recorder = CsvRecorder(log, header)
        try:
            for tally in record(opened, recorder, clock, started, interval=interval, rows=rows, seconds=seconds):
                progress(tally)
        except KeyboardInterrupt:
            tally.interrupted = not endless
        finally:
            recorder.close()
            tally.rows, tally.link_statistics = recorder.rows, opened.link_statistics()
    return tally


def record(
    sensors: SensorSet,
    log: CsvRecorder,
    clock: Clock,
    started: datetime,
    *,
    interval: float,
    rows: int | None,
    seconds: float | None = None,
) -> Iterator[RecordingTally]:
    """Take samples at a steady pace, an ``interval`` of seconds apart, and append them to a log; yield after each."""
    tally = RecordingTally()
    # A sensor that talks faster than rows are taken would be read later and later.
    slower = interval > 1.5 * min(model.interval for model in sensors.models)
    begun_ns = due_ns = secured_ns = clock.now_ns()
    while (rows is None or tally.rows < rows) and (seconds is None or clock.now_ns() - begun_ns < seconds * 1e9):
        readings, why = sensors.read_available(fresh=slower or not tally.rows)
        now_ns = clock.now_ns()
        moment, thermometer = moment_after(started, now_ns), sensors.thermometer is not None
        log.write(_cells(sensors.models, readings, moment, thermometer=thermometer))
        tally.rows += 1
        if why:
            tally.missing, tally.why = tally.missing + len(why), why[-1]
        if now_ns - secured_ns >= SECURE_NS:
            log.secure()
            secured_ns = now_ns
        yield tally
        due_ns = max(due_ns + round(interval * 1e9), now_ns - round(interval * 1e9))
        clock.sleep(max(0, due_ns - clock.now_ns()) / 1e9)


def _row(cells: Sequence[str]) -> bytes:
    return (",".join(cells) + "\n").encode()


def _cells(
    models: Sequence[Model], readings: Sequence[Reading | None], moment: datetime, *, thermometer: bool
) -> list[str]:
    cells = [stamp(moment)]
    for model, reading in zip(models, readings, strict=True):
        cells += [""] * len(model.channels) if reading is None else [f"{value:.10g}" for value in reading.values]
        if model.thermometer and not thermometer:
            cells.append(_celsius(reading))
    return cells + ([_celsius(next(filter(None, readings), None))] if thermometer else [])


def _celsius(reading: Reading | None) -> str:
    return "" if reading is None or reading.temperature is None else f"{reading.temperature:.3f}"

"""Recording a bench to a log: every sensor's readings, row by row, until someone stops it.

A row is in the kernel's hands when it is written and on the disk within a second, so Ctrl-C and a pulled plug lose
nothing that was shown.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import BinaryIO

from tiltcal.bench.event_log import EventLog
from tiltcal.bench.sensor_set import ConnectedSensor, Listener, SensorSet
from tiltcal.drivers.bus.clock import Clock
from tiltcal.drivers.device import Reading
from tiltcal.errors import UsageError
from tiltcal.files.journal import write_all
from tiltcal.files.moments import stamp

SECURE_NS = 1_000_000_000
"""Time that a row may wait for the disk, ns."""


@dataclass
class RecordingTally:
    """The content of a recording so far.

    Attributes
    ----------
    missing : int
        Readings that could not be taken; their cells are empty.
    why : str
        The last reason.
    """

    rows: int = 0
    missing: int = 0
    why: str = ""


class CsvRecorder:
    """A log that only grows.

    Parameters
    ----------
    path : Path
        Made anew; an existing file is never touched.

    Attributes
    ----------
    rows : int
        How many it has below its header.
    """

    def __init__(self, path: Path, header: Sequence[str]) -> None:
        try:
            self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND, 0o644)
        except FileExistsError:
            raise UsageError(f"{path} exists; a recording never replaces one: name another file") from None
        except OSError as error:
            raise UsageError(f"cannot write {path}: {error.strerror}") from None
        self._path = path
        self._size = self._appended = 0
        self.rows = -1
        self.write(header)

    def write(self, cells: Sequence[str]) -> None:
        """Append one row, whole or not at all.

        Raises
        ------
        UsageError
            The disk is full or fails; the rows before are kept.
        """
        row = (",".join(cells) + "\n").encode()
        self._appended = len(row)
        try:
            write_all(self._descriptor, row)
        except OSError as error:
            with suppress(OSError):
                os.ftruncate(self._descriptor, self._size)
            raise self._failed(error) from error
        self._count_row()

    def secure(self) -> None:
        """Have all rows on the disk.

        Raises
        ------
        UsageError
            The disk fails.
        """
        try:
            os.fdatasync(self._descriptor)
        except OSError as error:
            if error.errno not in (errno.EINVAL, errno.EROFS):  # a pipe or a device has nothing to secure
                raise self._failed(error) from error

    def close(self) -> None:
        """Secure the rows and let the file go.

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


def column_name(serial: str, channel: str, *, alone: bool) -> str:
    """Return the column of a channel: its name alone, or of several devices behind the serial number."""
    return channel if alone else f"{serial}_{channel}"


def header(connected: Sequence[ConnectedSensor], *, thermometer: bool) -> list[str]:
    """Column names: ``x``, ``y``, ``temperature`` of a single sensor; of several each begins with the serial number."""
    names = ["time"]
    for device in connected:
        own = ["temperature"] if device.model.thermometer and not thermometer else []
        names += [
            column_name(device.serial, name, alone=len(connected) == 1) for name in (*device.model.channels, *own)
        ]
    return names + (["temperature"] if thermometer else [])


def sample_rows(
    stream: BinaryIO, connected: Sequence[ConnectedSensor], started: datetime, events: EventLog, thermometer: bool
) -> Listener:
    """Return a listener that writes samples as the rows of a log; a sensor that was given up leaves its cells empty.

    Parameters
    ----------
    stream : BinaryIO
        Has the header at once.
    started : datetime
        UTC, when the session began.
    events : EventLog
        Says when a sample was taken.
    thermometer : bool
        Whether the bench has one of its own.
    """

    def write(cells: Sequence[str]) -> None:
        stream.write((",".join(cells) + "\n").encode())

    def row(sample: Mapping[str, Reading]) -> None:
        moment = started + timedelta(microseconds=events.now_ns() / 1000)
        write(_cells(connected, [sample.get(device.serial) for device in connected], moment, thermometer))

    write(header(connected, thermometer=thermometer))
    return row


def record(
    sensors: SensorSet,
    log: CsvRecorder,
    clock: Clock,
    started: datetime,
    *,
    thermometer: bool,
    interval: float,
    rows: int | None,
) -> Iterator[RecordingTally]:
    """Take samples at a steady pace and append them to a log.

    Parameters
    ----------
    started : datetime
        UTC, when ``clock`` stood at zero.
    thermometer : bool
        Whether the bench has a thermometer of its own.
    interval : float
        Seconds between rows.
    rows : int or None
        How many; None goes on until the caller stops.

    Yields
    ------
    RecordingTally
        After each row.
    """
    tally = RecordingTally()
    # A sensor that talks faster than rows are taken would be read later and later.
    slower = interval > 1.5 * min(model.interval for model in sensors.models)
    due_ns = secured_ns = clock.now_ns()
    while rows is None or tally.rows < rows:
        readings, why = sensors.read_available(fresh=slower or not tally.rows)
        now_ns = clock.now_ns()
        log.write(_cells(sensors.sensors, readings, started + timedelta(microseconds=now_ns / 1000), thermometer))
        tally.rows += 1
        if why:
            tally.missing, tally.why = tally.missing + len(why), why[-1]
        if now_ns - secured_ns >= SECURE_NS:
            log.secure()
            secured_ns = now_ns
        yield tally
        due_ns = max(due_ns + round(interval * 1e9), now_ns - round(interval * 1e9))
        clock.sleep(max(0, due_ns - clock.now_ns()) / 1e9)


def _cells(
    connected: Sequence[ConnectedSensor], readings: Sequence[Reading | None], moment: datetime, thermometer: bool
) -> list[str]:
    cells = [stamp(moment)]
    common = None
    for device, reading in zip(connected, readings, strict=True):
        cells += [""] * len(device.model.channels) if reading is None else [f"{value:.10g}" for value in reading.values]
        temperature = None if reading is None else reading.temperature
        common = temperature if common is None else common
        if device.model.thermometer and not thermometer:
            cells.append(_temperature(temperature))
    return cells + ([_temperature(common)] if thermometer else [])


def _temperature(value: float | None) -> str:
    return "" if value is None else f"{value:.3f}"

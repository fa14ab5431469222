"""Recording a bench to a log: every sensor's readings, row by row, until someone stops it.

The operating system has a row as soon as it is written, and the disk has it within a second: Ctrl-C loses no row, and a
power cut those of a second.
"""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

from tiltcal.bench.devices import RECOVERY, Recorder, SensorSet, VirtualBench, connected, probe_devices
from tiltcal.drivers.bus.clock import SECOND, VIRTUAL_START, Clock, session_clock
from tiltcal.drivers.model import link_in_words
from tiltcal.errors import Argument, UsageError
from tiltcal.files.atomic import BINARY, append_whole, sync_data
from tiltcal.files.bench import BenchFile
from tiltcal.files.moments import moment_after
from tiltcal.journal.header import THERMOMETER, thermometer_of
from tiltcal.journal.samples import LogColumns, csv_row

SECURE_NS = 1_000_000_000  # time that a row may wait for the disk, ns


class Recording:
    """A CSV log that rows are appended to, made anew.

    ``rows`` are those below its header; ``missing`` counts readings that failed, of which ``why`` is the last reason;
    ``interrupted`` is whether it was stopped before its end; ``link_statistics`` are by device what was used, damaged
    and lost on its line.

    UsageError: the file exists, or cannot be made.
    """

    def __init__(self, path: Path, names: Sequence[str]) -> None:
        try:
            self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | BINARY, 0o644)
        except FileExistsError:
            raise UsageError(f"{path} exists; a recording never replaces one: name another file") from None
        except OSError as error:
            raise UsageError(f"cannot write {path}: {error.strerror}") from None
        self._path = path
        self._size = self._appended = self.missing = 0
        self.rows, self.why, self.interrupted = -1, "", False
        self.link_statistics: Mapping[str, Mapping[str, int]] = {}
        self.append(csv_row(names))

    @property
    def losses_in_words(self) -> str:
        """The missing readings as the end of a line, and the link statistics as lines of text."""
        missing = f", {self.missing} readings missing ({self.why})" if self.missing else ""
        return missing + "".join(
            f"\n{device}: {link_in_words(counts)}" for device, counts in self.link_statistics.items()
        )

    def append(self, row: bytes) -> None:
        """Append one row, whole or not at all; a UsageError where the disk is full or fails."""
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


def record_bench(
    bench: BenchFile,
    log: Path,
    *,
    rate: float | None,
    rows: int | None,
    seconds: float | None,
    progress: Callable[[Recording], None],
) -> Recording:
    """Record the sensors of a bench to a CSV log, until the limit or Ctrl-C; ``progress`` is called after each row.

    ``rate`` is in rows per second; None is as fast as the sensors renew themselves. With neither ``rows`` nor
    ``seconds`` it goes on until Ctrl-C, which then is no interruption.

    UsageError: the log exists, an address is wrong, or there is no end on the virtual bench.
    HardwareError: a sensor does not answer.
    """
    sensors, thermometer = bench.sensors, thermometer_of(bench)
    beside = {} if thermometer is None else {THERMOMETER: thermometer}
    devices = (*sensors, *beside.values())
    virtual = all(device.simulated for device in devices)
    interval = 1.0 / rate if rate else max(sensor.wired.interval for sensor in sensors)
    endless = rows is None and seconds is None
    if seconds is not None and interval:
        rows = min(rows or sys.maxsize, max(1, round(seconds / interval)))
    if virtual and endless:
        raise UsageError(("a recording on the virtual bench needs ", Argument("rows"), " or ", Argument("seconds")))
    started = VIRTUAL_START if virtual else datetime.now(UTC)
    clock = session_clock(started, virtual=virtual)
    probe_devices(devices, clock)
    with connected(sensors, beside, Recorder(clock), VirtualBench(clock, devices)) as opened:
        columns = LogColumns(opened.models, thermometer=thermometer is not None)
        recording = Recording(log, columns.names)
        try:
            record(recording, columns, opened, clock, started, interval, rows, seconds, progress)
        except KeyboardInterrupt:
            recording.interrupted = not endless
        finally:
            recording.close()
            recording.link_statistics = opened.link_statistics()
    return recording


def record(
    recording: Recording, columns: LogColumns, sensors: SensorSet, clock: Clock, started: datetime, interval: float,
    rows: int | None, seconds: float | None, progress: Callable[[Recording], None],
) -> None:  # fmt: skip
    """Take samples at a steady pace, an ``interval`` of seconds apart, and append them to a recording."""
    # A sensor that talks faster than rows are taken would be read later and later.
    slower = interval > 1.5 * min(model.interval for model in sensors.models.values())
    begun_ns = due_ns = secured_ns = clock.now_ns()
    while (rows is None or recording.rows < rows) and (seconds is None or clock.now_ns() - begun_ns < seconds * SECOND):
        sample, why = sensors.read_available(fresh=slower or not recording.rows)
        now_ns = clock.now_ns()
        recording.append(columns.row(moment_after(started, now_ns), sample))
        if why:
            recording.missing, recording.why = recording.missing + len(why), why[-1]
        if now_ns - secured_ns >= SECURE_NS:
            recording.secure()
            secured_ns = now_ns
        progress(recording)
        due_ns = max(due_ns + round(interval * SECOND), now_ns - round(interval * SECOND))
        clock.sleep(max((due_ns - clock.now_ns()) / SECOND, 0.0 if sample or interval else RECOVERY))

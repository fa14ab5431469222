"""Recording a bench to a log: every sensor's readings, row by row, until someone stops it.

A row is in the kernel's hands when it is written and on the disk within a second, so Ctrl-C and a pulled plug lose
nothing that was shown.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import BinaryIO

from tiltcal.bench.event_log import EventLog
from tiltcal.bench.sensor_set import ConnectedSensor, Listener, SensorSet, column_name
from tiltcal.bench.session_plan import stamp
from tiltcal.drivers.bus.clock import Clock
from tiltcal.drivers.device import Reading
from tiltcal.errors import HardwareError, UsageError

SECURE_NS = 1_000_000_000
"""How long a row may wait for the disk."""


@dataclass
class RecordingTally:
    """What a recording holds so far.

    Attributes
    ----------
    rows : int
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
    header : sequence of str
    """

    def __init__(self, path: Path, header: Sequence[str]) -> None:
        try:
            self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND, 0o644)
        except FileExistsError:
            raise UsageError(f"{path} exists; a recording never replaces one: name another file") from None
        except OSError as error:
            raise UsageError(f"cannot write {path}: {error.strerror}") from None
        self.write(header)

    def write(self, cells: Sequence[str]) -> None:
        """Append one row."""
        os.write(self._descriptor, (",".join(cells) + "\n").encode())

    def secure(self) -> None:
        """Have all rows on the disk."""
        os.fdatasync(self._descriptor)

    def close(self) -> None:
        """Secure the rows and let the file go."""
        self.secure()
        os.close(self._descriptor)


def header(bays: Sequence[ConnectedSensor], *, thermometer: bool) -> list[str]:
    """Column names: ``x``, ``y``, ``temperature`` of a single sensor; of several each begins with the serial number."""
    names = ["time"]
    for bay in bays:
        own = ["temperature"] if bay.model.thermometer and not thermometer else []
        names += [column_name(bay.serial, name, alone=len(bays) == 1) for name in (*bay.model.channels, *own)]
    return names + (["temperature"] if thermometer else [])


def sample_rows(
    stream: BinaryIO, bays: Sequence[ConnectedSensor], started: datetime, tape: EventLog, thermometer: bool
) -> Listener:
    """What writes a session's samples as the rows of a log; a sensor that was given up leaves its cells empty.

    Parameters
    ----------
    stream : BinaryIO
        Has the header at once.
    bays : sequence of ConnectedSensor
    started : datetime
        UTC, when the session began.
    tape : EventLog
        Says when a sample was taken.
    thermometer : bool
        Whether the bench has one of its own.
    """

    def write(cells: Sequence[str]) -> None:
        stream.write((",".join(cells) + "\n").encode())

    def row(sample: Mapping[str, Reading]) -> None:
        moment = started + timedelta(microseconds=tape.now_ns() / 1000)
        write(_cells(bays, [sample.get(bay.serial) for bay in bays], moment, thermometer))

    write(header(bays, thermometer=thermometer))
    return row


def record(
    rack: SensorSet,
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
    rack : SensorSet
    log : CsvRecorder
    clock : Clock
    started : datetime
        UTC, when ``clock`` stood at zero.
    thermometer : bool
        Whether the rack has one of its own.
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
    slower = interval > 1.5 * min(model.interval for model in rack.models)
    rack.discard()
    due_ns = secured_ns = clock.now_ns()
    while rows is None or tally.rows < rows:
        if slower:
            with suppress(HardwareError):
                rack.discard()
        readings, why = rack.read_available()
        now_ns = clock.now_ns()
        log.write(_cells(rack.bays, readings, started + timedelta(microseconds=now_ns / 1000), thermometer))
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
    bays: Sequence[ConnectedSensor], readings: Sequence[Reading | None], moment: datetime, thermometer: bool
) -> list[str]:
    cells = [stamp(moment)]
    common = None
    for bay, reading in zip(bays, readings, strict=True):
        cells += [""] * len(bay.model.channels) if reading is None else [f"{value:.10g}" for value in reading.values]
        temperature = None if reading is None else reading.temperature
        common = temperature if common is None else common
        if bay.model.thermometer and not thermometer:
            cells.append(_temperature(temperature))
    return cells + ([_temperature(common)] if thermometer else [])


def _temperature(value: float | None) -> str:
    return "" if value is None else f"{value:.3f}"

"""``tiltcal record``: log a sensor or a whole bench."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import click

from tiltcal.bench.device_setup import devices_of, known_bench, single
from tiltcal.bench.event_log import EventLog
from tiltcal.bench.recording import CsvRecorder, RecordingTally, header, record
from tiltcal.bench.sensor_set import connected, open_device
from tiltcal.bench.session_plan import VIRTUAL_START
from tiltcal.bench.virtual_bench import VirtualBench
from tiltcal.cli import options
from tiltcal.cli.talk import remark
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import Clock, SystemClock, VirtualClock
from tiltcal.errors import INTERRUPTED, UsageError
from tiltcal.files.bench import BenchFile
from tiltcal.files.document import read_document

SHOWN_EVERY = 0.25
"""Period of the progress line, s."""


@click.command(epilog="Example: tiltcal record --bench bench.yaml --rate 10 -o night.csv")
@options.file_option("--bench", metavar="FILE", help="Record the sensors of a bench file.")
@click.option("--sensor", metavar="MODEL", help="The model of a single sensor.")
@click.option("--address", help="Its address.")
@options.above_zero("--rate", metavar="HZ", help="Rows per second [the rate of the slowest sensor].")
@click.option("--rows", type=options.Count(1, "rows"), help="Stop after this number of rows.")
@options.above_zero("--for", "seconds", metavar="SECONDS", help="Stop after this time.")
@options.file_option("-o", "--output", required=True, help="The log to write: .csv or .parquet.")
def command(
    bench: Path | None,
    sensor: str | None,
    address: str | None,
    rate: float | None,
    rows: int | None,
    seconds: float | None,
    output: Path,
) -> int:
    """Record the readings of a sensor or a bench until Ctrl-C.

    Each row has the time (UTC), the readings and the temperature. No row that was written is lost. A reading that fails
    leaves empty cells and is counted. A .parquet log is written as CSV first and converted at the end; after a power
    cut the CSV remains.
    """
    if (bench is None) == (sensor is None) or (sensor is None) != (address is None):
        raise UsageError("record needs either --bench FILE, or --sensor MODEL and --address ADDRESS")
    named = known_bench(read_document(bench)) if bench is not None else single(str(sensor), "", str(address))
    recorded = record_bench(named, rate, rows, seconds, output)
    remark(f"{recorded.tally.rows} rows in {output}{missing(recorded.tally)}")
    return INTERRUPTED if recorded.interrupted else 0


@dataclass(frozen=True)
class RecordedRows:
    """The result of a recording, and whether it was stopped before its end."""

    tally: RecordingTally
    interrupted: bool


def record_bench(
    named: BenchFile, rate: float | None, rows: int | None, seconds: float | None, output: Path
) -> RecordedRows:
    """Log the sensors of a bench, until the limit or Ctrl-C.

    Parameters
    ----------
    rate : float or None
        Rows per second; None is as fast as the sensors renew themselves.
    seconds : float or None
        How long. With neither it goes on until Ctrl-C, which then is no interruption.
    output : Path
        Made anew, in the format that its name selects: CSV, or Parquet, which is recorded as CSV beside it and
        converted at the end.

    Raises
    ------
    UsageError
        ``output`` exists or would be NetCDF, or there is no end on the virtual bench.
    HardwareError
        A sensor does not answer.
    """
    from tiltcal.logs.formats import log_format

    if os.path.lexists(output):
        raise UsageError(f"{output} exists; a recording never replaces one: name another file")
    written = log_format(output)
    if written.kept:
        raise UsageError(f"{output} would be NetCDF, and a recording is CSV or Parquet: name a .csv or .parquet")
    log = output if written.name == "Csv" else output.with_name(output.name + ".csv")
    sensors, thermometer = devices_of(named)
    devices = sensors if thermometer is None else (*sensors, thermometer)
    virtual = all(parse_address(device.address).simulated for device in devices)
    interval = 1.0 / rate if rate else max(sensor.model.interval for sensor in sensors)
    wanted = rows if seconds is None else min(rows or sys.maxsize, max(1, round(seconds / interval)))
    if virtual and wanted is None:
        raise UsageError("a recording on the virtual bench needs --rows or --for")
    started = VIRTUAL_START if virtual else datetime.now(UTC)
    clock: Clock = VirtualClock() if virtual else SystemClock(int(started.timestamp() * 1e9))
    twins = VirtualBench(clock, devices)
    for device in devices:
        link = open_device(device, twins)
        try:
            device.model.driver(link, clock).probe()
        finally:
            link.close()
    interrupted = False
    tally = RecordingTally()
    measured = thermometer is not None
    with connected(sensors, thermometer, EventLog(clock), clock, twins) as sensor_set, _progress() as tell:
        rows_log = CsvRecorder(log, header(sensor_set.sensors, thermometer=measured))
        try:
            for tally in record(
                sensor_set, rows_log, clock, started, thermometer=measured, interval=interval, rows=wanted
            ):
                tell(tally)
        except KeyboardInterrupt:
            interrupted = wanted is not None
        finally:
            rows_log.close()
            tally.rows = rows_log.rows
    if log != output:
        _to_parquet(log, output)
    return RecordedRows(tally, interrupted)


def missing(tally: RecordingTally) -> str:
    """Return the missing readings as text; empty if there are none."""
    return f", {tally.missing} readings missing ({tally.why})" if tally.missing else ""


@contextmanager
def _progress() -> Iterator[Callable[[RecordingTally], None]]:
    """Yield what shows the progress: a line on a terminal, nothing elsewhere."""
    shown = 0.0

    def tell(tally: RecordingTally) -> None:
        nonlocal shown
        now = time.monotonic()
        if now - shown >= SHOWN_EVERY:
            shown = now
            sys.stderr.write(f"\r\x1b[2K{tally.rows} rows{missing(tally)[:100]}   Ctrl-C stops")
            sys.stderr.flush()

    if not sys.stderr.isatty():
        yield lambda tally: None
        return
    try:
        yield tell
    finally:
        sys.stderr.write("\r\x1b[2K")


def _to_parquet(log: Path, output: Path) -> None:
    """Convert the recorded CSV to Parquet, block by block, then remove the CSV."""
    from tiltcal.files.atomic import whole_file
    from tiltcal.logs.formats import create_log, open_log

    with open_log(log) as rows, whole_file(output) as sink:
        writer = create_log(output, sink, rows)
        blocks = rows.rows(range(len(rows.names)), rows.names.index("time"), frames=True)
        writer.write((block, {}) for block in blocks)
    log.unlink()

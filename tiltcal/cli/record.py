"""``tiltcal record``"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

import click

from tiltcal.bench.plan import VIRTUAL_START, places_of, single
from tiltcal.bench.recording import CsvLog, Tally, header, record
from tiltcal.bench.tape import Tape
from tiltcal.bench.virtual import VirtualBench
from tiltcal.bench.wiring import open_place, wired
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import Clock, SystemClock, VirtualClock
from tiltcal.errors import UsageError
from tiltcal.files.bench import read_bench

INTERRUPTED = 130
SHOWN_EVERY = 0.25
"""Seconds between two looks of the progress line."""


@click.command(epilog="Example: tiltcal record --bench bench.yaml --rate 10 -o night.csv")
@click.option("--bench", type=click.Path(path_type=Path), metavar="FILE", help="The sensors, named in a bench file.")
@click.option("--sensor", metavar="MODEL", help="One sensor's model, where there is no bench file.")
@click.option("--address", help="Where it is connected.")
@click.option(
    "--rate",
    type=click.FloatRange(0.0, min_open=True),
    metavar="HZ",
    help="Rows a second [as fast as the sensors renew themselves].",
)
@click.option("--rows", type=click.IntRange(1), help="Stop after so many rows.")
@click.option(
    "--for", "seconds", type=click.FloatRange(0.0, min_open=True), metavar="SECONDS", help="Stop after so long."
)
@click.option(
    "-o", "--output", required=True, type=click.Path(path_type=Path), help="The log to make: .csv or .parquet."
)
def command(
    bench: Path | None,
    sensor: str | None,
    address: str | None,
    rate: float | None,
    rows: int | None,
    seconds: float | None,
    output: Path,
) -> int:
    """Record the readings of a sensor, or of a whole bench, until stopped with Ctrl-C.

    Each row has its time (UTC), the readings and the temperature. A row that is written is kept, whatever happens
    next; a reading that fails leaves its cells empty and is counted. A .parquet log is captured as CSV beside it and
    made at the end; if the machine dies before, the CSV is there.
    """
    if (bench is None) == (sensor is None) or (sensor is None) != (address is None):
        raise UsageError("record needs either --bench FILE, or --sensor MODEL and --address ADDRESS")
    named = read_bench(bench) if bench is not None else single(str(sensor), "", str(address))
    places, thermometer = places_of(named)
    devices = places if thermometer is None else (*places, thermometer)
    virtual = all(parse_address(place.address).simulated for place in devices)
    interval = 1.0 / rate if rate else max(place.fitted.interval for place in places)
    wanted = rows if seconds is None else min(rows or sys.maxsize, max(1, round(seconds / interval)))
    if virtual and wanted is None:
        raise UsageError("on the virtual bench time takes no time: say --rows or --for")
    started = VIRTUAL_START if virtual else datetime.now(UTC)
    clock: Clock = VirtualClock() if virtual else SystemClock(int(started.timestamp() * 1e9))
    twins = VirtualBench(clock, devices)
    for place in devices:
        link = open_place(place, twins)
        try:
            place.fitted.driver(link, clock).probe()
        finally:
            link.close()
    capture = output.with_name(output.name + ".csv") if output.suffix == ".parquet" else output
    if output.exists():
        raise UsageError(f"{output} exists; a recording never replaces one: name another file")
    interrupted = False
    tally = Tally()
    with wired(places, thermometer, Tape(clock), clock, twins) as rack, _progress() as tell:
        log = CsvLog(capture, header(rack.bays, thermometer=thermometer is not None))
        try:
            for tally in record(
                *(rack, log, clock, started), thermometer=thermometer is not None, interval=interval, rows=wanted
            ):
                tell(tally)
        except KeyboardInterrupt:
            interrupted = wanted is not None
        finally:
            log.close()
    if capture != output:
        _to_parquet(capture, output)
    click.echo(f"{tally.rows} rows in {output}{_told_missing(tally)}", err=True)
    return INTERRUPTED if interrupted else 0


def _told_missing(tally: Tally) -> str:
    return f", {tally.missing} readings missing ({tally.why})" if tally.missing else ""


def _to_parquet(capture: Path, output: Path) -> None:
    """Make the Parquet log of the captured CSV, and let the CSV go once it is there."""
    import polars as pl

    from tiltcal.files.whole import whole_file

    log = pl.scan_csv(capture, infer_schema_length=None).with_columns(
        pl.col("time").str.to_datetime(time_unit="ms", time_zone="UTC")
    )
    with whole_file(output) as stream:
        log.collect().write_parquet(stream)
    capture.unlink()


@contextmanager
def _progress() -> Iterator[Callable[[Tally], None]]:
    """A line that tells a person how far it is; nothing for a program."""
    shown = 0.0

    def tell(tally: Tally) -> None:
        nonlocal shown
        now = time.monotonic()
        if now - shown >= SHOWN_EVERY:
            shown = now
            sys.stderr.write(f"\r\x1b[2K{tally.rows} rows{_told_missing(tally)[:100]}   Ctrl-C stops")
            sys.stderr.flush()

    if not sys.stderr.isatty():
        yield lambda tally: None
        return
    try:
        yield tell
    finally:
        sys.stderr.write("\r\x1b[2K")

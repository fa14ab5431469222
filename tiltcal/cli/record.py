"""``tiltcal record``: log a sensor or a whole bench."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from tiltcal.bench.record import Recording, record_bench
from tiltcal.bench.setup import known_bench, require_trusted, single
from tiltcal.cli import options
from tiltcal.cli.talk import remark
from tiltcal.errors import INTERRUPTED, UsageError
from tiltcal.files.bench import BenchFile
from tiltcal.files.document import read_document

SHOWN_EVERY = 0.25  # period of the progress line, s


@options.command(epilog="Example: tiltcal record --bench bench.yaml --rate 10 -o night.csv")
@options.file_option("--bench", metavar="FILE", help="Record the sensors of a bench file.")
@click.option("--sensor", metavar="MODEL", help="The model of a single sensor.")
@click.option("--address", help="Its address.")
@click.option("--python", metavar="MODULES", help="Modules of python: addresses in the bench file, to import.")
@options.above_zero("--rate", metavar="HZ", help="Rows per second [the rate of the slowest sensor].")
@click.option("--rows", type=options.count(1, "rows"), help="Stop after this number of rows.")
@options.above_zero("--for", "seconds", metavar="SECONDS", help="Stop after this time.")
@options.file_option("-o", "--output", required=True, help="The log to write: .csv or .parquet.")
def command(
    bench: Path | None, sensor: str | None, address: str | None, python: str | None, rate: float | None,
    rows: int | None, seconds: float | None, output: Path,
) -> int:  # fmt: skip
    """Record the readings of a sensor or a bench until Ctrl-C.

    Each row has the time (UTC), the readings and the temperature. No row that was written is lost. A reading that fails
    leaves empty cells and is counted, and so is what was damaged or lost on a line. A .parquet log keeps these counts
    as `link_statistics` in its metadata; it is written as CSV first and converted at the end, and after a power cut the
    CSV remains.
    """
    if (bench is None) == (sensor is None) or (sensor is None) != (address is None):
        raise UsageError("record needs either --bench FILE, or --sensor MODEL and --address ADDRESS")
    named = known_bench(read_document(bench)) if bench is not None else single(str(sensor), "", str(address))
    if bench is not None:
        require_trusted(named, bench, python)
    tally = record_log(named, rate, rows, seconds, output)
    remark(f"{tally.rows} rows in {output}{tally.losses_in_words}")
    return INTERRUPTED if tally.interrupted else 0


def record_log(
    bench: BenchFile, rate: float | None, rows: int | None, seconds: float | None, output: Path
) -> Recording:
    """Record the sensors of a bench in the format that the output's name selects; the limits are those of the command.

    UsageError: ``output`` exists or is neither CSV nor Parquet, or there is no end on the virtual bench.
    HardwareError: a sensor does not answer.
    """
    from tiltcal.logs.formats import CSV, PARQUET, log_format

    if os.path.lexists(output):
        raise UsageError(f"{output} exists; a recording never replaces one: name another file")
    written = log_format(output)
    if written not in (CSV, PARQUET):
        raise UsageError(f"{output}: a recording is CSV or Parquet: name a .csv or .parquet")
    log = output if written == CSV else output.with_name(output.name + ".csv")
    with _progress() as progress:
        tally = record_bench(bench, log, rate=rate, rows=rows, seconds=seconds, progress=progress)
    if log != output:
        _to_parquet(log, output, tally)
    return tally


@contextmanager
def _progress() -> Iterator[Callable[[Recording], None]]:
    """Yield what shows the progress: a line on a terminal, nothing elsewhere."""
    shown = 0.0

    def show(tally: Recording) -> None:
        nonlocal shown
        now = time.monotonic()
        if now - shown >= SHOWN_EVERY:
            shown = now
            sys.stderr.write(f"\r\x1b[2K{tally.rows} rows{tally.losses_in_words[:100]}   Ctrl-C stops")
            sys.stderr.flush()

    if not sys.stderr.isatty():
        yield lambda tally: None
        return
    try:
        yield show
    finally:
        sys.stderr.write("\r\x1b[2K")


def _to_parquet(log: Path, output: Path, tally: Recording) -> None:
    """Convert the recorded CSV to Parquet, block by block, then remove the CSV."""
    from tiltcal.files.atomic import whole_file
    from tiltcal.logs.formats import create_log, open_log

    with open_log(log) as rows, whole_file(output) as sink:
        rows.notes = {"link_statistics": json.dumps(tally.link_statistics)} if tally.link_statistics else {}
        writer = create_log(output, sink, rows)
        blocks = rows.rows(range(len(rows.names)), rows.names.index("time"), frames=True)
        writer.write((block, {}) for block in blocks)
    log.unlink()

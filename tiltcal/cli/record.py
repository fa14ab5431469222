"""``tiltcal record``: log a sensor or a whole bench."""

from __future__ import annotations

from pathlib import Path

import click

from tiltcal.bench.session_plan import known_bench, single
from tiltcal.cli import options
from tiltcal.cli.recording import capture
from tiltcal.cli.talk import remark
from tiltcal.errors import INTERRUPTED, UsageError
from tiltcal.files.document import read_document


@click.command(epilog="Example: tiltcal record --bench bench.yaml --rate 10 -o night.csv")
@options.file_option("--bench", metavar="FILE", help="Record the sensors of a bench file.")
@click.option("--sensor", metavar="MODEL", help="The model of a single sensor.")
@click.option("--address", help="Its address.")
@options.above_zero(
    "--rate",
    metavar="HZ",
    help="Rows per second [the rate of the slowest sensor].",
)
@click.option("--rows", type=click.IntRange(1), help="Stop after this number of rows.")
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
    captured = capture(named, rate, rows, seconds, output)
    remark(f"{captured.tally.rows} rows in {output}{captured.missing}")
    return INTERRUPTED if captured.interrupted else 0

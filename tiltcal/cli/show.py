"""``tiltcal show``: print the coefficients of a calibration, and the map that they make."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import click

from tiltcal.calibration.record import record_in
from tiltcal.calibration.wording import pair_summary, summary
from tiltcal.cli import options
from tiltcal.core.model import AXES
from tiltcal.errors import UsageError
from tiltcal.export.affine import affine_of
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.document import read_document


@options.command(epilog="Example: tiltcal show S-0042.yaml --matrix")
@click.argument("calibration", type=options.FILE)
@click.option("--matrix", is_flag=True, help="Print A and b too: g = A (u - b).")
def command(calibration: Path, matrix: bool) -> None:
    """Print the coefficients of a calibration with their standard uncertainties, and how uncertain a tilt is.

    With --matrix it also prints A (g/unit) and b (unit) at the reference temperature: gravity is A (u - b), in the
    frame of the application, of the readings u. `tiltcal export` has it for programs.
    """
    record = record_in(read_document(calibration))
    if not isinstance(record, CalibrationRecord):
        if matrix:
            raise UsageError(f"{calibration} is of pairs, which have no matrix: leave --matrix out")
        click.echo("\n\n".join(map(pair_summary, record.matchings)))
        return
    lines = [summary(record), *(_map_lines(record) if matrix else ())]
    click.echo("\n".join(lines))


def _map_lines(record: CalibrationRecord) -> Iterator[str]:
    """Yield the lines of A and b."""
    affine, sensor = affine_of(record.coefficients), record.sensor
    axes = sensor.channels if len(affine.matrix) == 1 else AXES[: len(affine.matrix)]
    yield f"  g = A (u - b), A in g per {sensor.unit}, columns {', '.join(sensor.channels)}; b in {sensor.unit}"
    for axis, row in zip(axes, affine.matrix, strict=True):
        yield f"  A {axis}" + "".join(f"{value:>16.9g}" for value in row)
    yield "  b  " + "".join(f"{value:>16.9g}" for value in affine.offset)

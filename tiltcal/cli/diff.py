"""``tiltcal diff``: compare two calibrations of one sensor."""

from __future__ import annotations

from pathlib import Path

import click

from tiltcal.calibration.comparison import compare_records
from tiltcal.cli import options
from tiltcal.errors import NEGATIVE_VERDICT
from tiltcal.files.calibration import read_calibration


@options.command(epilog="Example: tiltcal diff S-0042-spring.yaml S-0042-autumn.yaml")
@click.argument("before", type=click.Path(path_type=Path))
@click.argument("after", type=click.Path(path_type=Path))
@options.as_json
def command(before: Path, after: Path, as_json: bool) -> int:
    """Compare two calibrations of one sensor against their uncertainty.

    It prints the change of every coefficient, and the change over its standard uncertainty. The verdict allows for the
    number of coefficients: of two calibrations of an unchanged sensor it calls 5 % changed. A coefficient that does not
    mean the same in both files is not comparable. Exit code 1 if something changed.
    """
    found = compare_records(*map(read_calibration, (before, after)))
    options.print_judged(options.json_text(found.as_data()) if as_json else str(found))
    return NEGATIVE_VERDICT if found.verdict.word == "changed" else 0

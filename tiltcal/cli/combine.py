"""``tiltcal combine``: make one calibration of several sessions."""

from __future__ import annotations

from pathlib import Path

import click

from tiltcal.calibration.wording import summary
from tiltcal.cli import options
from tiltcal.cli.talk import remark
from tiltcal.files.calibration_output import require_replaceable
from tiltcal.library.calibration import combine


@options.command(epilog="Example: tiltcal combine S-0042-scale.yaml S-0042-drift.yaml -o S-0042.yaml")
@click.argument("calibrations", metavar="CALIBRATION...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--mounting",
    default="",
    metavar="roll=DEG,…",
    help="How the sensor sits, such as roll=180 for upside down (pitch=, yaw=): roll first, then pitch, then yaw. It "
    "replaces the mounting of every CALIBRATION and counts as exact; one CALIBRATION alone is enough with it.",
)
@options.file_option("-o", "--output", required=True, help="The calibration file to write.")
def command(calibrations: tuple[Path, ...], mounting: str, output: Path) -> None:
    """Combine calibrations of one sensor from several sessions: their positions are fitted again, together.

    So the scale comes from the vise, and the drift from the overnight run. A difference that sessions in agreement
    have once in 1000 times is refused with the figures. An assumed sensitivity, nominal or of a --base, is no
    information. Positions of one journal count once. A file without positions enters by its values and their
    covariance.
    """
    require_replaceable(output, None, *calibrations)
    found = combine(calibrations, mounting=mounting)
    found.save(output, remark)
    click.echo(summary(found.record))
    remark(f"wrote {output}")

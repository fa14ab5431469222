"""``tiltcal measure``: calibrate sensors at the bench."""

from __future__ import annotations

from typing import Any

import click

from tiltcal.cli import options
from tiltcal.cli.talk import remark


@options.command(
    epilog="Example: tiltcal measure zero-45 --sensor sca100t-d02 --address spi:///dev/spidev0.0 --serial S-0042 "
    "-o S-0042.yaml"
)
@click.argument("procedure", required=False)
@options.file_option("--bench", metavar="FILE", help="Measure the sensors of a bench file together.")
@click.option("--sensor", metavar="MODEL", help="The sensor's model; `tiltcal devices` lists them.")
@click.option("--address", help="Its address, such as spi:///dev/spidev0.0, or sim: for its virtual twin.")
@click.option("--serial", help="Its serial number, for the calibration file.")
@options.file_option("-o", "--output", help="The calibration file to write; with --bench a folder.")
@click.option(
    "--operator",
    type=options.OPERATORS,
    default="terminal",
    show_default=True,
    help="Who sets the positions: a person at the terminal or at a page in a browser, a program that reads and writes "
    "JSON Lines, or the virtual jig.",
)
@options.hands_free
@options.listen
@options.samples
@options.above_zero(
    "--settle",
    metavar="SECONDS",
    help="How long a reading must be still before it is sampled; overrides the procedure.",
)
@options.jig
@options.table_lean
@options.heading
@options.tilt
@click.option("--turns", type=int, help="Largest number of turns of the stage; overrides the procedure.")
@options.alignment
@options.file_option("--base", metavar="CAL", help=options.BASE + " A file names model and serial number as well.")
@click.option(
    "--typical-temperature",
    is_flag=True,
    help="Use the mean temperature curves of the data sheet for a unit without its own; the file states this.",
)
@click.option(
    "--closing", is_flag=True, help="Visit the first position again at the end, to show what has changed meanwhile."
)
@options.file_option("--journal", help="The journal of the session [beside the output].")
@options.resume
@options.plain
def command(procedure: str | None, operator: str, **settings: Any) -> None:
    """Measure the positions of PROCEDURE, write the calibration file, and print its coefficients.

    PROCEDURE is one of `tiltcal procedures`, or the path of your own. With `rotation` a stage turns instead, and -o is
    the file of its pairs. A journal records everything at once: after a crash, a power cut or Ctrl-C, `--resume
    JOURNAL` continues from the last byte.
    """
    from tiltcal.library.measure import measure

    chosen = None if options.left_at_default("operator") else operator
    measure(procedure, operator=chosen, remark=remark, result=click.echo, **settings)

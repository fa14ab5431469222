"""``tiltcal measure``"""

from __future__ import annotations

from pathlib import Path

import click

from tiltcal.cli.session_options import LEADERS, left_at_default, remark


@click.command(
    epilog="Example: tiltcal measure zero-45 --sensor sca100t-d02 --address spi:///dev/spidev0.0 --serial S-0042 "
    "-o S-0042.yaml"
)
@click.argument("procedure", required=False)
@click.option(
    "--bench", type=click.Path(path_type=Path), metavar="FILE", help="Measure the sensors of a bench file together."
)
@click.option("--sensor", metavar="MODEL", help="The sensor's model; `tiltcal devices` lists them.")
@click.option("--address", help="Its address, such as spi:///dev/spidev0.0, or sim: for its virtual twin.")
@click.option("--serial", help="Its serial number, for the calibration file.")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), help="The calibration file to write; with --bench a folder."
)
@click.option(
    "--operator",
    type=LEADERS,
    default="terminal",
    show_default=True,
    help="Who sets the positions: a person, a program that reads and writes JSON Lines, or the virtual jig.",
)
@click.option("--samples", type=click.IntRange(2), help="Samples per position; overrides the procedure.")
@click.option(
    "--settle",
    type=click.FloatRange(0.0, min_open=True),
    metavar="SECONDS",
    help="How long a reading must be still before it is sampled; overrides the procedure.",
)
@click.option(
    "--jig",
    type=click.FloatRange(0.0),
    metavar="DEGREES",
    help="Standard uncertainty of a set angle; without it, it is estimated from the residuals.",
)
@click.option(
    "--table-lean",
    type=click.FloatRange(0.0),
    metavar="DEGREES",
    help="Standard uncertainty of the lean of the table that all positions share.",
)
@click.option(
    "--heading-uncertainty",
    "heading",
    type=click.FloatRange(0.0),
    metavar="DEGREES",
    help="Standard uncertainty of a heading.",
)
@click.option("--tilt", type=float, metavar="DEGREES", help="The angle of a procedure with a free angle.")
@click.option("--turns", type=int, help="Largest number of turns of the stage; overrides the procedure.")
@click.option(
    "--alignment",
    type=click.FloatRange(0.0),
    metavar="DEGREES",
    help="With level: by how much at most the sensor may sit askew since its calibration, about each axis [2]; 0 if it "
    "was not unplugged.",
)
@click.option(
    "--base",
    type=click.Path(path_type=Path),
    metavar="CAL",
    help="The calibration file of the sensor, or a folder with SERIAL.yaml of each: mounting and level complete it, "
    "and procedures that determine no sensitivity use its own. A file names model and serial number as well.",
)
@click.option(
    "--typical-temperature",
    is_flag=True,
    help="Use the mean temperature curves of the data sheet for a unit without its own; the file states this.",
)
@click.option(
    "--closing", is_flag=True, help="Visit the first position again at the end, to show what has changed meanwhile."
)
@click.option("--journal", type=click.Path(path_type=Path), help="The journal of the session [beside the output].")
@click.option("--resume", type=click.Path(path_type=Path), metavar="JOURNAL", help="Continue an interrupted session.")
@click.option("--plain", is_flag=True, help="Plain lines: no live reading, no single keys.")
def command(
    procedure: str | None,
    bench: Path | None,
    sensor: str | None,
    address: str | None,
    serial: str | None,
    output: Path | None,
    operator: str,
    samples: int | None,
    settle: float | None,
    jig: float | None,
    table_lean: float | None,
    heading: float | None,
    tilt: float | None,
    turns: int | None,
    alignment: float | None,
    base: Path | None,
    typical_temperature: bool,
    closing: bool,
    journal: Path | None,
    resume: Path | None,
    plain: bool,
) -> None:
    """Measure the positions of PROCEDURE and write the calibration file.

    PROCEDURE is one of `tiltcal procedures`, or the path of your own. With `rotation` a stage turns instead, and -o is
    the file of its pairs. A journal records everything at once: after a crash, a power cut or Ctrl-C, `--resume
    JOURNAL` continues from the last byte.
    """
    from tiltcal.bench.measure import measure

    measure(
        procedure,
        operator=None if left_at_default("operator") else operator,
        sensor=sensor,
        address=address,
        serial=serial,
        output=output,
        bench=bench,
        samples=samples,
        settle=settle,
        jig=jig,
        table_lean=table_lean,
        heading=heading,
        tilt=tilt,
        turns=turns,
        alignment=alignment,
        base=base,
        typical_temperature=typical_temperature,
        closing=closing,
        journal=journal,
        resume=resume,
        plain=plain,
        remark=remark,
    )

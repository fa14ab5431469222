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
    "--bench", type=click.Path(path_type=Path), metavar="FILE", help="Several sensors at once, named in a bench file."
)
@click.option("--sensor", metavar="MODEL", help="The sensor's model; `tiltcal devices` lists them.")
@click.option("--address", help="Where it is connected, such as spi:///dev/spidev0.0, or sim: for its virtual twin.")
@click.option("--serial", help="Its serial number, for the calibration file.")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), help="The calibration file to write; with --bench the folder."
)
@click.option(
    "--operator",
    type=LEADERS,
    default="terminal",
    show_default=True,
    help="Who brings the sensor into position: a person, a program over JSON Lines, or the virtual jig.",
)
@click.option("--samples", type=click.IntRange(2), help="Samples per position, in place of the procedure's.")
@click.option(
    "--settle",
    type=click.FloatRange(0.0, min_open=True),
    metavar="SECONDS",
    help="How long a reading must hold still before it is sampled, in place of the procedure's.",
)
@click.option(
    "--jig",
    type=click.FloatRange(0.0),
    metavar="DEGREES",
    help="Standard uncertainty of a set angle; where it is not stated, the positions' scatter says it.",
)
@click.option("--tilt", type=float, metavar="DEGREES", help="The angle that the procedure leaves free.")
@click.option("--turns", type=int, help="The most turns of the stage, in place of the procedure's.")
@click.option(
    "--base",
    type=click.Path(path_type=Path),
    metavar="CAL",
    help="The sensor's calibration file, which the mounting procedure completes.",
)
@click.option(
    "--typical-temperature",
    is_flag=True,
    help="Where the unit has no temperature run of its own, take the data sheet's mean curves, and say so in the file.",
)
@click.option("--journal", type=click.Path(path_type=Path), help="Where the session is captured [beside the output].")
@click.option("--resume", type=click.Path(path_type=Path), metavar="JOURNAL", help="Go on with an interrupted session.")
@click.option("--plain", is_flag=True, help="Lines only: no live reading, no single keys.")
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
    tilt: float | None,
    turns: int | None,
    base: Path | None,
    typical_temperature: bool,
    journal: Path | None,
    resume: Path | None,
    plain: bool,
) -> None:
    """Walk a sensor through the positions of PROCEDURE and write its calibration file.

    PROCEDURE is one of `tiltcal procedures`, or the path of your own. With `rotation` a stage turns instead, and -o is
    the file of its pairs. Everything is captured in a journal as it happens: after a crash, a power cut or Ctrl-C,
    `--resume JOURNAL` goes on from the last byte.
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
        tilt=tilt,
        turns=turns,
        base=base,
        typical_temperature=typical_temperature,
        journal=journal,
        resume=resume,
        plain=plain,
        remark=remark,
    )

"""``tiltcal measure``"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from tiltcal.bench.channel_map import map_channels
from tiltcal.bench.session import Session
from tiltcal.bench.session_plan import SessionPlan, plan_session, single
from tiltcal.calibration.unit_gravity import require_no_jig
from tiltcal.cli.session_options import LEADERS, captured, free_journal, led, left_at_default
from tiltcal.drivers.device import in_words
from tiltcal.errors import JournalError, UsageError
from tiltcal.files.bench import BenchFile, read_bench
from tiltcal.files.document import read_text
from tiltcal.files.procedure import Procedure, find_procedure


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
    if resume is not None and resume.exists():
        journal_before = captured(resume)
        session = Session(SessionPlan.from_journal(journal_before), resume, journal_before)
        operator = session.plan.lead if left_at_default("operator") else operator
    else:
        wanted: dict[str, object] = {"PROCEDURE": procedure}
        if bench is None:
            wanted |= {"--sensor": sensor, "--address": address, "--serial": serial, "-o": output}
        missing = [name for name, value in wanted.items() if value is None]
        if resume is not None and missing:
            raise JournalError("no such journal; nothing was captured there", file=resume)
        if missing:
            raise UsageError(f"measure needs {', '.join(missing)} (or --resume JOURNAL); see tiltcal measure --help")
        if bench is not None and (sensor or address or serial):
            raise UsageError("the --bench file names the sensors: leave --sensor, --address and --serial out")
        steps = find_procedure(str(procedure), tilt).with_turns(turns)
        if steps.rotation is not None:
            _require_steady(samples, settle, jig)
        sensors = read_bench(bench) if bench is not None else single(str(sensor), str(serial), str(address))
        require_no_jig(steps, jig)
        sensors = sensors if jig is None else replace(sensors, jig=jig)
        mounted = _base(steps, base, sensors)
        outputs, beside = _outputs(steps, sensors, bench, output)
        path = resume or journal or free_journal(beside)
        plan = plan_session(
            *(steps, sensors, outputs, path),
            lead=operator,
            samples=samples,
            settle=settle,
            base=mounted,
            typical=typical_temperature,
        )
        session = Session(plan, path)
        _show_outlook(plan)
    with led(session, operator, plain=plain, again="measure") as leader:
        result = session.measure(leader)
    for name, link_statistics in result.link_statistics_by_serial.items():
        click.echo(f"{name}: {in_words(link_statistics)}", err=True)


def _show_outlook(plan: SessionPlan) -> None:
    """Tell how well the positions will determine the coefficients; refuse those that cannot."""
    from tiltcal.calibration.prediction import predict

    if plan.procedure.determines.mounting:
        return
    if plan.procedure.rotation is not None:
        hookup = map_channels(plan.procedure.rotation, [(place.serial, place.fitted) for place in plan.places])
        for why in hookup.left_out:
            click.echo(why, err=True)
        if len(plan.places) > 1:
            click.echo(
                "several devices are read one after the other: what one is late by, times 2 pi f, goes into q",
                err=True,
            )
        return
    for place in {(place.model, place.orientation): place for place in plan.places}.values():
        expected = predict(
            plan.procedure,
            place.fitted,
            jig=plan.jig,
            thermometer=plan.thermometer_uncertainty,
            samples=plan.settings.samples,
            orientation=place.orientation,
            sensors=len(plan.places),
        )
        click.echo(f"{place.model}, {expected}", err=True)


def _base(procedure: Procedure, base: Path | None, sensors: BenchFile) -> str | None:
    """The text of the calibration that a mounting completes."""
    from tiltcal.calibration.calibrate import base_of

    base_of(procedure, base, [sensor.serial for sensor in sensors.sensors])
    return None if base is None else read_text(base)


def _require_steady(samples: int | None, settle: float | None, jig: float | None) -> None:
    """Refuse what only positions have."""
    for option, value in (("--samples", samples), ("--settle", settle), ("--jig", jig)):
        if value is not None:
            raise UsageError(f"a stage that turns has no positions: leave {option} out; --turns says how long it turns")


def _outputs(
    procedure: Procedure, sensors: BenchFile, bench: Path | None, output: Path | None
) -> tuple[list[Path | None], Path]:
    """The calibration files, and the file beside which the journal lies.

    A bench file's sensors each have a file of their own, named for their serial number, in the folder that -o names;
    those of a stage that turns have one together, which -o names.
    """
    if procedure.rotation is not None:
        if output is None or output.is_dir():
            raise UsageError("the pairs of a stage have one file together: name it with -o PAIR.yaml")
        return [output, *(None for _ in sensors.sensors[1:])], output
    if bench is None and output is not None:
        return [output], output
    folder = output or Path()
    if not folder.is_dir():
        raise UsageError(f"with --bench, -o names the folder for the calibration files; {folder} is no folder")
    return [folder / f"{sensor.serial}.yaml" for sensor in sensors.sensors], folder / str(bench and bench.name)

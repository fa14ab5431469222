"""``tiltcal verify``: compare a calibration with positions that it was not fitted to."""

from __future__ import annotations

from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, cast

import click

from tiltcal.cli import options
from tiltcal.cli.talk import remark
from tiltcal.errors import NEGATIVE_VERDICT, UsageError
from tiltcal.files.calibration import SensorIdentity, read_calibration
from tiltcal.files.procedure_file import find_procedure

if TYPE_CHECKING:
    from tiltcal.bench.operators.operator import PositionOperator
    from tiltcal.bench.session import Session
    from tiltcal.files.procedure import Procedure


@options.command(epilog="Example: tiltcal verify S-0042.yaml --address spi:///dev/spidev0.0 --limit 0.3")
@click.argument("calibration", type=click.Path(path_type=Path))
@click.option("--address", help="The address of the sensor, or sim: for its virtual twin.")
@click.option(
    "--procedure", default="verify", show_default=True, help="The positions to measure: a name, or your own file."
)
@options.above_zero(
    "--limit", default=0.5, show_default=True, metavar="DEGREES", help="The largest tilt error that passes."
)
@options.degrees("--jig", help="Standard uncertainty of a set angle. Not stated, the positions count as exact.")
@options.tilt
@click.option(
    "--operator", type=options.OPERATORS, default="terminal", show_default=True, help="Who sets the positions."
)
@options.samples
@options.above_zero("--settle", metavar="SECONDS", help="How long a reading must be still; overrides the procedure.")
@options.file_option("--journal", help="The journal of the session [beside the calibration].")
@options.resume
@options.plain
@click.option("--json", "as_json", is_flag=True, help="Print a JSON object after the session, as with --operator json.")
def command(
    calibration: Path,
    address: str | None,
    procedure: str,
    limit: float,
    jig: float | None,
    tilt: float | None,
    operator: str,
    samples: int | None,
    settle: float | None,
    journal: Path | None,
    resume: Path | None,
    plain: bool,
    as_json: bool,
) -> int:
    """Measure positions that CALIBRATION was not fitted to, and compare tilts.

    The verdict follows ISO 14253-1 with the expanded uncertainty of the verification, from --jig and the noise: passed
    if every tilt error is within the limit with it added, failed if one is beyond the limit with it subtracted, else
    not decided. Exit code 1 unless passed.
    """
    from tiltcal.bench.device_setup import single
    from tiltcal.bench.operators.selection import open_operator
    from tiltcal.bench.session import Session
    from tiltcal.bench.session_plan import plan_session
    from tiltcal.bench.session_start import free_journal
    from tiltcal.calibration.verification import PASSED

    judged = read_calibration(calibration)
    if resume is not None:
        session = Session.of_journal(resume, remark)
        operator = session.plan.operator if options.left_at_default("operator") else operator
    elif address is None:
        raise UsageError("verify needs --address, where the sensor is connected (or --resume JOURNAL)")
    else:
        path = journal or free_journal(calibration.with_name(f"{calibration.stem}.verify.yaml"), remark)
        bench = single(judged.sensor.model, judged.sensor.serial, address, jig)
        steps = _positions(procedure, tilt)
        plan = plan_session(steps, bench, [None], path, operator=operator, samples=samples, settle=settle)
        session = Session(plan, path)
    _require_sensor(session, judged.sensor, calibration)
    if resume is not None:
        session.plan.require_as_begun(
            {
                "--procedure": None if options.left_at_default("procedure") else procedure,
                "--address": address,
                "--jig": jig,
                "--tilt": tilt,
                "--samples": samples,
                "--settle": settle,
                "--journal": None if journal is None else journal.name,
            }
        )
    again = f"verify {quote(str(calibration))}"
    again += "" if options.left_at_default("limit") else f" --limit {limit}"
    again += " --json" if as_json else ""
    session.require_writable()
    with session.resumable(again, remark):
        session.probe()
        with open_operator(operator, turns=False, virtual=session.plan.virtual, say=remark, plain=plain) as opened:
            found = session.verify(cast("PositionOperator", opened), judged, limit)
            opened.done([], session.path)
    if found.jig is None:
        remark("no --jig is stated: the positions count as exact")
    # What a program reads is JSON to the last line.
    as_json = as_json or operator == "json"
    options.print_judged(options.json_text(found.as_data()) if as_json else str(found))
    return 0 if found.verdict == PASSED else NEGATIVE_VERDICT


def _positions(procedure: str, tilt: float | None) -> Procedure:
    """Return a procedure, which must set positions to verify with."""
    steps = find_procedure(procedure, tilt)
    if steps.determines.free or steps.determines.completes or steps.ramp is not None:
        raise UsageError(f"{steps.name} sets no positions to verify with: name another procedure")
    steps.require_positions()
    return steps


def _require_sensor(session: Session, judged: SensorIdentity, calibration: Path) -> None:
    """Refuse the journal of a measurement, and readings that are not those of the calibration's sensor."""
    if session.outputs:
        raise UsageError(
            f"{session.path} is of a measurement; continue it with: tiltcal measure --resume {quote(str(session.path))}"
        )
    for device in session.plan.sensors:
        if (device.model_name, device.serial) != (judged.model, judged.serial):
            raise UsageError(
                f"{session.path} is of {device.model_name} {device.serial}, and {calibration} of {judged.model} "
                f"{judged.serial}: name the calibration of that sensor"
            )
        channels, unit = device.model.channels, device.model.unit
        if unit != judged.unit or not set(judged.channels) <= set(channels):
            raise UsageError(
                f"{calibration} is of {', '.join(judged.channels)} in {judged.unit}, and {device.address} gives "
                f"{', '.join(channels)} in {unit}: name the address as it was calibrated"
            )

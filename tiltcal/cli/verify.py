"""``tiltcal verify``: compare a calibration with positions that it was not fitted to."""

from __future__ import annotations

from pathlib import Path
from shlex import quote
from typing import Any

import click

from tiltcal.bench.live import require_as_calibrated
from tiltcal.bench.measure import led_by
from tiltcal.bench.messages import Done, Results
from tiltcal.bench.options import MeasureOptions
from tiltcal.bench.session import Session
from tiltcal.bench.setup import free_journal, known_bench, new_setup, require_trusted, single
from tiltcal.calibration.verification import LIMIT, PASSED
from tiltcal.cli import options
from tiltcal.cli.config import defaults_here
from tiltcal.cli.talk import remark
from tiltcal.errors import NEGATIVE_VERDICT, UsageError
from tiltcal.files.bench import BenchFile
from tiltcal.files.calibration import CalibrationRecord, read_calibration
from tiltcal.files.document import read_document
from tiltcal.files.procedure import find_procedure
from tiltcal.library.afterwards import verified
from tiltcal.library.measure import resumed
from tiltcal.options import complete
from tiltcal.stated_arguments import require_from_zero


@options.command(epilog="Example: tiltcal verify S-0042.yaml --address spi:///dev/spidev0.0 --limit 0.3")
@click.argument("calibration", type=click.Path(path_type=Path))
@click.option("--address", help="The address of the sensor, or sim: for its virtual twin.")
@click.option(
    "--procedure", default="verify", show_default=True, help="The positions to measure: a name, or your own file."
)
@options.above_zero(
    "--limit", default=LIMIT, show_default=True, metavar="DEGREES", help="The largest tilt error that passes."
)
@click.option(
    "--jig",
    type=options.Number(require_from_zero),
    metavar="DEGREES",
    help="Standard uncertainty of a set angle. Not stated, the positions count as exact.",
)
@click.option(
    "--bench", metavar="FILE", help="A bench file with the sensor: its address, jig, thermometer and reference."
)
@options.declared(MeasureOptions, "python tilt samples settle resume journal operator plain hands_free listen")
@click.option("--json", "as_json", is_flag=True, help="Print a JSON object after the session, as with --operator json.")
def command(
    calibration: Path, procedure: str, limit: float, operator: str | None, resume: str | None, as_json: bool,
    **given: Any,
) -> int:  # fmt: skip
    """Measure positions that CALIBRATION was not fitted to, and compare tilts.

    The verdict follows ISO 14253-1 with the expanded uncertainty of the verification, from --jig and the noise: passed
    if every tilt error is within the limit with it added, failed if one is beyond the limit with it subtracted, else
    not decided. Exit code 1 unless passed.
    """
    judged, stated = read_calibration(calibration), complete(MeasureOptions, given)
    if resume is not None:
        named = {"--procedure": None if options.left_at_default("procedure") else procedure}
        named |= {
            f"--{name}": given[name] for name in ["address", "bench", "jig", "tilt", "samples", "settle", "journal"]
        }
        session = resumed(Path(resume), None, named, remark, stated["python"], verifies=True)
    elif stated["address"] is None and stated["bench"] is None:
        raise UsageError("verify needs --address or --bench, where the sensor is connected (or --resume JOURNAL)")
    else:
        beside = calibration.with_name(f"{calibration.stem}.verify.yaml")
        path = Path(stated["journal"]) if stated["journal"] else free_journal(beside, remark)
        bench = _bench_of(judged, stated).with_stated(jig=stated["jig"])
        bench = defaults_here().completing(bench, "operator", "references", "jig")
        steps = find_procedure(procedure, stated["tilt"]).in_positions().verifying()
        setup = new_setup(
            steps,
            bench,
            [None],
            path,
            operator=operator or "terminal",
            samples=stated["samples"],
            settle=stated["settle"],
        )
        session = Session(setup, path)
    _require_sensor(session, judged, calibration)
    again = f"verify {quote(str(calibration))}"
    again += "" if options.left_at_default("limit") else f" --limit {limit}"
    again += " --json" if as_json else ""
    operator = operator or session.setup.operator
    with led_by(operator, session, again, remark, stated) as opened:
        verification = verified(session, opened, {judged.sensor.serial: judged}, limit)[judged.sensor.serial]
        shown = {"serial": judged.sensor.serial, "file": str(calibration), "verdict": str(verification)}
        opened.tell(Results([shown]))
        opened.tell(Done([], str(session.files.journal)))
    if verification.jig is None:
        remark("no --jig is stated: the positions count as exact")
    # What a program reads is JSON to the last line.
    as_json = as_json or operator == "json"
    options.print_judged(options.json_text(verification.as_data()) if as_json else str(verification))
    return 0 if verification.verdict == PASSED else NEGATIVE_VERDICT


def _bench_of(judged: CalibrationRecord, stated: MeasureOptions) -> BenchFile:
    """Return the bench of the sensor of a calibration: of a bench file the sensor of its serial number alone."""
    sensor, address = judged.sensor, stated["address"]
    if stated["bench"] is None:
        return single(sensor.model, sensor.serial, str(address), device=judged.device)
    file = str(stated["bench"])
    bench = known_bench(read_document(file))
    require_trusted(bench, file, stated["python"])
    own = [one for one in bench.sensors if one.serial == sensor.serial]
    if not own:
        raise UsageError(f"{file} has no sensor {sensor.serial}, which the calibration is of")
    return bench.replaced(sensors=tuple(one.replaced(address=address or one.address) for one in own))


def _require_sensor(session: Session, judged: CalibrationRecord, calibration: Path) -> None:
    """Refuse the journal of another sensor, and readings that are not those of the calibration's sensor."""
    for device in session.setup.sensors:
        if (device.model, device.serial) != (judged.sensor.model, judged.sensor.serial):
            raise UsageError(
                f"{session.files.journal} is of {device.model} {device.serial}, and {calibration} of "
                f"{judged.sensor.model} {judged.sensor.serial}: name the calibration of that sensor"
            )
        require_as_calibrated(judged, device)

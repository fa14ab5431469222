"""``tiltcal apply``: compensate a recorded log."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tiltcal.cli import options
from tiltcal.cli.talk import progress_bar, remark, talk
from tiltcal.errors import InputError, TiltcalError, UsageError
from tiltcal.logs.options import ApplyOptions
from tiltcal.options import complete

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from tiltcal.cli.apply_several import Outcome

_EXAMPLE = """\b
Examples:
  tiltcal apply S-0042.yaml night.csv --uncertainty -o night-tilt.csv
  tiltcal apply S-0042.yaml may-*.parquet -o tilt
  tiltcal apply --calibrations calibrations night.csv --serial S-0042 -o night-tilt.csv
  tiltcal apply S-0042.yaml dive.csv --magnetometer mx,my,mz --velocity u,v,w -o currents.csv
  zcat night.csv.gz | tiltcal apply S-0042.yaml - --every 10s | gzip > night-tilt.csv.gz
"""


@options.command(epilog=_EXAMPLE)
@click.argument("files", metavar="CALIBRATION LOG...", nargs=-1, required=True)
@click.option("-o", "--output", default="-", metavar="OUT", help="The file to write [standard output], or the folder.")
@click.option(
    "--calibrations",
    type=click.Path(path_type=Path, file_okay=False, exists=True),
    metavar="DIR",
    help="In place of CALIBRATION: a folder; each row takes those of its sensor and time.",
)
@click.option("--scheduler", metavar="ADDRESS", help="Process each log on a worker of this dask scheduler.")
@click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON; on stderr if the rows go to stdout.")
@options.topic
@options.declared(ApplyOptions)
def command(
    files: tuple[str, ...],
    calibrations: Path | None,
    output: str,
    scheduler: str | None,
    as_json: bool,
    topic: str | None,
    **how: Any,
) -> int:
    """Convert the raw readings of LOG to tilt with quality flags.

    LOG is CSV with a header, Parquet, NetCDF-4, a bag of ROS, or - for CSV on standard input; OUT's name is its format.
    OUT has the columns of LOG, g_x and tilt_x (degrees) of each axis, pitch, roll and inclination of three axes, flag
    (1 pass, 3 suspect, 4 fail, 9 missing) and reason, a sum: 1 arcsine argument beyond ±1, 2 temperature and 8 tilt
    outside the calibrated range, 4 reading at the rail, 16 temperature missing, 32 not a number, 64 outside the time of
    the calibrations, 128 no direction or its sign unknown, or a field of unusual length, 256 length of gravity is not
    1 g. Several logs are processed into the folder OUT; one that fails is named, and the others are processed. Of pairs
    (`tiltcal match`) the columns are the matched sums and the gradient signal.
    """
    from tiltcal.library.apply import apply_log
    from tiltcal.logs.apply import prepare_any

    calibration, logs = (Path(files[0]), files[1:]) if calibrations is None else (calibrations, files)
    logs = tuple(options.of_topic(log, topic) for log in logs)
    if not logs:
        raise UsageError(f"no LOG is given behind {calibration}; see `tiltcal apply --help`")
    if calibrations is not None and len(logs) > 1:
        from tiltcal.files.calibration_folder import SUFFIXES

        if logs[0].lower().endswith(SUFFIXES):
            raise UsageError(f"{logs[0]} is a calibration, and --calibrations names a folder of them: leave one out")
    if len(logs) > 1 or scheduler is not None or os.path.isdir(output):
        from tiltcal.cli.apply_several import applied_here, applied_on, outputs_in

        outputs = outputs_in(output, logs, calibration)
        said: list[str] = []  # remarks on the calibration, or an error of it, come once
        prepare_any(calibration, complete(ApplyOptions, {**how, "say": said.append}))
        for text in said:
            remark(text)
        task = (calibration, outputs, how)
        return _reported(
            outputs, applied_here(*task) if scheduler is None else applied_on(scheduler, *task), said, as_json
        )
    with progress_bar("apply") as progress:
        summary = apply_log(calibration, logs[0], output, say=remark, progress=progress, **how)
    if as_json:
        (talk if output == "-" else click.echo)(options.json_text(summary.as_data()))
    else:
        remark(str(summary))
    return 0


def _reported(
    outputs: Mapping[str, str], outcomes: Iterable[tuple[str, Outcome]], said: Sequence[str], as_json: bool
) -> int:
    """Report what became of each of several logs, and raise an error at the end if one failed."""
    done = {}
    for log, (remarks, outcome) in outcomes:
        for text in remarks:
            if text not in said:
                remark(f"{log}: {text}")
        if isinstance(outcome, TiltcalError):
            remark(f"{log} failed and is left out: {outcome}")
            continue
        done[log] = {"output": outputs[log], **outcome.as_data()}
        if not as_json:
            remark(f"{outputs[log]}: {outcome}")
    if as_json:
        options.print_judged(options.json_text({"logs": {log: done[log] for log in outputs if log in done}}))
    if len(done) < len(outputs):
        rest = "; the others are written" if done else ""
        raise InputError(f"{len(outputs) - len(done)} of {len(outputs)} logs failed{rest}")
    return 0

"""``tiltcal noise``: characterise the noise of a sensor at rest."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Any

import click

from tiltcal.cli import options
from tiltcal.cli.talk import progress_bar, remark
from tiltcal.errors import INTERRUPTED, UsageError

_EXAMPLES = """\b
Examples:
  tiltcal noise --sensor sca100t-d02 --address spi:///dev/spidev0.0 --for 600 -o still.csv
  tiltcal noise still.csv --sensor sca100t-d02 --target 0.005 --figure still.svg
  tiltcal noise imu.csv --columns x=acc_x,y=acc_y,z=acc_z --rate 102.4 --unit m/s2
"""


@options.command(epilog=_EXAMPLES)
@click.argument("log", required=False)
@click.option("--sensor", metavar="MODEL", help="The model of the sensor; for a LOG it gives unit and sensitivity.")
@click.option("--address", help="Its address, to record it now instead of reading a LOG.")
@click.option("--samples", type=options.count(2, "samples"), help="Number of samples to record.")
@options.above_zero("--for", "seconds", metavar="SECONDS", help="Time to record.")
@options.above_zero(
    "--rate",
    metavar="HZ",
    help="Samples per second: of the recording [the rate of the sensor], or of a LOG [from its column time].",
)
@options.file_option("-o", "--output", metavar="LOG", help="Keep the recording: CSV, or Parquet by its name.")
@click.option(
    "--columns",
    default="",
    metavar="x=NAME,...",
    help="The column of each reading of LOG [x, y, z, if present] and of time; a number without a header.",
)
@options.topic
@click.option("--skip-bad-rows", is_flag=True, help="Count rows of LOG that cannot be parsed as missing.")
@options.file_option("--calibration", metavar="CAL.yaml", help="The calibration of the sensor, for results in g and °.")
@click.option(
    "--unit", help="The unit of the readings, without model and calibration; m/s2 and g imply the sensitivity."
)
@options.above_zero("--target", metavar="DEGREES", help="Standard uncertainty that the mean of a position must have.")
@options.file_option("--figure", metavar="SVG", help="Draw the Allan deviation.")
@options.as_json
def command(
    log: str | None, topic: str | None, calibration: Path | None, unit: str | None,
    target: float | None, figure: Path | None, as_json: bool, **recorded: Any,
) -> int:  # fmt: skip
    """Characterise the noise of a sensor at rest, and recommend the number of samples per position.

    Give a LOG (CSV, Parquet, NetCDF-4, or - for CSV on standard input) of a sensor at rest, or --sensor and --address
    to record one now. The table shows the scatter of averages of 1, 10, 100 samples, beside that of independent
    samples. The Allan deviation shows the kinds of noise and where averaging stops to help. The recommended number for
    `measure --samples` is the smallest that meets --target, or without a target the largest that is
    worth its time. Degrees are those of an axis near level.
    """
    from tiltcal.files.atomic import check_writable
    from tiltcal.logs.noise import characterise_readings, require_target, stated_scale
    from tiltcal.report.record_figures import draw_noise

    log = log and options.of_topic(log, topic)
    _require_log_or_sensor(log, recorded)
    sensor, address, rate, output = (recorded[name] for name in ("sensor", "address", "rate", "output"))
    scale, channels = stated_scale(sensor, address, calibration, unit)
    if address is not None or scale.unit is not None:  # before a sensor is recorded
        require_target(target, scale)
    if figure is not None:
        check_writable(figure, *(path for path in (log, calibration) if path is not None))
    interrupted, name = False, None
    with ExitStack() as stack:
        if address is not None:
            from tempfile import TemporaryDirectory

            from tiltcal.bench.setup import single
            from tiltcal.cli.record import record_log

            path = output or Path(stack.enter_context(TemporaryDirectory(prefix="tiltcal-"))) / "recorded"
            tally = record_log(single(str(sensor), "", address), rate, recorded["samples"], recorded["seconds"], path)
            kept = f" in {output}" if output is not None else ""
            remark(f"{tally.rows} samples{kept}{tally.losses_in_words}")
            interrupted = tally.interrupted
            log, rate, name = str(path), None, str(output or "the record")
        progress = stack.enter_context(progress_bar("noise"))
        how = {"columns": recorded["columns"], "skip_bad_rows": recorded["skip_bad_rows"]}
        found = characterise_readings(log, scale, channels, target, rate=rate, name=name, progress=progress, **how)
    if figure is not None:
        draw_noise(figure, found.channels, found.scale)
    for note in found.remarks:
        remark(f"note: {note}")
    click.echo(options.json_text(found.as_data()) if as_json else str(found))
    return INTERRUPTED if interrupted else 0


def _require_log_or_sensor(log: str | None, recorded: dict[str, Any]) -> None:
    """Refuse options that are not for a log, or not for a sensor that is recorded now."""
    from tiltcal.drivers.bus.address import parse_address

    address = recorded["address"]
    if address is None:
        if log is None:
            raise UsageError("noise needs either a LOG, or --sensor MODEL and --address ADDRESS to record one now")
        for option, name in (("--samples", "samples"), ("--for", "seconds"), ("--output", "output")):
            if recorded[name] is not None:
                raise UsageError(f"{option} is for recording a sensor with --address, not for a LOG")
        return
    if log is not None:
        raise UsageError(f"either the log {log} or the sensor at {address}, not both; -o LOG keeps what is recorded")
    if recorded["sensor"] is None:
        raise UsageError("--address needs the --sensor model that is connected there")
    if recorded["columns"] or recorded["skip_bad_rows"]:
        raise UsageError("--columns and --skip-bad-rows are for a LOG")
    if recorded["samples"] is None and recorded["seconds"] is None and parse_address(address).simulated:
        raise UsageError("a recording on the virtual bench needs --samples or --for")

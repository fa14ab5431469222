"""``tiltcal noise``"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tiltcal.errors import UsageError

if TYPE_CHECKING:
    from tiltcal.drivers.device import Model
    from tiltcal.files.calibration import CalibrationRecord
    from tiltcal.logs.noise_log import NoiseLog
    from tiltcal.report.noise_summary import NoiseScale

INTERRUPTED = 130
STANDARD_GRAVITY = 9.80665
"""m/s²"""

_EXAMPLES = """\b
Examples:
  tiltcal noise --sensor sca100t-d02 --address spi:///dev/spidev0.0 --for 600 -o still.csv
  tiltcal noise still.csv --sensor sca100t-d02 --target 0.005 --figure still.svg
  tiltcal noise imu.csv --columns x=acc_x,y=acc_y,z=acc_z --rate 102.4 --unit m/s2
"""


@click.command(epilog=_EXAMPLES)
@click.argument("log", required=False)
@click.option("--sensor", metavar="MODEL", help="The sensor's model; with a LOG it says unit and sensitivity.")
@click.option("--address", help="Where it is connected, to record it now in place of a LOG.")
@click.option("--samples", type=click.IntRange(2), help="How many to record.")
@click.option(
    "--for", "seconds", type=click.FloatRange(0.0, min_open=True), metavar="SECONDS", help="How long to record."
)
@click.option(
    "--rate",
    type=click.FloatRange(0.0, min_open=True),
    metavar="HZ",
    help="Samples a second: to record [as fast as the sensor renews itself], or of a LOG [its column time says it].",
)
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="LOG", help="Keep what is recorded, as CSV.")
@click.option(
    "--columns",
    default="",
    metavar="x=NAME,...",
    help="Which column of LOG holds which reading [x, y, z, as far as there], and time; by number without a header.",
)
@click.option("--skip-bad-rows", is_flag=True, help="Count rows of LOG that cannot be parsed as missing.")
@click.option(
    "--calibration", type=click.Path(path_type=Path), metavar="CAL.yaml", help="The sensor's calibration, for g and °."
)
@click.option(
    "--unit", help="The readings' unit, where neither model nor calibration says it; of m/s2 and g, g is known."
)
@click.option(
    "--averages", metavar="N,...", default="", help="More sizes of averages for the table, beside 1, 10, 100."
)
@click.option(
    "--target",
    type=click.FloatRange(0.0, min_open=True),
    metavar="DEGREES",
    help="Standard uncertainty that the mean of a position should have.",
)
@click.option("--figure", type=click.Path(path_type=Path), metavar="SVG", help="Draw the Allan deviation.")
@click.option("--json", "as_json", is_flag=True, help="Print an object for a program.")
def command(
    log: str | None,
    sensor: str | None,
    address: str | None,
    samples: int | None,
    seconds: float | None,
    rate: float | None,
    output: Path | None,
    columns: str,
    skip_bad_rows: bool,
    calibration: Path | None,
    unit: str | None,
    averages: str,
    target: float | None,
    figure: Path | None,
    as_json: bool,
) -> int:
    """Tell how noisy a sensor is at rest, and how many samples its positions need.

    Either a LOG (CSV, Parquet, NetCDF-4, or - for CSV on standard input) of a sensor that nobody touched, or --sensor
    and --address to record one now. The table shows how averages of 1, 10, 100 samples scatter, beside what independent
    samples would give; the Allan deviation, which kinds of noise there are and where averaging stops to help. From it
    follows the number for `measure --samples`: the smallest that meets --target, or without one the largest that is
    worth its time. Degrees are those of an axis near level.
    """
    from tiltcal.files.whole import check_writable
    from tiltcal.report.noise_summary import as_data, draw_noise, summary

    if address is None:
        _refuse_for_log(log, samples, seconds, output)
    else:
        _refuse_live(log, sensor, columns, skip_bad_rows, address, samples, seconds)
    sizes = _sizes(averages)
    facts = _facts(sensor, address, calibration, unit)
    if target is not None and not facts.sensitivity:
        raise UsageError(
            "--target is in degrees, and nothing says how much a degree is: give the --sensor model, a --calibration, "
            "or --unit g or m/s2"
        )
    if figure is not None:
        check_writable(figure)
    interrupted = False
    if address is None:
        resting = _characterised(str(log), columns, rate, facts, sizes, skip_bad_rows)
    else:
        with _kept(output) as path:
            interrupted = _recorded(str(sensor), address, rate, samples, seconds, path, output)
            called = str(output or "the record")
            resting = _characterised(str(path), "", None, facts, sizes, skip_bad_rows, called)
    scale = facts.scale(resting)
    if figure is not None:
        draw_noise(figure, resting.channels, scale)
    if not as_json:
        click.echo(resting.as_text())
    for remark in resting.remarks():
        click.echo(f"note: {remark}", err=True)
    said = resting.channels, resting.pace.interval, scale, target
    click.echo(json.dumps({**resting.as_data(), **as_data(*said)}) if as_json else summary(*said))
    return INTERRUPTED if interrupted else 0


@dataclass(frozen=True)
class NoiseFacts:
    """What is known of the sensor beside its readings.

    Attributes
    ----------
    channels : tuple of str
        Its readings; empty where the log has to say it.
    unit : str or None
    sensitivity : dict of str to float
        Unit/g, per channel, or under ``*`` for all of them; empty where it is not known.
    source : str
        Where the sensitivity is from.
    """

    channels: tuple[str, ...]
    unit: str | None
    sensitivity: dict[str, float]
    source: str

    def scale(self, resting: NoiseLog) -> NoiseScale:
        """The scale of a log's channels."""
        from tiltcal.report.noise_summary import NoiseScale

        per_g = {
            channel: abs(self.sensitivity.get(channel, self.sensitivity.get("*", 0.0))) for channel in resting.channels
        }
        return NoiseScale(self.unit or "unit", {c: s for c, s in per_g.items() if s}, self.source)


def _facts(sensor: str | None, address: str | None, calibration: Path | None, unit: str | None) -> NoiseFacts:
    from tiltcal.calibration.calibrate import ACCELERATION
    from tiltcal.drivers import find_model
    from tiltcal.drivers.bus.address import parse_address
    from tiltcal.files.calibration import read_calibration

    model = find_model(sensor) if sensor else None
    if model is not None and address is not None:
        model = model.at(parse_address(address))
    known = read_calibration(calibration) if calibration else None
    _refuse_contradiction(model, known, unit)
    own_unit = unit or (known.sensor.unit if known else None) or (model.unit if model else None)
    channels = tuple(model.channels) if model else known.sensor.channels if known else ()
    if known is not None:
        matrix = known.coefficients
        own = {
            channel: float(matrix.sensitivity[row, matrix.axes.index(channel)])
            for row, channel in enumerate(matrix.channels)
            if channel in matrix.axes
        }
        return NoiseFacts(channels, own_unit, own, f"calibration of {known.sensor.serial}")
    if model is not None and model.scaled:
        return NoiseFacts(channels, own_unit, {"*": model.sensitivity}, f"nominal sensitivity of {model.name}")
    if own_unit in (*ACCELERATION, "g"):
        return NoiseFacts(channels, own_unit, {"*": 1.0 if own_unit == "g" else STANDARD_GRAVITY}, f"unit {own_unit}")
    return NoiseFacts(channels, own_unit, {}, "")


def _refuse_contradiction(model: Model | None, known: CalibrationRecord | None, unit: str | None) -> None:
    units = {
        "--sensor": model.unit if model else None,
        "--calibration": known.sensor.unit if known else None,
        "--unit": unit,
    }
    said = {name: one for name, one in units.items() if one is not None}
    if len(set(said.values())) > 1:
        raise UsageError("the readings have one unit: " + ", but ".join(f"{name} says {u}" for name, u in said.items()))
    if model and known and set(known.sensor.channels) - set(model.channels):
        raise UsageError(
            f"--calibration is of {', '.join(known.sensor.channels)}, and {model.name} has {', '.join(model.channels)}"
        )


def _refuse_for_log(log: str | None, samples: int | None, seconds: float | None, output: Path | None) -> None:
    if log is None:
        raise UsageError("noise needs either a LOG, or --sensor MODEL and --address ADDRESS to record one now")
    for option, value in (("--samples", samples), ("--for", seconds), ("--output", output)):
        if value is not None:
            raise UsageError(f"{option} is for recording a sensor with --address; a LOG is taken as it is")


def _refuse_live(
    log: str | None,
    sensor: str | None,
    columns: str,
    skip_bad_rows: bool,
    address: str,
    samples: int | None,
    seconds: float | None,
) -> None:
    from tiltcal.drivers.bus.address import parse_address

    if log is not None:
        raise UsageError(f"either the log {log} or the sensor at {address}, not both; -o LOG keeps what is recorded")
    if sensor is None:
        raise UsageError("--address needs the --sensor model that is connected there")
    if columns or skip_bad_rows:
        raise UsageError("--columns and --skip-bad-rows are for a LOG")
    if samples is None and seconds is None and parse_address(address).simulated:
        raise UsageError("on the virtual bench time takes no time: say --samples or --for")


def _sizes(text: str) -> tuple[int, ...]:
    try:
        sizes = tuple(int(part) for part in text.split(",") if part.strip())
    except ValueError:
        sizes = (0,)
    if any(size < 1 for size in sizes):
        raise UsageError(f"--averages {text!r}: write whole numbers of samples, such as 5,20")
    return sizes


@contextmanager
def _kept(output: Path | None) -> Iterator[Path]:
    """Where what is recorded goes: to the file that was asked for, or to one that is gone afterwards."""
    from tempfile import TemporaryDirectory

    if output is not None:
        if output.suffix == ".parquet":
            raise UsageError(f"{output}: noise records CSV; name it .csv")
        yield output
        return
    with TemporaryDirectory(prefix="tiltcal-") as folder:
        yield Path(folder) / "recorded"


def _recorded(
    sensor: str,
    address: str,
    rate: float | None,
    samples: int | None,
    seconds: float | None,
    path: Path,
    output: Path | None,
) -> bool:
    """Record the sensor; whether it was interrupted."""
    from tiltcal.bench.session_plan import single
    from tiltcal.cli.recording import capture

    captured = capture(single(sensor, "", address), rate, samples, seconds, path)
    kept = f" in {output}" if output is not None else ""
    click.echo(f"{captured.tally.rows} samples{kept}{captured.missing}", err=True)
    return captured.interrupted


def _characterised(
    log: str,
    columns: str,
    rate: float | None,
    facts: NoiseFacts,
    sizes: tuple[int, ...],
    skip_bad_rows: bool,
    called: str | None = None,
) -> NoiseLog:
    from tiltcal.cli.progress import progress_bar
    from tiltcal.core.model import AXES
    from tiltcal.logs.columns import parse_columns
    from tiltcal.logs.formats import open_log
    from tiltcal.logs.noise_log import characterise_log
    from tiltcal.logs.uniform_sampling import UniformLog

    named = parse_columns(columns, AXES)
    with (
        progress_bar("noise") as progress,
        open_log(log, name=called, skip_bad_rows=skip_bad_rows, progress=progress) as rows,
    ):
        asked = tuple(axis for axis in AXES if axis in named)
        there = tuple(axis for axis in AXES if axis in rows.names)
        # With neither, x is looked for, and the message that it is not there says how to name it.
        channels = asked or facts.channels or there or AXES[:1]
        return characterise_log(UniformLog(rows, channels, named, rate), channels, sizes)

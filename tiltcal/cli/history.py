"""``tiltcal history``: show the calibrations of a folder."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import click

from tiltcal.calibration.season import CalibrationFolder, FleetHistory, fleet_history
from tiltcal.cli import options
from tiltcal.errors import UsageError

LONGEST = 36525  # interval of 100 years, days
_EXAMPLE = """\b
Examples:
  tiltcal history calibrations
  tiltcal history calibrations --interval 180d --json
"""


@options.command(epilog=_EXAMPLE)
@click.argument("folder", type=click.Path(path_type=Path), metavar="DIR")
@click.option("--interval", default="365d", metavar="DAYS", help="Time from one calibration to the next [365d].")
@options.as_json
def command(folder: Path, interval: str, as_json: bool) -> None:
    """Show the calibrations of all sensors in a folder, what changed, and when the next one is due.

    Each calibration is compared with the one before it, as `tiltcal diff` does. Then follows, for each model with three
    sensors or more, the distribution of every coefficient over the last calibrations, at one reference temperature, and
    the sensors that lie outside it by more than five robust standard deviations. Files that cannot be used, or that
    contradict each other, are named. `tiltcal report DIR` makes a page of it.
    """
    found = read_history(folder, interval)
    click.echo(options.json_text(found.as_data()) if as_json else str(found))


def read_history(folder: Path, interval: str = "365d") -> FleetHistory:
    """Return the history of a folder at this moment.

    UsageError: it is no folder, it has no calibration, or the interval is not one.
    """
    try:
        days = float(interval.removesuffix("d"))
    except ValueError:
        raise UsageError(f"--interval: {interval!r} is no number of days; write it as 365d") from None
    if not 0.0 <= days <= LONGEST:
        raise UsageError(f"--interval: {interval} is not between 0d and {LONGEST}d")
    calibrations = CalibrationFolder(folder)
    if not calibrations.serials and not calibrations.index.problems:
        raise UsageError(f"{folder} has no calibration files")
    return fleet_history(calibrations, timedelta(days=days), datetime.now(UTC))

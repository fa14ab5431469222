"""``tiltcal live``: the calibrated tilt of a sensor as it is now."""

from __future__ import annotations

import sys
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tiltcal.cli import options
from tiltcal.cli.talk import in_options, talk
from tiltcal.errors import INTERRUPTED, HardwareError, UsageError
from tiltcal.files.moments import stamp

if TYPE_CHECKING:
    from tiltcal.bench.live import LiveTilt

CLEAR = "\r\x1b[2K"


@options.command(epilog="Example: tiltcal live S-0042.yaml --address spi:///dev/spidev0.0")
@click.argument("calibration", type=click.Path(path_type=Path))
@click.option(
    "--address", help="The address of the sensor, or sim: for its virtual twin; not stated, the one of the CALIBRATION."
)
@options.above_zero("--rate", metavar="HZ", default=4.0, show_default=True, help="Readings per second.")
@options.above_zero("--for", "seconds", metavar="SECONDS", help="Stop after this time.")
@click.option("--json", "as_json", is_flag=True, help="Print a JSON object a reading.")
def command(calibration: Path, address: str | None, rate: float, seconds: float | None, as_json: bool) -> int:
    """Show the tilt of a sensor by its CALIBRATION until Ctrl-C.

    Each tilt is followed by ± its 95 % half-width; a suspect reading ends with the reason. On a terminal one line
    renews itself; elsewhere each reading is a line. A failed reading is reported; five in a row end the command.
    """
    from tiltcal.bench.devices import ATTEMPTS
    from tiltcal.bench.live import as_calibrated, live_tilts
    from tiltcal.files.bench import BenchSensor
    from tiltcal.files.calibration import read_calibration

    record = read_calibration(calibration)
    serial, bench = record.sensor.serial, record.provenance.bench
    address = address or (None if bench is None else bench.address)
    if address is None:
        raise UsageError(f"{calibration} names no address of its sensor: state --address")
    address = as_calibrated(record, address)
    device = BenchSensor(serial, record.sensor.model, address, device=record.device)
    renews = sys.stdout is not None and sys.stdout.isatty() and not as_json
    failures = 0
    with live_tilts([device], {serial: record}) as read:
        began = due = time.monotonic()
        try:
            while seconds is None or due - began < seconds:
                try:
                    _show(serial, read()[serial], renews=renews, as_json=as_json)
                    failures = 0
                except HardwareError as error:
                    failures += 1
                    if failures == ATTEMPTS:
                        raise
                    talk(f"{CLEAR if renews else ''}no reading: {in_options(error)}")
                due = max(due + 1.0 / rate, time.monotonic())
                time.sleep(max(0.0, due - time.monotonic()))
        except KeyboardInterrupt:
            return 0 if seconds is None else INTERRUPTED
        finally:
            if renews:
                click.echo()
    return 0


def _show(serial: str, tilt: LiveTilt, *, renews: bool, as_json: bool) -> None:
    """Print a tilt, on a terminal in place of the one before."""
    if as_json:
        click.echo(options.json_text({"time": stamp(datetime.now(UTC)), **tilt.as_data()}))
    elif renews:
        from shutil import get_terminal_size

        click.echo(f"{CLEAR}{serial}{tilt.within(get_terminal_size().columns - 1 - len(serial))}", nl=False)
    else:
        click.echo(f"{serial}   {tilt}")

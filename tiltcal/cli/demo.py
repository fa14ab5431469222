"""``tiltcal demo``: measure, calibrate, apply and report on the virtual bench."""

from __future__ import annotations

from math import asin, degrees, pi, sin
from pathlib import Path
from textwrap import indent
from typing import Any

import click
import numpy as np
import polars as pl

from tiltcal.bench.devices import VirtualBench
from tiltcal.calibration.wording import summary
from tiltcal.cli import options
from tiltcal.cli.apply import command as apply
from tiltcal.cli.report import write_report
from tiltcal.core.attitude import gravity_from_tilt
from tiltcal.drivers import find_model
from tiltcal.drivers.bus.address import Address, parse_address
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.model import Model
from tiltcal.errors import UsageError
from tiltcal.files.atomic import write_whole
from tiltcal.files.bench import BenchSensor
from tiltcal.files.calibration import read_calibration
from tiltcal.library.measure import measure
from tiltcal.report.calibration_figures import draw_tilt_error
from tiltcal.report.figure import require_extra

MODEL, PROCEDURE, SERIAL = "sca100t-d02", "complete", "SIM-1"
ROWS, REACH, TEMPERATURES = 1500, {"x": 40.0, "y": 35.0}, (22.0, 8.0)


@options.command(epilog="Example: tiltcal demo demo")
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False), default=Path("demo"))
@click.option("--seed", default=1, show_default=True, help="The number of the virtual part.")
def command(folder: Path, seed: int) -> None:
    """Measure, calibrate, apply to a recorded log and report, on the virtual bench.

    It measures a virtual SCA100T-D02 in seven positions at two temperatures, and applies the calibration to a log of
    the same part with known true tilt. All files are written into FOLDER.
    """
    model, address = find_model(MODEL), parse_address(f"sim:?seed={seed}")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"cannot make the folder {folder}: {error.strerror}") from None
    calibration, journal = folder / f"{SERIAL}.yaml", folder / f"{SERIAL}.journal.jsonl"
    log, compensated = folder / "log.csv", folder / "log-tilt.csv"
    picture, page = folder / "tilt-error.svg", folder / "report.html"

    click.echo("1. measure, on the virtual bench (no real sensor)")
    journal.unlink(missing_ok=True)
    sensor: dict[str, Any] = {"sensor": MODEL, "address": str(address), "serial": SERIAL}
    sensor |= {"remark": lambda text: click.echo(indent(text, "   "))}
    measure(PROCEDURE, operator="sim", output=calibration, journal=journal, **sensor)
    click.echo("\n2. the calibration file")
    click.echo(summary(read_calibration(calibration), notes=False))
    click.echo(
        f"\n3. apply it to a recorded log: {ROWS} rows inside the calibrated range, tilts up to ±{REACH['x']:g}°, "
        f"{TEMPERATURES[0]:g} to {TEMPERATURES[1]:g} °C"
    )
    _record(log, address, model)
    apply.main([str(calibration), str(log), "-o", str(compensated)], standalone_mode=False)
    click.echo("   flag 1 is good; a row outside the calibrated range gets 3, one without a tilt 4, an empty one 9")
    click.echo(f"   wrote {compensated}")
    click.echo("\n4. tilt error against the log's true tilt")
    rows = {column.name: column.to_numpy() for column in pl.read_csv(compensated)}
    before, after = {}, {}
    click.echo("            before                     after")
    click.echo("            rms       largest          rms       largest")
    for axis in REACH:
        ratio = (rows[axis] - model.offset) / model.sensitivity  # by the data sheet
        before[axis] = np.degrees(np.arcsin(np.clip(ratio, -1.0, 1.0))) - rows[f"true_tilt_{axis}"]
        after[axis] = rows[f"tilt_{axis}"] - rows[f"true_tilt_{axis}"]
        errors = (before[axis], after[axis])
        figures = (f"{np.sqrt(np.mean(error**2)):.3f}°    {np.abs(error).max():.3f}°" for error in errors)
        click.echo(f"   tilt {axis}   " + "           ".join(figures))
    click.echo("\n5. report")
    try:
        require_extra()
    except UsageError as missing:
        click.echo(f"   no picture and no page: {missing}")
        return

    title = f"{MODEL} on the virtual bench, tilts within ±{REACH['x']:g}°"
    draw_tilt_error(picture, rows["time"], rows["temperature"], before, after, title)
    write_report([str(calibration), str(compensated)], page)
    click.echo(f"   wrote {picture}\n   wrote {page}")


def _record(path: Path, address: Address, model: Model) -> None:
    """Write the log for the calibration, a row each second, with its true tilt beside the readings."""
    clock, device = VirtualClock(), BenchSensor("", model.name, str(address))
    bench = VirtualBench(clock, [device])
    sensor = model.driver(bench.twin(device), clock)
    lines = ["time,x,y,temperature,true_tilt_x,true_tilt_y"]
    for number in range(ROWS):
        share = number / (ROWS - 1)
        tilt = {axis: REACH[axis] * sin(turns * 2 * pi * share) for axis, turns in (("x", 9), ("y", 14))}
        bench.fixture.move(gravity_from_tilt(tilt), TEMPERATURES[0] + (TEMPERATURES[1] - TEMPERATURES[0]) * share)
        clock.sleep(1.0)
        g_x, g_y, _ = bench.fixture.gravity
        reading = sensor.read()
        x, y = reading.values
        true_x, true_y = degrees(asin(g_x)), degrees(asin(g_y))
        lines.append(f"{clock.now_ns() / 1e9:.4f},{x:.0f},{y:.0f},{reading.temperature:.2f},{true_x:.5f},{true_y:.5f}")
    write_whole(path, "\n".join(lines) + "\n")

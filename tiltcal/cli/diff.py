"""``tiltcal diff``"""

from __future__ import annotations

import json
from pathlib import Path

import click

from tiltcal.files.calibration import changes_between, read_calibration, require_same_sensor


@click.command(epilog="Example: tiltcal diff S-0042-spring.yaml S-0042-autumn.yaml")
@click.argument("before", type=click.Path(path_type=Path))
@click.argument("after", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print an object for a program.")
def command(before: Path, after: Path, as_json: bool) -> None:
    """Tell whether two calibrations of one sensor differ by more than their uncertainty.

    Every coefficient's change, and the change over its standard uncertainty. The verdict allows for the number of
    coefficients that are compared: of two calibrations of an unchanged sensor it calls 5 % different.
    """
    from tiltcal.core.comparison import judge

    old, new = read_calibration(before), read_calibration(after)
    require_same_sensor(old, new)
    found = changes_between(old, new)
    verdict = judge(found)
    if as_json:
        rows = [
            {
                "name": c.name,
                "before": c.before,
                "after": c.after,
                "change": c.difference,
                "u": c.u,
                "ratio": c.ratio,
                "threshold": verdict.thresholds.get(c.name),
            }
            for c in found
        ]
        click.echo(
            json.dumps(
                {
                    "sensor": new.sensor.serial,
                    "verdict": verdict.word,
                    "threshold": verdict.threshold,
                    "changed": list(verdict.changed),
                    "coefficients": rows,
                }
            )
        )
        return
    click.echo(f"{new.sensor.model} {new.sensor.serial}, {new.sensor.unit}")
    click.echo(f"  {'':<26} {'before':>12} {'after':>12} {'change':>12}   change / u (threshold)")
    for change in found:
        ratio = "" if change.ratio is None else f"{change.ratio:8.2f} ({verdict.thresholds[change.name]:.2f})"
        mark = "  <" if change.name in verdict.changed else ""
        click.echo(
            f"  {change.name:<26} {change.before:>12.6g} {change.after:>12.6g} {change.difference:>+12.4g}"
            f"   {ratio}{mark}"
        )
    click.echo(str(verdict))

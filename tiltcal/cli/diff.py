"""``tiltcal diff``"""

from __future__ import annotations

import json
from pathlib import Path

import click

from tiltcal.errors import UsageError
from tiltcal.files.calibration import Calibration, read_calibration

COVERAGE = 0.95
"""How sure the verdict is to be that nothing has changed before it calls a difference one."""


@click.command(epilog="Example: tiltcal diff S-0042-spring.yaml S-0042-autumn.yaml")
@click.argument("before", type=click.Path(path_type=Path))
@click.argument("after", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print an object for a program.")
def command(before: Path, after: Path, as_json: bool) -> None:
    """Tell whether two calibrations of one sensor differ by more than their uncertainty.

    Every coefficient's change, and the change over its standard uncertainty. The verdict allows for the number of
    coefficients that are compared: of two calibrations of an unchanged sensor it calls 5 % different.
    """
    from tiltcal.core.change import changes
    from tiltcal.files.uncertainty import named_uncertainties

    old, new = read_calibration(before), read_calibration(after)
    _require_same_sensor(old, new)
    u_old, u_new = (dict(named_uncertainties(one.uncertainty)) for one in (old, new))
    found = changes(old.coefficients, new.coefficients, u_old, u_new)
    ratios = [change.ratio for change in found if change.ratio is not None]
    threshold = _threshold(len(ratios)) if ratios else None
    changed = [change.name for change in found if threshold and change.ratio is not None and change.ratio > threshold]
    verdict = "unknown" if threshold is None else "changed" if changed else "unchanged"
    if as_json:
        rows = [
            {"name": c.name, "before": c.before, "after": c.after, "change": c.difference, "u": c.u, "ratio": c.ratio}
            for c in found
        ]
        click.echo(
            json.dumps(
                {
                    "sensor": new.sensor.serial,
                    "verdict": verdict,
                    "threshold": threshold,
                    "changed": changed,
                    "coefficients": rows,
                }
            )
        )
        return
    click.echo(f"{new.sensor.model} {new.sensor.serial}, {new.sensor.unit}")
    click.echo(f"  {'':<26} {'before':>12} {'after':>12} {'change':>12}   change / u")
    for change in found:
        ratio = "" if change.ratio is None else f"{change.ratio:8.2f}"
        mark = "  <" if change.name in changed else ""
        click.echo(
            f"  {change.name:<26} {change.before:>12.6g} {change.after:>12.6g} {change.difference:>+12.4g}"
            f"   {ratio}{mark}"
        )
    click.echo(_in_words(verdict, changed, threshold))


def _in_words(verdict: str, changed: list[str], threshold: float | None) -> str:
    if threshold is None:
        return "no verdict: the files state no uncertainties to compare with"
    if verdict == "unchanged":
        return f"unchanged: no change is more than {threshold:.2f} standard uncertainties"
    return f"changed: {', '.join(changed)} by more than {threshold:.2f} standard uncertainties"


def _threshold(count: int) -> float:
    """How many standard uncertainties one of ``count`` changes may be (Šidák)."""
    from statistics import NormalDist

    return NormalDist().inv_cdf((1.0 + COVERAGE ** (1.0 / count)) / 2.0)


def _require_same_sensor(old: Calibration, new: Calibration) -> None:
    for what in ("serial", "model", "unit", "channels"):
        a, b = getattr(old.sensor, what), getattr(new.sensor, what)
        if a != b:
            raise UsageError(f"not two calibrations of one sensor: its {what} is {a} in one and {b} in the other")

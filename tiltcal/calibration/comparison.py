"""Two calibrations of one sensor compared, which ``tiltcal diff`` prints."""

from __future__ import annotations

from dataclasses import dataclass
from math import nan
from typing import Any

import numpy as np

from tiltcal.calibration.labels import unit_of
from tiltcal.calibration.verdict import Verdict, judge
from tiltcal.core.attitude import LEVEL, gravity_from_tilt, normalised, orientation
from tiltcal.core.model import AXES, Array
from tiltcal.core.named_coefficients import CoefficientChange, values
from tiltcal.core.rounding import plus_minus
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity, changes_between, require_same_sensor
from tiltcal.files.results import NOISE_ALONE, PositionSet

_ALIKE = 0.02
"""Coefficients of two files mean the same if the shares of other terms that they hold differ by less than this."""

_INCOMPLETE = (
    "the uncertainty of the {which} file rests on noise alone and leaves out how well the positions were set: measure "
    "with --jig, or in more positions"
)


@dataclass(frozen=True)
class Comparison:
    """The comparison of an older and a newer calibration of one sensor.

    Attributes
    ----------
    changes : tuple of CoefficientChange
        Every coefficient that means the same in both, at the newer one's reference temperature, or where only one has a
        drift at the temperature of the other.
    not_comparable : tuple of str
        All others; where the positions do not determine the column of z, an offset holds a part of it.
    """

    sensor: SensorIdentity
    changes: tuple[CoefficientChange, ...]
    verdict: Verdict
    not_comparable: tuple[str, ...] = ()

    @property
    def in_words(self) -> str:
        """The verdict in one word, and by how much each changed coefficient has changed."""
        rest = f"; not comparable: {', '.join(self.not_comparable)}" if self.not_comparable else ""
        if self.verdict.word != "changed":
            return self.verdict.word + rest
        changed = [change for change in self.changes if change.name in self.verdict.changed]
        moved = (
            f"{change.name} by {plus_minus(change.difference, change.u or 0.0, signed=True)} "
            f"{unit_of(change.name, self.sensor.unit)}".rstrip()
            for change in changed
        )
        return f"changed: {', '.join(moved)}{rest}"

    def as_data(self) -> dict[str, Any]:
        """Return the comparison as plain data."""
        verdict = self.verdict
        return {
            "sensor": self.sensor.serial,
            "verdict": verdict.word,
            "threshold": verdict.threshold,
            "changed": list(verdict.changed) if verdict.word == "changed" else [],
            "coefficients": [
                {
                    "name": change.name,
                    "before": change.before,
                    "after": change.after,
                    "change": change.difference,
                    "u": change.u,
                    "ratio": change.ratio,
                    "threshold": verdict.thresholds.get(change.name),
                }
                for change in self.changes
            ],
            "not_comparable": list(self.not_comparable),
        }

    def __str__(self) -> str:
        verdict = self.verdict
        lines = [
            f"{self.sensor.model} {self.sensor.serial}, {self.sensor.unit}",
            f"  {'':<26} {'before':>12} {'after':>12} {'change':>12}   change / u (threshold)",
        ]
        for change in self.changes:
            ratio = "" if change.ratio is None else f"{change.ratio:8.2f} ({verdict.thresholds[change.name]:.2f})"
            mark = "  <" if change.name in verdict.changed else ""
            lines.append(
                f"  {change.name:<26} {change.before:>12.6g} {change.after:>12.6g} {change.difference:>+12.4g}"
                f"   {ratio}{mark}"
            )
        lines += [f"  {name:<26} not comparable" for name in self.not_comparable]
        return "\n".join([*lines, str(verdict)])

    __repr__ = __str__


def compare_records(old: CalibrationRecord, new: CalibrationRecord) -> Comparison:
    """Compare two calibrations of one sensor; a UsageError names what differs where they are not of one."""
    require_same_sensor(old, new)
    reference = _temperature(old if old.coefficients.thermal is None else new)
    steady = {record.coefficients.thermal is None for record in (old, new)}
    unlike = {"offset", "sensitivity"} if len(steady) == 2 and reference is None else set()
    bent = (old.coefficients.nonlinearity is None) != (new.coefficients.nonlinearity is None)
    shares = [_held_shares(record) for record in (old, new)]

    def comparable(name: str) -> bool:
        kind, channel, *axis = name.split(".")
        first, last = (held.get("".join(axis) if kind == "sensitivity" else kind, 0.0) for held in shares)
        curved = bent and (kind == "offset" or (kind == "sensitivity" and axis == [channel]))
        return kind not in unlike and not curved and np.allclose(first, last, rtol=0.0, atol=_ALIKE, equal_nan=True)

    compared = tuple(change for change in changes_between(old, new, reference) if comparable(change.name))
    files = (("older", old), ("newer", new))
    alone = [which for which, record in files if record.fit.uncertainty_from == NOISE_ALONE]
    incomplete = _INCOMPLETE.format(which=" and the ".join(alone)) if alone else ""
    verdict = judge(compared, incomplete if compared else "no coefficient means the same in both files")
    rest = (values(old.coefficients) | values(new.coefficients)).keys() - {change.name for change in compared}
    return Comparison(new.sensor, compared, verdict, tuple(sorted(rest)))


def _temperature(record: CalibrationRecord) -> float | None:
    """Return the reference temperature, without a drift the mean of the positions, °C; None where none is stated."""
    if record.coefficients.thermal is not None:
        return record.coefficients.thermal.reference
    own, _, levelled = record.runs
    met = [position.temperature for position in levelled or own if position.temperature is not None]
    return float(np.mean(met)) if met else None


def _held_shares(record: CalibrationRecord) -> dict[str, Array]:
    """Return the shares of the columns x, y and z that a file leaves out in its ``offset`` and each column, shape (3,).

    They are those of least squares at the positions; NaN where the attitudes are not stated.
    """
    axes, bench = record.coefficients.axes, record.provenance.bench
    own, _, levelled = record.runs
    stated = [record.procedure.set.get(position.position, PositionSet()) for position in own]
    attitudes = [gravity_from_tilt(one.tilt) if one.tilt is not None else one.gravity for one in stated]
    seen = orientation(bench.axes if bench is not None and bench.axes else AXES).seen
    up = np.array([(nan,) * 3 if one is None else seen(normalised(one)) for one in [*attitudes, LEVEL]])
    fitted = [AXES.index(axis) for axis in axes]
    design = np.column_stack([np.ones(len(up)), up[:, fitted]])
    held = np.full((design.shape[1], 3), nan)
    if own and np.isfinite(up).all():
        held = np.linalg.lstsq(design[:-1], up[:-1], rcond=None)[0]
    if levelled:
        held[0] = up[-1] - design[-1, 1:] @ held[1:]
    held[:, fitted] = 0.0
    return dict(zip(("offset", *axes), held, strict=True))

"""Two calibrations of one sensor compared: ``compare``, its thresholds and verdict, which ``tiltcal diff`` prints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tiltcal.calibration.calibration import Calibration
from tiltcal.calibration.labels import unit_of
from tiltcal.calibration.verdict import Verdict, judge
from tiltcal.core.named_coefficients import CoefficientChange
from tiltcal.core.rounding import plus_minus
from tiltcal.errors import UsageError
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity, changes_between, require_same_sensor
from tiltcal.files.fit_record import NOISE_ALONE

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
        Every coefficient that both have, at the newer one's reference temperature.
    """

    sensor: SensorIdentity
    changes: tuple[CoefficientChange, ...]
    verdict: Verdict

    @property
    def in_words(self) -> str:
        """The verdict in one word, and by how much each changed coefficient has changed."""
        if self.verdict.word != "changed":
            return self.verdict.word
        changed = [change for change in self.changes if change.name in self.verdict.changed]
        return "changed: " + ", ".join(
            f"{change.name} by {plus_minus(change.difference, change.u or 0.0, signed=True)} "
            f"{unit_of(change.name, self.sensor.unit)}".rstrip()
            for change in changed
        )

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
        return "\n".join([*lines, str(verdict)])

    __repr__ = __str__


def compare(old: Calibration, new: Calibration) -> Comparison:
    """Compare two calibrations of one sensor.

    The verdict allows for the number of coefficients that are compared: of two calibrations of an unchanged sensor it
    calls 5 % different.

    Raises
    ------
    UsageError
        They are not tilt calibrations of one sensor; the message names what differs.

    Examples
    --------
    >>> print(tiltcal.compare(tiltcal.read("spring.yaml"), tiltcal.read("autumn.yaml")))
    """
    for calibration in (old, new):
        if not isinstance(calibration, Calibration):
            raise UsageError(
                f"compare takes two tilt calibrations, as tiltcal.read returns them, not a {type(calibration).__name__}"
            )
    return compare_records(old.record, new.record)


def compare_records(old: CalibrationRecord, new: CalibrationRecord) -> Comparison:
    """Compare the contents of two calibration files, as :func:`compare` does."""
    require_same_sensor(old, new)
    found = tuple(changes_between(old, new))
    alone = [
        which
        for which, calibration in (("older", old), ("newer", new))
        if calibration.fit.uncertainty_from == NOISE_ALONE
    ]
    return Comparison(
        new.sensor, found, judge(found, _INCOMPLETE.format(which=" and the ".join(alone)) if alone else "")
    )

"""Two calibrations of one sensor compared, which ``tiltcal diff`` prints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import degrees, hypot, inf, isclose, nan
from statistics import NormalDist
from typing import Any

import numpy as np

from tiltcal.calibration.wording import label
from tiltcal.core.attitude import LEVEL, mounting_matrix, orientation, rotation_vector
from tiltcal.core.model import AXES, Array, referred, values
from tiltcal.core.rounding import plus_minus
from tiltcal.core.uncertain import COVERAGE, Uncertain, weighted_sum
from tiltcal.errors import UsageError
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity
from tiltcal.files.coefficients import TURNS
from tiltcal.files.results import NOISE_ALONE, PositionSet
from tiltcal.printable import in_html

ROUNDED = 1e-3  # share of an uncertainty that is left of the difference of one and the same error: files round
UNDETERMINED = 1e-3  # the positions do not determine a coefficient whose uncertainty is its prior's within this share
_ALIKE = 0.02  # coefficients of two files mean the same if the shares of other terms in them differ by less

_INCOMPLETE = (
    "the uncertainty of the {which} file rests on noise alone and leaves out how well the positions were set: measure "
    "with --jig, or in more positions"
)


def require_same_sensor(
    old: CalibrationRecord, new: CalibrationRecord, names: tuple[str, str] = ("one", "the other")
) -> None:
    """Refuse two calibrations that are not of one sensor, with a UsageError that names what differs."""
    for what in ("serial", "model", "unit", "channels"):
        a, b = getattr(old.sensor, what), getattr(new.sensor, what)
        if a != b:
            raise UsageError(
                f"not two calibrations of one sensor: its {what} is {a} in {names[0]} and {b} in {names[1]}"
            )


@dataclass(frozen=True)
class CoefficientChange:
    """The change of one coefficient by its dotted name; its standard uncertainty is None where a file states none."""

    name: str
    before: float
    after: float
    u: float | None
    dof: float = inf

    @property
    def difference(self) -> float:
        """After minus before."""
        return self.after - self.before

    @property
    def ratio(self) -> float | None:
        """The difference over its standard uncertainty; None where that is not known."""
        return abs(self.difference) / self.u if self.u else None

    def threshold(self, confidence: float) -> float:
        """Return the number of standard uncertainties that the difference of an unchanged coefficient stays within."""
        upper = (1.0 + confidence) / 2.0
        if self.dof == inf:
            return NormalDist().inv_cdf(upper)
        from scipy.special import stdtrit

        return float(stdtrit(max(self.dof, 1.0), upper))


@dataclass(frozen=True)
class Verdict:
    """The verdict on the changes of a sensor: ``changed``, ``unchanged`` or ``unknown``, and as a sentence."""

    thresholds: Mapping[str, float]  # standard uncertainties that each change of an unchanged sensor stays within
    changed: tuple[str, ...]  # the coefficients beyond theirs
    word: str
    sentence: str

    def __str__(self) -> str:
        return self.sentence


def judge(found: Sequence[CoefficientChange], incomplete: str) -> Verdict:
    """Judge whether one of several changes is too large for chance, given their number (Šidák).

    ``incomplete`` is why the uncertainties are too small to call anything changed; empty where they are whole.
    """
    judged = [change for change in found if change.ratio is not None]
    thresholds = {change.name: change.threshold(COVERAGE ** (1.0 / max(len(judged), 1))) for change in judged}
    changed = tuple(change.name for change in judged if (change.ratio or 0.0) > thresholds[change.name])
    # By more than arithmetic makes.
    differing = [one for one in found if abs(one.difference) > 1e-9 * max(abs(one.before), abs(one.after))]
    unjudged = [change.name for change in differing if not change.u]
    word, why = "unchanged", "no change is more than its threshold of standard uncertainties"
    if not thresholds:
        word, why = "unknown", incomplete or "the files state no uncertainties to compare with"
    elif changed:
        word, why = "changed", f"{', '.join(changed)} by more than the threshold of standard uncertainties"
        if incomplete:
            word, why = "unknown", f"{why}, but {incomplete}"
    elif unjudged:
        word, why = "unknown", f"no uncertainty is stated of {', '.join(unjudged)}, which differs"
    return Verdict(thresholds, changed, word, f"{'no verdict' if word == 'unknown' else word}: {why}")


def changes(difference: Uncertain, before: Array) -> list[CoefficientChange]:
    """Return an uncertain difference as the change of each coefficient; of one without an error u is None."""
    rows = np.column_stack([before, before + difference.value, difference.u, difference.dof]).tolist()
    return [
        CoefficientChange(n, a, b, u or None, dof) for n, (a, b, u, dof) in zip(difference.names, rows, strict=True)
    ]


def changes_between(
    before: CalibrationRecord, after: CalibrationRecord, reference: float | None
) -> list[CoefficientChange]:
    """Return the change of every coefficient between two calibrations at a temperature, °C, where they have drifts."""
    records = (before, after)
    old, new = (values(referred(record.coefficients, reference)) for record in records)
    errors = [record.uncertain_at(reference) for record in records]
    # What a file states as exact is known, too.
    known = [{*e.names, *(n for n, u in r.uncertainty.items() if not u)} for e, r in zip(errors, records, strict=True)]
    step = weighted_sum(errors[0], errors[1], (-1.0, 1.0), shared_errors(before, after))
    u, dof = step.by_name(step.u), step.by_name(step.dof)
    least = [one.by_name(ROUNDED * one.u) for one in errors]

    def change(name: str, start: float, end: float, scale: float = 1.0) -> CoefficientChange:
        smallest = hypot(*(floor.get(name, 0.0) for floor in least))
        size = scale * max(u.get(name, 0.0), smallest) if name in known[0] & known[1] else None
        return CoefficientChange(name, start, end, size, dof.get(name, inf))

    found = [change(name, old[name], new[name]) for name in new if name in old]
    lags = [0.0 if r.coefficients.thermal is None else r.coefficients.thermal.lag for r in records]
    if all(lags):
        both = [record.uncertainty.get("temperature.lag", 0.0) for record in records]
        found.append(CoefficientChange("temperature.lag", lags[0], lags[1], hypot(*both) if all(both) else None))
    first, last = (record.coefficients.mounting for record in records)
    if first is not None and last is not None and first != last:
        turn = np.degrees(rotation_vector(mounting_matrix(last) @ mounting_matrix(first).T)).tolist()
        found += [change(name, 0.0, angle, degrees(1.0)) for name, angle in zip(TURNS, turn, strict=True)]
    return found


def shared_errors(before: CalibrationRecord, after: CalibrationRecord) -> frozenset[str]:
    """Return the coefficients whose errors are one error in both calibrations of a sensor.

    Where one completes the other, or both lean on one base or assumption, they are all that are equal in value and
    uncertainty; else what the data sheet states of both and the positions of neither determine.
    """
    one, other = before.uncertainty, after.uncertainty
    old, new = values(before.coefficients), values(after.coefficients)
    equal = {name for name in old if name in one and old[name] == new.get(name) and one[name] == other.get(name)}
    leans = any(record.fit.level or record.fit.mounting or record.derived.assumed for record in (before, after))
    if leans and equal >= {name for name in (*old, *new) if not name.startswith("offset.")}:
        same = before.coefficients.mounting == after.coefficients.mounting
        return frozenset(equal | (set(TURNS) if same else set()))
    if before.fit.priors != after.fit.priors:
        return frozenset()
    return frozenset(
        name
        for name, u in before.fit.priors.items()
        if all(isclose(stated.get(name, 0.0), u, rel_tol=UNDETERMINED) for stated in (one, other))
    )


@dataclass(frozen=True)
class Comparison:
    """The comparison of an older and a newer calibration of one sensor.

    ``changes`` has every coefficient that means the same in both, at the newer one's reference temperature, or where
    only one has a drift at the temperature of the other; ``not_comparable`` has all others: where the positions do not
    determine the column of z, an offset holds a part of it.
    """

    sensor: SensorIdentity
    changes: tuple[CoefficientChange, ...]
    verdict: Verdict
    not_comparable: tuple[str, ...]

    @property
    def in_words(self) -> str:
        """The verdict in one word, and by how much each changed coefficient has changed."""
        rest = f"; not comparable: {', '.join(self.not_comparable)}" if self.not_comparable else ""
        if self.verdict.word != "changed":
            return self.verdict.word + rest
        moved = (
            f"{one.name} by {plus_minus(one.difference, one.u, signed=True)} "
            f"{label(one.name, self.sensor.unit).unit}".rstrip()
            for one in self.changes
            if one.name in self.verdict.changed
        )
        return f"changed: {', '.join(moved)}{rest}"

    def as_data(self) -> dict[str, Any]:
        """Return the comparison as plain data."""
        verdict = self.verdict
        return {
            "sensor": self.sensor.serial,
            "verdict": verdict.word,
            "threshold": min(verdict.thresholds.values(), default=None),
            "changed": list(verdict.changed) if verdict.word == "changed" else [],
            "coefficients": [
                {key: getattr(change, key) for key in ("name", "before", "after")}
                | {"change": change.difference, "u": change.u, "ratio": change.ratio}
                | {"threshold": verdict.thresholds.get(change.name)}
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
    _repr_html_ = in_html


def compare_records(old: CalibrationRecord, new: CalibrationRecord) -> Comparison:
    """Compare two calibrations of one sensor; a UsageError names what differs where they are not of one."""
    require_same_sensor(old, new)
    reference = (old if old.coefficients.thermal is None else new).temperature
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


def _held_shares(record: CalibrationRecord) -> dict[str, Array]:
    """Return the shares of the columns x, y, z that a file leaves out in its offset and columns; NaN: not stated."""
    axes, bench = record.coefficients.axes, record.provenance.bench
    own, _, levelled = record.runs
    attitudes = [record.procedure.set.get(position.position, PositionSet()).up for position in own]
    seen = orientation(bench.axes if bench is not None and bench.axes else AXES).seen
    up = np.array([(nan,) * 3 if one is None else seen(one) for one in [*attitudes, LEVEL]])
    fitted = [AXES.index(axis) for axis in axes]
    design = np.column_stack([np.ones(len(up)), up[:, fitted]])
    held = np.full((design.shape[1], 3), nan)
    if own and np.isfinite(up).all():
        held = np.linalg.lstsq(design[:-1], up[:-1], rcond=None)[0]
    if levelled:
        held[0] = up[-1] - design[-1, 1:] @ held[1:]
    held[:, fitted] = 0.0
    return dict(zip(("offset", *axes), held, strict=True))

"""The calibration of a sensor at a time between two of its calibrations, or beyond the last one.

Between two, each coefficient lies on the line that joins them::

    c(t) = (1 - s) c_before + s c_after        s = (t - t_before) / (t_after - t_before)

and its covariance is ``(1 - s)² C_before + s² C_after`` with the bridge of its random walk added to the diagonal: the
errors of two calibrations are independent, but for how the sensor sits (``alignment``), which both share. Beyond, it is
the nearest calibration, and the walk adds to its variance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import cos, degrees, radians

import numpy as np

from tiltcal.core.coverage_factor import NORMAL_FACTOR, coverage_factor, welch_satterthwaite
from tiltcal.core.instrumental_drift import RandomWalk
from tiltcal.core.model import Array, Coefficients, Limits, Mounting, overlap, vector_of, with_vector
from tiltcal.core.mounting_angles import mounting_angles, mounting_matrix
from tiltcal.core.named_coefficients import referred, values
from tiltcal.core.uncertainty_budget import Budget, Part, central_differences
from tiltcal.core.uncertainty_inputs import TURN, UncertaintyInputs, is_turn, with_turns_scaled
from tiltcal.errors import UsageError
from tiltcal.files.calibration import CalibrationRecord, require_same_sensor, responses_to_priors
from tiltcal.files.results import FitRecord, ProcedureRecord, Provenance
from tiltcal.files.uncertainty import Covariance, Uncertainty, uncertainty_inputs

FARTHEST_TURN = 5.0
"""Degrees by which two mountings may differ to have others between them."""

LARGEST_CHANGE = 0.5
"""Share by which the sensitivity of a channel may differ between two calibrations."""


@dataclass(frozen=True)
class Stability:
    """The stability of a sensor: how far its coefficients wander.

    Attributes
    ----------
    between : mapping of str to RandomWalk
        By the dotted name of a coefficient: between two calibrations.
    beyond : mapping of str to RandomWalk
        Before the first and after the last one, where no other calibration shows a steady change.
    source : str
        What it is estimated from.
    """

    between: Mapping[str, RandomWalk] = field(default_factory=dict)
    beyond: Mapping[str, RandomWalk] = field(default_factory=dict)
    source: str = ""


@dataclass(frozen=True)
class Interval:
    """The time between two calibrations of a sensor; what no time in it changes is computed once.

    Attributes
    ----------
    days : float
        The time between them, d.
    ends : tuple of _End
        Their coefficients and covariances at the reference temperature of the second.
    named : str
        What messages call the two.
    """

    before: CalibrationRecord
    after: CalibrationRecord
    days: float
    ends: tuple[_End, _End]
    named: str

    @classmethod
    def between(cls, before: CalibrationRecord, after: CalibrationRecord, days: float, named: str) -> Interval:
        """Return the interval of two calibrations.

        UsageError: they are not of one sensor, only one of them has temperature terms or a mounting, or their
            sensitivities are too far apart for a change with time.
        """
        require_same_sensor(before, after)
        one, other = before.coefficients, after.coefficients
        for what, differ in (
            ("other axes", one.axes != other.axes),
            ("temperature terms", (one.thermal is None) != (other.thermal is None)),
            ("a mounting", (one.mounting is None) != (other.mounting is None)),
        ):
            if differ:
                raise UsageError(
                    f"{named}: one has {what} and the other has not: give both the same coefficients, such as with "
                    "`tiltcal combine`"
                )
        _require_one_sensitivity(one, other, named)
        reference = None if other.thermal is None else other.thermal.reference
        return cls(before, after, days, (_End.of(before, reference), _End.of(after, reference)), named)

    def coefficients(self, share: float) -> Coefficients:
        """Return the coefficients at a time in the interval; the arguments and errors are those of :meth:`at`."""
        return _blended([end.coefficients for end in self.ends], share, self.named)

    def at(self, share: float, stability: Stability | None = None) -> CalibrationRecord:
        """Return the calibration at a time in the interval.

        Parameters
        ----------
        share : float
            Of the interval that has passed, 0 to 1.
        stability : Stability, optional
            Without it, the calibrations alone are uncertain.

        UsageError: their mountings are too far apart for a change with time.
        """
        before, after = self.before, self.after
        coefficients = self.coefficients(share)
        bridge = {
            name: (walk.rate * self.days * share * (1.0 - share), walk.dof)
            for name, walk in (stability or Stability()).between.items()
        }
        first, last = before.uncertainty.single_reading, after.uncertainty.single_reading
        single = {
            name: (1.0 - share) * first.get(name, u) + share * last.get(name, u)
            for name, u in {**first, **last}.items()
        }
        weighted = [end.times(weight) for end, weight in zip(self.ends, (1.0 - share, share), strict=True)]
        alignment = (1.0 - share) * before.uncertainty.alignment + share * after.uncertainty.alignment
        uncertainty = _joined(weighted, bridge, single, alignment)
        return _at(after, coefficients, _limits(before.limits, after.limits), uncertainty)


def extrapolate(nearest: CalibrationRecord, days: float, stability: Stability | None = None) -> CalibrationRecord:
    """Return the nearest calibration with what its coefficients may have wandered since, or before.

    Parameters
    ----------
    days : float
        How far away it is, d.
    stability : Stability, optional
        Without it, the calibration alone is uncertain.
    """
    grown = {name: (walk.rate * days, walk.dof) for name, walk in (stability or Stability()).beyond.items()}
    uncertainty = nearest.uncertainty
    if grown:
        uncertainty = _joined([_End.of(nearest, None)], grown, uncertainty.single_reading, uncertainty.alignment)
    return _at(nearest, nearest.coefficients, nearest.limits, uncertainty)


@dataclass(frozen=True)
class _End:
    """A calibration at an end of an interval: its coefficients at the common reference, and their covariance."""

    coefficients: Coefficients
    names: tuple[str, ...]
    covariance: Array
    dof: Array
    by_prior: Array

    @classmethod
    def of(cls, record: CalibrationRecord, reference: float | None) -> _End:
        coefficients = record.coefficients
        moved = coefficients if reference is None else referred(coefficients, reference)
        stated = uncertainty_inputs(record.uncertainty, coefficients)
        names, by = stated.names, np.eye(len(stated.names))
        if reference is not None and moved is not coefficients:
            names, by = _referring(coefficients, stated, reference)
        known = Budget.of([Part("", by, stated.covariance, stated.factors)])
        common = responses_to_priors(record)
        none = np.zeros(len(record.fit.priors))
        return cls(moved, names, known.covariance, known.dof, by @ [common.get(name, none) for name in stated.names])

    def times(self, weight: float) -> _End:
        """Return this end with the covariance that its coefficients have when they are multiplied by a weight."""
        return replace(self, covariance=self.covariance * weight**2, by_prior=self.by_prior * weight)


def _referring(
    coefficients: Coefficients, stated: UncertaintyInputs, reference: float
) -> tuple[tuple[str, ...], Array]:
    """Return the names and the derivatives of coefficients at another reference temperature by the stated ones."""
    turned = is_turn(stated.names)
    own, turns = stated.without_turn.names, stated.chosen(np.flatnonzero(turned)).names
    names = list(values(coefficients))
    vector = vector_of(coefficients, own)
    steps = 1e-4 * np.sqrt(np.diag(stated.covariance))[~turned]

    def at(moved: Array) -> Array:
        return vector_of(referred(with_vector(coefficients, own, moved), reference), names)

    jacobian = np.zeros((len(names) + len(turns), len(stated.names)))
    jacobian[: len(names), ~turned] = central_differences(at, vector, steps)
    jacobian[len(names) :, turned] = np.eye(len(turns))
    kept = np.flatnonzero(jacobian.any(axis=1))
    return tuple(np.array([*names, *turns], dtype=object)[kept]), jacobian[kept]


def _joined(
    ends: Sequence[_End], walked: Mapping[str, tuple[float, float]], single: Mapping[str, float], alignment: float
) -> Uncertainty:
    """Return the sum of weighted covariances and of what each coefficient may have wandered (variance, dof)."""
    names = tuple(dict.fromkeys([name for end in ends for name in end.names] + [*walked]))
    if not any(end.names for end in ends):
        return Uncertainty({}, single, alignment=alignment)
    covariance, alone = np.zeros((len(names), len(names))), np.eye(len(names))
    sources: list[tuple[Array, float]] = []
    for end in ends:
        rows = [names.index(name) for name in end.names]
        covariance[np.ix_(rows, rows)] += end.covariance
        variances = np.diag(end.covariance)
        sources += [(v * alone[k], float(dof)) for k, v, dof in zip(rows, variances, end.dof, strict=True)]
    if len(ends) == 2 and ends[0].by_prior.shape[1] == ends[1].by_prior.shape[1]:
        # What the data sheet states errs alike in both.
        across = np.zeros_like(covariance)
        across[np.ix_(*([names.index(name) for name in end.names] for end in ends))] = (
            ends[0].by_prior @ ends[1].by_prior.T
        )
        covariance += across + across.T
    for name, (variance, dof) in walked.items():
        row = names.index(name)
        covariance[row, row] += variance
        sources.append((variance * alone[row], dof))
    factors = coverage_factor(welch_satterthwaite(np.diag(covariance).copy(), sources))
    matrix = with_turns_scaled(names, covariance, degrees(1.0))
    u = np.sqrt(np.diag(matrix))
    return Uncertainty(
        {name: float(u_value) for name, u_value in zip(names, u, strict=True) if not name.startswith(TURN)},
        single,
        {name: float(k) for name, k in zip(names, factors, strict=True) if k > NORMAL_FACTOR * 1.001},
        Covariance(parameters=names, matrix=tuple(tuple(row) for row in matrix.tolist())),
        alignment,
    )


def _blended(both: Sequence[Coefficients], share: float, named: str) -> Coefficients:
    """Return the coefficients between two at one reference temperature."""

    def line(before: Array, after: Array) -> Array:
        wide = np.zeros((2, *after.shape[:-1], max(before.shape[-1], after.shape[-1])))
        for terms, row in zip((before, after), wide, strict=True):
            row[..., : terms.shape[-1]] = terms
        return np.asarray((1.0 - share) * wide[0] + share * wide[1])

    before, after = both
    thermal, shares = after.thermal, after.nonlinearity
    if thermal is not None and before.thermal is not None:
        known = overlap(before.thermal.range, thermal.range)
        thermal = replace(
            thermal,
            range=known,
            drift=line(before.thermal.drift, thermal.drift),
            gain=line(before.thermal.gain, thermal.gain),
            lag=(1.0 - share) * before.thermal.lag + share * thermal.lag,
        )
    if shares is not None or before.nonlinearity is not None:
        none = np.zeros((len(after.channels), 1))
        shares = line(
            *(none if coefficients.nonlinearity is None else coefficients.nonlinearity for coefficients in both)
        )
    return replace(
        after,
        offset=line(before.offset, after.offset),
        sensitivity=line(before.sensitivity, after.sensitivity),
        thermal=thermal,
        nonlinearity=shares,
        mounting=_mounting(before.mounting, after.mounting, share, named),
    )


def _require_one_sensitivity(before: Coefficients, after: Coefficients, named: str) -> None:
    change = np.linalg.norm(after.sensitivity - before.sensitivity, axis=1)
    far = change > LARGEST_CHANGE * np.linalg.norm(before.sensitivity, axis=1)
    for channel, is_far in zip(after.channels, far.tolist(), strict=True):
        if is_far:
            raise UsageError(
                f"{named}: the sensitivity of {channel} differs by more than {LARGEST_CHANGE:.0%}, which is no change "
                "with time: move the file that is wrong out of the folder"
            )


def _mounting(before: Mounting | None, after: Mounting | None, share: float, named: str) -> Mounting | None:
    if before is None or after is None or before == after:
        return after
    first, last = mounting_matrix(before), mounting_matrix(after)
    if np.trace(first.T @ last) < 1.0 + 2.0 * cos(radians(FARTHEST_TURN)):
        raise UsageError(
            f"{named}: the mountings are more than {FARTHEST_TURN:g}° apart, so the sensor was mounted anew between "
            "them: apply the calibration of each mounting by its file, or state --mounting"
        )
    left, _, right = np.linalg.svd((1.0 - share) * first + share * last)
    return mounting_angles(left @ right).mounting


def _limits(before: Limits, after: Limits) -> Limits:
    """Return the ranges that both calibrations cover."""
    tilt = {axis: overlap(before.tilt.get(axis), limits) or limits for axis, limits in after.tilt.items()}
    return Limits(tilt, overlap(before.temperature, after.temperature), after.reading)


def _at(
    nearest: CalibrationRecord, coefficients: Coefficients, limits: Limits, uncertainty: Uncertainty
) -> CalibrationRecord:
    """Return a record without what was measured for one of the calibrations alone."""
    return replace(
        nearest,
        coefficients=coefficients,
        limits=limits,
        uncertainty=uncertainty,
        fit=FitRecord(),
        procedure=ProcedureRecord(),
        positions=(),
        provenance=Provenance(software=nearest.provenance.software),
    )

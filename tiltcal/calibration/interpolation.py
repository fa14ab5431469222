"""The calibration of a sensor at a time between two of its calibrations, or beyond the last one.

Between two, each coefficient lies on the line that joins them::

    c(t) = (1 - s) c_before + s c_after        s = (t - t_before) / (t_after - t_before)

Their errors have these weights too. An error that both share, such as that of a sensitivity that a renewed level took
over, stays what it is; the others are independent. What a coefficient may have wandered from the line adds to it: as
far as is stated, with the variance of a Brownian bridge, or by half of its change, with a rectangular distribution.
Beyond, it is the nearest calibration, and the wandering adds to its variance.

Source: B. Øksendal, *Stochastic Differential Equations*, exercise 5.11 (bridge).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import cos, radians

import numpy as np

from tiltcal.calibration.comparison import shared_errors, uncertain_of
from tiltcal.calibration.estimate_record import unrounded_section
from tiltcal.core.model import Array, Coefficients, Limits, Mounting, overlap
from tiltcal.core.mounting_angles import mounting_angles, mounting_matrix
from tiltcal.core.named_coefficients import referred, values
from tiltcal.core.uncertain import Uncertain, weighted_sum
from tiltcal.errors import UsageError
from tiltcal.files.calibration import CalibrationRecord, require_same_sensor
from tiltcal.files.results import FitRecord, ProcedureRecord, Provenance
from tiltcal.files.uncertainty import Uncertainty

FARTHEST_TURN = 5.0
"""Degrees by which two mountings may differ to have others between them."""

LARGEST_CHANGE = 0.5
"""Share by which the sensitivity of a channel may differ between two calibrations."""

WANDERING = ("offset.", "sensitivity.")
"""What may wander; temperature coefficients follow their line."""


@dataclass(frozen=True)
class Stability:
    """How far a sensor wanders.

    Attributes
    ----------
    rate : mapping of str to float
        By the dotted name of a coefficient, the variance that a day adds, unit²/d. Empty where it is not stated: half
        of the change between two calibrations counts, as a rectangular distribution.
    """

    rate: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Interval:
    """The time between two calibrations of a sensor; what no time in it changes is computed once.

    Attributes
    ----------
    days : float
        The time between them, d.
    ends : tuple of Coefficients
        At the reference temperature of the second.
    errors : tuple of Uncertain
        Of these.
    named : str
        What messages call the two.
    """

    before: CalibrationRecord
    after: CalibrationRecord
    days: float
    ends: tuple[Coefficients, Coefficients]
    errors: tuple[Uncertain, Uncertain]
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
        errors = uncertain_of(before, reference), uncertain_of(after, reference)
        return cls(before, after, days, (referred(one, reference), other), errors, named)

    def coefficients(self, share: float) -> Coefficients:
        """Return the coefficients at a time in the interval; the arguments and errors are those of :meth:`at`."""
        return _blended(*self.ends, share, self.named)

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
        before, after, weights = self.before.uncertainty, self.after.uncertainty, (1.0 - share, share)
        first, last = before.single_reading, after.single_reading
        single = {
            name: weights[0] * first.get(name, u) + weights[1] * last.get(name, u)
            for name, u in {**first, **last}.items()
        }
        errors = weighted_sum(*self.errors, weights, shared_errors(self.before, self.after))
        if stability is not None:
            walked = {name: rate * self.days for name, rate in stability.rate.items()} or {
                name: 4.0 * variance for name, variance in self.half_change.items()
            }
            errors = _with_walk(errors, {name: share * (1.0 - share) * v for name, v in walked.items()})
        alignment = weights[0] * before.alignment + weights[1] * after.alignment
        limits = _limits(self.before.limits, self.after.limits)
        return _at(self.after, self.coefficients(share), limits, _section(errors, single, alignment))

    @property
    def half_change(self) -> dict[str, float]:
        """The variance of a rectangular distribution of half of each change that may be a wandering, unit²."""
        first, last = map(values, self.ends)
        return {n: (last[n] - first[n]) ** 2 / 12.0 for n in last if n in first and n.startswith(WANDERING)}


def extrapolate(
    nearest: CalibrationRecord,
    days: float,
    stability: Stability | None = None,
    interval: Interval | None = None,
) -> CalibrationRecord:
    """Return the nearest calibration with what its coefficients may have wandered since, or before.

    Parameters
    ----------
    days : float
        How far away it is, d.
    stability : Stability, optional
        Without it, the calibration alone is uncertain.
    interval : Interval, optional
        The nearest one: half of its change counts where no stability is stated.
    """
    uncertainty, walked = nearest.uncertainty, {}
    if stability is not None and stability.rate:
        walked = {name: rate * days for name, rate in stability.rate.items()}
    elif stability is not None and interval is not None:
        walked = interval.half_change
    if walked:
        errors = _with_walk(uncertain_of(nearest, None), walked)
        uncertainty = _section(errors, uncertainty.single_reading, uncertainty.alignment)
    return _at(nearest, nearest.coefficients, nearest.limits, uncertainty)


def _with_walk(errors: Uncertain, walked: Mapping[str, float]) -> Uncertain:
    """Add the variance of what each coefficient may have wandered, unit²; none where nothing is uncertain."""
    if not errors.names:
        return errors
    walk = Uncertain.errors(tuple(walked), np.diag(list(walked.values())))
    return weighted_sum(errors, walk, (1.0, 1.0), ())


def _section(errors: Uncertain, single: Mapping[str, float], alignment: float) -> Uncertainty:
    if not errors.names:
        return Uncertainty({}, single, alignment=alignment)
    return replace(unrounded_section(errors), single_reading=single, alignment=alignment)


def _blended(before: Coefficients, after: Coefficients, share: float, named: str) -> Coefficients:
    """Return the coefficients between two at one reference temperature."""

    def line(before: Array, after: Array) -> Array:
        wide = np.zeros((2, *after.shape[:-1], max(before.shape[-1], after.shape[-1])))
        for terms, row in zip((before, after), wide, strict=True):
            row[..., : terms.shape[-1]] = terms
        return np.asarray((1.0 - share) * wide[0] + share * wide[1])

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
            *(
                none if coefficients.nonlinearity is None else coefficients.nonlinearity
                for coefficients in (before, after)
            )
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

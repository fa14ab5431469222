"""Coefficients by their dotted names: how well each is known, and how it changed between two calibrations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf, sqrt

import numpy as np

from tiltcal.core.coverage_factor import NORMAL_FACTOR, degrees_of_freedom, welch_satterthwaite
from tiltcal.core.model import Array, Coefficients, polynomial, vector_of, with_vector
from tiltcal.core.uncertainty_budget import Budget, propagated

ROUNDED = 1e-3
"""The share of an uncertainty that remains of a difference although both errors are one: files round their numbers."""


@dataclass(frozen=True)
class KnownCoefficient:
    """The standard uncertainty of a coefficient.

    Attributes
    ----------
    u : float
        In the unit of the coefficient.
    dof : float
        Its effective degrees of freedom; infinite where it was not estimated from a scatter.
    """

    u: float
    dof: float = inf


@dataclass(frozen=True)
class CoefficientChange:
    """The change of one coefficient between two calibrations.

    Attributes
    ----------
    name : str
        Dotted, such as ``sensitivity.x.y``.
    u : float or None
        Standard uncertainty of the difference; None where one of the files states none.
    dof : float
        Its effective degrees of freedom.
    """

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
        """The difference over its standard uncertainty; None where that is not known, or zero."""
        return abs(self.difference) / self.u if self.u else None

    @property
    def is_unjudged(self) -> bool:
        """Whether it differs, by more than arithmetic makes, and has no uncertainty."""
        return not self.u and abs(self.difference) > 1e-9 * max(abs(self.before), abs(self.after))

    def threshold(self, confidence: float) -> float:
        """Return the number of standard uncertainties that the difference of an unchanged coefficient stays within."""
        upper = (1.0 + confidence) / 2.0
        if self.dof == inf:
            from statistics import NormalDist

            return NormalDist().inv_cdf(upper)
        from scipy.special import stdtrit

        return float(stdtrit(self.dof, upper))


@dataclass(frozen=True)
class DeterminedCoefficients:
    """Coefficients that data determine, with their uncertainty.

    Attributes
    ----------
    names : tuple of str
        Those that are uncertain, in the order of ``covariance``.
    budget : Budget
        Their covariance, its sources, and degrees of freedom of each.
    """

    coefficients: Coefficients
    names: tuple[str, ...]
    budget: Budget

    @property
    def covariance(self) -> Array:
        """Covariance of the uncertain coefficients, shape (k, k)."""
        return self.budget.covariance

    def uncertainty(self) -> dict[str, float]:
        """Return the standard uncertainty of each by its dotted name."""
        return dict(zip(self.names, self.budget.u.tolist(), strict=True))

    def coverage_factors(self) -> dict[str, float]:
        """Return the coverage factor of each one's 95 % interval by its dotted name."""
        return dict(zip(self.names, self.budget.factors.tolist(), strict=True))


def known(
    coefficients: Coefficients, names: Sequence[str], covariance: Array, factors: Array, reference: float | None = None
) -> dict[str, KnownCoefficient]:
    """Return the standard uncertainty of each uncertain coefficient, at another reference temperature if one is given.

    Parameters
    ----------
    names : sequence of str
        Of the uncertain coefficients.
    covariance : ndarray, shape (k, k)
    factors : ndarray, shape (k,)
        Of each standard uncertainty for an interval of 95 %: the degrees of freedom follow from Student's t.
    reference : float, optional
        °C; None for the coefficients' own.
    """

    def numbers(vector: Array) -> Array:
        moved = with_vector(coefficients, names, vector)
        return np.array(list(values(referred(moved, reference)).values()))

    u, wide = propagated(numbers, vector_of(coefficients, names), covariance, np.maximum(factors, NORMAL_FACTOR))
    return {
        name: KnownCoefficient(own, dof)
        for name, own, dof in zip(values(coefficients), u.tolist(), degrees_of_freedom(wide).tolist(), strict=True)
        if own > 0.0
    }


def referred(coefficients: Coefficients, reference: float | None) -> Coefficients:
    """Return the same coefficients at another reference temperature.

    Parameters
    ----------
    coefficients : Coefficients
        Without temperature terms they are the same at every temperature.
    reference : float or None
        °C; None for their own.

    Notes
    -----
    A polynomial p(dT) without a constant term becomes p(dT + s) - p(s) with s the shift of the reference; the offset
    takes p(s) over, and the sensitivity the factor 1 + gain(s), by which the new gain is divided.
    """
    thermal = coefficients.thermal
    if thermal is None or reference is None or thermal.reference == reference:
        return coefficients
    shift = reference - thermal.reference
    drift, gain = (
        np.array([polynomial(row, np.array(shift)) for row in table]) for table in (thermal.drift, thermal.gain)
    )
    return replace(
        coefficients,
        offset=coefficients.offset + drift,
        sensitivity=coefficients.sensitivity * (1.0 + gain)[:, None],
        thermal=replace(
            thermal,
            reference=reference,
            drift=_shifted(thermal.drift, shift),
            gain=_shifted(thermal.gain, shift) / (1.0 + gain)[:, None],
        ),
    )


def changes(
    before: Coefficients,
    after: Coefficients,
    known_before: Mapping[str, KnownCoefficient],
    known_after: Mapping[str, KnownCoefficient],
    common: Mapping[str, float] | None = None,
) -> list[CoefficientChange]:
    """Return the change of each coefficient that both have, at the later one's reference temperature.

    Parameters
    ----------
    known_before, known_after : mapping of str to KnownCoefficient
        By dotted name, at the later one's reference temperature; a name that is missing is not known.
    common : mapping of str to float
        Covariance of the errors of both, by dotted name; a name that is missing has none.
    """
    before = referred(before, None if after.thermal is None else after.thermal.reference)
    old, new, common = values(before), values(after), common or {}
    return [
        CoefficientChange(
            name,
            old[name],
            new[name],
            *difference_of(known_before.get(name), known_after.get(name), common.get(name, 0.0)),
        )
        for name in new
        if name in old
    ]


def difference_of(
    before: KnownCoefficient | None, after: KnownCoefficient | None, common: float = 0.0
) -> tuple[float | None, float]:
    """Return the standard uncertainty of a difference and its degrees of freedom (GUM, eq. G.2b)."""
    if before is None or after is None:
        return None, inf
    total = before.u**2 + after.u**2
    total = max(total - 2.0 * common, ROUNDED**2 * total)
    parts = [(np.array([value.u**2]), value.dof) for value in (before, after)]
    return sqrt(total), float(welch_satterthwaite(np.array([total]), parts)[0])


def values(coefficients: Coefficients) -> dict[str, float]:
    """Return every coefficient by its dotted name."""
    named = {f"offset.{c}": float(v) for c, v in zip(coefficients.channels, coefficients.offset, strict=True)}
    for channel, row in zip(coefficients.channels, coefficients.sensitivity, strict=True):
        named |= {f"sensitivity.{channel}.{axis}": float(v) for axis, v in zip(coefficients.axes, row, strict=True)}
    if coefficients.thermal is not None:
        for what, table in (("offset", coefficients.thermal.drift), ("sensitivity", coefficients.thermal.gain)):
            for channel, row in zip(coefficients.channels, table, strict=True):
                named |= {f"temperature.{what}.{channel}.{k}": float(v) for k, v in enumerate(row, start=1)}
    if coefficients.nonlinearity is not None:
        for channel, row in zip(coefficients.channels, coefficients.nonlinearity, strict=True):
            named |= {f"nonlinearity.{channel}.{k}": float(v) for k, v in enumerate(row, start=2)}
    return named


def _shifted(table: Array, shift: float) -> Array:
    """Return the coefficients of p(dT + shift) - p(shift), row by row, without the constant term."""
    rows = []
    for row in table:
        moved = np.polynomial.Polynomial([0.0, *row])(np.polynomial.Polynomial([shift, 1.0]))
        rows.append(np.pad(moved.coef[1:], (0, len(row) - len(moved.coef[1:]))))
    return np.array(rows, dtype=float).reshape(table.shape)

"""Coefficients of one sensor from several sessions: generalised least squares of what each session states.

Session j states values m_j of coefficients with a covariance P_j. With the coefficients θ of the sensor at one
reference temperature, ``h_j(θ)`` are those at the temperature of the session, and θ minimises::

    Σ_j (m_j - h_j(θ))ᵀ P_j⁻¹ (m_j - h_j(θ))

What a session has assumed, such as the sensitivity of a run at level, is no information: P_j is conditional on it, and
``h_j`` follows the value that other sessions give. So nothing counts twice where a session took it from another one.

Sources: GUM 5.2 and H.3; W. Baarda, *A testing procedure for use in geodetic networks*, Delft (1968), for the
difference between one statement and all others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.coverage_factor import NORMAL_FACTOR, coverage_factor, welch_satterthwaite
from tiltcal.core.model import Array, Coefficients, polynomial_slope, vector_of, with_vector
from tiltcal.core.named_coefficients import CoefficientChange, DeterminedCoefficients, referred
from tiltcal.core.uncertainty_budget import Budget, Part, central_differences
from tiltcal.errors import EstimateError

ROUNDS = 8
"""Steps of the minimisation: all but the change of reference is linear, two are usual."""

CLOSE = 1e-6
"""Part of a standard uncertainty below which a step changes nothing."""

DIGITS = 1e-9
"""Eigenvalue of a correlation below which it is what rounding leaves of zero."""

REDUNDANT = 1e-6
"""Share of a statement that the others check, below which they do not."""

ASSUMED = "assumed"


@dataclass(frozen=True)
class Statement:
    """The coefficients of a sensor that one session states, with their covariance.

    Attributes
    ----------
    label : str
        What messages call it.
    names : tuple of str
        The coefficients that it has measured, by dotted name.
    values : ndarray, shape (k,)
    covariance : ndarray, shape (k, k)
        Conditional on what it has assumed.
    factors : ndarray, shape (k,)
        What each standard uncertainty is multiplied with for an interval of 95 %.
    temperature : float or None
        Where the values hold, °C; None where it does not matter.
    u_temperature : float
        Its standard uncertainty, °C.
    given : tuple of str
        The coefficients that it has assumed and its values depend on.
    given_values : ndarray, shape (g,)
    by_given : ndarray, shape (k, g)
        How its values follow them.
    """

    label: str
    names: tuple[str, ...]
    values: Array
    covariance: Array
    factors: Array
    temperature: float | None
    u_temperature: float
    given: tuple[str, ...]
    given_values: Array
    by_given: Array

    def expected(self, coefficients: Coefficients) -> Array:
        """Return what the session should state of a sensor with these coefficients."""
        at = coefficients if self.temperature is None else referred(coefficients, self.temperature)
        return vector_of(at, self.names) + self.by_given @ (vector_of(at, self.given) - self.given_values)


@dataclass(frozen=True)
class Combination(DeterminedCoefficients):
    """What several sessions together state; the sources of its budget are the sessions.

    Attributes
    ----------
    statements : tuple of Statement
        With the uncertainty of their temperature in them.
    parts : tuple of ndarray, shape (names, k)
        By statement, how the coefficients follow its values.
    differences : tuple of CoefficientChange
        By coefficient that more than one session has measured, what one states (``after``) against what all others
        give (``before``); that of the largest ratio.
    compared : int
        The number of differences among which these are the largest.
    """

    statements: tuple[Statement, ...]
    parts: tuple[Array, ...]
    differences: tuple[tuple[str, CoefficientChange], ...]
    compared: int
    chi_square: float
    dof: int


def combine_statements(statements: Sequence[Statement], start: Coefficients, names: Sequence[str]) -> Combination:
    """Combine what sessions state.

    Parameters
    ----------
    start : Coefficients
        At the common reference temperature; what is in no statement stays.
    names : sequence of str
        The coefficients to determine; all are in a statement.

    EstimateError: the sessions together do not determine them.
    """
    names = tuple(names)
    theta = vector_of(start, names)
    statements = [_warmed(statement, start) for statement in statements]
    weights = [_weight(statement) for statement in statements]
    for _ in range(ROUNDS):
        slopes = [_slopes(statement, start, names, theta) for statement in statements]
        normal = np.sum([a.T @ w @ a for a, w in zip(slopes, weights, strict=True)], axis=0)
        left = [statement.values - statement.expected(with_vector(start, names, theta)) for statement in statements]
        right = np.sum([a.T @ w @ r for a, w, r in zip(slopes, weights, left, strict=True)], axis=0)
        step = _solved(normal, right, names)
        theta = theta + step
        inverse = _solved(normal, np.eye(len(names)), names)
        if np.all(np.abs(step) <= CLOSE * np.sqrt(np.diag(inverse))):
            break
    parts = [inverse @ a.T @ w for a, w in zip(slopes, weights, strict=True)]
    found = with_vector(start, names, theta)
    left = [statement.values - statement.expected(found) for statement in statements]
    chi_square = float(sum(r @ w @ r for r, w in zip(left, weights, strict=True)))
    differences, compared = _differences(statements, slopes, weights, parts, left)
    return Combination(
        coefficients=found,
        names=names,
        budget=_budget(statements, slopes, parts),
        statements=tuple(statements),
        parts=tuple(parts),
        differences=tuple(differences),
        compared=compared,
        chi_square=chi_square,
        dof=sum(len(statement.names) for statement in statements) - len(names),
    )


def _warmed(statement: Statement, start: Coefficients) -> Statement:
    """Return the statement with the uncertainty of its temperature in its offsets."""
    thermal = start.thermal
    if statement.temperature is None or thermal is None or not statement.u_temperature:
        return statement
    dt = np.array(statement.temperature - thermal.reference)
    slope = dict(zip(start.channels, (float(polynomial_slope(row, dt)) for row in thermal.drift), strict=True))
    by = np.array([slope[name.split(".")[1]] if name.startswith("offset.") else 0.0 for name in statement.names])
    added = np.outer(by, by) * statement.u_temperature**2
    covariance = statement.covariance + added
    factors, own = statement.factors.copy(), np.diag(statement.covariance)
    for k in np.flatnonzero(np.diag(added)):
        dof = Part("", np.eye(1), statement.covariance[k : k + 1, k : k + 1], statement.factors[k : k + 1]).dof
        factors[k] = coverage_factor(welch_satterthwaite(covariance[k, k : k + 1], [(own[k : k + 1], dof)]))[0]
    return replace(statement, covariance=covariance, factors=factors)


def _weight(statement: Statement) -> Array:
    """Return the inverse of the covariance; what rests on few residuals weighs less, as its interval is wider."""
    wider = np.maximum(statement.factors / NORMAL_FACTOR, 1.0)
    scale = np.sqrt(np.diag(statement.covariance)) * wider
    values, vectors = np.linalg.eigh(statement.covariance * np.outer(wider, wider) / np.outer(scale, scale))
    return np.asarray((vectors / np.maximum(values, DIGITS)) @ vectors.T / np.outer(scale, scale))


def _budget(statements: Sequence[Statement], slopes: Sequence[Array], parts: Sequence[Array]) -> Budget:
    """Return the covariance of the combination, with what estimated weights cost.

    Notes
    -----
    A session whose residuals happen to be small weighs too much and states too little. To first order in one over its
    degrees of freedom ν, the lost efficiency and the bias of the variance are each 2/ν of the variance of what it
    differs by from the combination. The sessions that understate themselves weigh most, so their degrees of freedom do
    not add up: the effective ones are their harmonic mean, weighted with the variances.

    Sources: P. Meier, *Variance of a weighted mean*, Biometrics 9 (1953) 59; M. G. Kenward and J. H. Roger, *Small
    sample inference for fixed effects*, Biometrics 53 (1997) 983.
    """
    costly = []
    for statement, a, own in zip(statements, slopes, parts, strict=True):
        single = Part("", np.eye(len(statement.names)), statement.covariance, statement.factors)
        more = np.outer(*[2.0 / np.sqrt(single.dof)] * 2)
        if more.any():
            differs = [
                (np.eye(len(a)) if other is statement else 0.0) - a @ by
                for other, by in zip(statements, parts, strict=True)
            ]
            more *= sum(d @ other.covariance @ d.T for d, other in zip(differs, statements, strict=True))
        costly.append(Part(statement.label, own, statement.covariance + more, statement.factors))
    whole = Budget.of(costly)
    variance = np.diag(whole.covariance)
    inverse = sum(np.diag(part.by @ part.covariance @ part.by.T) / part.dof for part in costly)
    return replace(whole, dof=np.divide(variance, inverse, out=np.full_like(variance, inf), where=inverse > 0.0))


def _slopes(statement: Statement, start: Coefficients, names: Sequence[str], theta: Array) -> Array:
    """Return the derivatives of what a session should state by the coefficients, shape (k, names)."""
    steps = 1e-6 * np.maximum(np.abs(theta), 1e-3)
    return central_differences(lambda vector: statement.expected(with_vector(start, names, vector)), theta, steps)


def _solved(normal: Array, right: Array, names: Sequence[str]) -> Array:
    scale = np.sqrt(np.diag(normal))
    unseen = [name for name, size in zip(names, scale, strict=True) if size == 0.0]
    scaled = normal / np.outer(scale, scale) if not unseen else normal
    if unseen or np.linalg.eigvalsh(scaled)[0] < 1e-14:
        raise EstimateError(f"the calibrations together do not determine {', '.join(unseen or names)}")
    shape = (-1,) + (1,) * (right.ndim - 1)
    return np.asarray(np.linalg.solve(scaled, right / scale.reshape(shape)) / scale.reshape(shape))


def _differences(
    statements: Sequence[Statement],
    slopes: Sequence[Array],
    weights: Sequence[Array],
    parts: Sequence[Array],
    left: Sequence[Array],
) -> tuple[list[tuple[str, CoefficientChange]], int]:
    """Return by coefficient what one statement differs by most from what all others give; and among how many."""
    count: dict[str, int] = {}
    worst: dict[str, tuple[str, CoefficientChange]] = {}
    for statement, a, w, part, r in zip(statements, slopes, weights, parts, left, strict=True):
        checked = w - w @ a @ part
        for k, name in enumerate(statement.names):
            others = any(other is not statement and name in other.names for other in statements)
            if not others or checked[k, k] <= REDUNDANT * w[k, k]:
                continue
            count[name] = count.get(name, 0) + 1
            difference = float((w @ r)[k] / checked[k, k])
            # The weights are widened, so that their inverse is not the variance of the difference.
            rows = [
                (w[k] - (w @ a @ by)[k] if other is statement else -(w @ a @ by)[k]) / checked[k, k]
                for other, by in zip(statements, parts, strict=True)
            ]
            budget = Budget.of(
                [
                    Part(other.label, row[None], other.covariance, other.factors)
                    for other, row in zip(statements, rows, strict=True)
                ]
            )
            value = float(statement.values[k])
            change = CoefficientChange(name, value - difference, value, float(budget.u[0]), float(budget.dof[0]))
            if name not in worst or (change.ratio or 0.0) > (worst[name][1].ratio or 0.0):
                worst[name] = statement.label, change
    # Two statements differ by the same from each other.
    return list(worst.values()), sum(1 if statements_of == 2 else statements_of for statements_of in count.values())


def conditional(names: Sequence[str], covariance: Array, measured: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return the covariance of what was measured given what was assumed, and how it follows that.

    Parameters
    ----------
    covariance : ndarray, shape (n, n)
    measured : ndarray of bool, shape (n,)

    Returns
    -------
    covariance : ndarray, shape (k, k)
    by_given : ndarray, shape (k, n - k)
    """
    own = covariance[np.ix_(measured, measured)]
    cross, given = covariance[np.ix_(measured, ~measured)], covariance[np.ix_(~measured, ~measured)]
    scale = np.sqrt(np.diag(given))
    by = cross / scale @ np.linalg.pinv(given / np.outer(scale, scale), rcond=DIGITS, hermitian=True) / scale
    return own - by @ cross.T, by

"""Whether two calibrations of one sensor differ by more than their uncertainty."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import hypot
from statistics import NormalDist

import numpy as np

from tiltcal.core.model import Array, Coefficients, Thermal, polynomial

COVERAGE = 0.95
"""How sure the verdict is to be that nothing has changed before it calls a difference one."""


@dataclass(frozen=True)
class Change:
    """How one coefficient changed.

    Attributes
    ----------
    name : str
        Dotted, such as ``sensitivity.x.y``.
    before, after : float
    u : float or None
        Standard uncertainty of the difference; None where one of the files states none.
    """

    name: str
    before: float
    after: float
    u: float | None

    @property
    def difference(self) -> float:
        """After minus before."""
        return self.after - self.before

    @property
    def ratio(self) -> float | None:
        """The difference over its standard uncertainty; None where that is not known, or zero."""
        return abs(self.difference) / self.u if self.u else None


@dataclass(frozen=True)
class Verdict:
    """Whether a sensor has changed.

    Attributes
    ----------
    threshold : float or None
        How many standard uncertainties a change may be; None where no change has one to be compared with.
    changed : tuple of str
        The coefficients that changed by more.
    """

    threshold: float | None
    changed: tuple[str, ...]

    @property
    def word(self) -> str:
        """``changed``, ``unchanged`` or ``unknown``."""
        return "unknown" if self.threshold is None else "changed" if self.changed else "unchanged"

    def __str__(self) -> str:
        if self.threshold is None:
            return "no verdict: the files state no uncertainties to compare with"
        if not self.changed:
            return f"unchanged: no change is more than {self.threshold:.2f} standard uncertainties"
        return f"changed: {', '.join(self.changed)} by more than {self.threshold:.2f} standard uncertainties"


def judge(found: Sequence[Change]) -> Verdict:
    """Whether any of some changes is too large for chance, allowing for their number (Šidák)."""
    ratios = {change.name: change.ratio for change in found if change.ratio is not None}
    if not ratios:
        return Verdict(None, ())
    threshold = NormalDist().inv_cdf((1.0 + COVERAGE ** (1.0 / len(ratios))) / 2.0)
    return Verdict(threshold, tuple(name for name, ratio in ratios.items() if ratio > threshold))


def referred(coefficients: Coefficients, reference: float) -> Coefficients:
    """The same coefficients counted from another reference temperature.

    Parameters
    ----------
    coefficients : Coefficients
        Without temperature terms they are the same at every temperature.
    reference : float
        °C.

    Notes
    -----
    A polynomial p(dT) without a constant term becomes p(dT + s) - p(s) with s the shift of the reference; the offset
    takes p(s) over, and the sensitivity the factor 1 + gain(s), by which the new gain is divided.
    """
    thermal = coefficients.thermal
    if thermal is None or thermal.reference == reference:
        return coefficients
    shift = reference - thermal.reference
    at = np.array([shift])
    drift, gain = polynomial(thermal.drift, at)[0], polynomial(thermal.gain, at)[0]
    return replace(
        coefficients,
        offset=coefficients.offset + drift,
        sensitivity=coefficients.sensitivity * (1.0 + gain)[:, None],
        thermal=Thermal(
            reference,
            thermal.range,
            _shifted(thermal.drift, shift),
            _shifted(thermal.gain, shift) / (1.0 + gain)[:, None],
        ),
    )


def changes(
    before: Coefficients,
    after: Coefficients,
    u_before: Mapping[str, float],
    u_after: Mapping[str, float],
) -> list[Change]:
    """Every coefficient that both have, the earlier ones referred to the later one's reference temperature.

    Parameters
    ----------
    before, after : Coefficients
    u_before, u_after : mapping of str to float
        Standard uncertainties by dotted name; a name that is missing is not known.
    """
    if after.thermal is not None:
        before = referred(before, after.thermal.reference)
    old, new = values(before), values(after)
    return [
        Change(
            name,
            old[name],
            new[name],
            hypot(u_before[name], u_after[name]) if name in u_before and name in u_after else None,
        )
        for name in new
        if name in old
    ]


def values(coefficients: Coefficients) -> dict[str, float]:
    """Every coefficient by its dotted name."""
    named = {f"offset.{c}": float(v) for c, v in zip(coefficients.channels, coefficients.offset, strict=True)}
    for channel, row in zip(coefficients.channels, coefficients.sensitivity, strict=True):
        named |= {f"sensitivity.{channel}.{axis}": float(v) for axis, v in zip(coefficients.axes, row, strict=True)}
    if coefficients.thermal is not None:
        for what, table in (("offset", coefficients.thermal.drift), ("sensitivity", coefficients.thermal.gain)):
            for channel, row in zip(coefficients.channels, table, strict=True):
                named |= {f"temperature.{what}.{channel}.{k}": float(v) for k, v in enumerate(row, start=1)}
    return named


def _shifted(table: Array, shift: float) -> Array:
    """Coefficients of p(dT + shift) - p(shift), row by row, without the constant term."""
    rows = []
    for row in table:
        moved = np.polynomial.Polynomial([0.0, *row])(np.polynomial.Polynomial([shift, 1.0]))
        rows.append(np.pad(moved.coef[1:], (0, len(row) - len(moved.coef[1:]))))
    return np.array(rows, dtype=float).reshape(table.shape)

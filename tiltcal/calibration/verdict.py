"""The verdict on the changes of a sensor: whether one is too large for chance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from tiltcal.core.coverage_factor import COVERAGE
from tiltcal.core.named_coefficients import CoefficientChange


@dataclass(frozen=True)
class Verdict:
    """The verdict on the changes of a sensor.

    Attributes
    ----------
    thresholds : mapping of str to float
        The number of standard uncertainties that each change stays within if the sensor is unchanged; empty where no
        change has an uncertainty.
    changed : tuple of str
        The coefficients that changed by more.
    unjudged : tuple of str
        Those that differ and have no uncertainty to judge this by.
    incomplete : str
        Why the uncertainties are too small to call anything changed; empty where they are whole.
    """

    thresholds: Mapping[str, float]
    changed: tuple[str, ...]
    unjudged: tuple[str, ...] = ()
    incomplete: str = ""

    @property
    def threshold(self) -> float | None:
        """The lowest of the thresholds; those of coefficients that rest on few residuals are higher."""
        return min(self.thresholds.values(), default=None)

    @property
    def word(self) -> str:
        """``changed``, ``unchanged`` or ``unknown``."""
        if not self.thresholds or (self.changed and self.incomplete) or (self.unjudged and not self.changed):
            return "unknown"
        return "changed" if self.changed else "unchanged"

    def __str__(self) -> str:
        if not self.thresholds:
            return f"no verdict: {self.incomplete or 'the files state no uncertainties to compare with'}"
        if not self.changed and self.unjudged:
            return f"no verdict: no uncertainty is stated of {', '.join(self.unjudged)}, which differs"
        if not self.changed:
            return "unchanged: no change is more than its threshold of standard uncertainties"
        more = f"{', '.join(self.changed)} by more than the threshold of standard uncertainties"
        return f"no verdict: {more}, but {self.incomplete}" if self.incomplete else f"changed: {more}"


def judge(
    found: Sequence[CoefficientChange], incomplete: str = "", *, among: int = 0, confidence: float = COVERAGE
) -> Verdict:
    """Judge whether one of several changes is too large for chance, given their number (Šidák).

    Parameters
    ----------
    incomplete : str
        Why the uncertainties are too small; empty where they are whole.
    among : int
        The number of changes of which these are the largest, where it is more than their own.
    confidence : float
        The probability that an unchanged sensor is called unchanged.
    """
    judged = [change for change in found if change.ratio is not None]
    each = confidence ** (1.0 / max(len(judged), among, 1))
    thresholds = {change.name: change.threshold(each) for change in judged}
    changed = tuple(change.name for change in judged if (change.ratio or 0.0) > thresholds[change.name])
    return Verdict(thresholds, changed, tuple(change.name for change in found if change.is_unjudged), incomplete)

"""From the parts of a variance to the half width of an interval of 95 %, for millions of values at a time.

Of a variance one part was estimated, and Student's t is its factor; the other part is known. Their sum has effective
degrees of freedom (GUM, eq. G.2b), and those a factor. Both functions have one argument and are smooth, so they are
looked up.
"""

from __future__ import annotations

import numpy as np

from tiltcal.core.budget import COVERAGE, NEGLIGIBLE
from tiltcal.core.model import Array

STEPS = 1 << 14
"""Of a table: four digits of a factor."""


class ExpandedUncertainty:
    """The coverage factors of sums of an estimated and a known variance."""

    def __init__(self) -> None:
        from scipy.special import ndtri, stdtrit

        upper = 0.5 + COVERAGE / 2.0
        self.normal = float(ndtri(upper))
        at = (np.arange(STEPS) + 0.5) / STEPS
        self._factors = np.asarray(stdtrit(1.0 / at, upper))
        """By one over the degrees of freedom, from 0 to 1."""
        whole = np.concatenate([[self.normal], self._factors, [float(stdtrit(1.0, upper))]])
        self._doubts = np.interp(self.normal / np.sqrt(at), whole, np.concatenate([[0.0], at, [1.0]]))
        """One over the degrees of freedom, by the square of the normal factor over Student's."""

    def factor(self, estimated: Array, stretched: Array, known: Array) -> Array:
        """What the standard uncertainty is multiplied with for an interval of 95 %.

        Parameters
        ----------
        estimated : ndarray, shape (n,)
            The part of the variance that was estimated.
        stretched : ndarray, shape (n,)
            The same part with what Student's t stretches it by: its square of half an interval over that of 1.96.
        known : ndarray, shape (n,)
            The other part.

        Returns
        -------
        ndarray, shape (n,)
            NaN where an argument is, or where nothing is uncertain.

        Notes
        -----
        A part that its factor narrows, because errors come with the residuals that tell their size, is narrowed by
        itself.
        """
        total = estimated + known
        with np.errstate(invalid="ignore", divide="ignore"):
            doubt = _looked_up(self._doubts, estimated / stretched)
            doubt *= (estimated / total) ** 2
        factor = _looked_up(self._factors, doubt)
        narrow = stretched <= estimated * (1.0 + NEGLIGIBLE) ** 2
        if narrow.any():
            factor[narrow] = self.normal * np.sqrt((stretched + known)[narrow] / total[narrow])
        return factor


def _looked_up(table: Array, argument: Array) -> Array:
    """The table's values at arguments from 0 to 1, and the first one where there is no number."""
    with np.errstate(invalid="ignore"):
        place = (argument * len(table)).astype(np.int32)
    return np.take(table, place, mode="clip")

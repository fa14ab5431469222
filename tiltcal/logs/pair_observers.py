"""The observers of a log of pairs while it is read: the online estimators, and the spectra of a figure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import ceil, hypot, log2

import numpy as np

from tiltcal.core.model import Array
from tiltcal.core.pair.encoder import FEWEST_TURNS, AngleTracker
from tiltcal.core.pair.matching import PairCoefficients
from tiltcal.core.pair.model import Pair, sum_weights
from tiltcal.core.pair.online import Online, OnlineHistory
from tiltcal.core.pair.sectors import COARSE
from tiltcal.core.pair.spectrum import Spectra
from tiltcal.errors import EstimateError
from tiltcal.logs.pair_matching import Demodulated
from tiltcal.logs.pair_rows import PairBlock

_TURNS_OF_SEGMENT = 8
_LONGEST_SEGMENT = 1 << 18
_LAST_TURNS = 16


class PairObserver:
    """The online estimators of some pairs, run along a log; ``say`` is called where they are held, and go on."""

    def __init__(self, pairs: Sequence[Pair], channels: Sequence[str], say: Callable[[str], None]) -> None:
        self._online = {pair: Online(pair, channels) for pair in pairs}
        self._say = say

    def __call__(self, block: PairBlock) -> None:
        """Push the rows of a block."""
        notices = [online.push(block.theta, block.readings) for online in self._online.values()]
        # What holds one pair holds the other: it is said once.
        for text in dict.fromkeys(str(notice) for of_pair in notices for notice in of_pair):
            self._say(text)

    def course(self, pair: Pair) -> Sequence[OnlineHistory]:
        """Return the estimates of a pair, turn by turn."""
        return self._online[pair].course

    def coefficients(self, pair: Pair, *, loops: bool) -> PairCoefficients:
        """Return what a pair's estimator ended with.

        Parameters
        ----------
        loops : bool
            The source's two loops; otherwise the recursive estimator.

        Raises
        ------
        EstimateError
            It was held for so long that it has no estimate.
        """
        online = self._online[pair]
        if online.stream.turns < FEWEST_TURNS or online.stream.coarse:
            why = COARSE if online.stream.coarse else online.stream.why or "the record is too short"
            raise EstimateError(
                f"the online estimators had {online.stream.turns:.2f} whole turns and need {FEWEST_TURNS:g}: {why}"
            )
        if online.refused:
            raise EstimateError(online.refused)
        if not loops:
            recursive = online.recursive
            recursive.solve()
            return PairCoefficients(recursive.p, recursive.q, *recursive.uncertainty())
        # A loop that is trimmed wanders by its noise and by what it has still to go.
        late = np.array([course.loops for course in online.course[-_LAST_TURNS:]])
        u_p, u_q = (np.std(late, axis=0) if len(late) > 1 else np.zeros(2)).tolist()
        trims = online.loops
        return PairCoefficients(trims.p, trims.q, hypot(u_p, trims.in_phase), hypot(u_q, trims.quadrature))


class SpectrumObserver:
    """The spectra of a log's readings."""

    def __init__(self, channels: Sequence[str]) -> None:
        self._channels = tuple(channels)
        self._spectra: Spectra | None = None

    def __call__(self, block: PairBlock) -> None:
        """Take the rows of a block; the first one settles how long a segment is."""
        if self._spectra is None:
            stage = AngleTracker()
            theta = block.theta[np.isfinite(block.theta)]
            stage.follow(theta)
            rows = _TURNS_OF_SEGMENT * len(theta) / max(stage.turns, 1e-3)
            self._spectra = Spectra(self._channels, min(1 << ceil(log2(max(rows, 64))), _LONGEST_SEGMENT))
        self._spectra.add(block.readings)

    def densities(self, pair: Pair, p: float, q: float, found: Demodulated) -> tuple[Array, dict[str, Array]]:
        """Frequencies, and the densities of the source's figure 6.

        Raises
        ------
        EstimateError
            The record is shorter than a segment.
        """
        if self._spectra is None or not self._spectra.count:
            raise EstimateError(f"the record is too short for a spectrum; {2 * _TURNS_OF_SEGMENT} turns will do")
        rate = found.rate or 1.0
        after_p, after_pq = (
            dict(zip(pair.channels, sum_weights(*trim).tolist(), strict=True)) for trim in ((p, 0.0), (p, q))
        )
        mixes = {pair.first: {pair.first: 1.0}, "sum after p": after_p, "sum after p and q": after_pq}
        densities = {name: self._spectra.density(mix, rate) for name, mix in mixes.items()}
        return densities[pair.first][0], {name: density for name, (_, density) in densities.items()}

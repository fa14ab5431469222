"""Welch's spectral density of readings and of their matched sum, from a record of any length."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.model import Array


class Spectra:
    """Cross-spectral densities of all channels, averaged over half-overlapping segments.

    What a matched sum will be made of is known at the end of a record only; its density is a quadratic form of these.

    Parameters
    ----------
    segment : int
        Rows of a segment; even.
    """

    def __init__(self, channels: Sequence[str], segment: int) -> None:
        self._channels = tuple(channels)
        self._segment = segment
        # The periodic Hann window, as Welch's method takes it.
        self._window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(segment) / segment)
        self._pending = np.empty((0, len(channels)))
        self._sum: NDArray[np.complex128] = np.zeros(
            (segment // 2 + 1, len(channels), len(channels)), dtype=np.complex128
        )
        self.count = 0

    def add(self, readings: Array) -> None:
        """Take more rows, shape (n, channels); one with a missing value is left out."""
        pending = np.concatenate([self._pending, readings[np.isfinite(readings).all(axis=1)]])
        start = 0
        while start + self._segment <= len(pending):
            part = pending[start : start + self._segment]
            lines = np.fft.rfft((part - part.mean(axis=0)) * self._window[:, None], axis=0)
            self._sum += lines[:, :, None].conj() * lines[:, None, :]
            self.count += 1
            start += self._segment // 2
        self._pending = pending[start:]

    def density(self, weights: dict[str, float], rate: float) -> tuple[Array, Array]:
        """One-sided power spectral density of a mix of channels.

        Parameters
        ----------
        rate : float
            Rows per second.

        Returns
        -------
        frequency : ndarray, shape (segment / 2 + 1,)
            Hz.
        density : ndarray, same shape
            Unit²/Hz; NaN where the record is shorter than a segment.
        """
        mix = np.array([weights.get(channel, 0.0) for channel in self._channels])
        power = np.einsum("i,fij,j->f", mix, self._sum, mix).real
        scale = np.full(len(power), 2.0)
        scale[[0, -1]] = 1.0
        density = scale * power / (self.count or np.nan) / (rate * np.sum(self._window**2))
        return np.arange(len(power)) * rate / self._segment, np.maximum(density, 0.0)

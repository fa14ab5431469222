"""Noise of known kind and strength, made without anything of tiltcal's."""

import numpy as np
from numpy.typing import NDArray

Samples = NDArray[np.float64]


def white(rng: np.random.Generator, n: int, sigma: float) -> Samples:
    """Independent samples; Allan deviation sigma/√m for averages of m."""
    return rng.normal(scale=sigma, size=n)


def flicker(rng: np.random.Generator, n: int, sigma: float) -> Samples:
    """1/f noise, by Kasdin's filter (1995): one-sided density sigma²/(π f), Allan deviation sigma √(2 ln 2 / π)."""
    k = np.arange(1, n)
    response = np.concatenate([[1.0], np.cumprod((k - 0.5) / k)])
    driven = np.fft.rfft(response, 2 * n) * np.fft.rfft(rng.normal(scale=sigma, size=n), 2 * n)
    return np.asarray(np.fft.irfft(driven, 2 * n)[:n])


def walk(rng: np.random.Generator, n: int, sigma: float) -> Samples:
    """Random walk with steps of sigma; Allan deviation sigma √(m/3) for averages of many (m) samples."""
    return np.cumsum(rng.normal(scale=sigma, size=n))


def ramp(n: int, rise: float) -> Samples:
    """A steady rise by so much a sample; Allan deviation rise m/√2."""
    return rise * np.arange(n)

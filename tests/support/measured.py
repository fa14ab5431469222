"""Means of simulated sensors in the positions of a procedure."""

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tiltcal.calibration.measurement import Measurement
from tiltcal.core.samples import SampleSummary
from tiltcal.files.procedure import Position


def mean_of(name: str, up: ArrayLike, means: ArrayLike, u: float, **stated: object) -> Measurement:
    """A position with the means of 100 samples of each channel, good to u, and with 10 block means."""
    values = np.asarray(means, dtype=float)
    summaries = {c: SampleSummary(float(v), 10.0 * u, 100, u, 0.0, 9.0) for c, v in zip("xyz", values, strict=False)}
    x, y, z = np.asarray(up, dtype=float).tolist()
    return Measurement(name, (x, y, z), **{"tilt": None, "temperature": None, **stated}, summaries=summaries)  # type: ignore[arg-type]


def measured(
    positions: Iterable[Position],
    read: Callable[[Position], NDArray[np.float64]],
    rng: np.random.Generator,
    noise: float,
) -> list[Measurement]:
    """The positions with what a sensor reads in each, and noise."""
    made = []
    for one in positions:
        means = read(one)
        means = means + rng.normal(0.0, noise, len(means))
        stated = {"tilt": one.tilt, "temperature": one.temperature, "heading": one.heading}
        made.append(mean_of(one.name, one.gravity, means, noise, **stated))
    return made

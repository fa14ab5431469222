"""Records of four accelerometers on a turning disk, made by the formula of the source, and a judge of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PHASES = np.deg2rad([0.0, 180.0, 90.0, 270.0])
NAMES = ("a1", "a2", "a3", "a4")


def line(*values: float) -> bytes:
    return ",".join(f"{value:.10g}" for value in values).encode() + b"\r\n"


@dataclass(frozen=True)
class Record:
    """Time in seconds, stage angle in degrees, readings of a1 to a4."""

    time: Array
    theta: Array
    readings: Array

    def rows(self, where: slice | NDArray[np.bool_]) -> Record:
        return Record(self.time[where], self.theta[where], self.readings[where])

    def lines(self, *, time: bool = False) -> list[bytes]:
        """The stage angle and four readings as the device prints them, behind the time on request."""
        rows = np.column_stack([self.time, self.theta, self.readings])[:, 0 if time else 1 :]
        return [line(*row) for row in rows.tolist()]

    def write(self, path: Path) -> Path:
        table = np.column_stack([self.time, self.theta, self.readings])
        np.savetxt(path, table, fmt="%.12g", delimiter=",", header="time,theta,a1,a2,a3,a4", comments="")
        return path


def record(
    *,
    seconds: float = 800.0,
    rate: float = 50.0,
    spin: float = 0.125,
    scale: Sequence[float] = (3.383, 3.415, 3.402, 3.390),
    misalignment: Sequence[float] = (0.022, -0.015, 0.011, -0.02),
    noise: float = 3e-4,
    wander: float = 0.02,
    start: float = 0.0,
    offset: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
    drift: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
    gradient: tuple[float, float] = (0.0, 0.0),
    corner: float = 0.0,
    seed: int = 0,
) -> Record:
    """Eq. 1 and 4 of the source as they stand there; ``start`` in degrees, ``drift`` over the whole record.

    Below ``corner``, in Hz, the noise is mostly 1/f.
    """
    draw = np.random.default_rng(seed)
    time = np.arange(round(seconds * rate)) / rate
    turned = 2 * np.pi * spin * time + np.deg2rad(start)
    common = 1.0 + wander * np.sin(2 * np.pi * 1.3 * time / seconds + seed)
    columns = []
    for k, d, phi, off, slope in zip(scale, misalignment, PHASES, offset, drift, strict=True):
        angle = turned + phi
        felt = common * (np.sin(angle) + d * np.cos(angle))
        if any(gradient):
            felt += 0.5 * gradient[0] * np.sin(2 * angle) + gradient[1] * np.cos(2 * angle)
        columns.append(off + slope * time / seconds + k * felt + noise * coloured(draw, len(time), corner / rate))
    return Record(time, np.rad2deg(turned) % 360.0, np.stack(columns, axis=1))


def coloured(draw: np.random.Generator, rows: int, corner: float) -> Array:
    """Noise of the density 1 + corner / f, shaped in a longer record's spectrum; ``corner`` in 1/row."""
    if not corner:
        return draw.standard_normal(rows)
    lines = np.fft.rfft(draw.standard_normal(4 * rows))
    frequency = np.fft.rfftfreq(4 * rows)
    lines[1:] *= np.sqrt(1.0 + corner / frequency[1:])
    return np.fft.irfft(lines, 4 * rows)[:rows]


def truth(
    scale: Sequence[float] = (3.383, 3.415, 3.402, 3.390),
    misalignment: Sequence[float] = (0.022, -0.015, 0.011, -0.02),
    pair: tuple[int, int, int] = (0, 1, 3),
) -> tuple[float, float]:
    """p and q from the requirement alone that the matched sum has no component left: two linear equations."""
    vectors = []
    for i in pair:
        phi = PHASES[i]
        vectors.append(
            scale[i]
            * np.array([np.cos(phi) - misalignment[i] * np.sin(phi), np.sin(phi) + misalignment[i] * np.cos(phi)])
        )
    return nulled(vectors)


def nulled(vectors: Sequence[Array]) -> tuple[float, float]:
    """p and q that leave no component of the first vector plus the second and q times the third over 1 - p."""
    rest, q = np.linalg.solve(np.stack([vectors[0], vectors[2]], axis=1), -vectors[1])
    return 1.0 - float(rest), float(q)


def regressed(taken: Record, pair: tuple[int, int, int]) -> tuple[float, float]:
    """p and q of a record by a regression of its own, that the sum has no component left."""
    return nulled([np.array(judged(taken, taken.readings[:, index])) for index in pair])


def judged(taken: Record, signal: Array, harmonic: int = 1) -> tuple[float, float]:
    """sin and cos component of a signal, by ordinary least squares with offset and drift."""
    angle = np.deg2rad(taken.theta)
    columns = [
        np.sin(angle), np.cos(angle), np.sin(2 * angle), np.cos(2 * angle), np.ones_like(angle), taken.time - 400.0
    ]  # fmt: skip
    found = np.linalg.lstsq(np.stack(columns, axis=1), signal, rcond=None)[0]
    return float(found[2 * harmonic - 2]), float(found[2 * harmonic - 1])


def suppression(taken: Record, p: float, q: float) -> float:
    """Common acceleration in a1 over that in the matched sum."""
    a1, a2, _, a4 = taken.readings.T
    return float(np.hypot(*judged(taken, a1)) / np.hypot(*judged(taken, a1 + (a2 + q * a4) / (1.0 - p))))

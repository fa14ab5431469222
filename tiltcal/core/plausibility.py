"""The expected reading of a position, by which a wrong position is caught at once.

The coefficients are taken as normal, centred on the model's nominal values with the spread of its parts, and every
accepted position sharpens them (recursive linear least squares). A reading is then so many standard deviations from
what each position of the procedure should give.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import cos, radians, sin, sqrt

import numpy as np

from tiltcal.core.angle_readings import AngleReadings
from tiltcal.core.attitude import Vector
from tiltcal.core.model import AXES, Array

POSE = sin(radians(1.5))  # how far a careful operator may be off, g: above any jig, below the distance of two positions
MATCHED, ODD = 5.0, 8.0  # deviations from which a reading is refused: another position fits better, or none
UNKNOWN_OFFSET = 1.0  # an offset with a larger standard deviation over parts is not known, g: it predicts no reading
SAME_TILT = radians(5.0)  # attitudes closer than this are one attitude taken again
CROSS_SPREAD = 0.03  # standard deviation of a cross-axis sensitivity over parts, of the main one (SCA100T: 4 % at most)
OFFSET_FLOOR = 0.03  # offsets may differ by this much more than the part's specification: boards are soldered askew, g
DRIFT = 0.005  # how far an offset may move per °C before the drift is known, g/°C: the ADXL202's worst part


class ExpectedReadings:
    """The reading that each position should give, of a part with nominal offset, unit, and sensitivity, unit/g.

    The spreads are standard deviations over parts: of the offset, g, and of the sensitivity, relative. What reads
    ``angles`` has its sensitivity near level.
    """

    def __init__(
        self,
        channels: tuple[str, ...],
        offset: float,
        sensitivity: float,
        offset_spread: float,
        sensitivity_spread: float,
        angles: AngleReadings | None = None,
    ) -> None:
        self._angles = angles
        self._channels = channels
        self._offset, self._sensitivity = offset, sensitivity
        self._or = ", or was a position before it wrong (go back)" if offset_spread > UNKNOWN_OFFSET else ""
        prior = np.diag([offset_spread**2 + OFFSET_FLOOR**2, *(3 * [CROSS_SPREAD**2])])
        own = [1 + AXES.index(channel) for channel in channels]
        self._mean = [np.eye(4)[place] for place in own]
        self._covariance = [prior + (sensitivity_spread**2 - CROSS_SPREAD**2) * np.diag(np.eye(4)[k]) for k in own]
        self._first_temperature: float | None = None

    def distance(self, gravity: Vector, reading: Array, temperature: float | None) -> float:
        """Return how many standard deviations a reading is from what ``gravity`` should give, in the worst channel."""
        means, deviations = self.in_g(gravity, temperature)
        misses = [abs(value - mean) for value, mean in zip(self._in_g(reading), means, strict=True)]
        return max(miss / deviation for miss, deviation in zip(misses, deviations, strict=True))

    def learn(self, gravity: Vector, reading: Array, temperature: float | None = None) -> None:
        """Take an accepted position into account."""
        if self._first_temperature is None:
            self._first_temperature = temperature
        row, sigma = np.array([1.0, *gravity]), self._pose(temperature)
        for i, value in enumerate(self._in_g(reading)):
            spread = self._covariance[i] @ row
            gain = spread / (row @ spread + sigma**2)
            self._mean[i] = self._mean[i] + gain * (value - row @ self._mean[i])
            self._covariance[i] = self._covariance[i] - np.outer(gain, spread)

    def expected(self, gravity: Vector) -> dict[str, float]:
        """Return the reading per channel that ``gravity`` should give, in the sensor's unit."""
        means, _ = self.in_g(gravity)
        signals = means if self._angles is None else [self._angles.near_level(mean) for mean in means]
        readings = (self._offset + self._sensitivity * signal for signal in signals)
        return dict(zip(self._channels, readings, strict=True))

    def in_g(self, gravity: Vector, temperature: float | None = None) -> tuple[list[float], list[float]]:
        """Return the expected readings by the nominal coefficients, g, and their standard deviations."""
        row = np.array([1.0, *gravity])
        means = [float(row @ mean) for mean in self._mean]
        spreads = (row @ covariance @ row for covariance in self._covariance)
        return means, [sqrt(spread + self._pose(temperature) ** 2) for spread in spreads]

    def objection(
        self, position: str, positions: Mapping[str, Vector], reading: Array, temperature: float | None = None
    ) -> str | None:
        """Return why a reading, (channels,), cannot be that of a position among others; None where it can."""
        if other := self.resembled(position, positions, reading, temperature):
            return f"this looks like {other}: is the sensor turned round{self._or}?"
        if self.distance(positions[position], reading, temperature) > ODD:
            expected = self.expected(positions[position])
            differences = ", ".join(
                f"{channel} reads {value:.6g} where about {expected[channel]:.6g} is expected"
                for channel, value in zip(self._channels, reading, strict=True)
            )
            return (
                f"no position of this procedure reads like this ({differences}): is the sensor at the angle, and are "
                f"its axes named right{self._or}?"
            )
        return None

    def resembled(
        self, position: str, positions: Mapping[str, Vector], reading: Array, temperature: float | None = None
    ) -> str:
        """Return the position that a reading, (channels,), fits clearly better than the one it was taken in, if any."""
        distances = {name: self.distance(gravity, reading, temperature) for name, gravity in positions.items()}
        own, nearest = distances[position], min(distances, key=lambda name: distances[name])
        return nearest if own > MATCHED and distances[nearest] < own / 2 else ""

    def repeated(self, readings: Mapping[str, Array], reading: Array) -> str | None:
        """Return why a reading, (3,), is the attitude of one before, by their names; None where it is not."""
        own = np.array(self._in_g(reading))
        for name, before in readings.items():
            other = np.array(self._in_g(before))
            if float(own @ other) > cos(SAME_TILT) * float(np.linalg.norm(own) * np.linalg.norm(other)):
                return f"this is the attitude of {name} again: hold the sensor in a different attitude"
        return None

    def _in_g(self, reading: Array) -> list[float]:
        signals = [(float(value) - self._offset) / self._sensitivity for value in reading]
        return signals if self._angles is None else self._angles.components(self._channels, signals)

    def _pose(self, temperature: float | None) -> float:
        if temperature is None or self._first_temperature is None:
            return POSE
        return float(np.hypot(POSE, DRIFT * (temperature - self._first_temperature)))

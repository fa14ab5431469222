"""The input of the estimator: positions with their mean readings, and the coefficients to determine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import inf, radians

import numpy as np
from numpy.typing import NDArray

from tiltcal.core.angle_readings import AngleReadings
from tiltcal.core.attitude import STRAIGHT
from tiltcal.core.model import Array, ChannelModel, Coefficients, Thermal
from tiltcal.core.uncertain import Uncertain
from tiltcal.errors import EstimateError

Indices = NDArray[np.intp]
LEAST_VERTICAL = 0.05  # least component of gravity along z by which an error of a tilt counts, g: 87° of tilt


@dataclass(frozen=True)
class Observation:
    """The mean reading in one position."""

    position: str
    gravity: Array  # up in the sensor frame as set, shape (3,), g
    mean: Array  # shape (channels,), unit
    u: Array  # its standard uncertainty from noise and rounding, shape (channels,), unit
    temperature: float | None = None  # °C
    heading: float | None = None  # how far the fixture is turned about the vertical, degrees
    held: bool = False  # not set again after the position before: it has the same attitude error
    dof: Array | float = inf  # of the noise in u, shape (channels,); infinite where the noise is known
    adc: Array | float = 0.0  # the part of u that rounding gives, shape (channels,), unit
    noise_unknown: bool = False  # nothing but rounding is in u: the residuals show one noise for all readings
    looser: float = 1.0  # factor of the design's jig here: sessions set their positions each with its own


@dataclass(frozen=True)
class InstrumentErrors:
    """The errors that a reference instrument on the plate has in all positions alike, as standard uncertainties."""

    axes: tuple[str, ...]  # the tilts that it reads
    zero: float  # degrees
    scale: float  # share of the tilt
    alignment: float  # about the vertical of the plate, degrees
    unread: float  # of a tilt that it does not read, degrees, beyond the design's jig; not alike in all positions

    def moves(self, gravity: Array, settings: Indices) -> Array:
        """Return by how much each error moves gravity, (places, 3), at each place: (places, 3, errors), g."""
        x, y, z = gravity.T
        away = np.where(np.abs(z) < LEAST_VERTICAL, np.copysign(LEAST_VERTICAL, z), z)
        columns = [radians(self.alignment) * np.stack([-y, x, np.zeros_like(z)], axis=1)]
        for number, axis in enumerate("xy"):
            sine = gravity[:, number]
            by_tilt = np.zeros_like(gravity)
            by_tilt[:, number], by_tilt[:, 2] = 1.0, -sine / away
            by_tilt *= np.sqrt(np.maximum(1.0 - sine**2, 0.0))[:, None]
            if axis in self.axes:
                columns += [radians(self.zero) * by_tilt, self.scale * np.arcsin(sine)[:, None] * by_tilt]
            else:
                own = settings == np.arange(settings.max() + 1)[:, None]
                columns += [radians(self.unread) * by_tilt * here[:, None] for here in own]
        return np.stack(columns, axis=2)


@dataclass(frozen=True)
class Prior:
    """Value and standard uncertainty of a coefficient before anything is measured; u = 0 holds it at the value."""

    value: float
    u: float = 0.0


@dataclass(frozen=True)
class Design:
    """Which coefficients are to be determined, and how well the bench sets what it sets (standard uncertainties).

    A jig that is not stated (None) is estimated from the residuals, and so is a thermometer beside a stated jig; an
    infinite jig means free positions. Of a lean that is not stated positions at several headings show what it is.
    """

    channels: tuple[str, ...]
    axes: tuple[str, ...]  # columns of the sensitivity matrix
    drift: int = 0  # order of the offset's polynomial in temperature
    gain: int = 0  # and of the sensitivity's
    reference: float = 0.0  # °C, where an order is above 0
    jig: float | None = None  # of each set angle, degrees per axis
    table_lean: float | None = None  # of the lean that all positions share, degrees per axis
    heading: float = 0.0  # degrees
    thermometer: float | None = 0.0  # °C
    instrument: InstrumentErrors | None = None  # where a reference says what was set; the jig is its repeatability
    nonlinearity: int = 0  # 0 for a straight line, 1 for a square, 2 for a square and a cube
    priors: Mapping[str, Prior] = field(default_factory=dict)  # by the coefficient's dotted name
    nominal: float = 0.0  # sensitivity of the model, unit/g; 0 where it is not known
    angles: AngleReadings | None = None  # of a device that prints angles; nonlinearity is none then
    # What calibrations of the sensor state jointly, beside the priors: of some coefficients, first of all, values that
    # are rows @ coefficients, (k, coefficients), with their covariance.
    stated: tuple[tuple[Array, Uncertain], ...] = ()

    @property
    def assumes_sensitivity(self) -> bool:
        """Whether the sensitivities are known before, and not determined."""
        return any(f"sensitivity.{channel}.{channel}" in self.priors for channel in self.channels)

    @property
    def thermal(self) -> bool:
        """Whether temperature terms are asked for."""
        return bool(self.drift or self.gain)

    @property
    def free(self) -> bool:
        """Whether the directions of gravity are unknown."""
        return self.jig == inf

    @cached_property
    def models(self) -> tuple[ChannelModel, ...]:
        """The model of each channel."""
        orders = self.drift, self.gain, self.nonlinearity
        return tuple(ChannelModel(name, self.axes, *orders, self.angles) for name in self.channels)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Dotted names of all coefficients, channel by channel."""
        return tuple(name for model in self.models for name in model.coefficients)


@dataclass(frozen=True)
class SensorObservations:
    """The positions of one sensor of a fixture; those of several sensors belong together by their names.

    ``orientation`` is 3 by 3 and takes a vector of the fixture's frame to the sensor's.
    """

    design: Design
    observations: Sequence[Observation]
    orientation: Sequence[Sequence[float]] = STRAIGHT.matrix

    def coefficients(self, theta: Array) -> Coefficients:
        """Return the coefficients that a vector of all channels holds, with the range of the temperatures met."""
        design, table = self.design, theta.reshape(len(self.design.channels), -1)
        sensitivity, drift, gain, bend = design.models[0].split(table)
        thermal = None
        if design.thermal:
            met = [one.temperature for one in self.observations if one.temperature is not None]
            thermal = Thermal(design.reference, (float(min(met)), float(max(met))) if met else None, drift, gain)
        bent = bend if design.nonlinearity else None
        return Coefficients(
            design.channels, design.axes, table[:, 0], sensitivity, thermal, nonlinearity=bent, angles=design.angles
        )


def require_sound(sensors: Sequence[SensorObservations]) -> None:
    """Refuse sensors without positions, and positions that are there twice or lack a temperature, as EstimateErrors."""
    for design, observations in ((sensor.design, sensor.observations) for sensor in sensors):
        if not observations:
            raise EstimateError("no position was measured: measure the procedure's positions first")
        names = [observation.position for observation in observations]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise EstimateError(f"position {twice} is there twice: name each one differently")
        cold = next((one.position for one in observations if design.thermal and one.temperature is None), None)
        if cold is not None:
            raise EstimateError(f"position {cold}: a temperature is needed for the temperature terms")

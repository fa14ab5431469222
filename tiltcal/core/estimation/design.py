"""The input of the estimator: positions with their mean readings, and the coefficients to determine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import inf

from tiltcal.core.model import Array, ChannelModel
from tiltcal.core.orientation import STRAIGHT
from tiltcal.errors import EstimateError


@dataclass(frozen=True)
class Observation:
    """The mean reading in one position.

    Attributes
    ----------
    gravity : ndarray, shape (3,)
        Up in the sensor frame as set, g.
    mean : ndarray, shape (channels,)
        In the sensor's unit.
    u : ndarray, shape (channels,)
        Standard uncertainty of the mean from noise and quantisation, same unit.
    temperature : float or None
        °C.
    heading : float or None
        How far the fixture is turned about the vertical, degrees.
    held : bool
        The fixture was not set again after the position before: it has the same attitude error.
    dof : ndarray, shape (channels,), or float
        Degrees of freedom of the noise's part of ``u``; infinite where it is known.
    adc : ndarray, shape (channels,), or float
        The part of ``u`` that quantisation gives.
    noise_unknown : bool
        Nothing else is in ``u``, because nothing is known of the noise: one number for all readings.
    looser : float
        By what the design's jig is multiplied here: sessions set their positions each with its own.
    """

    position: str
    gravity: Array
    mean: Array
    u: Array
    temperature: float | None = None
    heading: float | None = None
    held: bool = False
    dof: Array | float = inf
    adc: Array | float = 0.0
    noise_unknown: bool = False
    looser: float = 1.0


@dataclass(frozen=True)
class Prior:
    """Value and uncertainty of a coefficient before anything is measured.

    Attributes
    ----------
    u : float
        Standard uncertainty, same unit; 0 holds the coefficient at the value.
    """

    value: float
    u: float = 0.0


@dataclass(frozen=True)
class StatedCoefficients:
    """What a calibration file states: ``rows @ coefficients`` is ``values``, with a covariance.

    Attributes
    ----------
    names : tuple of str
        The coefficient that each value is of, first of all.
    rows : ndarray, shape (k, coefficients)
        By the names of the design.
    values : ndarray, shape (k,)
    covariance : ndarray, shape (k, k)
    """

    names: tuple[str, ...]
    rows: Array
    values: Array
    covariance: Array


@dataclass(frozen=True)
class Design:
    """Which coefficients are to be determined, and how well the bench sets what it sets.

    Attributes
    ----------
    axes : tuple of str
        Columns of the sensitivity matrix.
    drift, gain : int
        Orders of the temperature polynomials; 0 leaves them out.
    reference : float
        Reference temperature, °C; used where an order is above 0.
    jig : float or None
        Standard uncertainty of each set angle, degrees, normal and per axis. None: not stated, and estimated from the
        residuals. Infinite: free positions.
    table : float or None
        Standard uncertainty of the table's lean, degrees per axis; all positions share it. None where nothing is known
        of it: positions at several headings then show it, and at one heading it goes into the offsets unseen.
    heading : float
        Standard uncertainty of each heading, degrees.
    thermometer : float or None
        Standard uncertainty of each temperature, °C. None: not stated, and estimated from the residuals where a stated
        jig leaves more of them than it explains.
    nonlinearity : int
        0 for a straight line, 1 for a square, 2 for a square and a cube.
    priors : mapping of str to Prior
        By the coefficient's dotted name.
    nominal : float
        Sensitivity of the model, unit/g; 0 where it is not known.
    stated : tuple of StatedCoefficients
        What calibrations of the sensor state of coefficients jointly, beside the priors.
    """

    channels: tuple[str, ...]
    axes: tuple[str, ...]
    drift: int = 0
    gain: int = 0
    reference: float = 0.0
    jig: float | None = None
    table: float | None = None
    heading: float = 0.0
    thermometer: float | None = 0.0
    nonlinearity: int = 0
    priors: Mapping[str, Prior] = field(default_factory=dict)
    nominal: float = 0.0
    stated: tuple[StatedCoefficients, ...] = ()

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
        return tuple(ChannelModel(name, self.axes, self.drift, self.gain, self.nonlinearity) for name in self.channels)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Dotted names of all coefficients, channel by channel."""
        return tuple(name for model in self.models for name in model.coefficients)


@dataclass(frozen=True)
class SensorObservations:
    """Observations of one sensor of a fixture.

    Attributes
    ----------
    observations : sequence of Observation
        Positions are common to the sensors of a fixture by their names, which are unique.
    orientation : sequence of sequence of float
        3 by 3; takes a vector of the fixture's frame to the sensor's.
    """

    design: Design
    observations: Sequence[Observation]
    orientation: Sequence[Sequence[float]] = STRAIGHT.matrix


def _bench(design: Design) -> tuple[float | None, ...]:
    return design.jig, design.table, design.heading, design.thermometer


def require_sound(sensors: Sequence[SensorObservations]) -> None:
    """Refuse sensors that do not belong on one fixture, and designs that contradict themselves.

    Raises
    ------
    EstimateError
        Nothing to estimate from, a missing temperature, a position twice, benches that differ, a channel whose
        nonlinearity has no own axis.
    """
    if not sensors:
        raise EstimateError("no sensor, nothing to estimate")
    first = sensors[0].design
    for sensor in sensors:
        design = sensor.design
        if not sensor.observations:
            raise EstimateError("no position was measured: measure the procedure's positions first")
        if _bench(design) != _bench(first):
            raise EstimateError("the sensors of one fixture share its jig, its table and its thermometer")
        names = [observation.position for observation in sensor.observations]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise EstimateError(f"position {twice} is there twice: name each one differently")
        if design.nonlinearity and not set(design.channels) <= set(design.axes):
            raise EstimateError("a nonlinearity is counted along each channel's own axis: determine that axis too")
        for observation in sensor.observations:
            if design.thermal and observation.temperature is None:
                raise EstimateError(
                    f"position {observation.position}: a temperature is needed for the temperature terms"
                )
        strange = sorted(set(design.priors) - set(design.names))
        if strange:
            raise EstimateError(f"a prior names {strange[0]}, which is no coefficient of this design")

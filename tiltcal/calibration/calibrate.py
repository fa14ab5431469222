"""From measured positions to a calibration: the one path that the bench, the replay and recorded logs share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import asin, degrees, fsum, inf, radians, sqrt
from typing import Any

import numpy as np

from tiltcal.calibration.results import derived_record, fit_record, rounded, uncertainty_record
from tiltcal.core.estimation.design import STRAIGHT, Design, Observation, Prior, SensorObservations
from tiltcal.core.estimation.estimate import estimate_jointly
from tiltcal.core.estimation.pooling import pooled
from tiltcal.core.model import AXES, Array, Limits
from tiltcal.core.rounding import round_to, significant
from tiltcal.core.statistics import SampleSummary
from tiltcal.drivers.device import Model
from tiltcal.errors import EstimateError
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity
from tiltcal.files.procedure import Procedure


@dataclass(frozen=True)
class Measurement:
    """One position of one sensor, ready for the estimator.

    Attributes
    ----------
    position : str
    gravity : tuple of float
        Up in the sensor frame as set, g.
    tilt : mapping of str to float or None
        As set, degrees; None where the position is given by its direction.
    temperature : float or None
        °C.
    summaries : mapping of str to SampleSummary
        Per channel of the sensor.
    when : mapping of str to Any
        How the position is found again: its time, or its rows of a log.
    heading : float or None
        How far the fixture was turned about the vertical, degrees.
    """

    position: str
    gravity: tuple[float, float, float]
    tilt: Mapping[str, float] | None
    temperature: float | None
    summaries: Mapping[str, SampleSummary]
    when: Mapping[str, Any] = field(default_factory=dict)
    heading: float | None = None


@dataclass(frozen=True)
class Nominal:
    """What a sensor's model is known for; stands in where a procedure does not determine it.

    Attributes
    ----------
    sensitivity, spread : float
        Nominal sensitivity in unit/g, and its standard deviation over parts in unit/g.
    rails : tuple of float
        In unit.
    """

    sensitivity: float
    spread: float
    rails: tuple[float, float]

    @classmethod
    def of(cls, model: Model) -> Nominal:
        """Of a model as its data sheet has it."""
        return cls(model.sensitivity, model.sensitivity * model.sensitivity_spread, model.rails)


@dataclass(frozen=True)
class MeasuredSensor:
    """One sensor of a fixture with what was measured of it.

    Attributes
    ----------
    sensor : SensorIdentity
    measurements : sequence of Measurement
    nominal : Nominal or None
        Of the sensor's model.
    orientation : sequence of sequence of float
        3 by 3; takes a vector of the fixture's frame to the sensor's.
    """

    sensor: SensorIdentity
    measurements: Sequence[Measurement]
    nominal: Nominal | None = None
    orientation: Sequence[Sequence[float]] = STRAIGHT


def calibrate_jointly(
    subjects: Sequence[MeasuredSensor],
    procedure: Procedure,
    *,
    jig: float | None = None,
    thermometer: float | None = None,
    settings: Mapping[str, Any] | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> list[CalibrationRecord]:
    """Calibrate all sensors of a fixture: they share its attitude in every position.

    Parameters
    ----------
    subjects : sequence of MeasuredSensor
    procedure : Procedure
        Says which coefficients to determine.
    jig : float, optional
        Standard uncertainty of a set angle, degrees; None where it was not stated. A procedure of free positions
        trusts none: there the directions of the measurements are a first guess, and unit gravity determines the rest.
    thermometer : float, optional
        Standard uncertainty of a temperature, °C; None where it was not stated, and counts as nothing.
    settings, provenance : mapping, optional
        Records for the files.

    Returns
    -------
    list of CalibrationRecord
        One a subject, their numbers rounded to what their uncertainty warrants.

    Raises
    ------
    EstimateError
        The positions cannot determine the coefficients.
    """
    designs = [design_of(subject, procedure, jig, thermometer) for subject in subjects]
    found = estimate_jointly(
        [
            SensorObservations(design, observations_of(subject.measurements, design.channels), subject.orientation)
            for subject, design in zip(subjects, designs, strict=True)
        ]
    )
    calibrations = []
    for subject, design, one in zip(subjects, designs, found, strict=True):
        calibrations.append(
            CalibrationRecord(
                sensor=replace(subject.sensor, channels=design.channels),
                coefficients=rounded(one),
                uncertainty=uncertainty_record(one, _reading(subject.measurements, design)),
                limits=_limits(design, subject.measurements, subject.nominal, one.coefficients.thermal is not None),
                derived=derived_record(one, design),
                fit=fit_record(one, design, _largest_noise(subject.measurements, design.channels)),
                procedure=_procedure(procedure, subject.measurements, settings or {}),
                positions=[_position(measurement, design.channels) for measurement in subject.measurements],
                provenance=provenance or {},
            )
        )
    return calibrations


def design_of(subject: MeasuredSensor, procedure: Procedure, jig: float | None, thermometer: float | None) -> Design:
    """What a procedure determines of a sensor, and how well the bench sets what it sets.

    Raises
    ------
    EstimateError
        The sensor has none of the procedure's axes, or a sensitivity must stand in that nobody knows.
    """
    determines, sensor = procedure.determines, subject.sensor
    channels = tuple(c for c in sensor.channels if not determines.axes or c in determines.axes)
    if not channels:
        raise EstimateError(
            f"{procedure.name} determines the axes {', '.join(determines.axes)}; {sensor.model} has none of them"
        )
    return Design(
        channels,
        determines.axes or channels,
        determines.drift,
        determines.gain,
        procedure.reference or 0.0,
        inf if determines.free else jig,
        thermometer=thermometer or 0.0,
        nonlinearity=determines.nonlinearity,
        priors={} if determines.axes else _assumed(procedure, channels, subject.nominal),
    )


def _assumed(procedure: Procedure, channels: Sequence[str], nominal: Nominal | None) -> dict[str, Prior]:
    """The model's sensitivity, where the procedure determines none."""
    if nominal is None:
        raise EstimateError(
            f"{procedure.name} determines no sensitivity: name a --sensor model whose nominal one may stand in"
        )
    return {
        f"sensitivity.{channel}.{axis}": Prior(nominal.sensitivity, nominal.spread) if axis == channel else Prior(0.0)
        for channel in channels
        for axis in channels
    }


def observations_of(measurements: Sequence[Measurement], channels: Sequence[str]) -> list[Observation]:
    """The positions for the estimator, each one's noise made better known by that of the others."""
    noise = [pooled(*_noise(measurements, channel)) for channel in channels]
    observations = []
    before: Measurement | None = None
    for number, measurement in enumerate(measurements):
        summaries = [measurement.summaries[channel] for channel in channels]
        adc = np.array([summary.quantisation for summary in summaries])
        observations.append(
            Observation(
                measurement.position,
                np.array(measurement.gravity),
                np.array([summary.mean for summary in summaries]),
                np.sqrt(np.array([variance[number] for variance, _ in noise]) + adc**2),
                measurement.temperature,
                measurement.heading,
                held=before is not None and _stands(before) == _stands(measurement),
                dof=np.array([dof[number] for _, dof in noise]),
                adc=adc,
            )
        )
        before = measurement
    return observations


def _noise(measurements: Sequence[Measurement], channel: str) -> tuple[Array, Array]:
    """Variance of each position's mean, and its degrees of freedom."""
    summaries = [measurement.summaries[channel] for measurement in measurements]
    return np.array([summary.noise**2 for summary in summaries]), np.array([summary.dof for summary in summaries])


def _stands(measurement: Measurement) -> tuple[object, ...]:
    """How the fixture was set; what is set like the position before was not touched."""
    return measurement.gravity, measurement.heading


def _largest_noise(measurements: Sequence[Measurement], channels: Sequence[str]) -> float:
    return max(measurement.summaries[channel].u for measurement in measurements for channel in channels)


def _reading(measurements: Sequence[Measurement], design: Design) -> dict[str, float]:
    """What a single reading is uncertain by: the samples' scatter within the positions, and what rounding leaves."""
    known: dict[str, float] = {}
    for channel in design.channels:
        summaries = [measurement.summaries[channel] for measurement in measurements]
        dof = sum(summary.n - 1 for summary in summaries)
        if dof:
            scatter = fsum((summary.n - 1) * summary.std**2 for summary in summaries) / dof
            known[channel] = sqrt(scatter + max(summary.quantisation for summary in summaries) ** 2)
    if known and design.thermometer and (design.drift or design.gain):
        known["temperature"] = design.thermometer
    return known


def _limits(design: Design, measurements: Sequence[Measurement], nominal: Nominal | None, thermal: bool) -> Limits:
    """Tilt to either side as far as any position went, the temperatures that were met, the model's rails."""
    tilt = {}
    for axis in design.channels:
        reach = max(abs(measurement.gravity[AXES.index(axis)]) for measurement in measurements)
        if reach > 0.0:
            furthest = radians(round(degrees(asin(min(reach, 1.0))), 6))
            tilt[axis] = (-furthest, furthest)
    met = [round(measurement.temperature, 3) for measurement in measurements if measurement.temperature is not None]
    return Limits(
        tilt=tilt,
        temperature=(min(met), max(met)) if thermal else None,
        reading=dict.fromkeys(design.channels, nominal.rails) if nominal else {},
    )


def _procedure(
    procedure: Procedure, measurements: Sequence[Measurement], settings: Mapping[str, Any]
) -> dict[str, Any]:
    return {
        "name": procedure.name,
        "title": procedure.title,
        **({"source": procedure.source} if procedure.source else {}),
        **settings,
        "set": {measurement.position: _set(measurement) for measurement in measurements},
    }


def _set(measurement: Measurement) -> dict[str, Any]:
    """What was actually set in a position."""
    if measurement.tilt is not None:
        return {"tilt": {axis: float(angle) for axis, angle in measurement.tilt.items()}}
    return {"gravity": [significant(component, 9) for component in measurement.gravity]}


def _position(measurement: Measurement, channels: Sequence[str]) -> dict[str, Any]:
    summaries = {channel: measurement.summaries[channel] for channel in channels}
    return {
        "position": measurement.position,
        "mean": {c: round_to(summary.mean, summary.u) for c, summary in summaries.items()},
        "std": {c: significant(summary.std, 4) for c, summary in summaries.items()},
        "u": {c: significant(summary.u, 4) for c, summary in summaries.items()},
        "n": next(iter(summaries.values())).n,
        **({"temperature": round(measurement.temperature, 3)} if measurement.temperature is not None else {}),
        **measurement.when,
    }

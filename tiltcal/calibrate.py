"""From measured positions to a calibration: the one path that the bench, the replay and recorded logs share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import asin, degrees, radians
from typing import Any

import numpy as np

from tiltcal.core.derived import cross_axis, misalignment
from tiltcal.core.estimate import Design, Estimate, Observation, estimate
from tiltcal.core.model import AXES, Array, Coefficients, Limits, Thermal
from tiltcal.core.rounding import round_to, significant
from tiltcal.core.statistics import Summary
from tiltcal.errors import EstimateError
from tiltcal.files.calibration import Calibration, SensorIdentity
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
    summaries : mapping of str to Summary
        Per channel of the sensor.
    when : mapping of str to Any
        How the position is found again: its time, or its rows of a log.
    """

    position: str
    gravity: tuple[float, float, float]
    tilt: Mapping[str, float] | None
    temperature: float | None
    summaries: Mapping[str, Summary]
    when: Mapping[str, Any] = field(default_factory=dict)


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


def calibrate(
    sensor: SensorIdentity,
    procedure: Procedure,
    measurements: Sequence[Measurement],
    *,
    nominal: Nominal | None = None,
    jig: float | None = None,
    settings: Mapping[str, Any] | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> Calibration:
    """Calibrate one sensor from its positions.

    Parameters
    ----------
    sensor : SensorIdentity
    procedure : Procedure
        Says which coefficients to determine.
    measurements : sequence of Measurement
    nominal : Nominal, optional
        Of the sensor's model.
    jig : float, optional
        Standard uncertainty of a set angle, degrees; None where it was not stated.
    settings, provenance : mapping, optional
        Records for the file.

    Returns
    -------
    Calibration
        With its numbers rounded to what their uncertainty warrants.

    Raises
    ------
    EstimateError
        The positions cannot determine the coefficients.
    """
    determines = procedure.determines
    channels = tuple(c for c in sensor.channels if not determines.axes or c in determines.axes)
    if not channels:
        raise EstimateError(
            f"{procedure.name} determines the axes {', '.join(determines.axes)}; {sensor.model} has none of them"
        )
    known = _known_sensitivity(procedure, channels, nominal)
    design = Design(channels, determines.axes, determines.drift, determines.gain, procedure.reference or 0.0, jig)
    observations = [_observation(measurement, channels, known) for measurement in measurements]
    found = estimate(observations, design)
    uncertainty = found.uncertainty()
    coefficients = _rounded(found.coefficients, uncertainty)
    spread = nominal.spread if nominal else 0.0
    if known is not None:
        coefficients = replace(coefficients, axes=channels, sensitivity=_square(known, channels))
        uncertainty |= {f"sensitivity.{c}.{a}": spread if c == a else 0.0 for c in channels for a in channels}
    return Calibration(
        sensor=replace(sensor, channels=channels),
        coefficients=coefficients,
        uncertainty=_uncertainty(coefficients, uncertainty),
        limits=_limits(coefficients, measurements, nominal),
        derived=_derived(coefficients) if known is None else {"assumed": ["sensitivity: nominal of the model"]},
        fit=_fit(found, measurements, channels, jig),
        procedure=_procedure(procedure, measurements, settings or {}),
        positions=[_position(measurement, channels) for measurement in measurements],
        provenance=provenance or {},
    )


def _known_sensitivity(procedure: Procedure, channels: Sequence[str], nominal: Nominal | None) -> Array | None:
    """The nominal matrix (channels, 3), where the procedure determines no sensitivity."""
    if procedure.determines.axes:
        return None
    if nominal is None:
        raise EstimateError(
            f"{procedure.name} determines no sensitivity: name a --sensor model whose nominal one may stand in"
        )
    matrix = np.zeros((len(channels), 3))
    for row, channel in enumerate(channels):
        matrix[row, AXES.index(channel)] = nominal.sensitivity
    return matrix


def _square(matrix: Array, channels: Sequence[str]) -> Array:
    return matrix[:, [AXES.index(channel) for channel in channels]]


def _observation(measurement: Measurement, channels: Sequence[str], known: Array | None) -> Observation:
    gravity = np.array(measurement.gravity)
    mean = np.array([measurement.summaries[channel].mean for channel in channels])
    return Observation(
        measurement.position,
        gravity,
        mean if known is None else mean - known @ gravity,
        np.array([measurement.summaries[channel].u for channel in channels]),
        measurement.temperature,
    )


def _rounded(coefficients: Coefficients, u: Mapping[str, float]) -> Coefficients:
    """The coefficients with the digits that their uncertainties warrant."""
    thermal = coefficients.thermal
    if thermal is not None:
        thermal = Thermal(
            reference=thermal.reference,
            range=None if thermal.range is None else (round(thermal.range[0], 3), round(thermal.range[1], 3)),
            drift=_rounded_rows(thermal.drift, coefficients.channels, "temperature.offset", u),
            gain=_rounded_rows(thermal.gain, coefficients.channels, "temperature.sensitivity", u),
        )
    return replace(
        coefficients,
        offset=np.array(
            [round_to(v, u[f"offset.{c}"]) for c, v in zip(coefficients.channels, coefficients.offset, strict=True)]
        ),
        sensitivity=np.array(
            [
                [round_to(v, u[f"sensitivity.{c}.{a}"]) for a, v in zip(coefficients.axes, row, strict=True)]
                for c, row in zip(coefficients.channels, coefficients.sensitivity, strict=True)
            ]
        ).reshape(coefficients.sensitivity.shape),
        thermal=thermal,
    )


def _rounded_rows(table: Array, channels: Sequence[str], name: str, u: Mapping[str, float]) -> Array:
    rows = [
        [round_to(value, u[f"{name}.{channel}.{power}"]) for power, value in enumerate(row, start=1)]
        for channel, row in zip(channels, table, strict=True)
    ]
    return np.array(rows).reshape(table.shape)


def _uncertainty(coefficients: Coefficients, u: Mapping[str, float]) -> dict[str, Any]:
    """Standard uncertainties in the shape of the file's ``calibration`` section, to four digits."""
    channels = coefficients.channels
    shaped: dict[str, Any] = {
        "offset": {c: significant(u[f"offset.{c}"], 4) for c in channels},
        "sensitivity": {c: {a: significant(u[f"sensitivity.{c}.{a}"], 4) for a in coefficients.axes} for c in channels},
    }
    if coefficients.thermal is not None:
        orders = {"offset": coefficients.thermal.drift.shape[1], "sensitivity": coefficients.thermal.gain.shape[1]}
        shaped["temperature"] = {
            name: {c: [significant(u[f"temperature.{name}.{c}.{k + 1}"], 4) for k in range(order)] for c in channels}
            for name, order in orders.items()
            if order
        }
    return shaped


def _limits(coefficients: Coefficients, measurements: Sequence[Measurement], nominal: Nominal | None) -> Limits:
    """Tilt to either side as far as any position went, the temperatures that were met, the model's rails."""
    tilt = {}
    for axis in coefficients.channels:
        reach = max(abs(measurement.gravity[AXES.index(axis)]) for measurement in measurements)
        if reach > 0.0:
            furthest = radians(round(degrees(asin(min(reach, 1.0))), 6))
            tilt[axis] = (-furthest, furthest)
    return Limits(
        tilt=tilt,
        temperature=coefficients.thermal.range if coefficients.thermal else None,
        reading=dict.fromkeys(coefficients.channels, nominal.rails) if nominal else {},
    )


def _derived(coefficients: Coefficients) -> dict[str, Any]:
    return {
        "cross_axis_percent": {c: significant(v, 4) for c, v in cross_axis(coefficients).items()},
        "misalignment_degrees": {c: significant(v, 4) for c, v in misalignment(coefficients).items()},
    }


def _fit(
    found: Estimate, measurements: Sequence[Measurement], channels: Sequence[str], jig: float | None
) -> dict[str, Any]:
    scale = max(
        max(measurement.summaries[channel].u for measurement in measurements for channel in channels),
        float(np.max(np.abs(found.residuals))),
    )
    residuals = {
        measurement.position: {c: round_to(float(r), scale) for c, r in zip(channels, row, strict=True)}
        for measurement, row in zip(measurements, found.residuals, strict=True)
    }
    record: dict[str, Any] = {"residuals": residuals}
    if found.dof:
        record["worst"] = _worst(residuals)
    record["degrees_of_freedom"] = found.dof
    if found.chi_square is not None and found.stated:
        record["chi_square"] = significant(found.chi_square, 4)
    record["uncertainty_from"] = _source_of_uncertainty(found, jig)
    if jig is not None:
        record["jig_degrees"] = jig
    return record


def _source_of_uncertainty(found: Estimate, jig: float | None) -> str:
    if not found.stated:
        return "residuals"
    return "noise alone: no jig is stated, and no position is left over" if jig is None else "stated noise and jig"


def _worst(residuals: Mapping[str, Mapping[str, float]]) -> dict[str, Any]:
    """The largest residual; the rounded ones are compared, so that a tie falls alike on every processor."""
    position, channel = max(
        ((position, channel) for position, row in residuals.items() for channel in row),
        key=lambda place: abs(residuals[place[0]][place[1]]),
    )
    return {"position": position, "channel": channel, "residual": residuals[position][channel]}


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

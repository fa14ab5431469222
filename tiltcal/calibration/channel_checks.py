"""Channels that are not what they are called: two copies of one, two that are swapped, one whose sign is turned.

A calibration of swapped or turned channels corrects them, so that it is remarked and not refused: it goes with the
wiring as it is. Two copies of one channel determine nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations
from math import acos, degrees

import numpy as np

from tiltcal.calibration.measurement import MeasuredSensor, at_rail, rails_of
from tiltcal.core.estimation.estimate import Estimate
from tiltcal.core.model import Coefficients
from tiltcal.core.rounding import significant
from tiltcal.drivers.columns import OF_G
from tiltcal.errors import EstimateError

LEAST_ANGLE = 15.0
"""Channels whose directions are closer together are one channel twice, degrees."""

REACTION = 3.0
"""Expanded uncertainties that a sensitivity must be apart from zero: noise alone is beyond one of them in 5 of 100."""

ROUNDING = 1e-9
"""The share of a reading below which a sensitivity is a rounding error."""

CLEARLY = 2.0
"""A channel whose sensitivity to another axis is so many times that to its own is that axis's channel."""


def require_own_readings(sensor: MeasuredSensor) -> None:
    """Refuse readings at a rail, and two channels that read alike, noise and all, with an EstimateError."""
    known = rails_of(sensor.sensor.channels, sensor.nominal, sensor.base) if sensor.ramp is None else {}
    for channel, (low, high) in known.items():
        for measurement in sensor.measurements:
            if not low < measurement.summaries[channel].mean < high:
                reads = f"{measurement.summaries[channel].mean:.6g} {sensor.sensor.unit} in {measurement.position}"
                raise EstimateError(at_rail(channel, reads, (low, high)))
    for first, second in combinations(sensor.sensor.channels, 2):
        pairs = [(measurement.summaries[first], measurement.summaries[second]) for measurement in sensor.measurements]
        if any(a.std for a, _ in pairs) and all(a.mean == b.mean and a.std == b.std for a, b in pairs):
            raise EstimateError(f"{first} and {second} read the same in every position: {_COPIES}")


def judge_channels(sensor: MeasuredSensor, found: Estimate) -> tuple[str, ...]:
    """Return remarks on the wiring that the sensitivities show.

    EstimateError: a channel does not react to gravity, or two react to it alike.
    """
    _require_reaction(sensor, found)
    _require_apart(found.coefficients)
    return remarks_on_wiring(found.coefficients, sensor.sensor.unit)


def remarks_on_wiring(coefficients: Coefficients, unit: str) -> tuple[str, ...]:
    """Return remarks on channels that are exchanged or turned, and on readings of another unit."""
    return (*_remarks(coefficients), *_remarks_on_unit(coefficients, unit))


_COPIES = "two copies of one channel? Look at the wiring, and at --columns"


def _require_reaction(sensor: MeasuredSensor, found: Estimate) -> None:
    """Refuse a channel whose sensitivity to every axis is zero within its uncertainty.

    No reading is exact: a sensitivity below a billionth of the readings is a rounding error.
    """
    u, factors, coefficients = found.uncertainty(), found.coverage_factors(), found.coefficients
    for channel, row in zip(coefficients.channels, coefficients.sensitivity, strict=True):
        sensitivity, axis = max((abs(float(value)), axis) for axis, value in zip(coefficients.axes, row, strict=True))
        name = f"sensitivity.{channel}.{axis}"
        largest = max(abs(measurement.summaries[channel].mean) for measurement in sensor.measurements)
        expanded = factors.get(name, 2.0) * u[name]
        if sensitivity <= max(REACTION * expanded, ROUNDING * largest):
            raise EstimateError(
                f"{channel} of {sensor.sensor.serial} does not react to gravity: its sensitivity is "
                f"{significant(sensitivity, 3):g} ± {significant(expanded, 2):g} "
                f"{sensor.sensor.unit}/g; see that the channel is wired, and that its sensor converts"
            )


def _require_apart(coefficients: Coefficients) -> None:
    rows = dict(zip(coefficients.channels, coefficients.sensitivity, strict=True))
    for (first, a), (second, b) in combinations(rows.items(), 2):
        size = float(np.linalg.norm(a) * np.linalg.norm(b))
        if size == 0.0:
            continue
        angle = degrees(acos(min(abs(float(a @ b)) / size, 1.0)))
        if angle < LEAST_ANGLE:
            raise EstimateError(f"{first} and {second} answer to gravity alike, {angle:.1f}° apart: {_COPIES}")


def _remarks(coefficients: Coefficients) -> Iterator[str]:
    axes = coefficients.axes
    takes = {
        channel: _axis_of(row, axes, channel)
        for channel, row in zip(coefficients.channels, coefficients.sensitivity, strict=True)
        if channel in axes
    }
    for first, second in combinations(takes, 2):
        if takes[first] == second and takes[second] == first:
            yield f"{first} and {second} are swapped: each answers to the other's axis; look at the wiring or --columns"
    for channel, axis in takes.items():
        if axis != channel and takes.get(axis) != channel:
            yield f"channel {channel} answers to axis {axis} more than to its own: look at the wiring or --columns"
        if axis == channel and coefficients.own_sensitivity(channel) < 0.0:
            yield f"the sign of {channel} is turned: it reads less where +{channel} points up; look at how it sits"


def _remarks_on_unit(coefficients: Coefficients, unit: str) -> Iterator[str]:
    if unit not in OF_G:
        return
    for channel, row in zip(coefficients.channels, coefficients.sensitivity, strict=True):
        size = float(np.linalg.norm(row))
        if not OF_G[unit] / CLEARLY < size < OF_G[unit] * CLEARLY:
            known = f"{OF_G[unit]:.3g} {unit}"
            yield f"{channel} reads {size:.3g} {unit} for 1 g, which is {known}: are the readings in {unit}?"


def _axis_of(row: Sequence[float], axes: Sequence[str], own: str) -> str:
    """Return the axis that a channel measures: its own, unless its sensitivity to another is clearly larger."""
    strength = dict(zip(axes, np.abs(row).tolist(), strict=True))
    strongest = max(strength, key=lambda axis: strength[axis])
    return strongest if strength[strongest] > CLEARLY * strength[own] else own

"""What a calibration file records of an estimate, with the digits that its uncertainty warrants."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tiltcal.core.derived import cross_axis, derived_uncertainty, misalignment
from tiltcal.core.estimation.design import Design
from tiltcal.core.estimation.estimate import Estimate
from tiltcal.core.intrinsic import IntrinsicQuantity, intrinsic
from tiltcal.core.model import AXES, Array, Coefficients, Thermal
from tiltcal.core.rounding import round_to, significant

DIGITS = 4
"""Of an uncertainty."""

MATRIX_DIGITS = 100.0
"""The covariance is rounded to this part of what four digits of its two uncertainties would be."""

SHARE_DIGITS = 3


def rounded(found: Estimate) -> Coefficients:
    """The coefficients with the digits that their uncertainties warrant."""
    coefficients, u = found.coefficients, found.uncertainty()
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
        nonlinearity=None
        if coefficients.nonlinearity is None
        else _rounded_rows(coefficients.nonlinearity, coefficients.channels, "nonlinearity", u, first=2),
    )


def uncertainty_record(found: Estimate, reading: Mapping[str, float]) -> dict[str, Any]:
    """The ``uncertainty`` section: standard uncertainties in the shape of ``calibration``, and how they hang together.

    Parameters
    ----------
    found : Estimate
    reading : mapping of str to float
        Standard uncertainty of a single reading by channel, unit, and of its temperature, °C; where they are known.
    """
    coefficients, u = found.coefficients, found.uncertainty()
    channels = coefficients.channels
    shaped: dict[str, Any] = {
        "offset": {c: significant(u[f"offset.{c}"], DIGITS) for c in channels},
        "sensitivity": {
            c: {a: significant(u[f"sensitivity.{c}.{a}"], DIGITS) for a in coefficients.axes} for c in channels
        },
    }
    if coefficients.nonlinearity is not None:
        powers = range(2, 2 + coefficients.nonlinearity.shape[1])
        shaped["nonlinearity"] = {
            c: [significant(u[f"nonlinearity.{c}.{k}"], DIGITS) for k in powers] for c in channels
        }
    if coefficients.thermal is not None:
        orders = {"offset": coefficients.thermal.drift.shape[1], "sensitivity": coefficients.thermal.gain.shape[1]}
        shaped["temperature"] = {
            name: {
                c: [significant(u[f"temperature.{name}.{c}.{k + 1}"], DIGITS) for k in range(order)] for c in channels
            }
            for name, order in orders.items()
            if order
        }
    if reading:
        shaped["single_reading"] = {name: significant(value, DIGITS) for name, value in reading.items()}
    shaped["coverage_factor"] = {n: round(factor, 3) for n, factor in found.coverage_factors().items() if u[n] > 0.0}
    shaped["covariance"] = covariance_record(found.names, found.covariance)
    return shaped


def covariance_record(names: Sequence[str], covariance: Array) -> dict[str, Any]:
    """Of the coefficients that are uncertain at all, without the dust that stands for zero."""
    u = np.sqrt(np.diag(covariance))
    some = np.flatnonzero(u > 0.0).tolist()
    return {
        "parameters": [names[i] for i in some],
        "matrix": [[round_to(float(covariance[i, j]), float(u[i] * u[j]) / MATRIX_DIGITS) for j in some] for i in some],
    }


def derived_record(found: Estimate, design: Design, assumed: str) -> dict[str, Any]:
    """The ``derived`` section: cross-axis sensitivities, misalignments, and what does not change with the mounting.

    Where the sensitivity was ``assumed`` (from what, in words), it has nothing but that.
    """
    if design.priors:
        return {"assumed": [f"sensitivity: {assumed}"]}
    coefficients, names, covariance = found.coefficients, found.names, found.covariance
    record: dict[str, Any] = {}
    doubts: dict[str, Any] = {}
    quantities: Mapping[str, Callable[[Coefficients], dict[str, float]]] = {
        "cross_axis_percent": cross_axis,
        "misalignment_degrees": misalignment,
    }
    for name, quantity in quantities.items():
        u = derived_uncertainty(quantity, coefficients, names, covariance)
        record[name] = {c: round_to(value, u[c]) for c, value in quantity(coefficients).items()}
        doubts[name] = {c: significant(value, DIGITS) for c, value in u.items()}
    record["uncertainty"] = doubts
    if len(coefficients.channels) == 3 and set(coefficients.axes) == set(AXES):
        record["intrinsic"] = _intrinsic_record(found, design)
    return record


def fit_record(found: Estimate, design: Design, noise: float) -> dict[str, Any]:
    """The ``fit`` section: how well the positions agree, and where the uncertainty comes from.

    Parameters
    ----------
    found : Estimate
    design : Design
    noise : float
        The largest standard uncertainty of a reading, unit.
    """
    channels = design.channels
    scale = max(noise, float(np.max(np.abs(found.residuals))))
    residuals = {
        position: {c: round_to(float(r), scale) for c, r in zip(channels, row, strict=True)}
        for position, row in zip(found.positions, found.residuals, strict=True)
    }
    record: dict[str, Any] = {"residuals": residuals}
    if found.dof:
        record["worst"] = _worst(residuals)
    record["degrees_of_freedom"] = found.dof
    if found.chi_square is not None and found.p is not None and found.stated:
        record["chi_square"] = significant(found.chi_square, 4)
        record["p_value"] = significant(found.p, SHARE_DIGITS)
        suspects = found.suspects()
        if suspects:
            record["suspect_positions"] = {
                one.position: {
                    "off_degrees": significant(float(np.linalg.norm(one.turn)), SHARE_DIGITS),
                    "chi_square": significant(one.chi_square, SHARE_DIGITS),
                }
                for one in suspects
            }
    record["uncertainty_from"] = _source_of_uncertainty(found, design)
    if design.jig is not None and not design.free:
        record["jig_degrees"] = design.jig
    if found.scatter_jig is not None:
        record["jig_estimated_degrees"] = significant(found.scatter_jig, SHARE_DIGITS)
    if design.thermometer:
        record["thermometer_celsius"] = design.thermometer
    record["budget"] = _budget(found)
    if found.notes:
        record["notes"] = list(found.notes)
    return record


def _rounded_rows(table: Array, channels: Sequence[str], name: str, u: Mapping[str, float], first: int = 1) -> Array:
    rows = [
        [round_to(value, u[f"{name}.{channel}.{power}"]) for power, value in enumerate(row, start=first)]
        for channel, row in zip(channels, table, strict=True)
    ]
    return np.array(rows).reshape(table.shape)


def _intrinsic_record(found: Estimate, design: Design) -> dict[str, Any]:
    """The nine intrinsic parameters and, where positions were set, the rotation that is left."""
    own = intrinsic(found.coefficients, found.names, found.covariance, mounted=not design.free)
    record: dict[str, Any] = {}
    doubts: dict[str, Any] = {}
    parts = {"offset": own.offset, "sensitivity": own.sensitivity, "angle_degrees": own.angle}
    if own.mounting:
        parts["rotation_degrees"] = own.mounting
    for name, quantities in parts.items():
        record[name], doubts[name] = _told(quantities)
    record["uncertainty"] = doubts
    if own.gimbal_lock:
        record["gimbal_lock"] = True
    if own.left_handed:
        record["left_handed"] = own.left_handed
    return record


def _told(quantities: Mapping[str, IntrinsicQuantity]) -> tuple[dict[str, float], dict[str, float]]:
    """Values and uncertainties, rounded."""
    return (
        {name: round_to(one.value, one.u) for name, one in quantities.items()},
        {name: significant(one.u, DIGITS) for name, one in quantities.items()},
    )


def _budget(found: Estimate) -> dict[str, dict[str, float]]:
    """Which share of each variance comes from what, without the shares that round to nothing."""
    shares = found.budget.shares
    return {
        name: {
            source: share for source, column in shares.items() if (share := round(float(column[k]), SHARE_DIGITS) + 0.0)
        }
        for k, name in enumerate(found.names)
        if found.budget.u[k] > 0.0
    }


def _source_of_uncertainty(found: Estimate, design: Design) -> str:
    if not found.stated:
        return "residuals"
    if design.free:
        return "noise alone: no position is left over"
    if design.jig is None:
        return "noise alone: no jig is stated, and no position is left over"
    return "stated noise and jig"


def _worst(residuals: Mapping[str, Mapping[str, float]]) -> dict[str, Any]:
    """The largest residual; the rounded ones are compared, so that a tie falls alike on every processor."""
    position, channel = max(
        ((position, channel) for position, row in residuals.items() for channel in row),
        key=lambda place: abs(residuals[place[0]][place[1]]),
    )
    return {"position": position, "channel": channel, "residual": residuals[position][channel]}

"""The ``uncertainty`` section of a calibration file: what is read, and what the angles are uncertain by.

Standard uncertainties (k = 1) in the shape of the ``calibration`` section, for people; how they hang together
(``covariance``) and what each is multiplied with for an interval of 95 % (``coverage_factor``), by the coefficients'
dotted names; and what a single ``reading`` of a log is uncertain by.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf, radians
from typing import Any

import numpy as np

from tiltcal.core.angle_uncertainty import TURN, UncertaintyInputs
from tiltcal.core.budget import coverage_factor
from tiltcal.core.comparison import KnownCoefficient, known, values
from tiltcal.core.model import AXES, Array, Coefficients, Mounting
from tiltcal.core.mounting import mounting_matrix
from tiltcal.errors import EstimateError
from tiltcal.files.coefficients import ANGLES, read_polynomials
from tiltcal.files.node import Node

SHAPED = ("offset", "sensitivity", "nonlinearity", "temperature", "mounting")
"""What has the shape of the ``calibration`` section."""

TEMPERATURE = "temperature"

_SYMMETRY = 1e-9
_ROUNDED = 0.01  # an eigenvalue of the correlations that is below zero by more is no matter of digits


@dataclass(frozen=True)
class StatedUncertainty:
    """What a calibration file says of its uncertainty, for the kernel.

    Attributes
    ----------
    doubt : UncertaintyInputs
    remarks : tuple of str
        What had to be taken for granted.
    """

    doubt: UncertaintyInputs
    remarks: tuple[str, ...]


def read_uncertainty(node: Node, coefficients: Coefficients) -> dict[str, Any]:
    """The section as plain data, checked; any part of it may be absent."""
    channels, axes = coefficients.channels, coefficients.axes
    section = node.mapping(optional=(*SHAPED, "single_reading", "coverage_factor", "covariance"))
    uncertainty: dict[str, Any] = {}
    for name, value in section.items():
        match name:
            case "offset":
                uncertainty[name] = _not_negative(value, channels)
            case "sensitivity":
                rows = value.mapping(optional=channels)
                uncertainty[name] = {channel: _not_negative(row, axes) for channel, row in rows.items()}
            case "nonlinearity":
                uncertainty[name] = read_polynomials(value, channels, minimum=0.0)
            case "temperature":
                uncertainty[name] = _read_thermal(value, channels)
            case "mounting":
                uncertainty[name] = _not_negative(value, ANGLES)
            case "single_reading":
                uncertainty[name] = _not_negative(value, (*channels, TEMPERATURE))
            case "coverage_factor":
                uncertainty[name] = {key: factor.number(above=0.0) for key, factor in value.entries().items()}
            case _:
                uncertainty[name] = _read_covariance(value)
    return uncertainty


def stated_uncertainty(
    uncertainty: Mapping[str, Any], coefficients: Coefficients, *, reading_noise: float | None = None
) -> StatedUncertainty:
    """What the angles of a calibration are uncertain by.

    Parameters
    ----------
    uncertainty : mapping
        As :func:`read_uncertainty` gives it.
    coefficients : Coefficients
    reading_noise : float, optional
        Standard uncertainty of a reading, unit, in place of the one that the file states.

    Returns
    -------
    StatedUncertainty
        Without a covariance the coefficients count as uncorrelated; what is not stated counts as exact. The remarks
        tell both.

    Raises
    ------
    EstimateError
        No uncertainty of any coefficient is stated, or the covariance is none.
    """
    alone = dict(named_uncertainties(uncertainty))
    names, covariance = _joint(uncertainty, alone)
    if not names:
        raise EstimateError(
            "the file states no uncertainty of any coefficient: calibrate with `tiltcal measure` or `tiltcal fit`, "
            "which write it, or write standard uncertainties (k = 1) under `uncertainty`, in the shape of `calibration`"
        )
    remarks = []
    if "covariance" not in uncertainty:
        remarks.append("the file has no covariance: the coefficients count as uncorrelated")
    silent = [name for name in values(coefficients) if name not in alone and name not in names]
    if silent:
        remarks.append(f"no uncertainty is stated of {', '.join(silent)}: exact, so far as anyone says")
    turned = any(name.startswith(TURN) for name in names)
    if coefficients.mounting is not None and not turned:
        angles = {angle: alone[f"mounting.{angle}"] for angle in ANGLES if f"mounting.{angle}" in alone}
        if angles:
            names, covariance = _with_turn(names, covariance, coefficients.mounting, angles)
        else:
            remarks.append("no uncertainty is stated of the mounting: exact, so far as anyone says")
    reading = dict(uncertainty.get("single_reading", {}))
    if reading_noise is not None:
        reading |= dict.fromkeys(coefficients.channels, reading_noise)
    elif not any(channel in reading for channel in coefficients.channels):
        remarks.append(
            "the file does not say how uncertain a reading is: only the calibration counts (--reading-noise)"
        )
    _require_covariance(covariance)
    told, usual = uncertainty.get("coverage_factor", {}), float(coverage_factor(np.array([inf]))[0])
    scale = np.array([radians(1.0) if name.startswith(TURN) else 1.0 for name in names])
    return StatedUncertainty(
        UncertaintyInputs(
            names,
            covariance * np.outer(scale, scale),
            np.array([told.get(name, usual) for name in names]),
            np.array([reading.get(channel, 0.0) for channel in coefficients.channels]),
            reading.get(TEMPERATURE, 0.0),
        ),
        tuple(remarks),
    )


def known_coefficients(
    uncertainty: Mapping[str, Any], coefficients: Coefficients, reference: float | None
) -> dict[str, KnownCoefficient]:
    """How well the coefficients are known at a reference temperature, °C, or at their own; empty where nobody says."""
    exact = {name: KnownCoefficient(0.0) for name, u in named_uncertainties(uncertainty) if u == 0.0}
    try:
        doubt = stated_uncertainty(uncertainty, coefficients).doubt
    except EstimateError:
        return exact
    own = np.array([not name.startswith(TURN) for name in doubt.names])
    names = [name for name, kept in zip(doubt.names, own, strict=True) if kept]
    return exact | known(coefficients, names, doubt.covariance[np.ix_(own, own)], doubt.factors[own], reference)


def named_uncertainties(section: Mapping[str, Any], lead: str = "") -> Iterator[tuple[str, float]]:
    """Standard uncertainties by dotted name; a list counts from the power of its first number."""
    for key, value in section.items():
        if lead == "" and key not in SHAPED:
            continue
        name = f"{lead}{key}"
        if isinstance(value, Mapping):
            yield from named_uncertainties(value, f"{name}.")
        elif isinstance(value, list):
            first = 2 if lead.startswith("nonlinearity") else 1
            yield from ((f"{name}.{power}", float(u)) for power, u in enumerate(value, start=first))
        else:
            yield name, float(value)


def _joint(uncertainty: Mapping[str, Any], alone: Mapping[str, float]) -> tuple[tuple[str, ...], Array]:
    """The uncertain coefficients and their covariance; without a stated one they are uncorrelated."""
    if "covariance" in uncertainty:
        stated = uncertainty["covariance"]
        return tuple(stated["parameters"]), np.array(stated["matrix"], dtype=float)
    own = {
        name: u
        for name, u in alone.items()
        if u > 0.0 and not name.startswith("mounting.") and name != "temperature.reference"
    }
    return tuple(own), np.diag(np.array(list(own.values())) ** 2)


def _with_turn(
    names: tuple[str, ...], covariance: Array, mounting: Mounting, u: Mapping[str, float]
) -> tuple[tuple[str, ...], Array]:
    """The same, and the mounting's turn about the application's axes, from uncorrelated angles; all in degrees."""
    axes = np.column_stack(
        [
            mounting_matrix(Mounting(0.0, mounting.pitch, mounting.yaw))[:, 0],
            mounting_matrix(Mounting(0.0, 0.0, mounting.yaw))[:, 1],
            [0.0, 0.0, 1.0],
        ]
    )
    turn = axes @ np.diag([u.get(angle, 0.0) ** 2 for angle in ANGLES]) @ axes.T
    joint = np.zeros((len(names) + 3, len(names) + 3))
    joint[:-3, :-3], joint[-3:, -3:] = covariance, turn
    return (*names, *(f"{TURN}{axis}" for axis in AXES)), joint


def _require_covariance(covariance: Array) -> None:
    u = np.sqrt(np.diag(covariance))
    scale = np.where(u > 0.0, u, 1.0)
    if np.linalg.eigvalsh(covariance / np.outer(scale, scale))[0] < -_ROUNDED:
        raise EstimateError(
            "uncertainty.covariance is no covariance: its correlations contradict one another; take it from the file "
            "that the calibration wrote"
        )


def _not_negative(node: Node, names: Sequence[str]) -> dict[str, float]:
    return {name: value.number(minimum=0.0) for name, value in node.mapping(optional=names).items()}


def _read_thermal(node: Node, channels: Sequence[str]) -> dict[str, Any]:
    section = node.mapping(optional=("reference", "offset", "sensitivity"))
    return {
        name: value.number(minimum=0.0) if name == "reference" else read_polynomials(value, channels, minimum=0.0)
        for name, value in section.items()
    }


def _read_covariance(node: Node) -> dict[str, Any]:
    section = node.mapping(required=("parameters", "matrix"))
    parameters = [item.text() for item in section["parameters"].items()]
    if len(set(parameters)) < len(parameters):
        raise section["parameters"].error("a parameter is named twice")
    rows = section["matrix"].items()
    matrix = [row.numbers() for row in rows]
    size = len(parameters)
    if len(matrix) != size or any(len(row) != size for row in matrix):
        raise section["matrix"].error(f"{size} parameters need a matrix of {size} rows of {size} numbers")
    for i, node_of_row in enumerate(rows):
        if matrix[i][i] < 0.0:
            raise node_of_row.error(f"the variance {matrix[i][i]:g} of {parameters[i]} is negative")
        for j in range(i):
            scale = max(abs(matrix[i][j]), abs(matrix[j][i]))
            if abs(matrix[i][j] - matrix[j][i]) > _SYMMETRY * scale:
                raise node_of_row.error(f"the matrix is not symmetric in {parameters[i]} and {parameters[j]}")
    return {"parameters": parameters, "matrix": matrix}

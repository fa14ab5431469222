"""The ``uncertainty`` section of a calibration file: its reader, its writer, and the quantities that it states.

Standard uncertainties (k = 1) in the shape of the ``calibration`` section, for people; their covariance
(``covariance``) and what each is multiplied with for an interval of 95 % (``coverage_factor``), by the coefficients'
dotted names; and what a ``single_reading`` of a log is uncertain by.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations_with_replacement
from math import isclose, sqrt
from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from tiltcal.core.model import AXES, Array, Coefficients
from tiltcal.core.named_coefficients import values
from tiltcal.core.uncertain import TURN, widened
from tiltcal.files.coefficients import ANGLES, ORDER_LIMIT
from tiltcal.files.document import Document
from tiltcal.files.record import AboveZero, ByAxis, Finite, Record, Size, Text, about, one_of, plain

SHAPED = ("offset", "sensitivity", "nonlinearity", "temperature", "mounting")
"""What has the shape of the ``calibration`` section."""

TEMPERATURE = "temperature"

MOUNTING = "mounting."
TURNS = tuple(f"{TURN}{axis}" for axis in AXES)
_SYMMETRY = 1e-9
_POLYNOMIALS = ByAxis[Annotated[tuple[Size, ...], Meta(max_length=ORDER_LIMIT)]]
_ROUNDED = 0.01  # an eigenvalue of the correlations below zero, or a difference, that is larger is no matter of digits


class Covariance(Record, kw_only=True):
    """The covariance of the uncertain coefficients."""

    parameters: Annotated[
        tuple[Text, ...],
        about("coefficients by dotted name; `mounting.turn.x` is a turn about the application's x axis, degrees"),
    ]
    matrix: Annotated[tuple[tuple[Finite, ...], ...], about("their covariance matrix")]
    wide: Annotated[
        tuple[tuple[Finite, ...], ...],
        about(
            "the covariance of errors of known size that have the same 95 % intervals, which few degrees of freedom "
            "widen: half an interval of what follows from the coefficients is 1.96 times the root of its variance by "
            "this matrix; where it is left out, by `matrix` and the coverage factors"
        ),
    ] = ()

    def as_array(self) -> Array:
        """Return the matrix as an array, shape (k, k)."""
        return np.array(self.matrix, dtype=float).reshape(2 * (len(self.parameters),))

    def wide_array(self, factors: Array) -> Array:
        """Return the covariance of errors of known size with the same 95 % intervals, shape (k, k)."""
        if not self.wide:
            return widened(self.as_array(), factors)
        return np.array(self.wide, dtype=float)

    def without_turn(self) -> Covariance:
        """Return the covariance of all but the turn of the mounting."""
        kept = [k for k, name in enumerate(self.parameters) if not name.startswith(TURN)]
        matrix, wide = (
            tuple(tuple(rows[i][j] for j in kept) for i in kept) if rows else () for rows in (self.matrix, self.wide)
        )
        return Covariance(parameters=tuple(self.parameters[k] for k in kept), matrix=matrix, wide=wide)


@dataclass(frozen=True)
class Uncertainty(Mapping[str, float]):
    """The uncertainty of a calibration: standard uncertainties (k = 1) by the dotted names of the coefficients.

    ``uncertainty["sensitivity.x.y"]`` is that of channel x along y, in unit/g; angles of the mounting are in degrees,
    temperature coefficients per °C, °C², ... What the file does not state is no key.

    The other sections are those of :class:`UncertaintySection`.
    """

    standard: Mapping[str, float] = field(default_factory=dict)
    single_reading: Mapping[str, float] = field(default_factory=dict)
    coverage_factor: Mapping[str, float] = field(default_factory=dict)
    covariance: Covariance | None = None
    alignment: float = 0.0

    def __getitem__(self, name: str) -> float:
        return self.standard[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.standard)

    def __len__(self) -> int:
        return len(self.standard)

    def without_mounting(self) -> Uncertainty:
        """Return the uncertainty of all but the mounting."""
        standard, factors = (
            {name: value for name, value in named.items() if not name.startswith(MOUNTING)}
            for named in (self.standard, self.coverage_factor)
        )
        covariance = None if self.covariance is None else self.covariance.without_turn()
        return replace(self, standard=standard, coverage_factor=factors, covariance=covariance)


class ThermalUncertainty(Record, kw_only=True):
    """Standard uncertainties in the shape of ``calibration.temperature``."""

    reference: Annotated[Size | None, about("of the reference temperature, °C")] = None
    offset: Annotated[_POLYNOMIALS, about("per channel, unit/°C, unit/°C², …")] = {}
    sensitivity: Annotated[_POLYNOMIALS, about("per channel, 1/°C, 1/°C², …")] = {}
    lag: Annotated[Size | None, about("of the lag, s")] = None


def _check_covariance(covariance: Covariance, place: Document, known: Sequence[str]) -> None:
    """Refuse a covariance of other coefficients, or a matrix that is none."""
    names, size = covariance.parameters, len(covariance.parameters)
    if len(set(names)) < size:
        raise place.error("a parameter is named twice", "parameters")
    for number, name in enumerate(names):
        place.require_known(name, known, "parameters", number)
    for key, matrix in (("matrix", covariance.matrix), *((("wide", covariance.wide),) if covariance.wide else ())):
        if len(matrix) != size or any(len(row) != size for row in matrix):
            raise place.error(f"{size} parameters need a matrix of {size} rows of {size} numbers", key)
        for i, j in combinations_with_replacement(range(size), 2):
            if i == j and matrix[i][i] < 0.0:
                raise place.error(f"the variance {matrix[i][i]:g} of {names[i]} is negative", key, i)
            if abs(matrix[i][j] - matrix[j][i]) > _SYMMETRY * max(abs(matrix[i][j]), abs(matrix[j][i])):
                raise place.error(f"the matrix is not symmetric in {names[j]} and {names[i]}", key, j)
        stated = np.array(matrix, dtype=float).reshape(size, size)
        deviations = np.sqrt(np.diag(stated))
        scales = np.where(deviations > 0.0, deviations, 1.0)
        if np.linalg.eigvalsh(stated / np.outer(scales, scales)).min(initial=0.0) < -_ROUNDED:
            raise place.error(
                "this is no covariance: its correlations contradict one another; take it from the file that the "
                "calibration wrote",
                key,
            )


class UncertaintySection(Record, kw_only=True):
    """The section as it stands in a file."""

    offset: Annotated[ByAxis[Size], about("per channel, unit")] = {}
    sensitivity: Annotated[ByAxis[ByAxis[Size]], about("row = channel, column = axis, unit/g")] = {}
    nonlinearity: Annotated[_POLYNOMIALS, about("per channel, pure numbers")] = {}
    temperature: Annotated[ThermalUncertainty | None, about("in the shape of `calibration.temperature`")] = None
    mounting: Annotated[Mapping[Annotated[str, one_of(*ANGLES)], Size], about("`roll`, `pitch`, `yaw`, degrees")] = {}
    single_reading: Annotated[
        Mapping[Annotated[str, one_of(*AXES, TEMPERATURE)], Size],
        about("of a reading of a log, per channel, unit, and of its `temperature`, °C", formerly="reading"),
    ] = {}
    alignment: Annotated[
        Size, about("after `level`: of how the sensor sits since its sensitivity was measured, degrees about each axis")
    ] = 0.0
    coverage_factor: Annotated[
        Mapping[str, AboveZero],
        about("per coefficient, such as `sensitivity.x.y`, for an interval of 95 %; 1.96 where it is not named"),
    ] = {}
    covariance: Annotated[Covariance | None, about("the covariance of the coefficients")] = None


def uncertainty_of(section: UncertaintySection, place: Document, coefficients: Coefficients) -> Uncertainty:
    """Return a section with its standard uncertainties by dotted name; an InputError where it contradicts the rest."""
    channels, known = coefficients.channels, [*values(coefficients), *TURNS]
    thermal = section.temperature or ThermalUncertainty()
    for key, curves in {"offset": thermal.offset, "sensitivity": thermal.sensitivity}.items():
        place.require_keys(curves, channels, TEMPERATURE, key)
    for key in ("offset", "sensitivity", "nonlinearity"):
        place.require_keys(getattr(section, key), channels, key)
    for channel, row in section.sensitivity.items():
        place.require_keys(row, coefficients.axes, "sensitivity", channel)
    place.require_keys(section.single_reading, (*channels, TEMPERATURE), "single_reading")
    standard = dict(_named({key: value for key, value in plain(section).items() if key in SHAPED}))
    place.require_keys(section.coverage_factor, [*known, *standard], "coverage_factor")
    covariance = section.covariance
    if covariance is not None:
        _check_covariance(covariance, place.at("covariance"), known)
        for name, variance in zip(covariance.parameters, np.diag(covariance.as_array()).tolist(), strict=True):
            u = sqrt(variance)
            if not isclose(standard.get(name, u), u, rel_tol=_ROUNDED):
                raise place.error(
                    f"the variance of {name} is that of a standard uncertainty of {u:.4g}, and {standard[name]:g} is "
                    "stated: change both, or leave the covariance out",
                    "covariance",
                )
    return Uncertainty(standard, section.single_reading, section.coverage_factor, covariance, section.alignment)


def uncertainty_section(uncertainty: Uncertainty) -> UncertaintySection:
    """Return the uncertainty in the shape of ``calibration``."""
    shaped: dict[str, Any] = {key: {} for key in SHAPED}
    for name, u in uncertainty.items():
        *path, last = name.split(".")
        section = shaped
        for key in path[:-1]:
            section = section.setdefault(key, {})
        if last.isdigit():
            section[path[-1]] = (*section.get(path[-1], ()), u)
        else:
            section.setdefault(path[-1], {})[last] = u
    temperature = shaped.pop(TEMPERATURE)
    return UncertaintySection(
        **shaped,
        temperature=ThermalUncertainty(**temperature) if temperature else None,
        single_reading=uncertainty.single_reading,
        coverage_factor=uncertainty.coverage_factor,
        covariance=uncertainty.covariance,
        alignment=uncertainty.alignment,
    )


def _named(section: Mapping[str, Any], lead: str = "") -> Iterator[tuple[str, float]]:
    """Yield standard uncertainties by dotted name; a list counts from the power of its first number."""
    for key, value in section.items():
        name = f"{lead}{key}"
        if isinstance(value, Mapping):
            yield from _named(value, f"{name}.")
        elif isinstance(value, list):
            first = 2 if lead.startswith("nonlinearity") else 1
            yield from ((f"{name}.{power}", u) for power, u in enumerate(value, start=first))
        else:
            yield name, value

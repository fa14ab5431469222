"""The ``uncertainty`` section of a calibration file: its reader, its writer, and the quantities that it states.

Standard uncertainties (k = 1) in the shape of the ``calibration`` section, for people; their covariance
(``covariance``) and what each is multiplied with for an interval of 95 % (``coverage_factor``), by the coefficients'
dotted names; and what a ``single_reading`` of a log is uncertain by.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isclose
from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from tiltcal.core.model import AXES, Array, Coefficients, values
from tiltcal.core.uncertain import TURN
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

    parameters: Annotated[tuple[Text, ...], about("dotted names; `mounting.turn.x`: about the application's x")]
    matrix: Annotated[tuple[tuple[Finite, ...], ...], about("their covariance matrix")]
    wide: Annotated[
        tuple[tuple[Finite, ...], ...],
        about("that of errors of known size with the same 95 % intervals, which few degrees of freedom widen"),
    ] = ()

    def as_array(self) -> Array:
        """Return the matrix as an array, shape (k, k)."""
        return np.array(self.matrix, dtype=float).reshape(2 * (len(self.parameters),))

    def without_turn(self) -> Covariance:
        """Return the covariance of all but the turn of the mounting."""
        kept = [k for k, name in enumerate(self.parameters) if not name.startswith(TURN)]
        matrices = [self.matrix, self.wide] if self.wide else [self.matrix]
        matrix, *wide = [tuple(tuple(rows[i][j] for j in kept) for i in kept) for rows in matrices]
        return Covariance(
            parameters=tuple(self.parameters[k] for k in kept), matrix=matrix, wide=wide[0] if wide else ()
        )


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
        covariance = self.covariance and self.covariance.without_turn()
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
    for key, rows in (("matrix", covariance.matrix), *([("wide", covariance.wide)] if covariance.wide else [])):
        if [len(row) for row in rows] != [size] * size:
            raise place.error(f"{size} parameters need a matrix of {size} rows of {size} numbers", key)
        matrix = np.array(rows, dtype=float).reshape(size, size)
        for k in np.flatnonzero(np.diag(matrix) < 0.0):
            raise place.error(f"the variance {matrix[k, k]:g} of {names[k]} is negative", key, int(k))
        sizes = np.maximum(np.abs(matrix), np.abs(matrix.T))
        for i, j in np.argwhere(np.abs(matrix - matrix.T) > _SYMMETRY * sizes):
            raise place.error(f"the matrix is not symmetric in {names[j]} and {names[i]}", key, int(j))
        deviations = np.sqrt(np.diag(matrix))
        scales = np.where(deviations > 0.0, deviations, 1.0)
        if np.linalg.eigvalsh(matrix / np.outer(scales, scales)).min(initial=0.0) < -_ROUNDED:
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
    alignment: Annotated[Size, about("after `level`: of how the sensor sits since, degrees about each axis")] = 0.0
    coverage_factor: Annotated[Mapping[str, AboveZero], about("for 95 %; 1.96 where none is named")] = {}
    covariance: Annotated[Covariance | None, about("the covariance of the coefficients")] = None


def uncertainty_of(section: UncertaintySection, place: Document, coefficients: Coefficients) -> Uncertainty:
    """Return a section with its standard uncertainties by dotted name; an InputError where it contradicts the rest."""
    channels, known = coefficients.channels, [*values(coefficients), *TURNS]
    for key in ("offset", "sensitivity", "nonlinearity"):
        place.require_keys(getattr(section, key), channels, key)
        if key != "nonlinearity" and section.temperature is not None:
            place.require_keys(getattr(section.temperature, key), channels, TEMPERATURE, key)
    for channel, row in section.sensitivity.items():
        place.require_keys(row, coefficients.axes, "sensitivity", channel)
    place.require_keys(section.single_reading, (*channels, TEMPERATURE), "single_reading")
    standard = dict(_named({key: value for key, value in plain(section).items() if key in SHAPED}))
    place.require_keys(section.coverage_factor, [*known, *standard], "coverage_factor")
    covariance = section.covariance
    if covariance is not None:
        _check_covariance(covariance, place.at("covariance"), known)
        for name, u in zip(covariance.parameters, np.sqrt(np.diag(covariance.as_array())).tolist(), strict=True):
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
    warm = shaped.pop(TEMPERATURE)
    rest = {
        name: getattr(uncertainty, name) for name in ("single_reading", "coverage_factor", "covariance", "alignment")
    }
    return UncertaintySection(**shaped, **rest, temperature=ThermalUncertainty(**warm) if warm else None)


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

"""The coefficients of the measurement model and their uncertainty, as they stand in a calibration file.

Standard uncertainties (k = 1) have the shape of the ``calibration`` section, for people; their covariance
(``covariance``) and what each is multiplied with for an interval of 95 % (``coverage_factor``) go by the coefficients'
dotted names; and a ``single_reading`` of a log is uncertain, too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import degrees, isclose, radians
from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from tiltcal.core.angle_readings import AngleReadings
from tiltcal.core.attitude import mounting_matrix
from tiltcal.core.model import AXES, Array, Coefficients, Mounting, Thermal, polynomial, values
from tiltcal.core.rounding import significant
from tiltcal.core.uncertain import NORMAL_FACTOR, TURN, Uncertain, widened
from tiltcal.files.document import Document
from tiltcal.files.record import AboveZero, ByAxis, Finite, Range, Record, Size, Text, about, one_of, plain

ORDER_LIMIT = 6

LARGEST_ANGLES = {"roll": 180.0, "pitch": 90.0, "yaw": 180.0}  # the largest size of each angle of a mounting, degrees

ANGLES = tuple(LARGEST_ANGLES)

_SINGULAR = 1e-9  # smallest over largest singular value below which a sensitivity matrix has no inverse worth its name
_ANGLE_DIGITS = 12

STEEP = 0.1  # least slope of a bent characteristic relative to the straight one
Bend = ByAxis[Annotated[tuple[Finite, ...], Meta(max_length=2)]]  # shares of the square and the cube for all channels
Polynomials = ByAxis[Annotated[tuple[Finite, ...], Meta(max_length=ORDER_LIMIT)]]  # of dT, dT², ... for some


class ThermalSection(Record):
    """``calibration.temperature`` as it stands in a file."""

    reference: Annotated[Finite, about("reference temperature, °C")]
    range: Annotated[Range | None, about("`[low, high]`, the temperatures that were measured, °C")] = None
    offset: Annotated[Polynomials, about("per channel the coefficients of dT, dT², …, unit/°C, unit/°C², …")] = {}
    sensitivity: Annotated[Polynomials, about("per channel the coefficients of dT, dT², …, 1/°C, 1/°C², …")] = {}
    lag: Annotated[Finite, about("of the sensing element behind the thermometer, s; negative if ahead")] = 0.0

    def of_channels(self, channels: Sequence[str]) -> Thermal:
        """Return the terms of all channels."""
        drift, gain = _padded(self.offset, channels), _padded(self.sensitivity, channels)
        return Thermal(self.reference, self.range, drift, gain, self.lag)


class MountingSection(Record):
    """``calibration.mounting`` as it stands in a file."""

    always_written = ANGLES

    roll: Annotated[float, Meta(ge=-180, le=180), about("degrees, -180 to 180")] = 0.0
    pitch: Annotated[float, Meta(ge=-90, le=90), about("degrees, -90 to 90")] = 0.0
    yaw: Annotated[float, Meta(ge=-180, le=180), about("degrees, -180 to 180")] = 0.0


class CoefficientsSection(Record):
    """The section ``calibration`` as it stands in a file."""

    offset: Annotated[ByAxis[Finite], about("per channel, unit, at the reference temperature")]
    sensitivity: Annotated[
        ByAxis[ByAxis[Finite]],
        about(
            "row = channel, column = axis, unit/g (of angles unit/°); as many columns as channels, or x, y, z for two"
        ),
    ]
    nonlinearity: Annotated[Bend | None, about("n₂ or n₂, n₃: reads S_ii (a + n₂a² + n₃a³), not S_ii a")] = None
    temperature: Annotated[ThermalSection | None, about("absent where it was not measured")] = None
    mounting: Annotated[MountingSection | None, about("how the sensor sits in its application")] = None

    def checked(self, place: Document, channels: tuple[str, ...], angles: AngleReadings | None = None) -> Coefficients:
        """Return the coefficients; an InputError where they contradict the channels or cannot be inverted."""
        thermal, mounting, bent = self.temperature, self.mounting, self.nonlinearity
        place.require_keys(self.offset, channels, "offset", complete=True)
        axes, sensitivity = _matrix(self.sensitivity, place, channels)
        if bent is not None:
            place.require_keys(bent, channels, "nonlinearity", complete=True)
        if thermal is not None:
            for key in ("offset", "sensitivity"):
                if curves := getattr(thermal, key):
                    place.require_keys(curves, channels, "temperature", key, complete=True)
            place.require_order(thermal.range, "temperature", "range")
        return Coefficients(
            channels,
            axes,
            np.array([self.offset[channel] for channel in channels]),
            sensitivity,
            None if thermal is None else thermal.of_channels(channels),
            None if mounting is None else Mounting(*(radians(getattr(mounting, name)) for name in ANGLES)),
            None if bent is None else _nonlinearity(bent, place, channels, axes),
            angles,
        )

    @classmethod
    def of(cls, coefficients: Coefficients) -> CoefficientsSection:
        """Return the section of a file."""
        shaped, thermal, mounting = _shaped(values(coefficients)), coefficients.thermal, coefficients.mounting
        warm = shaped.pop(TEMPERATURE)
        if thermal is not None:
            warm |= {"reference": float(thermal.reference), "lag": float(thermal.lag)}
            warm["range"] = thermal.range and (float(thermal.range[0]), float(thermal.range[1]))
        if mounting is not None:
            shaped["mounting"] = MountingSection(**{name: in_degrees(getattr(mounting, name)) for name in ANGLES})
        shaped = {key: section for key, section in shaped.items() if section}
        return cls(**shaped, temperature=ThermalSection(**warm) if thermal is not None else None)


def in_degrees(angle: float) -> float:
    """Return an angle in radians as degrees, with 12 digits so that 60 does not become 59.99999999999999."""
    return significant(degrees(angle), _ANGLE_DIGITS)


def require_equal_columns(rows: Mapping[str, Mapping[str, float]], place: Document) -> None:
    """Refuse a sensitivity at a place whose rows have other columns than the first one."""
    first = next(iter(rows))
    for channel, row in rows.items():
        if set(row) != set(rows[first]):
            raise place.error(
                f"row {channel} has columns [{', '.join(row)}] and row {first} [{', '.join(rows[first])}]; "
                f"every row has the same columns",
                *("sensitivity", channel),
            )


def _matrix(
    rows: Mapping[str, Mapping[str, float]], place: Document, channels: Sequence[str]
) -> tuple[tuple[str, ...], Array]:
    """Return the columns of a matrix, in the order x, y, z, and the matrix."""
    place.require_keys(rows, channels, "sensitivity", complete=True)
    require_equal_columns(rows, place)
    axes = tuple(axis for axis in AXES if axis in rows[channels[0]])
    # The columns that are inverted: of two channels x and y, where unit gravity gives z; that of a single channel.
    inverted = {1: channels, 2: ("x", "y")}.get(len(channels), axes) if len(axes) > len(channels) else axes
    if len(inverted) != len(channels) or not set(inverted) <= set(axes):
        raise place.error(
            f"{len(axes)} columns [{', '.join(axes)}] do not go with {len(channels)} channels [{', '.join(channels)}]: "
            f"there are as many columns as channels; of two channels x, y and z; of one its own and others",
            "sensitivity",
        )
    matrix = np.array([[rows[channel][axis] for axis in axes] for channel in channels])
    sizes = np.linalg.svd(matrix[:, [axes.index(axis) for axis in inverted]], compute_uv=False)
    if not sizes[-1] >= _SINGULAR * sizes[0] or sizes[0] == 0.0:
        why = "the matrix is singular: its rows do not separate the axes; measure the sensitivity again"
        raise place.error(why, "sensitivity")
    for channel, row in zip(channels, matrix, strict=True):
        if channel in axes and row[axes.index(channel)] == 0.0:
            why = f"{channel} does not sense axis {channel}: call each channel by the axis it senses most"
            raise place.error(why, "sensitivity")
    return axes, matrix


def _padded(curves: Mapping[str, Sequence[float]], channels: Sequence[str]) -> Array:
    """Return the polynomials of all channels as a table, with zeros up to the longest."""
    order = max((len(numbers) for numbers in curves.values()), default=0)
    table = np.zeros((len(channels), order))
    for row, channel in zip(table, channels, strict=True):
        numbers = curves.get(channel, ())
        row[: len(numbers)] = numbers
    return table


def _nonlinearity(
    curves: Mapping[str, Sequence[float]], place: Document, channels: Sequence[str], axes: Sequence[str]
) -> Array:
    """Return the shares of the square and the cube by channel; refuse a reading that has several angles."""
    table = _padded(curves, channels)
    if any(channel not in axes for channel in channels):
        raise place.error("a nonlinearity needs every channel's sensitivity to its own axis", "nonlinearity")
    a = np.linspace(-1.0, 1.0, 201)  # of the own acceleration, g
    for channel, row in zip(channels, table, strict=True):
        if np.min(1.0 + polynomial(row * np.arange(2, 2 + len(row)), a)) < STEEP:
            raise place.error(
                f"the nonlinearity of {channel} is so large that one reading has several angles", "nonlinearity"
            )
    return table


SHAPED = ("offset", "sensitivity", "nonlinearity", "temperature", "mounting")  # what has the shape of `calibration`

TEMPERATURE = "temperature"

MOUNTING = "mounting."
TURNS = tuple(f"{TURN}{axis}" for axis in AXES)
_POLYNOMIALS = ByAxis[Annotated[tuple[Size, ...], Meta(max_length=ORDER_LIMIT)]]
_ROUNDED = 0.01  # an eigenvalue of the correlations below zero, or a difference, that is larger is no matter of digits


class Covariance(Record):
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

    def turned(self, signs: Array) -> Covariance:
        """Return the covariance of the coefficients with other signs, shape (k,)."""
        return self._changed(self.parameters, lambda rows: rows * np.outer(signs, signs))

    def without_turn(self) -> Covariance:
        """Return the covariance of all but the turn of the mounting."""
        kept = [k for k, name in enumerate(self.parameters) if not name.startswith(TURN)]
        return self._changed([self.parameters[k] for k in kept], lambda rows: rows[np.ix_(kept, kept)])

    def _changed(self, names: Sequence[str], change: Callable[[Array], Array]) -> Covariance:
        tables = [rows and change(np.array(rows, dtype=float)).tolist() for rows in (self.matrix, self.wide)]
        matrix, wide = (tuple(map(tuple, rows)) for rows in tables)
        return Covariance(parameters=tuple(names), matrix=matrix, wide=wide)


@dataclass(frozen=True)
class Uncertainty(Mapping[str, float]):
    """The uncertainty of a calibration: standard uncertainties (k = 1) by the dotted names of the coefficients.

    ``uncertainty["sensitivity.x.y"]`` is that of channel x along y, in unit/g; angles of the mounting are in degrees,
    temperature coefficients per °C, °C², ... What the file does not state is no key.
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

    def errors(self, mounting: Mounting | None) -> Uncertain:
        """Return the errors of the coefficients and of the turn of their mounting; none where none is stated."""
        stated = self.covariance
        if stated is None:
            untold = (MOUNTING, "temperature.reference", "temperature.lag")
            own = {name: u for name, u in self.standard.items() if u > 0.0 and not name.startswith(untold)}
            names, covariance = tuple(own), np.diag(np.array(list(own.values())) ** 2)
        else:
            names, covariance = stated.parameters, stated.as_array()
        factors = np.array([self.coverage_factor.get(name, NORMAL_FACTOR) for name in names])
        wide = np.array(stated.wide, dtype=float) if stated and stated.wide else widened(covariance, factors)
        scale = np.array([radians(1.0) if name.startswith(TURN) else 1.0 for name in names])
        scales = np.outer(scale, scale)
        found = Uncertain(names, np.zeros(len(names)), covariance * scales, wide * scales)
        angles = [radians(self.get(f"{MOUNTING}{angle}", 0.0)) for angle in ANGLES]
        silent = not any(f"{MOUNTING}{angle}" in self for angle in ANGLES)
        if not names or mounting is None or silent or any(name.startswith(TURN) for name in names):
            return found
        # A turn about the application's axes, from uncorrelated angles.
        roll = mounting_matrix(Mounting(0.0, mounting.pitch, mounting.yaw))[:, 0]
        axes = np.column_stack([roll, mounting_matrix(Mounting(0.0, 0.0, mounting.yaw))[:, 1], [0.0, 0.0, 1.0]])
        return found.beside(Uncertain.errors(ANGLES, np.diag(np.square(angles))).through(axes, TURNS))


class ThermalUncertainty(Record):
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
        deviations = np.sqrt(np.abs(np.diag(matrix)))
        scales = np.where(deviations > 0.0, deviations, 1.0)
        least = np.linalg.eigvalsh(matrix / np.outer(scales, scales)).min(initial=0.0)
        if least < -_ROUNDED or not np.array_equal(matrix, matrix.T):
            why = "it is not symmetric, or its variances and correlations contradict one another"
            raise place.error(f"this is no covariance: {why}; take it from the file that the calibration wrote", key)


class UncertaintySection(Record):
    """The section as it stands in a file."""

    offset: Annotated[ByAxis[Size], about("per channel, unit")] = {}
    sensitivity: Annotated[ByAxis[ByAxis[Size]], about("row = channel, column = axis, unit/g")] = {}
    nonlinearity: Annotated[_POLYNOMIALS, about("per channel, pure numbers")] = {}
    temperature: Annotated[ThermalUncertainty | None, about("in the shape of `calibration.temperature`")] = None
    mounting: Annotated[Mapping[Annotated[str, one_of(*ANGLES)], Size], about("`roll`, `pitch`, `yaw`, degrees")] = {}
    single_reading: Annotated[
        Mapping[Annotated[str, one_of(*AXES, TEMPERATURE)], Size],
        about("of a reading of a log, per channel, unit, and of its `temperature`, °C"),
    ] = {}
    alignment: Annotated[Size, about("after `level`: of how the sensor sits since, degrees about each axis")] = 0.0
    coverage_factor: Annotated[Mapping[str, AboveZero], about("for 95 %; 1.96 where none is named")] = {}
    covariance: Annotated[Covariance | None, about("the covariance of the coefficients")] = None

    def checked(self, place: Document, coefficients: Coefficients) -> Uncertainty:
        """Return it with its standard uncertainties by dotted name; an InputError where it contradicts the rest."""
        channels, known = coefficients.channels, [*values(coefficients), *TURNS]
        for key in ("offset", "sensitivity", "nonlinearity"):
            place.require_keys(getattr(self, key), channels, key)
            if key != "nonlinearity" and self.temperature is not None:
                place.require_keys(getattr(self.temperature, key), channels, TEMPERATURE, key)
        for channel, row in self.sensitivity.items():
            place.require_keys(row, coefficients.axes, "sensitivity", channel)
        place.require_keys(self.single_reading, (*channels, TEMPERATURE), "single_reading")
        standard = dict(_named({key: value for key, value in plain(self).items() if key in SHAPED}))
        place.require_keys(self.coverage_factor, [*known, *standard], "coverage_factor")
        covariance = self.covariance
        if covariance is not None:
            _check_covariance(covariance, place.at("covariance"), known)
            for name, u in zip(covariance.parameters, np.sqrt(np.diag(covariance.as_array())).tolist(), strict=True):
                if not isclose(standard.get(name, u), u, rel_tol=_ROUNDED):
                    why = f"the variance of {name} is that of a standard uncertainty of {u:.4g}, and {standard[name]:g}"
                    raise place.error(f"{why} is stated: change both, or leave the covariance out", "covariance")
        return Uncertainty(standard, self.single_reading, self.coverage_factor, covariance, self.alignment)

    @classmethod
    def of(cls, uncertainty: Uncertainty) -> UncertaintySection:
        """Return an uncertainty in the shape of ``calibration``."""
        shaped = _shaped(uncertainty)
        warm = shaped.pop(TEMPERATURE)
        names = ("single_reading", "coverage_factor", "covariance", "alignment")
        rest = {name: getattr(uncertainty, name) for name in names}
        return cls(**shaped, **rest, temperature=ThermalUncertainty(**warm) if warm else None)


def _shaped(named: Mapping[str, float]) -> dict[str, Any]:
    """Return numbers by dotted names in the shape of ``calibration``; those of powers are a list."""
    shaped: dict[str, Any] = {key: {} for key in SHAPED}
    for name, number in named.items():
        *path, last = name.split(".")
        section = shaped
        for key in path[:-1]:
            section = section.setdefault(key, {})
        if last.isdigit():
            section[path[-1]] = (*section.get(path[-1], ()), number)
        else:
            section.setdefault(path[-1], {})[last] = number
    return shaped


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

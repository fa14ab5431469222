"""What a calibration found, as tables: coefficients, their budget and correlations, and what follows from them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import degrees, sqrt
from typing import Any

from tiltcal.calibration.labels import symbol, unit_of, words
from tiltcal.core.comparison import values
from tiltcal.core.model import Coefficients
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.uncertainty import named_uncertainties
from tiltcal.report.number_format import AlignedNumber, at_place, column, half_width, measured, plain
from tiltcal.report.record import number, numbers, section, text

SOURCES = {
    "noise": "noise",
    "adc": "ADC",
    "jig": "jig",
    "table": "table",
    "thermometer": "thermometer",
    "assumed": "assumed",
}
"""Of uncertainty, as a calibration file names them and as the page does, in the order of their bars."""

ANGLES = ("roll", "pitch", "yaw")

Row = tuple[str, str, tuple[str, str], float, float | None, str, float | None]
"""Of a table: name, words, symbol, value, standard uncertainty, unit, coverage factor."""

_TOGETHER, _AGAINST = (31, 111, 139), (192, 80, 77)
_DARK = 0.6


@dataclass(frozen=True)
class CoefficientRow:
    """One row of a table of results.

    Attributes
    ----------
    name : str
        Dotted, as in the file.
    words : str
    symbol : tuple of str
        A letter and its index.
    value : AlignedNumber
        With its standard uncertainty in brackets.
    unit : str
    interval : AlignedNumber
        Half width of its 95 % interval; empty where nobody knows it.
    factor : str
        The coverage factor; empty where the file has none.
    """

    name: str
    words: str
    symbol: tuple[str, str]
    value: AlignedNumber
    unit: str
    interval: AlignedNumber
    factor: str


@dataclass(frozen=True)
class Shares:
    """Where the variance of one coefficient comes from: the shares by source, as parts of 1, and their sums before."""

    words: str
    symbol: tuple[str, str]
    shares: Mapping[str, float]
    before: Mapping[str, float]


@dataclass(frozen=True)
class TableCell:
    """One correlation: what is printed, and on which ground."""

    text: str
    ground: str
    dark: bool


@dataclass(frozen=True)
class Correlations:
    """The lower triangle of a correlation matrix, each row as long as its place: the coefficients and their shades."""

    symbols: Sequence[tuple[str, str]]
    rows: Sequence[Sequence[TableCell]]


@dataclass(frozen=True)
class CoefficientGroup:
    """Quantities under a heading of their own, with what is to be said of them."""

    heading: str
    quantities: Sequence[CoefficientRow]
    remark: str = ""


def named(coefficients: Coefficients) -> dict[str, float]:
    """Every coefficient by its dotted name, the non-linearity too."""
    found = values(coefficients)
    if coefficients.nonlinearity is not None:
        for channel, row in zip(coefficients.channels, coefficients.nonlinearity, strict=True):
            found |= {f"nonlinearity.{channel}.{power}": float(v) for power, v in enumerate(row, start=2)}
    return found


def coverage_factors(calibration: CalibrationRecord) -> dict[str, float]:
    """Per coefficient, what its standard uncertainty is multiplied with for an interval of 95 %."""
    return numbers(calibration.uncertainty, "coverage_factor")


def coefficient_table(calibration: CalibrationRecord) -> list[CoefficientRow]:
    """Every coefficient with its uncertainty and its 95 % interval."""
    factors, unit = coverage_factors(calibration), calibration.sensor.unit
    u = dict(named_uncertainties(calibration.uncertainty))
    rows = [
        (name, words(name), symbol(name), value, u.get(name), unit_of(name, unit), factors.get(name))
        for name, value in named(calibration.coefficients).items()
    ]
    return _quantities(rows)


def budget(calibration: CalibrationRecord) -> list[Shares]:
    """Which share of each variance comes from what; empty where the file does not say."""
    found = []
    stated_of = section(calibration.fit, "budget")
    known = list(named(calibration.coefficients))
    for name in sorted(stated_of, key=lambda name: known.index(name) if name in known else len(known)):
        stated = numbers(calibration.fit, "budget", name)
        order = [*(source for source in SOURCES if source in stated), *(one for one in stated if one not in SOURCES)]
        before, total = {}, 0.0
        for source in order:
            before[source] = total
            total += stated[source]
        found.append(Shares(words(name), symbol(name), {source: stated[source] for source in order}, before))
    return found


def sources_of(shares: Sequence[Shares]) -> list[str]:
    """The sources that a budget names anywhere, in the order of their bars."""
    met = {source for one in shares for source in one.shares}
    return [*(source for source in SOURCES if source in met), *sorted(met - set(SOURCES))]


def correlations(calibration: CalibrationRecord) -> Correlations | None:
    """Of the coefficients; None where the file has no covariance of at least two."""
    covariance = section(calibration.uncertainty, "covariance")
    if not covariance or len(covariance["parameters"]) < 2:
        return None
    matrix = covariance["matrix"]
    u = [sqrt(matrix[i][i]) for i in range(len(matrix))]
    rows = [[_cell(matrix[i][j] / (u[i] * u[j]) if u[i] and u[j] else 0.0) for j in range(i)] for i in range(len(u))]
    return Correlations([symbol(name) for name in covariance["parameters"]], rows)


def _cell(correlation: float) -> TableCell:
    """Blue for a positive one, red for a negative one, the deeper the stronger."""
    strength = min(abs(correlation), 1.0)
    full = _TOGETHER if correlation > 0.0 else _AGAINST
    ground = "".join(f"{round(255 + (end - 255) * strength):02x}" for end in full)
    shown = at_place(correlation, 2).replace("0.", ".", 1) if strength >= 0.005 else "0"
    return TableCell(shown, f"#{ground}", strength > _DARK)


def derived_groups(calibration: CalibrationRecord) -> list[CoefficientGroup]:
    """What follows from the coefficients: cross-axis errors, misalignment, intrinsic parameters, mounting."""
    return [group for group in _derived(calibration) if group.quantities or group.remark]


def _derived(calibration: CalibrationRecord) -> Iterator[CoefficientGroup]:
    derived, unit = calibration.derived, calibration.sensor.unit
    yield CoefficientGroup(
        "Cross-axis error",
        _quantities(
            [
                *_of_channels(derived, "cross_axis_percent", "Cross-axis sensitivity of {}", "%"),
                *_of_channels(derived, "misalignment_degrees", "Misalignment of {}", "°"),
            ]
        ),
    )
    intrinsic = section(derived, "intrinsic")
    told = _quantities(
        [
            *_of_channels(intrinsic, "offset", "Offset of {}", unit),
            *_of_channels(intrinsic, "sensitivity", "Sensitivity of {} along its own direction", f"{unit}/g"),
            *_of_channels(intrinsic, "angle_degrees", "Angle between {}", "°"),
            *_of_channels(intrinsic, "rotation_degrees", "Rotation in the jig’s frame, {}", "°"),
        ]
    )
    apart = text(intrinsic, "left_handed") or ("These do not change with the mounting." if told else "")
    yield CoefficientGroup("Intrinsic parameters", told, apart)
    yield _mounting(calibration)
    yield _scale(calibration)


def _scale(calibration: CalibrationRecord) -> CoefficientGroup:
    """The sensitivities per m/s², where the gravity of the place was stated."""
    derived, unit = calibration.derived, calibration.sensor.unit
    gravity = number(derived, "gravity_m_s2")
    if not gravity:
        return CoefficientGroup("Scale", ())
    per_g = {c: u for c in calibration.sensor.channels if (u := number(calibration.uncertainty, "sensitivity", c, c))}
    doubts = {
        "sensitivity_per_m_s2": {c: u / gravity for c, u in per_g.items()},
        "scale_error_percent": {c: 100.0 * u / gravity for c, u in per_g.items()},
    }
    stated = {**derived, "uncertainty": doubts}
    rows = [
        *_of_channels(stated, "sensitivity_per_m_s2", "Sensitivity of {} per m/s²", f"{unit}/(m/s²)"),
        *_of_channels(stated, "scale_error_percent", "Scale error of {}", "%"),
    ]
    return CoefficientGroup("Scale", _quantities(rows), f"At a gravity of {plain(gravity, 7)} m/s².")


def _mounting(calibration: CalibrationRecord) -> CoefficientGroup:
    mounting, derived = calibration.coefficients.mounting, calibration.derived
    remark = text(derived, "mounting") or ""
    if number(derived, "gimbal_lock") is None and derived.get("gimbal_lock"):
        remark = "Gimbal lock: roll and yaw cannot be told apart at this pitch, and yaw alone carries both. " + remark
    if mounting is None:
        return CoefficientGroup("Mounting", (), remark)
    rows = [
        (f"mounting.{a}", a.capitalize(), ("", ""), degrees(getattr(mounting, a)), u, "°", None)
        for a in ANGLES
        for u in [number(calibration.uncertainty, "mounting", a)]
    ]
    return CoefficientGroup("Mounting", _quantities(rows), remark or "Roll first, then pitch, then yaw.")


def _of_channels(record: Any, key: str, sentence: str, unit: str) -> list[Row]:
    """The rows of one derived quantity, one for each channel, or for each pair of them such as ``xy``."""
    return [
        (
            f"derived.{key}.{name}",
            sentence.format(" and ".join(name) if len(name) == 2 else name),
            ("", ""),
            value,
            number(record, "uncertainty", key, name),
            unit,
            None,
        )
        for name, value in numbers(record, key).items()
    ]


def _quantities(rows: Sequence[Row]) -> list[CoefficientRow]:
    told = column(measured(value, u) if u else plain(value, 6) for *_, value, u, _, _ in rows)
    widths = column(half_width(factor * u) if u and factor else "" for *_, u, _, factor in rows)
    return [
        CoefficientRow(name, said, sign, value, unit, width, f"{factor:.2f}" if factor and u else "")
        for (name, said, sign, _, u, unit, factor), value, width in zip(rows, told, widths, strict=True)
    ]

"""The tables of coefficients, uncertainty budget, correlations, derived quantities and changes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from math import degrees, sqrt
from typing import NamedTuple

from tiltcal.calibration.comparison import compare_records
from tiltcal.calibration.labels import symbol, unit_of, words
from tiltcal.core.named_coefficients import values
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.coefficients import ANGLES
from tiltcal.files.results import (
    DerivedCoverage,
    DerivedUncertainty,
    IntrinsicCoverage,
    IntrinsicRecord,
    IntrinsicUncertainty,
)
from tiltcal.report.number_format import AlignedNumber, at_place, column, half_width, measured, plain
from tiltcal.report.provenance import period

SOURCES = {
    "noise": "noise",
    "adc": "ADC",
    "jig": "jig",
    "table": "table",
    "thermometer": "thermometer",
    "assumed": "assumed",
}
"""The sources of uncertainty: their names in a file and on the page, in the order of the bars."""


class Row(NamedTuple):
    """One row of a table before alignment: standard uncertainty and coverage factor of the 95 % interval."""

    name: str
    words: str
    symbol: tuple[str, str]
    value: float
    u: float | None
    unit: str
    factor: float | None = None


_TOGETHER, _AGAINST = (31, 111, 139), (192, 80, 77)
_DARK = 0.6


@dataclass(frozen=True)
class CoefficientRow:
    """One row of a table of results.

    Attributes
    ----------
    name : str
        Dotted, as in the file.
    symbol : tuple of str
        A letter and its index.
    value : AlignedNumber
        With its standard uncertainty in brackets.
    interval : AlignedNumber
        Half width of its 95 % interval; empty where it is not known.
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
    """The budget of one coefficient: the share of its variance by source, and their cumulative sums."""

    words: str
    symbol: tuple[str, str]
    shares: Mapping[str, float]
    before: Mapping[str, float]


@dataclass(frozen=True)
class TableCell:
    """One correlation: its text and background colour."""

    text: str
    ground: str
    dark: bool


@dataclass(frozen=True)
class Correlations:
    """The lower triangle of a correlation matrix, row by row."""

    symbols: Sequence[tuple[str, str]]
    rows: Sequence[Sequence[TableCell]]


@dataclass(frozen=True)
class CoefficientGroup:
    """Quantities under one heading, with a remark."""

    heading: str
    quantities: Sequence[CoefficientRow]
    remark: str = ""


def coefficient_table(calibration: CalibrationRecord) -> list[CoefficientRow]:
    """Return every coefficient with its uncertainty and its 95 % interval."""
    u, unit = calibration.uncertainty, calibration.sensor.unit
    rows = [
        Row(name, words(name), symbol(name), value, u.get(name), unit_of(name, unit), u.coverage_factor.get(name))
        for name, value in values(calibration.coefficients).items()
    ]
    return _quantities(rows)


def budget(calibration: CalibrationRecord) -> list[Shares]:
    """Return the budget of each coefficient; empty if the file has none."""
    found = []
    stated_of = calibration.fit.budget
    known = list(values(calibration.coefficients))
    for name in sorted(stated_of, key=lambda name: known.index(name) if name in known else len(known)):
        stated = stated_of[name]
        shares = {source: stated[source] for source in SOURCES if source in stated} | dict(stated)
        before = dict(zip(shares, accumulate(shares.values(), initial=0.0), strict=False))
        found.append(Shares(words(name), symbol(name), shares, before))
    return found


def sources_of(shares: Sequence[Shares]) -> list[str]:
    """Return the sources that a budget contains, in the order of the bars."""
    met = {source for share in shares for source in share.shares}
    return [*(source for source in SOURCES if source in met), *sorted(met - set(SOURCES))]


def correlations(calibration: CalibrationRecord) -> Correlations | None:
    """Return the correlations of the coefficients; None without a covariance of at least two."""
    covariance = calibration.uncertainty.covariance
    if covariance is None or len(covariance.parameters) < 2:
        return None
    matrix = covariance.matrix
    u = [sqrt(matrix[i][i]) for i in range(len(matrix))]
    rows = [[_cell(matrix[i][j] / (u[i] * u[j]) if u[i] and u[j] else 0.0) for j in range(i)] for i in range(len(u))]
    return Correlations([symbol(name) for name in covariance.parameters], rows)


def _cell(correlation: float) -> TableCell:
    """Return the background: blue for a positive, red for a negative correlation, darker if stronger."""
    strength = min(abs(correlation), 1.0)
    full = _TOGETHER if correlation > 0.0 else _AGAINST
    ground = "".join(f"{round(255 + (end - 255) * strength):02x}" for end in full)
    shown = at_place(correlation, 2).replace("0.", ".", 1) if strength >= 0.005 else "0"
    return TableCell(shown, f"#{ground}", strength > _DARK)


def derived_groups(calibration: CalibrationRecord) -> list[CoefficientGroup]:
    """Return the derived quantities: cross-axis sensitivity, misalignment, intrinsic parameters, mounting."""
    return [group for group in _derived(calibration) if group.quantities or group.remark]


def _derived(calibration: CalibrationRecord) -> Iterator[CoefficientGroup]:
    derived, unit = calibration.derived, calibration.sensor.unit
    u = derived.uncertainty or DerivedUncertainty()
    k = u.coverage_factor or DerivedCoverage()
    crossed, turned = derived.cross_axis_percent, derived.misalignment_degrees
    yield _group(
        "Cross-axis error",
        _by_channel("Cross-axis sensitivity of {}", "%", crossed, u.cross_axis_percent, k.cross_axis_percent),
        _by_channel("Misalignment of {}", "°", turned, u.misalignment_degrees, k.misalignment_degrees),
    )
    if derived.intrinsic is not None:
        yield _intrinsic(derived.intrinsic, unit)
    yield _mounting(calibration)
    yield _scale(calibration)


def _intrinsic(own: IntrinsicRecord, unit: str) -> CoefficientGroup:
    u = own.uncertainty or IntrinsicUncertainty()
    k, length = u.coverage_factor or IntrinsicCoverage(), "Sensitivity of {} along its own direction"
    turn = own.rotation_degrees, u.rotation_degrees, k.rotation_degrees
    return _group(
        "Intrinsic parameters",
        _by_channel("Offset of {}", unit, own.offset, u.offset, k.offset),
        _by_channel(length, f"{unit}/g", own.sensitivity, u.sensitivity, k.sensitivity),
        _by_channel("Angle between {}", "°", own.angle_degrees, u.angle_degrees, k.angle_degrees),
        _by_channel("Rotation in the jig’s frame, {}", "°", *turn),
        remark=own.left_handed or "These do not change with the mounting.",
    )


def _scale(calibration: CalibrationRecord) -> CoefficientGroup:
    """Return the sensitivities per m/s², if local gravity was stated."""
    derived, unit, gravity = calibration.derived, calibration.sensor.unit, calibration.derived.gravity_m_s2
    if gravity is None:
        return CoefficientGroup("Scale", ())
    u = {c: calibration.uncertainty.get(f"sensitivity.{c}.{c}", 0.0) / gravity for c in calibration.sensor.channels}
    percent = {channel: 100.0 * value for channel, value in u.items()}
    return _group(
        "Scale",
        _by_channel("Sensitivity of {} per m/s²", f"{unit}/(m/s²)", derived.sensitivity_per_m_s2, u),
        _by_channel("Scale error of {}", "%", derived.scale_error_percent, percent),
        remark=f"At a gravity of {plain(gravity, 7)} m/s².",
    )


def _mounting(calibration: CalibrationRecord) -> CoefficientGroup:
    mounting, derived = calibration.coefficients.mounting, calibration.derived
    remark = derived.mounting or ""
    if derived.gimbal_lock:
        remark = "Gimbal lock: roll and yaw cannot be separated at this pitch; yaw contains both. " + remark
    if mounting is None:
        return CoefficientGroup("Mounting", (), remark)
    u = calibration.uncertainty
    rows = []
    for angle in ANGLES:
        name, value = f"mounting.{angle}", degrees(getattr(mounting, angle))
        factor = u.coverage_factor.get(name)
        rows.append(Row(name, angle.capitalize(), ("", ""), value, u.get(name, 0.0), "°", factor))
    return _group("Mounting", rows, remark=remark or "Roll first, then pitch, then yaw.")


def _group(heading: str, *rows: Sequence[Row], remark: str = "") -> CoefficientGroup:
    return CoefficientGroup(heading, _quantities([row for some in rows for row in some]), remark)


def _by_channel(
    sentence: str,
    unit: str,
    values: Mapping[str, float],
    u: Mapping[str, float],
    factors: Mapping[str, float] | None = None,
) -> list[Row]:
    """Return the rows of one derived quantity, one for each channel, or for each pair of them such as ``xy``."""
    known, rows = factors or {}, []
    for name, value in values.items():
        said = sentence.format(" and ".join(name) if len(name) == 2 else name)
        rows.append(Row("", said, ("", ""), value, u.get(name), unit, known.get(name)))
    return rows


def _quantities(rows: Sequence[Row]) -> list[CoefficientRow]:
    printed = column(measured(row.value, row.u) for row in rows)
    widths = column(half_width(row.factor * row.u) if row.u and row.factor else "" for row in rows)
    return [
        CoefficientRow(
            row.name, row.words, row.symbol, value, row.unit, width, f"{row.factor:.2f}" if row.factor and row.u else ""
        )
        for row, value, width in zip(rows, printed, widths, strict=True)
    ]


@dataclass(frozen=True)
class CoefficientChangeRow:
    """One coefficient before and after."""

    words: str
    symbol: tuple[str, str]
    before: AlignedNumber
    after: AlignedNumber
    change: AlignedNumber
    ratio: AlignedNumber
    unit: str
    changed: bool


@dataclass(frozen=True)
class ChangeSection:
    """The changes since an earlier calibration.

    Attributes
    ----------
    since : str
        Name of the earlier file, and when it was measured.
    """

    since: str
    verdict: str
    rows: Sequence[CoefficientChangeRow]


def change_section(before: CalibrationRecord, name: str, after: CalibrationRecord) -> ChangeSection:
    """Return every coefficient that both files have, the earlier ones at the later one's reference temperature."""
    comparison = compare_records(before, after)
    found, verdict = comparison.changes, comparison.verdict
    old = column(measured(change.before, before.uncertainty.get(change.name)) for change in found)
    new = column(measured(change.after, after.uncertainty.get(change.name)) for change in found)
    moved = column(measured(change.difference, change.u) for change in found)
    ratios = column("" if change.ratio is None else f"{change.ratio:.2f}" for change in found)
    unit = after.sensor.unit
    rows = [
        CoefficientChangeRow(
            words(change.name), symbol(change.name), *texts, unit_of(change.name, unit), change.name in verdict.changed
        )
        for change, texts in zip(found, zip(old, new, moved, ratios, strict=True), strict=True)
    ]
    when = period(before.provenance)
    rest = ", ".join(words(name) for name in comparison.not_comparable)
    said = f"{verdict}; not comparable: {rest}" if rest else str(verdict)
    return ChangeSection(f"{name}, {when}" if when else name, f"{said[:1].upper()}{said[1:]}.", rows)

"""The tables of the pages: of a calibration, of pairs, of a fleet and of logs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from decimal import Decimal
from html import escape
from itertools import groupby, pairwise
from math import degrees, nan
from typing import NamedTuple

from tiltcal.calibration.comparison import compare_records
from tiltcal.calibration.season import CoefficientDistribution, FleetHistory, ModelFleet
from tiltcal.calibration.wording import HEADINGS, label
from tiltcal.core.column_statistics import ColumnStatistics
from tiltcal.core.flags import FLAGS, REASONS
from tiltcal.core.model import values
from tiltcal.core.pair.matching import STAGES, SUM, Matching
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.coefficients import ANGLES
from tiltcal.files.results import DerivedRecord, IntrinsicRecord, PositionSet
from tiltcal.report.numbers import (
    LABORATORY,
    Html,
    aligned,
    at_place,
    at_place_if_stated,
    grouped,
    half_width,
    measured,
    plain,
    three_digits,
)
from tiltcal.report.sentences import as_set

KEPT = 16  # largest number of rows of a table that is kept on one page
LONGEST_WORD = 24  # characters of a name that is not broken into lines
SOURCES = ("noise", "adc", "jig", "table", "thermometer", "assumed")
"""The sources of uncertainty, in the order of their columns; others follow."""

ROUND = "roll"  # an angle that wraps from 180° to -180°, so that its mean has no meaning


class Column(NamedTuple):
    """A column of a table: its head, its cells, their style, and the heading over several columns."""

    head: str
    cells: Sequence[str]
    style: str = ""
    over: str = ""


@dataclass(frozen=True)
class Table:
    """A table, column by column; the cells of the first are the heads of the rows, ``marked`` the rows in bold."""

    columns: Sequence[Column]
    marked: frozenset[int] = frozenset()
    caption: str = ""
    style: str = ""

    @property
    def groups(self) -> list[tuple[str, list[Column]]]:
        """The columns below each heading; the columns without one together."""
        return [(over, list(columns)) for over, columns in groupby(self.columns, key=lambda column: column.over)]

    @property
    def rows(self) -> list[list[tuple[str, str]]]:
        """The cells of each row, with their styles."""
        styles = [column.style for column in self.columns]
        cells = zip(*(column.cells for column in self.columns), strict=True)
        return [list(zip(row, styles, strict=True)) for row in cells]

    @property
    def classes(self) -> str:
        """How it is shown: one that is short enough is kept on one page."""
        return " ".join(filter(None, [self.style, "keep" if len(self.columns[0].cells) <= KEPT else ""]))


def numbers(head: str, texts: Iterable[str], over: str = "") -> Column:
    """Return a column of numbers, aligned on their decimal points."""
    return Column(head, aligned(texts), "n", over)


def sign(name: str) -> Html:
    """Return the symbol of a coefficient, such as S with the index xy."""
    letter, index = label(name).symbol
    return Html(f"<var>{escape(letter)}</var><sub>{escape(index)}</sub>")


class Quantity(NamedTuple):
    """One quantity: standard uncertainty and coverage factor of its 95 % interval, where they are known."""

    words: str
    value: float
    u: float | None
    unit: str
    factor: float | None = None
    name: str = ""


def coefficient_table(calibration: CalibrationRecord) -> Table:
    """Return every coefficient with its uncertainty and its 95 % interval."""
    u, unit = calibration.uncertainty, calibration.sensor.unit
    return _quantities(
        [
            Quantity(label(name).words, value, u.get(name), label(name, unit).unit, u.coverage_factor.get(name), name)
            for name, value in values(calibration.coefficients).items()
        ]
    )


def _quantities(rows: Sequence[Quantity]) -> Table:
    factors, names = [row.factor if row.u else None for row in rows], [row.name for row in rows]
    columns = [Column("Quantity", [row.words for row in rows])]
    columns += [Column("", [sign(name) for name in names])] if any(names) else []
    columns.append(numbers("Value", [measured(row.value, row.u) for row in rows]))
    columns.append(Column("Unit", [row.unit for row in rows]))
    if any(factors):
        widths = [half_width(k * row.u) if k and row.u else "" for k, row in zip(factors, rows, strict=True)]
        columns.append(numbers("95 % interval: ±", widths))
        columns.append(Column(Html("<var>k</var>"), [f"{k:.2f}" if k else "" for k in factors], "n"))
    return Table(columns)


def budget_table(calibration: CalibrationRecord) -> Table | None:
    """Return the share of the variance of each coefficient by source; None if the file states none."""
    budget = calibration.fit.budget
    if not budget:
        return None
    names = [name for name in dict.fromkeys([*values(calibration.coefficients), *budget]) if name in budget]
    stated = {source for shares in budget.values() for source in shares}
    sources = [*(source for source in SOURCES if source in stated), *sorted(stated - set(SOURCES))]
    columns = _coefficients(names)
    for source in sources:
        cells = [f"{100 * budget[name][source]:.1f}" if source in budget[name] else "" for name in names]
        columns.append(Column("ADC" if source == "adc" else source, cells, "share", "Share of the variance / %"))
    return Table(columns)


def _coefficients(names: Sequence[str]) -> list[Column]:
    return [Column("Coefficient", [label(name).words for name in names]), Column("", [sign(name) for name in names])]


class Group(NamedTuple):
    """Derived quantities under one heading, with a remark."""

    heading: str
    table: Table | None
    remark: str = ""


def derived_groups(calibration: CalibrationRecord) -> list[Group]:
    """Return the derived quantities: cross-axis sensitivity, misalignment, intrinsic parameters, mounting, scale."""
    derived, unit = calibration.derived, calibration.sensor.unit
    crossed = _by_channel(derived, "cross_axis_percent", "Cross-axis sensitivity of {}", "%")
    turned = _by_channel(derived, "misalignment_degrees", "Misalignment of {}", "°")
    groups = [_group("Cross-axis error", [*crossed, *turned])]
    if (intrinsic := derived.intrinsic) is not None:
        rows = [
            *_by_channel(intrinsic, "offset", "Offset of {}", unit),
            *_by_channel(intrinsic, "sensitivity", "Sensitivity of {} along its own direction", f"{unit}/g"),
            *_by_channel(intrinsic, "angle_degrees", "Angle between {}", "°"),
            *_by_channel(intrinsic, "rotation_degrees", "Rotation in the jig’s frame, {}", "°"),
        ]
        remark = intrinsic.left_handed or "These do not change with the mounting."
        groups.append(_group("Intrinsic parameters", rows, remark))
    groups.append(_mounting(calibration))
    if (gravity := derived.gravity_m_s2) is not None:
        groups.append(_group("Scale", _scale(calibration, gravity), f"At a gravity of {plain(gravity, 7)} m/s²."))
    return [group for group in groups if group.table or group.remark]


def _by_channel(record: DerivedRecord | IntrinsicRecord, name: str, sentence: str, unit: str) -> list[Quantity]:
    """Return one derived quantity of each channel, or of each pair of them such as ``xy``."""
    u = getattr(record.uncertainty, name, {})
    factors = getattr(getattr(record.uncertainty, "coverage_factor", None), name, {})
    return [
        Quantity(
            sentence.format(" and ".join(key) if len(key) == 2 else key), value, u.get(key), unit, factors.get(key)
        )
        for key, value in getattr(record, name).items()
    ]


def _scale(calibration: CalibrationRecord, gravity: float) -> list[Quantity]:
    """Return the sensitivities per m/s², and how far they are from those of the data sheet."""
    derived, unit = calibration.derived, calibration.sensor.unit
    u = {c: calibration.uncertainty.get(f"sensitivity.{c}.{c}", 0.0) / gravity for c in calibration.sensor.channels}
    scale, errors = derived.sensitivity_per_m_s2, derived.scale_error_percent
    return [
        *(Quantity(f"Sensitivity of {c} per m/s²", one, u.get(c), f"{unit}/(m/s²)") for c, one in scale.items()),
        *(Quantity(f"Scale error of {c}", one, 100.0 * u[c] if c in u else None, "%") for c, one in errors.items()),
    ]


def _mounting(calibration: CalibrationRecord) -> Group:
    mounting, derived, u = calibration.coefficients.mounting, calibration.derived, calibration.uncertainty
    remark = derived.mounting or ""
    if derived.gimbal_lock:
        remark = "Gimbal lock: roll and yaw cannot be separated at this pitch; yaw contains both. " + remark
    if mounting is None:
        return Group("Mounting", None, remark)
    named = {f"mounting.{angle}": (angle.capitalize(), degrees(getattr(mounting, angle))) for angle in ANGLES}
    rows = [Quantity(*one, u.get(name, 0.0), "°", u.coverage_factor.get(name)) for name, one in named.items()]
    return _group("Mounting", rows, remark or "Roll first, then pitch, then yaw.")


def _group(heading: str, rows: Sequence[Quantity], remark: str = "") -> Group:
    return Group(heading, _quantities(rows) if rows else None, remark)


def position_table(calibration: CalibrationRecord) -> Table | None:
    """Return every measured position in order: its setting, means and residuals."""
    channels, fit, records = calibration.coefficients.channels, calibration.fit, calibration.positions
    if not records:
        return None
    names = [record.position for record in records]
    # Positions of a mounting come last and were not fitted; they may bear a name that was.
    fitted = [name in fit.residuals and name not in names[:k] for k, name in enumerate(names)]
    own, mounted, levelled = calibration.runs
    settings = [as_set(calibration.procedure.set.get(one.position, PositionSet())) for one in own]
    settings += ["for the mounting"] * len(mounted) + ["level, for the offset"] * len(levelled)
    decimals, unit = (
        three_digits(v for row in fit.residuals.values() for v in row.values()),
        calibration.sensor.fitted_unit,
    )
    columns = [
        Column("Position", names, "name"),
        Column("As set", settings),
        numbers(Html("<var>T</var> / °C"), [at_place_if_stated(record.temperature, 2) for record in records]),
        Column(Html("<var>n</var>"), ["" if record.n is None else str(record.n) for record in records], "n"),
    ]
    for channel in channels:
        means = [(record.mean.get(channel), (record.u or {}).get(channel)) for record in records]
        texts = ["" if mean is None else measured(mean, u, 7) for mean, u in means]
        columns.append(numbers(Html(f"<var>{channel}</var>"), texts, f"Mean / {unit}"))
    for channel in channels:
        residuals = [fit.residuals[n].get(channel) if known else None for n, known in zip(names, fitted, strict=True)]
        texts = [at_place_if_stated(residual, decimals) for residual in residuals]
        columns.append(numbers(Html(f"<var>{channel}</var>"), texts, f"Residual / {unit}"))
    suspect = frozenset(k for k, name in enumerate(names) if fitted[k] and name in fit.suspect_positions)
    return Table(columns, suspect, style="wide dense" if len(channels) > 2 else "wide")


def change_table(before: CalibrationRecord, after: CalibrationRecord) -> tuple[str, Table]:
    """Return the verdict on the changes, and every coefficient at the later one's reference temperature."""
    comparison = compare_records(before, after)
    changes, verdict, unit = comparison.changes, comparison.verdict, after.sensor.unit
    rest = ", ".join(label(name).words for name in comparison.not_comparable)
    said = "; not comparable: ".join(filter(None, [str(verdict), rest]))
    ratios = ["" if change.ratio is None else f"{change.ratio:.2f}" for change in changes]
    table = Table(
        [
            *_coefficients([change.name for change in changes]),
            numbers("Before", [measured(change.before, before.uncertainty.get(change.name)) for change in changes]),
            numbers("Now", [measured(change.after, after.uncertainty.get(change.name)) for change in changes]),
            numbers("Change", [measured(change.difference, change.u) for change in changes]),
            Column("Unit", [label(change.name, unit).unit for change in changes]),
            numbers(Html("Change / <var>u</var>"), ratios),
        ],
        frozenset(k for k, change in enumerate(changes) if change.name in verdict.changed),
    )
    return f"{said[:1].upper()}{said[1:]}.", table


def flag_table(overview: ColumnStatistics) -> Table:
    """Return how many rows of a log have each flag and each reason."""
    counts = [(f"Flag {code}", FLAGS[code], overview.flags[code]) for code in FLAGS if overview.flags.get(code)]
    counts += [(f"Reason {bit}", REASONS[bit], overview.reasons[bit]) for bit in REASONS if overview.reasons.get(bit)]
    names, said, rows = zip(*counts, strict=True)
    return Table(
        [
            Column("Flag or reason", names),
            Column("", said),
            Column("Rows", [grouped(count) for count in rows], "share"),
            Column("Share / %", [_percent(count, overview.rows) for count in rows], "share"),
        ]
    )


def _percent(count: int, rows: int) -> str:
    """Return a share in per cent that is never rounded to 0 or 100."""
    return "100.000" if count == rows else f"{min(max(100.0 * count / rows, 0.001), 99.999):.3f}"


def angle_table(overview: ColumnStatistics) -> Table:
    """Return the least, the mean and the largest of each angle of a log, degrees."""
    means = zip(overview.angles, overview.mean.tolist(), strict=True)
    angles = {
        "Least": [min((low for low in column if low == low), default=nan) for column in overview.low.T.tolist()],
        "Mean": [nan if angle == ROUND else mean for angle, mean in means],
        "Most": [max((high for high in column if high == high), default=nan) for column in overview.high.T.tolist()],
    }
    heads = Column("Angle / °", [angle_words(angle).capitalize() for angle in overview.angles])
    return Table([heads, *(numbers(h, [at_place_if_stated(a, 3) for a in column]) for h, column in angles.items())])


def angle_words(angle: str) -> str:
    """Return the name of a column of angles as text: ``tilt_x`` is the tilt of x."""
    return f"tilt of {angle.removeprefix('tilt_')}" if angle.startswith("tilt_") else angle


def pair_coefficient_table(matching: Matching) -> Table:
    """Return p and q."""
    rows = ("Scale factor mismatch p", matching.p, matching.u_p), ("Misalignment q", matching.q, matching.u_q)
    return _quantities([Quantity(said, value, u, "") for said, value, u in rows])


def component_table(matching: Matching) -> Table:
    """Return the components at the spin frequency before and after: Table 1 of the source."""
    pair = matching.pair
    names = {pair.first: pair.first, pair.second: pair.second, SUM: f"{pair.first} + {pair.second}"}
    columns = [Column("Channel", list(names.values()))]
    for stage in STAGES:
        row = [matching.components[stage][name] for name in names]
        over = HEADINGS[stage].capitalize()
        columns.append(numbers("sin", [measured(one.sin, one.u_sin) for one in row], over))
        columns.append(numbers("cos", [measured(one.cos, one.u_cos) for one in row], over))
    return Table(columns, caption="Components at the spin frequency, in the unit of the readings.", style="wide dense")


def sensor_table(history: FleetHistory) -> Table:
    """Return the sensors of a folder; those that are due are marked."""
    sensors = history.histories
    first, last = ([one.calibrations[place].date for one in sensors] for place in (0, -1))
    return Table(
        [
            _names("Sensor", [one.sensor.serial for one in sensors]),
            Column("Model", [one.sensor.model for one in sensors]),
            Column("Files", [str(len(one.calibrations)) for one in sensors]),
            Column("First", [f"{date:%Y-%m-%d}" for date in first]),
            Column("Last", [f"{date:%Y-%m-%d}" for date in last]),
            Column("Due", [f"{one.due(history.interval):%Y-%m-%d}" for one in sensors]),
        ],
        frozenset(k for k, one in enumerate(sensors) if history.is_due(one)),
        style="unbroken",
    )


def fleet_change_table(history: FleetHistory) -> Table | None:
    """Return each calibration of a folder beside the one before it."""
    pairs = [
        (one.sensor.serial, before, after, found)
        for one in history.histories
        for (before, after), found in zip(pairwise(one.calibrations), one.comparisons, strict=True)
    ]
    if not pairs:
        return None
    return Table(
        [
            _names("Sensor", [serial for serial, *_ in pairs]),
            Column("Date", [f"{after.date:%Y-%m-%d}" for _, _, after, _ in pairs], "n"),
            _names("File", [after.name for _, _, after, _ in pairs]),
            Column("Days since", [str((after.date - before.date).days) for _, before, after, _ in pairs], "n"),
            Column("Change", [found.in_words.removeprefix("changed: ") for *_, found in pairs]),
        ],
        frozenset(k for k, (*_, found) in enumerate(pairs) if found.verdict.word == "changed"),
    )


def _names(head: str, names: Sequence[str]) -> Column:
    return Column(head, names, "name" if max(map(len, names), default=0) > LONGEST_WORD else "n")


def distribution_table(fleet: ModelFleet) -> Table:
    """Return the distribution of each coefficient of a model; those with outliers are marked."""
    rows = fleet.distributions
    heads = ("Median", "Spread", "Least", "Most")
    texts = zip(*map(_distribution_numbers, rows), strict=True)
    return Table(
        [
            *_coefficients([row.name for row in rows]),
            *(numbers(head, column) for head, column in zip(heads, texts, strict=True)),
            Column("Unit", [label(row.name, fleet.unit).unit for row in rows]),
            Column("Outliers", [", ".join(row.outliers) for row in rows], "name"),
        ],
        frozenset(k for k, row in enumerate(rows) if row.outliers),
    )


def _distribution_numbers(distribution: CoefficientDistribution) -> list[str]:
    """Return the median, the spread, the least and the most, to the second digit of the spread where there is one."""
    spread, by_serial = distribution.spread, distribution.values.values()
    row = [distribution.median, spread, min(by_serial), max(by_serial)]
    if not spread > 0.0:
        return [plain(number, 4) for number in row]
    decimals = LABORATORY - 1 - Decimal(f"{spread:.{LABORATORY - 1}e}").adjusted()
    return [at_place(number, max(decimals, 0)) for number in row]

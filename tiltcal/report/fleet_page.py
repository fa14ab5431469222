"""The page of a fleet: the calibrations of a folder, what is due, and how the coefficients are distributed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal

from tiltcal.calibration.fleet import CoefficientDistribution, FleetHistory, ModelFleet
from tiltcal.calibration.labels import symbol, unit_of, words
from tiltcal.calibration.sensor_history import SensorHistory
from tiltcal.report.figure import SvgFigure
from tiltcal.report.fleet_figures import distribution_figure, drift_figure
from tiltcal.report.number_format import LABORATORY, AlignedNumber, at_place, column, plain
from tiltcal.report.page import render
from tiltcal.report.provenance import Fact


@dataclass(frozen=True)
class CalibrationChangeRow:
    """One calibration beside the one before it."""

    serial: str
    date: str
    name: str
    days: str
    change: str
    is_changed: bool


@dataclass(frozen=True)
class DistributionRow:
    """One coefficient of a model."""

    words: str
    symbol: tuple[str, str]
    numbers: Sequence[AlignedNumber]
    unit: str
    outliers: str


@dataclass(frozen=True)
class ModelSection:
    """The distributions of one model."""

    heading: str
    rows: Sequence[DistributionRow]
    distribution: SvgFigure | None
    drift: SvgFigure | None


def fleet_page(history: FleetHistory) -> str:
    """Return one HTML page that needs no other file."""
    return render(
        "fleet.html.j2",
        history=history,
        facts=[
            Fact("Folder", history.folder),
            Fact("Sensors", str(len(history.histories))),
            Fact("Calibrations", str(sum(len(known.calibrations) for known in history.histories))),
            Fact("Interval", f"{history.interval.days} days"),
            Fact("Due", f"{sum(map(history.is_due, history.histories))} on {history.now:%Y-%m-%d}"),
        ],
        changes=[row for known in history.histories for row in _change_rows(known)],
        models=[_model_section(model, number) for number, model in enumerate(history.models, start=1)],
        remarks=[
            *(f"{known.sensor.serial}: {remark}" for known in history.histories for remark in known.remarks),
            *(
                f"{known.sensor.serial}: no calibration for {(b.date - a.date).days} days, from {a.date:%Y-%m-%d}"
                for known in history.histories
                for a, b in known.gaps(history.interval)
            ),
        ],
    )


def _change_rows(history: SensorHistory) -> Iterator[CalibrationChangeRow]:
    for before, after, found in zip(history.calibrations, history.calibrations[1:], history.comparisons, strict=False):
        yield CalibrationChangeRow(
            history.sensor.serial,
            f"{after.date:%Y-%m-%d}",
            after.name,
            str((after.date - before.date).days),
            found.in_words.removeprefix("changed: "),
            found.verdict.word == "changed",
        )


def _model_section(fleet: ModelFleet, number: int) -> ModelSection:
    found = fleet.distributions
    numbers = [column(texts) for texts in zip(*map(_row_of, found), strict=True)]
    rows = [
        DistributionRow(
            words(distribution.name),
            symbol(distribution.name),
            cells,
            unit_of(distribution.name, fleet.unit),
            ", ".join(distribution.outliers),
        )
        for distribution, cells in zip(found, zip(*numbers, strict=True), strict=True)
    ]
    at = "" if fleet.reference is None else f", at {fleet.reference:g} °C"
    heading = f"{len(fleet.histories)} {fleet.model}{at}"
    return ModelSection(heading, rows, distribution_figure(fleet, number), drift_figure(fleet, number))


def _row_of(distribution: CoefficientDistribution) -> list[str]:
    """Return the median, the spread, the least and the most, to the second digit of the spread where there is one."""
    spread, values = distribution.spread, distribution.values.values()
    numbers = [distribution.median, spread, min(values), max(values)]
    if not spread > 0.0:
        return [plain(number, 4) for number in numbers]
    decimals = LABORATORY - 1 - Decimal(f"{spread:.{LABORATORY - 1}e}").adjusted()
    return [at_place(number, max(decimals, 0)) for number in numbers]

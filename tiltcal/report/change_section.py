"""The changes of a sensor between its calibrations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from tiltcal.calibration.comparison import compare_records
from tiltcal.calibration.labels import symbol, unit_of, words
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.report.number_format import AlignedNumber, column, measured
from tiltcal.report.provenance import period


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
    return ChangeSection(f"{name}, {when}" if when else name, _sentence(str(verdict)), rows)


def _sentence(verdict: str) -> str:
    return verdict[:1].upper() + verdict[1:] + "."

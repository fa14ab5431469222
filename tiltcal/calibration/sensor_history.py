"""The dated calibrations of one sensor, how far it wanders between them, and its calibration at any time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import cached_property
from itertools import pairwise
from operator import attrgetter

import numpy as np

from tiltcal.calibration.comparison import Comparison, compare_records, uncertain_of
from tiltcal.calibration.interpolation import Interval, Stability
from tiltcal.core.model import Array, Coefficients
from tiltcal.core.named_coefficients import referred, values
from tiltcal.errors import InputError, UsageError
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity, require_same_sensor
from tiltcal.files.moments import moment, to_the_second
from tiltcal.printable import counted

DAY = 86_400.0
"""Seconds."""


@dataclass(frozen=True)
class DatedCalibration:
    """A calibration file with its date.

    Attributes
    ----------
    date : datetime
        When it ended, UTC.
    started : str
        When it began.
    name : str
        The path within the folder.
    """

    record: CalibrationRecord
    date: datetime
    started: str
    path: str
    name: str


@dataclass(frozen=True)
class SensorHistory:
    """The calibrations of one sensor in the order of time, and remarks on sessions that overlap and on copies."""

    calibrations: tuple[DatedCalibration, ...]
    remarks: tuple[str, ...] = ()

    @classmethod
    def of(cls, found: Sequence[DatedCalibration]) -> SensorHistory:
        """Put the calibrations of one sensor in order, copies left out.

        InputError: two files contradict each other: another model, unit or channels, or one date and other
            coefficients.
        """
        kept: list[DatedCalibration] = []
        remarks: list[str] = []
        for calibration in sorted(found, key=attrgetter("date")):
            if not kept:
                kept.append(calibration)
                continue
            before = kept[-1]
            try:
                require_same_sensor(before.record, calibration.record)
            except UsageError as failure:
                raise InputError(
                    f"{calibration.record.sensor.serial} is {failure}, in {before.path}: give each sensor a serial "
                    "number of its own, or move one of the files",
                    file=calibration.path,
                ) from None
            if before.date == calibration.date:
                if _content(before.record.coefficients) != _content(calibration.record.coefficients):
                    raise InputError(
                        f"{before.path} has the same date, {to_the_second(calibration.date)}, and other coefficients "
                        f"of {calibration.record.sensor.serial}: keep one of them in the folder",
                        file=calibration.path,
                    )
                remarks.append(f"{calibration.name} is a copy of {before.name}")
                continue
            if moment(calibration.started, calibration.path) < before.date:
                remarks.append(f"the sessions of {before.name} and {calibration.name} overlap")
            kept.append(calibration)
        return cls(tuple(kept), tuple(remarks))

    def __repr__(self) -> str:
        dates = " to ".join(dict.fromkeys(f"{self.calibrations[end].date:%Y-%m-%d}" for end in (0, -1)))
        return f"<SensorHistory of {self.sensor.serial}: {counted(len(self.calibrations), 'calibration')}, {dates}>"

    @property
    def sensor(self) -> SensorIdentity:
        """The sensor."""
        return self.calibrations[-1].record.sensor

    def interval(self, k: int) -> Interval:
        """Return the time from a calibration, counted from 0, to the next.

        UsageError: the two do not lie on a line.
        """
        before, after = self.calibrations[k : k + 2]
        days = (after.date.timestamp() - before.date.timestamp()) / DAY
        return Interval.between(before.record, after.record, days, f"{before.name} and {after.name}")

    @cached_property
    def comparisons(self) -> tuple[Comparison, ...]:
        """How each calibration but the first differs from the one before it."""
        return tuple(compare_records(a.record, b.record) for a, b in pairwise(self.calibrations))

    def due(self, interval: timedelta) -> datetime:
        """Return when the next calibration is due."""
        return self.calibrations[-1].date + interval

    def gaps(self, interval: timedelta) -> list[tuple[DatedCalibration, DatedCalibration]]:
        """Return the neighbours that are further apart than the interval and a tenth of it."""
        return [(a, b) for a, b in pairwise(self.calibrations) if b.date - a.date > 1.1 * interval]

    def series(self, name: str) -> tuple[Array, Array] | None:
        """Return values and standard uncertainties of a coefficient that all have, at the last one's reference."""
        records = [calibration.record for calibration in self.calibrations]
        last = records[-1].coefficients.thermal
        reference = None if last is None else last.reference
        found = []
        for record in records:
            errors = uncertain_of(record, reference)
            u = errors.by_name(errors.u)
            if name in u:
                found.append((values(referred(record.coefficients, reference))[name], u[name]))
        return tuple(np.array(found).T) if len(found) == len(records) else None


def stated_stability(history: SensorHistory, milligravity: float) -> Stability:
    """Return a stated stability: the offset wanders by so many mg in a day, as a standard deviation."""
    coefficients = history.calibrations[-1].record.coefficients
    return Stability(
        {f"offset.{c}": (coefficients.own_sensitivity(c) * milligravity / 1000.0) ** 2 for c in coefficients.channels}
    )


def _content(coefficients: Coefficients) -> tuple[object, ...]:
    """Return what distinguishes two files of one date."""
    thermal = coefficients.thermal
    return values(coefficients), coefficients.mounting, None if thermal is None else (thermal.lag, thermal.range)

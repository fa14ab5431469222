"""The dated calibrations of one sensor, how far it wanders between them, and its calibration at any time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import cached_property
from itertools import pairwise
from math import inf, sqrt
from operator import attrgetter

import numpy as np

from tiltcal.calibration.comparison import Comparison, compare_records
from tiltcal.calibration.interpolation import Interval, Stability
from tiltcal.core.instrumental_drift import RandomWalk, WalkContrasts, estimate_walk, walk_contrasts
from tiltcal.core.model import Array, Coefficients
from tiltcal.core.named_coefficients import ROUNDED, referred, values
from tiltcal.errors import InputError, UsageError
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity, require_same_sensor, responses_to_priors
from tiltcal.files.moments import moment, to_the_second
from tiltcal.files.uncertainty import known_coefficients
from tiltcal.printable import counted

DAY = 86_400.0
"""Seconds."""

WANDERING = ("offset", "sensitivity")
"""What may wander, by the first part of its dotted name; temperature coefficients change along a line."""

STEADY_CONTRASTS = 4
"""Fewest contrasts without their part along a steady change from which a walk is estimated; with fewer it is kept."""

OWN_CONTRASTS = 10
"""Fewest contrasts of a sensor's own offsets with which its fleet is not asked."""


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

    @cached_property
    def series(self) -> dict[str, tuple[Array, ...]]:
        """Days, values and standard uncertainties of each coefficient that all have, at the last one's reference."""
        last = self.calibrations[-1].record.coefficients
        reference = None if last.thermal is None else last.thermal.reference
        found = []
        for calibration in self.calibrations:
            coefficients = calibration.record.coefficients
            moved = coefficients if reference is None else referred(coefficients, reference)
            known = known_coefficients(calibration.record.uncertainty, coefficients, reference)
            shared = responses_to_priors(calibration.record)  # errs alike in all, so that it makes no difference
            day = calibration.date.timestamp() / DAY
            alike = {name: float(row @ row) for name, row in shared.items()}
            u = {name: sqrt(max(c.u**2 - alike.get(name, 0.0), (ROUNDED * c.u) ** 2)) for name, c in known.items()}
            found.append({name: (day, value, u[name]) for name, value in values(moved).items() if name in u})
        common = [name for name in found[-1] if all(name in row for row in found)]
        return {name: tuple(np.array([row[name] for row in found]).T) for name in common}

    def contrasts(self, kind: str, *, steady: bool) -> WalkContrasts:
        """Return the contrasts of all coefficients of a kind, such as ``offset``."""
        if len(self.calibrations) < 2:
            return WalkContrasts.joined([])
        return WalkContrasts.joined(
            [
                walk_contrasts(*series, steady=steady)
                for name, series in self.series.items()
                if name.partition(".")[0] == kind
            ]
        )

    @property
    def wandering(self) -> list[str]:
        """The coefficients that may wander, by dotted name."""
        return [name for name in values(self.calibrations[-1].record.coefficients) if name.split(".")[0] in WANDERING]


def stated_stability(history: SensorHistory, milligravity: float) -> Stability:
    """Return a stated stability: the offset wanders by so many mg in a day, as a standard deviation."""
    coefficients = history.calibrations[-1].record.coefficients
    walks = {
        f"offset.{channel}": RandomWalk((coefficients.own_sensitivity(channel) * milligravity / 1000.0) ** 2, inf)
        for channel in coefficients.channels
    }
    return Stability(walks, walks, "as stated")


def estimated_stability(history: SensorHistory, fleet: Sequence[SensorHistory]) -> Stability:
    """Estimate how far a sensor wanders, from its own history where that is long enough, or with its fleet's.

    The fleet has the same model and unit, and the sensor is among it.
    """
    own = len(history.contrasts("offset", steady=True)) >= OWN_CONTRASTS
    asked = [history] if own else fleet
    source = "its own history" if own else f"the history of {len(fleet)} {history.sensor.model}"
    if len(fleet) < 2:
        source = "its own history"
    between: dict[str, RandomWalk] = {}
    beyond: dict[str, RandomWalk] = {}
    for kind in WANDERING:
        free = WalkContrasts.joined([history.contrasts(kind, steady=False) for history in asked])
        steady = WalkContrasts.joined([history.contrasts(kind, steady=True) for history in asked])
        walk = estimate_walk(free)
        if walk is None:
            continue
        names = [name for name in history.wandering if name.partition(".")[0] == kind]
        inner = estimate_walk(steady) if len(steady) >= STEADY_CONTRASTS else walk
        between |= dict.fromkeys(names, inner or walk)
        beyond |= dict.fromkeys(names, walk)
    return Stability(between, beyond, source if beyond else "")


def _content(coefficients: Coefficients) -> tuple[object, ...]:
    """Return what distinguishes two files of one date."""
    thermal = coefficients.thermal
    return values(coefficients), coefficients.mounting, None if thermal is None else (thermal.lag, thermal.range)

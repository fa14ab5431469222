"""The dated calibrations of the sensors in a folder, the calibration of one at any time, and the fleets they make.

Between two, each coefficient lies on the line that joins them, and its error has their weights: an error that both
share, such as that of a sensitivity that a renewed level took over, stays what it is, the others are independent. What
a coefficient may have wandered from the line adds to it, with the variance of a Brownian bridge: as it is stated, else
as the changes of three and more calibrations show it, with their few degrees of freedom; of two the whole change
counts. Beyond, the nearest calibration holds, and the wander grows with the time.

Source: B. Øksendal, *Stochastic Differential Equations*, exercise 5.11 (bridge).
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from functools import cached_property
from itertools import chain, pairwise
from math import inf
from operator import attrgetter
from pathlib import Path
from statistics import mode
from typing import Any

import numpy as np

from tiltcal.calibration.comparison import Comparison, compare_records, require_same_sensor, shared_errors
from tiltcal.calibration.stated import stated_section
from tiltcal.core.directions import common, tilts
from tiltcal.core.model import Array, Coefficients, Limits, overlap, referred, values, with_vector
from tiltcal.core.uncertain import Uncertain, weighted_sum
from tiltcal.errors import InputError, UsageError
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity, read_calibration
from tiltcal.files.calibration_folder import date_of, index_folder
from tiltcal.files.moments import to_the_second
from tiltcal.files.results import FitRecord, ProcedureRecord, Provenance
from tiltcal.printable import counted, did_you_mean
from tiltcal.stated_arguments import require_path, require_text

DAY = 86_400.0  # seconds
LARGEST_CHANGE = 0.5  # share by which the sensitivity of a channel may differ between two calibrations
WANDERING = ("offset.", "sensitivity.")  # what may wander; temperature coefficients follow their line


@dataclass(frozen=True)
class DatedCalibration:
    """A calibration file: when it ended (UTC), its path, and its name within the folder."""

    record: CalibrationRecord
    date: datetime
    path: str
    name: str


@dataclass(frozen=True)
class SensorHistory:
    """The calibrations of one sensor in the order of time."""

    calibrations: tuple[DatedCalibration, ...]

    @classmethod
    def of(cls, found: Sequence[DatedCalibration]) -> SensorHistory:
        """Put the calibrations of one sensor in order, copies left out; an InputError where two files contradict."""
        first, *rest = sorted(found, key=attrgetter("date"))
        kept = [first]
        for calibration in rest:
            _require_consistent(kept[-1], calibration)
            if calibration.date != kept[-1].date:
                kept.append(calibration)
        return cls(tuple(kept))

    def __repr__(self) -> str:
        dates = " to ".join(dict.fromkeys(f"{self.calibrations[end].date:%Y-%m-%d}" for end in (0, -1)))
        return f"<SensorHistory of {self.sensor.serial}: {counted(len(self.calibrations), 'calibration')}, {dates}>"

    @property
    def sensor(self) -> SensorIdentity:
        """The sensor."""
        return self.calibrations[-1].record.sensor

    @cached_property
    def comparisons(self) -> tuple[Comparison, ...]:
        """How each calibration but the first differs from the one before it."""
        return tuple(compare_records(a.record, b.record) for a, b in pairwise(self.calibrations))

    def due(self, interval: timedelta) -> datetime:
        """Return when the next calibration is due."""
        return self.calibrations[-1].date + interval

    def series(self, name: str) -> tuple[Array, Array] | None:
        """Return values and standard uncertainties of a coefficient that all have, at the last one's reference."""
        records = [calibration.record for calibration in self.calibrations]
        last = records[-1].coefficients.thermal
        reference = None if last is None else last.reference
        errors = [record.uncertain_at(reference) for record in records]
        if any(name not in one.names for one in errors):
            return None
        value = [values(referred(record.coefficients, reference))[name] for record in records]
        return np.array(value), np.array([one.u[one.names.index(name)] for one in errors])

    def at(self, time: float, stability: float | None = None) -> CalibrationRecord:
        """Return the calibration at a time, seconds since 1970: between two of them, or the nearest one.

        ``stability`` is how far the offset wanders in a day, mg; not stated, the changes show it.
        UsageError: the two calibrations do not lie on a line.
        """
        dates = [calibration.date.timestamp() for calibration in self.calibrations]
        k = max(min(bisect_right(dates, time), len(dates) - 1) - 1, 0)
        if dates[0] < time < dates[-1]:
            length = dates[k + 1] - dates[k]
            share = (time - dates[k]) / length
            bridge = share * (1.0 - share)
            walked = self._walked(k, bridge * length / DAY, stability)
            return _between(self.calibrations[k].record, self.calibrations[k + 1].record, share, walked)
        nearest = 0 if time <= dates[0] else -1
        record, days = self.calibrations[nearest].record, abs(time - dates[nearest]) / DAY
        if days:
            errors = _with_walk(record.uncertain, self._walked(k, days, stability))
            record = replace(record, uncertainty=stated_section(errors, record.uncertainty))
        return _without_measured(record)

    def require_line(self, k: int) -> None:
        """Refuse a calibration, counted from 0, and the next that do not lie on a line, with a UsageError."""
        before, after = self.calibrations[k : k + 2]
        one, other, named = before.record.coefficients, after.record.coefficients, f"{before.name} and {after.name}"
        kinds = [(c.axes, c.thermal is None, c.mounting is None) for c in (one, other)]
        if kinds[0] != kinds[1]:
            raise UsageError(
                f"{named}: one has axes, temperature terms or a mounting that the other has not: give both the same "
                "coefficients, such as with `tiltcal combine`"
            )
        for channel, new, old in zip(other.channels, other.sensitivity, one.sensitivity, strict=True):
            if np.linalg.norm(new - old) > LARGEST_CHANGE * np.linalg.norm(old):
                raise UsageError(
                    f"{named}: the sensitivity of {channel} differs by more than {LARGEST_CHANGE:.0%}, which is no "
                    "change with time: move the file that is wrong out of the folder"
                )

    def suggested_stability(self) -> float:
        """Return how far the offset wanders in a day by the changes, mg, the worst channel; 0 of one calibration."""
        coefficients, (rates, _) = self.calibrations[-1].record.coefficients, self._walk(0)
        each = [rates.get(f"offset.{c}", 0.0) / coefficients.own_sensitivity(c) ** 2 for c in coefficients.channels]
        return 1000.0 * float(np.sqrt(max(each)))

    def _walked(self, k: int, days: float, stability: float | None) -> Uncertain:
        """Return what coefficients wander in some days: as stated, or as the changes of all calibrations show it."""
        if stability is not None:
            coefficients = self.calibrations[-1].record.coefficients
            offsets = {f"offset.{c}": coefficients.own_sensitivity(c) / 1000.0 for c in coefficients.channels}
            return Uncertain.errors(tuple(offsets), np.diag([days * (stability * u) ** 2 for u in offsets.values()]))
        rates, dof = self._walk(k)
        return Uncertain.errors(tuple(rates), np.diag([days * rate for rate in rates.values()]), dof)

    def _walk(self, k: int) -> tuple[dict[str, float], float]:
        """Return the variance that each coefficient wanders in a day, unit²/day, and its degrees of freedom.

        The one change of two calibrations has hardly any: it counts whole, as the half width of a rectangle halfway.
        """
        if len(self.calibrations) == 1:
            return {}, inf
        self.require_line(k)
        thermal = self.calibrations[-1].record.coefficients.thermal
        reference = None if thermal is None else thermal.reference
        all_ = [values(referred(one.record.coefficients, reference)) for one in self.calibrations]
        days = [(after.date - before.date).total_seconds() / DAY for before, after in pairwise(self.calibrations)]
        names = [name for name in all_[-1] if name.startswith(WANDERING) and all(name in one for one in all_)]
        rates = {
            name: float(np.mean([(b[name] - a[name]) ** 2 / d for (a, b), d in zip(pairwise(all_), days, strict=True)]))
            for name in names
        }
        if len(days) > 1:
            return rates, float(len(days))
        return {name: 4.0 * rate / 3.0 for name, rate in rates.items()}, inf


class CalibrationFolder:
    """The calibrations in a folder, by serial number and date; each file is read when it is needed."""

    def __init__(self, folder: str | Path) -> None:
        require_path("the folder", folder)
        self.folder = Path(folder)
        self.index = index_folder(self.folder)
        self._histories: dict[str, SensorHistory] = {}

    @property
    def serials(self) -> tuple[str, ...]:
        """The serial numbers, in order."""
        return tuple(self.index.paths)

    @property
    def listed(self) -> str:
        """The serial numbers for a message, or as many as one line holds."""
        return (", ".join(self.serials[:12]) + (" ..." if len(self.serials) > 12 else "")) or "none"

    def history(self, serial: str) -> SensorHistory:
        """Return the calibrations of a sensor.

        Raises
        ------
        UsageError
            The folder has none of this serial number.
        InputError
            A file is wrong, or two contradict each other.
        """
        require_text("serial", serial)
        if serial not in self._histories:
            if serial not in self.index.paths:
                raise UsageError(self._unknown(serial))
            self._histories[serial] = SensorHistory.of([self._dated(path) for path in self.index.paths[serial]])
        return self._histories[serial]

    def _dated(self, path: str) -> DatedCalibration:
        record = read_calibration(path)
        name = Path(path).relative_to(self.folder).as_posix()
        return DatedCalibration(record, date_of(record, path), path, name)

    def _unknown(self, serial: str) -> str:
        hint = did_you_mean(serial, self.serials)
        unusable = f"; left out: {self.index.problems[0]}" if self.index.problems else ""
        return f"{self.folder} has no calibration of {serial!r}{hint}; it has {self.listed}{unusable}"


def _require_consistent(before: DatedCalibration, after: DatedCalibration) -> None:
    """Refuse another model, unit or channels, and one date with other coefficients, with an InputError."""
    serial = after.record.sensor.serial
    try:
        require_same_sensor(before.record, after.record)
    except UsageError as failure:
        raise InputError(
            f"{serial} is {failure}, in {before.path}: give each sensor a serial number of its own, or move one of the "
            "files",
            file=after.path,
        ) from None
    if before.date == after.date and repr(before.record.coefficients) != repr(after.record.coefficients):
        raise InputError(
            f"{before.path} has the same date, {to_the_second(after.date)}, and other coefficients of {serial}: keep "
            "one of them in the folder",
            file=after.path,
        )


def _between(before: CalibrationRecord, after: CalibrationRecord, share: float, walked: Uncertain) -> CalibrationRecord:
    """Return the calibration at a share of the time between two; what has ``walked`` adds to it."""
    weights, stated = (1.0 - share, share), (before.uncertainty, after.uncertainty)
    reference = None if after.coefficients.thermal is None else after.coefficients.thermal.reference
    ends = [record.uncertain_at(reference) for record in (before, after)]
    errors = _with_walk(weighted_sum(ends[0], ends[1], weights, shared_errors(before, after)), walked)
    single = {
        name: sum(weight * one.single_reading.get(name, u) for weight, one in zip(weights, stated, strict=True))
        for name, u in {**stated[0].single_reading, **stated[1].single_reading}.items()
    }
    alignment = sum(weight * one.alignment for weight, one in zip(weights, stated, strict=True))
    tilt = {a: overlap(before.limits.tilt.get(a), limits) or limits for a, limits in after.limits.tilt.items()}
    warmth, directions = overlap(before.limits.temperature, after.limits.temperature), after.limits.directions
    if directions is not None and before.limits.directions is not None:
        directions = common((before.limits.directions, directions))
        tilt = tilts(directions)
    limits = Limits(tilt, warmth, after.limits.reading, directions=directions)
    coefficients = _on_line(referred(before.coefficients, reference), after.coefficients, share)
    uncertainty = replace(stated_section(errors), single_reading=single, alignment=alignment)
    between = replace(after, coefficients=coefficients, limits=limits, uncertainty=uncertainty)
    return _without_measured(between)


def _on_line(before: Coefficients, after: Coefficients, share: float) -> Coefficients:
    """Return the coefficients between two at one reference temperature, in the mounting that is nearer in time."""
    thermal, bends = after.thermal, [one.nonlinearity for one in (before, after) if one.nonlinearity is not None]
    if thermal is not None and before.thermal is not None:
        thermal = replace(
            thermal,
            range=overlap(before.thermal.range, thermal.range),
            drift=max(before.thermal.drift, thermal.drift, key=np.size),
            gain=max(before.thermal.gain, thermal.gain, key=np.size),
            lag=(1.0 - share) * before.thermal.lag + share * thermal.lag,
        )
    mounting = before.mounting if share < 0.5 else after.mounting
    # The shapes of the higher orders, whose terms are 0 where one has none.
    wide = replace(after, thermal=thermal, nonlinearity=max(bends, key=np.size, default=None), mounting=mounting)
    old, new, names = values(before), values(after), list(values(wide))
    line = [(1.0 - share) * old.get(name, 0.0) + share * new.get(name, 0.0) for name in names]
    return with_vector(wide, names, np.array(line))


def _with_walk(errors: Uncertain, walked: Uncertain) -> Uncertain:
    """Add what each coefficient may have wandered; nothing where nothing is uncertain."""
    return weighted_sum(errors, walked, (1.0, 1.0), ()) if errors.names else errors


def _without_measured(record: CalibrationRecord) -> CalibrationRecord:
    """Return a record without what was measured for one of the calibrations alone."""
    provenance = Provenance(software=record.provenance.software)
    return replace(record, fit=FitRecord(), procedure=ProcedureRecord(), positions=(), provenance=provenance)


FEWEST_SENSORS = 3  # sensors of one model that make a distribution
FAR = 5.0  # robust standard deviations from the median of its fleet beyond which a sensor is an outlier


@dataclass(frozen=True)
class CoefficientDistribution:
    """A coefficient over the sensors of one model, each with its last calibration, ascending in value."""

    name: str
    values: Mapping[str, float]

    @property
    def median(self) -> float:
        """The median."""
        return float(np.median(list(self.values.values())))

    @property
    def spread(self) -> float:
        """The standard deviation; from the quartiles, so that outliers do not count (0.7413 times their distance)."""
        low, high = np.quantile(list(self.values.values()), [0.25, 0.75])
        return float(0.7413 * (high - low))

    @property
    def outliers(self) -> tuple[str, ...]:
        """Serial numbers, the most extreme first; none where more than half of the sensors have one value."""
        middle, reach = self.median, FAR * self.spread
        far = sorted(((abs(value - middle), serial) for serial, value in self.values.items()), reverse=True)
        return tuple(serial for distance, serial in far if distance > reach > 0.0)

    def __str__(self) -> str:
        low, *_, high = self.values.values()
        line = f"  {self.name:<26} {self.median:>12.6g} {self.spread:>12.4g} {low:>12.6g} {high:>12.6g}"
        return f"{line}   {', '.join(self.outliers)}".rstrip()

    def as_data(self) -> dict[str, Any]:
        """Return the distribution as plain data."""
        low, *_, high = self.values.values()
        stated = {"name": self.name, "n": len(self.values), "median": self.median, "spread": self.spread}
        return {**stated, "range": [low, high], "outliers": list(self.outliers), "values": dict(self.values)}


@dataclass(frozen=True)
class ModelFleet:
    """The sensors of one model and unit, with the distribution of each coefficient; ``reference`` in °C."""

    model: str
    unit: str
    reference: float | None
    histories: tuple[SensorHistory, ...]
    distributions: tuple[CoefficientDistribution, ...]

    @classmethod
    def of(cls, histories: Sequence[SensorHistory]) -> ModelFleet:
        """Return the fleet of sensors of one kind."""
        last = {history.sensor.serial: history.calibrations[-1].record.coefficients for history in histories}
        thermals = [coefficients.thermal for coefficients in last.values() if coefficients.thermal is not None]
        reference = mode(thermal.reference for thermal in thermals) if thermals else None
        named = {serial: values(referred(coefficients, reference)) for serial, coefficients in last.items()}
        distributions = []
        for name in dict.fromkeys(chain.from_iterable(named.values())):
            rows = sorted((row[name], serial) for serial, row in named.items() if name in row)
            if len(rows) >= FEWEST_SENSORS:
                distributions.append(CoefficientDistribution(name, {serial: value for value, serial in rows}))
        sensor = histories[0].sensor
        return cls(sensor.model, sensor.unit, reference, tuple(histories), tuple(distributions))


@dataclass(frozen=True)
class FleetHistory:
    """The history of a folder at a moment (UTC), of sensors that are calibrated again in an interval."""

    folder: str
    interval: timedelta
    now: datetime
    histories: tuple[SensorHistory, ...]
    models: tuple[ModelFleet, ...]
    problems: tuple[str, ...]

    def is_due(self, history: SensorHistory) -> bool:
        """Whether the next calibration of a sensor is due."""
        return history.due(self.interval) <= self.now

    def as_data(self) -> dict[str, Any]:
        """Return the history as plain data."""
        return {
            "folder": self.folder,
            "interval_days": self.interval / timedelta(days=1),
            "sensors": [self._sensor(history) for history in self.histories],
            "fleets": [
                {key: getattr(fleet, key) for key in ("model", "unit", "reference")}
                | {"coefficients": [distribution.as_data() for distribution in fleet.distributions]}
                for fleet in self.models
            ],
            "problems": list(self.problems),
        }

    def _sensor(self, history: SensorHistory) -> dict[str, Any]:
        dated = history.calibrations
        return {
            **{key: getattr(history.sensor, key) for key in ("serial", "model", "unit")},
            "calibrations": [{"file": one.path, "date": to_the_second(one.date)} for one in dated],
            "changes": [
                {"before": a.name, "after": b.name, "days": (b.date - a.date) / timedelta(days=1)} | found.as_data()
                for (a, b), found in zip(pairwise(dated), history.comparisons, strict=True)
            ],
            "due": to_the_second(history.due(self.interval)),
            "is_due": self.is_due(history),
        }

    def __str__(self) -> str:
        lines = []
        for history in self.histories:
            due = history.due(self.interval)
            word = "was due" if self.is_due(history) else "due"
            lines.append(f"{history.sensor.model} {history.sensor.serial}: {word} {due:%Y-%m-%d}")
            for place, calibration in enumerate(history.calibrations):
                words = f"  {history.comparisons[place - 1].in_words}" if place else ""
                lines.append(f"  {calibration.date:%Y-%m-%d}  {calibration.name}{words}")
        for fleet in self.models:
            at = "" if fleet.reference is None else f" at {fleet.reference:g} °C"
            lines += ["", f"{len(fleet.histories)} {fleet.model}, {fleet.unit}{at}"]
            lines.append(f"  {'':<26} {'median':>12} {'spread':>12} {'least':>12} {'most':>12}   outliers")
            lines += map(str, fleet.distributions)
        lines += ["", *(f"problem: {problem}" for problem in self.problems)] if self.problems else []
        return "\n".join(lines)


def fleet_history(library: CalibrationFolder, interval: timedelta, now: datetime) -> FleetHistory:
    """Return the history of all sensors of a folder, each calibrated again in an interval; ``now`` is in UTC."""
    problems = [str(problem) for problem in library.index.problems]
    kinds: dict[tuple[object, ...], list[SensorHistory]] = {}
    histories = []
    for serial in library.serials:
        try:
            history = library.history(serial)
            history.comparisons  # noqa: B018  (files that cannot be compared are problems)
        except InputError as problem:
            problems.append(str(problem))
            continue
        histories.append(history)
        sensor = history.sensor
        kinds.setdefault((sensor.model, sensor.unit, sensor.channels), []).append(history)
    fleets = map(ModelFleet.of, kinds.values())
    models = tuple(fleet for fleet in fleets if fleet.distributions)
    return FleetHistory(str(library.folder), interval, now, tuple(histories), models, tuple(problems))

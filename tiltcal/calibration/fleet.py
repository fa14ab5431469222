"""A fleet: all sensors of a folder, how each has changed, and how their coefficients are distributed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from itertools import chain
from statistics import mode
from typing import Any

import numpy as np

from tiltcal.calibration.season import CalibrationFolder, SensorHistory
from tiltcal.core.named_coefficients import referred, values
from tiltcal.errors import InputError
from tiltcal.files.moments import to_the_second

FEWEST_SENSORS = 3
"""Sensors of one model that make a distribution."""

FAR = 5.0
"""A sensor is an outlier where a coefficient is so many robust standard deviations from the median of its fleet."""


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
        far = {serial: abs(value - middle) for serial, value in self.values.items()}
        return tuple(sorted((serial for serial in far if far[serial] > reach > 0.0), key=lambda serial: -far[serial]))

    @property
    def line(self) -> str:
        """The distribution as a line of a table."""
        numbers = list(self.values.values())
        line = f"  {self.name:<26} {self.median:>12.6g} {self.spread:>12.4g} {numbers[0]:>12.6g} {numbers[-1]:>12.6g}"
        return f"{line}   {', '.join(self.outliers)}".rstrip()

    def as_data(self) -> dict[str, Any]:
        """Return the distribution as plain data."""
        numbers = list(self.values.values())
        return {
            "name": self.name,
            "n": len(numbers),
            "median": self.median,
            "spread": self.spread,
            "range": [numbers[0], numbers[-1]],
            "outliers": list(self.outliers),
            "values": dict(self.values),
        }


@dataclass(frozen=True)
class ModelFleet:
    """The sensors of one model and unit, with the distribution of each coefficient that three of them have.

    ``reference`` is the reference temperature of all coefficients, °C: that of most calibrations.
    """

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
    """The history of a folder at a moment (UTC): its sensors, its fleets, and files that cannot be used.

    Each sensor is calibrated again in an interval.
    """

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
                {
                    "model": fleet.model,
                    "unit": fleet.unit,
                    "reference": fleet.reference,
                    "coefficients": [distribution.as_data() for distribution in fleet.distributions],
                }
                for fleet in self.models
            ],
            "problems": list(self.problems),
        }

    def _sensor(self, history: SensorHistory) -> dict[str, Any]:
        dated = history.calibrations
        return {
            "serial": history.sensor.serial,
            "model": history.sensor.model,
            "unit": history.sensor.unit,
            "calibrations": [
                {"file": calibration.path, "date": to_the_second(calibration.date)} for calibration in dated
            ],
            "changes": [
                {"before": a.name, "after": b.name, "days": (b.date - a.date) / timedelta(days=1)} | found.as_data()
                for a, b, found in zip(dated, dated[1:], history.comparisons, strict=False)
            ],
            "due": to_the_second(history.due(self.interval)),
            "is_due": self.is_due(history),
            "gaps": [[to_the_second(a.date), to_the_second(b.date)] for a, b in history.gaps(self.interval)],
            "remarks": list(history.remarks),
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
            for a, b in history.gaps(self.interval):
                lines.append(f"  gap: {(b.date - a.date).days} days from {a.date:%Y-%m-%d} to {b.date:%Y-%m-%d}")
            lines += [f"  note: {remark}" for remark in history.remarks]
        for fleet in self.models:
            at = "" if fleet.reference is None else f" at {fleet.reference:g} °C"
            lines += ["", f"{len(fleet.histories)} {fleet.model}, {fleet.unit}{at}"]
            lines.append(f"  {'':<26} {'median':>12} {'spread':>12} {'least':>12} {'most':>12}   outliers")
            lines += [found.line for found in fleet.distributions]
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

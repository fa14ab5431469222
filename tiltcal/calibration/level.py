"""A new offset for a sensor that is calibrated already, from its reading where it is level.

A tilt meter that is plugged into its socket again sits a little askew. The reading at level then determines the offset
that belongs to it (*A Solid State Tilt Meter for Current Meter Attitude Determination*, section D); sensitivity and
temperature terms stay::

    offset = reading - drift(dT) - (1 + gain(dT)) S Rᵀ z

with the mounting R. What S, the temperature terms and R are uncertain by goes into the offset, with the covariance of
both. Away from level a sensor that sits askew by the small rotation θ errs by θ × (g - z): nothing at level, and by the
sine of the tilt where θ is about the vertical, which no level shows. The file states θ as ``uncertainty.alignment``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import asin, cos, degrees, hypot, radians, sin, sqrt

import numpy as np

from tiltcal.calibration.estimate_record import DIGITS, budget_record, intrinsic_record, rounded_covariance
from tiltcal.calibration.joint_fit import observations_of
from tiltcal.calibration.measurement import BenchUncertainty, Measurement, missing_temperature
from tiltcal.calibration.verdict import judge
from tiltcal.core.attitude import heading_rotations
from tiltcal.core.coverage_factor import COVERAGE, coverage_factor
from tiltcal.core.estimation.equations import ADC, JIG, NOISE, TABLE, THERMOMETER
from tiltcal.core.estimation.positions import Observation
from tiltcal.core.model import AXES, Array, Coefficients, vector_of, with_vector
from tiltcal.core.mounting_angles import mounting_matrix
from tiltcal.core.named_coefficients import CoefficientChange
from tiltcal.core.rounding import plus_minus, round_to, significant
from tiltcal.core.uncertainty_budget import Budget, Part, central_differences
from tiltcal.core.uncertainty_inputs import TURN, UncertaintyInputs, is_turn
from tiltcal.errors import EstimateError
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.procedure import Procedure
from tiltcal.files.results import NOISE_ALONE, CompletingRun, LevelFit
from tiltcal.files.uncertainty import Uncertainty, uncertainty_inputs

BASE = "base"
"""The share of an offset's variance that comes from the calibration that it completes."""

NEARLY_LEVEL = 5.0
"""The most that a position may be off level as it was set, degrees."""

SMALL_TURN = 1e-5
"""Turn by which derivatives are taken, radians."""

NO_LEVEL = (
    "how level the sensor lay is not stated (--jig, --table-lean), and the uncertainty of its offset leaves it out"
)

NO_NOISE = (
    "the noise of the mean is not stated (ux, uy), nor that of a reading by the base, and the uncertainty of the "
    "offset leaves it out"
)


def level(
    base: CalibrationRecord,
    measurements: Sequence[Measurement],
    procedure: Procedure,
    bench: BenchUncertainty,
) -> CalibrationRecord:
    """Return a calibration with the offset that a level position shows; all else is the base's.

    Parameters
    ----------
    base : CalibrationRecord
        Of the same sensor.
    measurements : sequence of Measurement
        One, or several at different headings, where the application is level.
    procedure : Procedure
        Its ``alignment`` is the most that the sensor may sit askew since the base was measured.

    Raises
    ------
    EstimateError
        A position is not level, or its temperature is missing and counts.
    """
    why = next(filter(None, (objection(base, measurement) for measurement in measurements)), "")
    if why:
        raise EstimateError(why)
    measurements = [_with_noise(measurement, base.uncertainty.single_reading) for measurement in measurements]
    silent = any(summary.noise_unknown for measurement in measurements for summary in measurement.summaries.values())
    found = _Renewal.of(base, measurements, bench)
    stated = bench.jig is not None or bench.table is not None
    u = found.budget.u[: len(found.offset)]
    coefficients = replace(
        base.coefficients,
        offset=np.array([round_to(value, u_value) for value, u_value in zip(found.offset, u, strict=True)]),
    )
    notes = [note for note in base.fit.notes if note not in (NO_LEVEL, NO_NOISE)]
    notes += ([] if stated else [NO_LEVEL]) + ([NO_NOISE] if silent else [])
    record = replace(
        base,
        coefficients=coefficients,
        uncertainty=found.uncertainty(procedure.alignment),
        fit=base.fit.replaced(
            uncertainty_from=base.fit.uncertainty_from if stated else NOISE_ALONE,
            budget={**base.fit.budget, **budget_record(found.budget, found.names[: len(found.offset)])},
            notes=tuple(notes),
            level=found.record(bench),
        ),
        procedure=base.procedure.replaced(
            level=CompletingRun(positions=tuple(measurement.position for measurement in measurements)),
        ),
        positions=base.positions_with(
            level=[measurement.record(base.coefficients.channels) for measurement in measurements]
        ),
    )
    before = base.derived.intrinsic
    if before is None:
        return record
    renewed = intrinsic_record(coefficients, found.inputs.without_turn, mounted=bool(before.rotation_degrees))
    return replace(record, derived=base.derived.replaced(intrinsic=renewed))


def _with_noise(measurement: Measurement, single: Mapping[str, float]) -> Measurement:
    """Return a measurement whose noise, where it is not stated, is that of so many readings of the base."""
    return replace(
        measurement,
        summaries={
            channel: replace(summary, u=hypot(summary.u, single[channel] / sqrt(summary.n)))
            if summary.noise_unknown and single.get(channel)
            else summary
            for channel, summary in measurement.summaries.items()
        },
    )


def level_summary(calibration: CalibrationRecord) -> str:
    """Return by how much the offsets have changed, and whether that is more than their uncertainty."""
    return "\n".join(_lines(calibration))


def _lines(calibration: CalibrationRecord) -> Iterator[str]:
    sensor, coefficients, found = calibration.sensor, calibration.coefficients, calibration.fit.level
    if found is None:
        return
    at = "" if found.temperature is None else f" at {found.temperature:g} °C"
    yield f"{sensor.model} {sensor.serial}, level{at}  (± standard uncertainty, k = 1)"
    for row, channel in enumerate(coefficients.channels):
        offset, change = float(coefficients.offset[row]), found.change[channel]
        column = coefficients.axes.index(channel) if channel in coefficients.axes else row
        angle = degrees(asin(max(-1.0, min(change / float(coefficients.sensitivity[row, column]), 1.0))))
        yield (
            f"  offset {channel}  {plus_minus(offset, calibration.uncertainty.get(f'offset.{channel}', 0.0))} "
            f"{sensor.unit}; was {offset - change:.6g}, changed by "
            f"{plus_minus(change, found.change_uncertainty.get(channel, 0.0), signed=True)} ({angle:+.3f}°)"
        )
    yield f"  {found.verdict}"
    askew = calibration.uncertainty.alignment
    if askew:
        yield (
            f"  the sensor may sit up to {askew * sqrt(3.0):.2g}° askew since its calibration (--alignment): nothing "
            f"at level, ±{2.0 * askew * sin(radians(30.0)):.2g}° (95 %) where the other axis is tilted by 30°"
        )


@dataclass(frozen=True)
class _Renewal:
    """The new offsets, by how much they have changed, and their covariance with all else that is uncertain.

    ``names`` are those of the offsets and then of the rest; turns of the mounting are in radians. ``factors`` are the
    base's of the rest.
    """

    base: CalibrationRecord
    offset: Array
    names: tuple[str, ...]
    budget: Budget
    changes: tuple[CoefficientChange, ...]
    temperature: float | None

    @classmethod
    def of(cls, base: CalibrationRecord, measurements: Sequence[Measurement], bench: BenchUncertainty) -> _Renewal:
        """Compute the offsets from the mean reading of the positions."""
        coefficients, channels = base.coefficients, base.coefficients.channels
        seen = observations_of(measurements, channels)
        stated = uncertainty_inputs(base.uncertainty, coefficients)
        known, covariance, factors = stated.names, stated.covariance, stated.factors
        at_level = _LevelReading(coefficients, seen)
        slopes = at_level.slopes(known)
        change = np.mean([measurement.mean for measurement in seen], axis=0) - at_level(known, at_level.start(known))
        own = np.array([[float(name == f"offset.{channel}") for name in known] for channel in channels])
        rest = [k for k, name in enumerate(known) if not name.startswith("offset.")]
        # An old offset is read anew: only what the other coefficients share with it is left.
        followed = np.vstack([own - slopes, np.eye(len(known))[rest]])
        errors = list(_errors_of_bench(at_level, seen, bench))
        alone = [replace(error, by=np.vstack([error.by, np.zeros((len(rest), error.by.shape[1]))])) for error in errors]
        budget = Budget.of([Part(BASE, followed, covariance, factors), *alone])
        changed = Budget.of([Part(BASE, slopes, covariance, factors), *errors])
        offsets = coefficients.offset + change
        return cls(
            base,
            offsets,
            (*(f"offset.{channel}" for channel in channels), *(known[k] for k in rest)),
            budget,
            tuple(
                CoefficientChange(f"offset.{channel}", float(new - step), float(new), float(u) or None, float(dof))
                for channel, new, step, u, dof in zip(channels, offsets, change, changed.u, changed.dof, strict=True)
            ),
            measurements[0].temperature,
        )

    @property
    def inputs(self) -> UncertaintyInputs:
        """The new offsets and all else that is uncertain."""
        return UncertaintyInputs(self.names, self.budget.covariance, self.budget.factors)

    def uncertainty(self, alignment: float) -> Uncertainty:
        """Return the base's uncertainty with that of the offsets, and of a sensor that may sit askew, degrees."""
        before, count = self.base.uncertainty, len(self.offset)
        offsets = self.names[:count]
        factors = dict(zip(offsets, self.budget.factors[:count].tolist(), strict=True))
        known = uncertainty_inputs(before, self.base.coefficients).names
        order = (*(name for name in offsets if name not in known), *known)
        joint = self.inputs.chosen([self.names.index(name) for name in order])
        u = dict(zip(offsets, self.budget.u[:count].tolist(), strict=True))
        return replace(
            before,
            standard={
                **{n: significant(value, DIGITS) for n, value in u.items()},
                **{n: v for n, v in before.items() if n not in u},
            },
            coverage_factor={
                **{name: round(k, 3) for name, k in factors.items() if u[name] > 0.0},
                **{name: k for name, k in before.coverage_factor.items() if name not in factors},
            },
            covariance=rounded_covariance(order, joint.covariance),
            alignment=max(significant(alignment / sqrt(3.0), DIGITS), before.alignment),
        )

    def record(self, bench: BenchUncertainty) -> LevelFit:
        """Return by how much the offsets have changed, for the file."""
        changes = dict(zip(self.base.coefficients.channels, self.changes, strict=True))
        incomplete = NO_LEVEL if bench.jig is None and bench.table is None else ""
        lean = [angle for angle in (bench.jig, bench.table) if angle is not None]
        return LevelFit(
            change={c: round_to(change.difference, change.u or 0.0) for c, change in changes.items()},
            change_uncertainty={c: significant(change.u, DIGITS) for c, change in changes.items() if change.u},
            change_coverage_factor={
                c: round(change.threshold(COVERAGE), 3) for c, change in changes.items() if change.u
            },
            verdict=str(judge(self.changes, incomplete)),
            temperature=None if self.temperature is None else round(self.temperature, 3),
            jig_degrees=significant(sqrt(sum(angle**2 for angle in lean)), DIGITS) if lean else None,
        )


@dataclass(frozen=True)
class _LevelReading:
    """The reading that a calibration expects, on average over the positions."""

    coefficients: Coefficients
    seen: Sequence[Observation]

    def __call__(self, names: Sequence[str], vector: Array, up: Array | None = None, warmer: float = 0.0) -> Array:
        """Return the mean reading, shape (channels,).

        Parameters
        ----------
        names : sequence of str
            Of coefficients and turns of the mounting, radians.
        vector : ndarray, shape (k,)
            Their values.
        up : ndarray, shape (positions, 3), optional
            Up in the application's frame; as it was set where it is left out.
        warmer : float
            Added to every temperature, °C.
        """
        turned = is_turn(names)
        own = np.array(names)[~turned].tolist()
        coefficients = with_vector(self.coefficients, own, vector[~turned])
        up = self.up if up is None else up
        for name, angle in zip(np.array(names)[turned].tolist(), vector[turned].tolist(), strict=True):
            up = up - np.cross(angle * np.eye(3)[AXES.index(name[len(TURN) :])], up)
        mounting = self.coefficients.mounting
        gravity = up if mounting is None else up @ mounting_matrix(mounting)
        thermal = coefficients.thermal is not None
        temperatures = (
            np.array([measurement.temperature for measurement in self.seen], dtype=float) + warmer if thermal else None
        )
        return np.asarray(coefficients.predict(gravity, temperatures).mean(axis=0))

    @property
    def up(self) -> Array:
        """Up in the application's frame as it was set, shape (positions, 3)."""
        return np.array([measurement.gravity for measurement in self.seen])

    def start(self, names: Sequence[str]) -> Array:
        """Return the values of the coefficients, and 0 for the turns of the mounting."""
        return np.array([0.0 if name.startswith(TURN) else vector_of(self.coefficients, [name])[0] for name in names])

    def slopes(self, names: Sequence[str]) -> Array:
        """Return the derivatives of the mean reading by the parameters, shape (channels, k)."""
        start = self.start(names)
        steps = SMALL_TURN * np.maximum(1.0, np.abs(start))
        return central_differences(lambda vector: self(names, vector), start, steps)

    def by_lean(self, headings: Sequence[float]) -> Array:
        """Return the derivatives by a lean that is turned with the headings, shape (channels, 2)."""
        turned = heading_rotations(np.radians(headings))

        def leaning(lean: Array) -> Array:
            return self((), np.zeros(0), self.up + np.pad(turned @ lean, ((0, 0), (0, 1))))

        return central_differences(leaning, np.zeros(2), np.full(2, SMALL_TURN))


def _errors_of_bench(at_level: _LevelReading, seen: Sequence[Observation], bench: BenchUncertainty) -> Iterator[Part]:
    """Yield what noise, jig, table and thermometer add to the mean reading."""
    count, channels = len(seen), len(at_level.coefficients.channels)
    adc = np.array([np.broadcast_to(measurement.adc, channels) for measurement in seen])
    noise = np.array([measurement.u for measurement in seen]) ** 2 - adc**2
    for measurement, variance in zip(seen, noise, strict=True):
        dof = np.broadcast_to(measurement.dof, channels)
        yield Part(NOISE, np.eye(channels) / count, np.diag(variance), coverage_factor(dof))
    # Rounding is alike in every position: it does not average out.
    yield Part.known(ADC, np.eye(channels), np.diag(np.max(adc, axis=0) ** 2))
    headings = [measurement.heading or 0.0 for measurement in seen]
    for source, angle, by, number in (
        (JIG, bench.jig, at_level.by_lean([0.0] * count), count),
        (TABLE, bench.table, at_level.by_lean(headings), 1),
    ):
        if angle:
            yield Part.known(source, by, np.eye(2) * radians(angle) ** 2 / number)
    if bench.thermometer and at_level.coefficients.thermal is not None:
        by = central_differences(
            lambda warmer: at_level((), np.zeros(0), warmer=float(warmer[0])), np.zeros(1), np.full(1, 1e-3)
        )
        yield Part.known(THERMOMETER, by, np.eye(1) * bench.thermometer**2)


def objection(base: CalibrationRecord, measurement: Measurement) -> str:
    """Return why a position cannot renew the offset of a calibration; empty where it can."""
    if measurement.gravity[2] < cos(radians(NEARLY_LEVEL)):
        return (
            f"{measurement.position} is not level, it was set to gravity "
            f"({', '.join(f'{g:.3g}' for g in measurement.gravity)}); how the sensor sits belongs into the mounting of "
            "its calibration: tiltcal combine CAL --mounting"
        )
    return missing_temperature(base, measurement)

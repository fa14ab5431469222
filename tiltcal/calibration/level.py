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

from tiltcal.calibration.comparison import changes, judge
from tiltcal.calibration.estimate_record import (
    DIGITS,
    budget_record,
    intrinsic_record,
    rounded_covariance,
    stated_section,
)
from tiltcal.calibration.joint_fit import observations_of
from tiltcal.calibration.measurement import BenchUncertainty, Measurement, missing_temperature
from tiltcal.core.attitude import heading_rotations
from tiltcal.core.estimation.equations import ADC, JIG, NOISE, TABLE, THERMOMETER
from tiltcal.core.estimation.positions import Observation
from tiltcal.core.model import AXES, Array, Coefficients
from tiltcal.core.mounting_angles import mounting_matrix
from tiltcal.core.rounding import plus_minus, round_to, significant
from tiltcal.core.uncertain import COVERAGE, TURN, Uncertain, selection
from tiltcal.errors import EstimateError
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.procedure import Procedure
from tiltcal.files.results import NOISE_ALONE, CompletingRun, LevelFit
from tiltcal.files.uncertainty import uncertain_coefficients

BASE = "base"
"""The share of an offset's variance that comes from the calibration that it completes."""

NEARLY_LEVEL = 5.0
"""The most that a position may be off level as it was set, degrees."""

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
    stated = bench.jig is not None or bench.table is not None
    coefficients, channels = base.coefficients, base.coefficients.channels
    change, renewed = _renewed(base, observations_of(measurements, channels), bench)
    offsets = coefficients.offset + change.value
    new = renewed.named(change.names)
    coefficients = replace(coefficients, offset=np.array(list(map(round_to, offsets.tolist(), new.u.tolist()))))
    notes = [note for note in base.fit.notes if note not in (NO_LEVEL, NO_NOISE)]
    notes += ([] if stated else [NO_LEVEL]) + ([NO_NOISE] if silent else [])
    askew = significant(procedure.alignment / sqrt(3.0), DIGITS)
    uncertainty = replace(
        stated_section(new, base.uncertainty),
        covariance=rounded_covariance(renewed),
        alignment=max(askew, base.uncertainty.alignment),
    )
    before = base.derived.intrinsic
    return replace(
        base,
        coefficients=coefficients,
        uncertainty=uncertainty,
        derived=base.derived
        if before is None
        else base.derived.replaced(
            intrinsic=intrinsic_record(coefficients, renewed.without(TURN), mounted=bool(before.rotation_degrees))
        ),
        fit=base.fit.replaced(
            uncertainty_from=base.fit.uncertainty_from if stated else NOISE_ALONE,
            budget={**base.fit.budget, **budget_record(new)},
            notes=tuple(notes),
            level=_level_fit(change, offsets, measurements[0].temperature, bench),
        ),
        procedure=base.procedure.replaced(
            level=CompletingRun(positions=tuple(measurement.position for measurement in measurements)),
        ),
        positions=base.positions_with(level=[measurement.record(channels) for measurement in measurements]),
    )


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


def _renewed(
    base: CalibrationRecord, seen: Sequence[Observation], bench: BenchUncertainty
) -> tuple[Uncertain, Uncertain]:
    """Return the change of the offsets, and the errors of the offsets with all else that is uncertain."""
    coefficients, known = base.coefficients, uncertain_coefficients(base.uncertainty, base.coefficients)
    expected = _ExpectedLevel.of(coefficients, seen)
    offsets = tuple(f"offset.{channel}" for channel in coefficients.channels)
    names = (*(name for name in offsets if name not in known.names), *known.names)
    slopes = np.array([expected.by_name[name] for name in known.names]).reshape(len(known.names), len(offsets)).T
    places = [names.index(name) for name in offsets]
    # An old offset is read anew: only what the other coefficients share with it is left.
    follows = selection(names, known.names)
    follows[places] -= slopes
    changed, renewed = known.through(slopes, offsets, source=BASE), known.through(follows, names, source=BASE)
    for error in _errors_of_bench(expected, seen, bench):
        changed, renewed = changed + error, renewed + error.through(selection(names, offsets), names)
    change = np.mean([observation.mean for observation in seen], axis=0) - expected.reading
    return replace(changed, value=change), renewed


def _level_fit(change: Uncertain, offsets: Array, temperature: float | None, bench: BenchUncertainty) -> LevelFit:
    """Return by how much the offsets have changed, for the file."""
    steps = changes(change, offsets - change.value)
    by_channel = {step.name.removeprefix("offset."): step for step in steps}
    known = {channel: step for channel, step in by_channel.items() if step.u}
    lean = [angle for angle in (bench.jig, bench.table) if angle is not None]
    return LevelFit(
        change={channel: round_to(step.difference, step.u or 0.0) for channel, step in by_channel.items()},
        change_uncertainty={channel: significant(step.u or 0.0, DIGITS) for channel, step in known.items()},
        change_coverage_factor={channel: round(step.threshold(COVERAGE), 3) for channel, step in known.items()},
        verdict=str(judge(steps, "" if lean else NO_LEVEL)),
        temperature=None if temperature is None else round(temperature, 3),
        jig_degrees=significant(hypot(*lean), DIGITS) if lean else None,
    )


@dataclass(frozen=True)
class _ExpectedLevel:
    """The reading that a calibration expects at level, on average over the positions, and its derivatives.

    Attributes
    ----------
    reading : ndarray, shape (channels,)
    by_name : dict of str to ndarray, shape (channels,)
        By each coefficient, and by each turn of the mounting, 1/rad.
    by_up : ndarray, shape (channels, positions, 3)
        By up in the application's frame, of a single position.
    by_temperature : ndarray, shape (channels,)
    """

    reading: Array
    by_name: dict[str, Array]
    by_up: Array
    by_temperature: Array

    @classmethod
    def of(cls, coefficients: Coefficients, seen: Sequence[Observation]) -> _ExpectedLevel:
        up, thermal = np.array([observation.gravity for observation in seen]), coefficients.thermal
        rotation = np.eye(3) if coefficients.mounting is None else mounting_matrix(coefficients.mounting)
        met = np.array([observation.temperature for observation in seen], dtype=float)
        dt = np.zeros(len(seen)) if thermal is None else np.nan_to_num(met - thermal.reference)
        read = [
            model.read(theta, up @ rotation, dt)
            for model, theta in zip(coefficients.models, coefficients.vectors, strict=True)
        ]
        alone = np.eye(len(read))
        by_name = {
            name: slope * alone[channel]
            for channel, (model, own) in enumerate(zip(coefficients.models, read, strict=True))
            for name, slope in zip(model.coefficients, own.by_coefficient.mean(axis=0).tolist(), strict=True)
        }
        by_up = np.array([own.by_gravity @ rotation.T for own in read])
        turned = np.cross(by_up, up).mean(axis=1)
        by_name |= {f"{TURN}{axis}": turned[:, k] for k, axis in enumerate(AXES)}
        by_temperature = np.array([own.by_temperature.mean() for own in read])
        return cls(np.array([own.value.mean() for own in read]), by_name, by_up, by_temperature)

    def by_lean(self, headings: Sequence[float]) -> Array:
        """Return the derivatives by a lean that is turned with the headings, shape (channels, 2), 1/rad."""
        turned = heading_rotations(np.radians(headings))
        return np.asarray(np.einsum("cni,nij->cj", self.by_up[..., :2], turned) / len(turned))


def _errors_of_bench(
    expected: _ExpectedLevel, seen: Sequence[Observation], bench: BenchUncertainty
) -> Iterator[Uncertain]:
    """Yield what noise, jig, table and thermometer add to the mean reading of each channel."""
    count, channels = len(seen), len(expected.reading)
    names, lean = [str(channel) for channel in range(channels)], ("x", "y")
    adc = np.array([np.broadcast_to(observation.adc, channels) for observation in seen])
    noise = np.array([observation.u for observation in seen]) ** 2 - adc**2
    for observation, variance in zip(seen, noise, strict=True):
        yield Uncertain.errors(names, np.diag(variance) / count**2, observation.dof, source=NOISE)
    # Rounding is alike in every position: it does not average out.
    yield Uncertain.errors(names, np.diag(np.max(adc, axis=0) ** 2), source=ADC)
    headings = [observation.heading or 0.0 for observation in seen]
    for source, angle, by, number in (
        (JIG, bench.jig, expected.by_lean([0.0] * count), count),
        (TABLE, bench.table, expected.by_lean(headings), 1),
    ):
        if angle:
            yield Uncertain.errors(lean, np.eye(2) * radians(angle) ** 2 / number, source=source).through(by, names)
    if bench.thermometer:
        by = expected.by_temperature
        yield Uncertain.errors(names, np.outer(by, by) * bench.thermometer**2, source=THERMOMETER)


def objection(base: CalibrationRecord, measurement: Measurement) -> str:
    """Return why a position cannot renew the offset of a calibration; empty where it can."""
    if measurement.gravity[2] < cos(radians(NEARLY_LEVEL)):
        return (
            f"{measurement.position} is not level, it was set to gravity "
            f"({', '.join(f'{g:.3g}' for g in measurement.gravity)}); how the sensor sits belongs into the mounting of "
            "its calibration: tiltcal combine CAL --mounting"
        )
    return missing_temperature(base, measurement)

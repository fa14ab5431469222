"""What completes the calibration of a sensor in its place: a new offset at level, or how it sits in its application.

A tilt meter that is plugged into its socket again sits a little askew. The reading at level then determines the offset
that belongs to it (*A Solid State Tilt Meter for Current Meter Attitude Determination*, section D); sensitivity and
temperature terms stay::

    offset = reading - drift(dT) - (1 + gain(dT)) S Rᵀ z

with the mounting R. What S, the temperature terms and R are uncertain by goes into the offset, with the covariance of
both. Away from level a sensor that sits askew by the small rotation θ errs by θ × (g - z): nothing at level, and by the
sine of the tilt where θ is about the vertical, which no level shows. The file states θ as ``uncertainty.alignment``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import cos, degrees, hypot, inf, radians, sqrt

import numpy as np

from tiltcal.calibration import stated
from tiltcal.calibration.comparison import changes, judge
from tiltcal.calibration.fit import observations_of
from tiltcal.calibration.measurement import BenchUncertainty, Measurement, missing_temperature
from tiltcal.core import attitude
from tiltcal.core.compensation import Compensation
from tiltcal.core.estimation.equations import ADC, BASE, JIG, NOISE, TABLE, THERMOMETER
from tiltcal.core.estimation.positions import Observation
from tiltcal.core.model import AXES, Array, Coefficients, Mounting, vector_of, with_vector
from tiltcal.core.rounding import round_to, significant
from tiltcal.core.uncertain import COVERAGE, TURN, Uncertain, central_differences, selection, weighted_sum
from tiltcal.errors import EstimateError
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.coefficients import ANGLES, TURNS
from tiltcal.files.procedure import LevelCompletion
from tiltcal.files.results import NOISE_ALONE, CompletingRun, LevelFit, MountingFit

NEARLY_LEVEL = 5.0  # largest tilt still accepted as level, degrees

NO_LEVEL = (
    "how level the sensor lay is not stated (--jig, --table-lean), and the uncertainty of its offset leaves it out"
)

NO_NOISE = "the noise of the mean is not stated (ux, uy), and the uncertainty of the offset leaves it out"

STEP = 1e-4  # a lean, radians, and a change of temperature, °C, by which derivatives are taken


def level(
    base: CalibrationRecord, measurements: Sequence[Measurement], procedure: LevelCompletion, bench: BenchUncertainty
) -> CalibrationRecord:
    """Return a calibration with the offset that level positions at some headings show; the rest is the base's."""
    for why in filter(None, (objection_to_level(base, measurement) for measurement in measurements)):
        raise EstimateError(why)
    silent = any(summary.noise_unknown for measurement in measurements for summary in measurement.summaries.values())
    lean_known = bench.jig is not None or bench.table_lean is not None
    channels, before = base.coefficients.channels, base.derived.intrinsic
    renewed, change = _renewed(base, observations_of(measurements, channels), bench)
    new = renewed.named(change.names)
    offset = base.coefficients.offset + change.value
    coefficients = replace(base.coefficients, offset=np.array(list(map(round_to, offset.tolist(), new.u.tolist()))))
    notes = [note for note in base.fit.notes if note not in (NO_LEVEL, NO_NOISE)]
    notes += ([] if lean_known else [NO_LEVEL]) + ([NO_NOISE] if silent else [])
    askew = significant(procedure.alignment / sqrt(3.0), stated.DIGITS)
    derived = base.derived
    if before is not None:
        mounted = bool(before.rotation_degrees)
        derived = derived.replaced(
            intrinsic=stated.intrinsic_record(coefficients, renewed.without(TURN), mounted=mounted)
        )
    return replace(
        base,
        coefficients=coefficients,
        uncertainty=replace(
            stated.stated_section(new, base.uncertainty),
            covariance=stated.rounded_covariance(renewed),
            alignment=max(askew, base.uncertainty.alignment),
        ),
        derived=derived,
        fit=base.fit.replaced(
            uncertainty_from=base.fit.uncertainty_from if lean_known else NOISE_ALONE,
            budget={**base.fit.budget, **stated.budget_record(new)},
            notes=tuple(notes),
            level=_level_fit(change, offset, measurements[0].temperature, bench),
        ),
        procedure=base.procedure.replaced(level=CompletingRun(positions=tuple(m.position for m in measurements))),
        positions=base.positions_with(level=[measurement.record(channels) for measurement in measurements]),
    )


def objection_to_level(base: CalibrationRecord, measurement: Measurement) -> str:
    """Return why a position cannot renew the offset of a calibration; empty where it can."""
    if measurement.gravity[2] < cos(radians(NEARLY_LEVEL)):
        return (
            f"{measurement.position} is not level, it was set to gravity "
            f"({', '.join(f'{g:.3g}' for g in measurement.gravity)}); how the sensor sits belongs into the mounting of "
            "its calibration: tiltcal combine CAL --mounting"
        )
    return missing_temperature(base, measurement)


def _renewed(
    base: CalibrationRecord, seen: Sequence[Observation], bench: BenchUncertainty
) -> tuple[Uncertain, Uncertain]:
    """Return the errors of the offsets with all else that is uncertain, and the change of the offsets."""
    coefficients, known = base.coefficients, base.uncertain
    up, size = np.array([observation.gravity for observation in seen]), len(known.names)
    rotation = np.eye(3) if coefficients.mounting is None else attitude.mounting_matrix(coefficients.mounting)
    warmth = np.array([observation.temperature for observation in seen], dtype=float)
    if coefficients.thermal is not None:
        warmth = np.where(np.isnan(warmth), coefficients.thermal.reference, warmth)
    headings = attitude.heading_rotations(np.radians([observation.heading or 0.0 for observation in seen]))
    own = [k for k, name in enumerate(known.names) if not name.startswith(TURN)]
    own_names = [known.names[k] for k in own]

    def reading(moved: Array) -> Array:
        """Return the mean reading by the coefficients and turns, leans of jig and table, and warmth, (channels,)."""
        errors = dict(zip(known.names, moved, strict=False))
        leaning = up + np.cross(up, [errors.get(f"{TURN}{axis}", 0.0) for axis in AXES])
        leaning[:, :2] += moved[size : size + 2] + headings @ moved[size + 2 : size + 4]
        sensor = with_vector(coefficients, own_names, moved[own])
        return np.asarray(sensor.predict(leaning @ rotation, warmth + moved[-1]).mean(axis=0))

    at = np.zeros(size + 5)
    at[own] = vector_of(coefficients, own_names)
    slopes = central_differences(reading, at, np.concatenate([known.u, np.full(5, STEP)]))
    offsets = tuple(f"offset.{channel}" for channel in coefficients.channels)
    names = (*(name for name in offsets if name not in known.names), *known.names)
    # An old offset is read anew: only what the other coefficients share with it is left.
    follows = selection(names, known.names)
    follows[[names.index(name) for name in offsets]] -= slopes[:, :size]
    renewed = known.through(follows, names, source=BASE)
    for error in _errors_of_bench(seen, bench, offsets, slopes[:, size:]):
        renewed = renewed + error.through(selection(names, offsets), names)
    change = weighted_sum(known, renewed, (-1.0, 1.0), [name for name in names if name not in offsets])
    mean = np.mean([observation.mean for observation in seen], axis=0)
    return renewed, replace(change.named(offsets), value=mean - reading(at))


def _errors_of_bench(
    seen: Sequence[Observation], bench: BenchUncertainty, names: Sequence[str], slopes: Array
) -> Iterator[Uncertain]:
    """Yield what the bench adds to the mean readings; ``slopes``: by leans of jig and table, and °C, (channels, 5)."""
    count = len(seen)
    adc = np.array([np.broadcast_to(observation.adc, len(slopes)) for observation in seen])
    noise = np.array([observation.u for observation in seen]) ** 2 - adc**2
    for observation, variance in zip(seen, noise, strict=True):
        yield Uncertain.errors(names, np.diag(variance) / count**2, observation.dof, source=NOISE)
    # Rounding is alike in every position: it does not average out.
    yield Uncertain.errors(names, np.diag(np.max(adc, axis=0) ** 2), source=ADC)
    for source, u, columns in (
        (JIG, radians(bench.jig or 0.0) / sqrt(count), slice(0, 2)),
        (TABLE, radians(bench.table_lean or 0.0), slice(2, 4)),
        (THERMOMETER, bench.thermometer or 0.0, slice(4, 5)),
    ):
        if u:
            yield Uncertain.errors(names, u**2 * slopes[:, columns] @ slopes[:, columns].T, source=source)


def _level_fit(change: Uncertain, offset: Array, temperature: float | None, bench: BenchUncertainty) -> LevelFit:
    """Return by how much the offsets have changed, for the file."""
    steps = changes(change, offset - change.value)
    by_channel = {step.name.removeprefix("offset."): (step, step.u or 0.0) for step in steps}
    known = {channel: pair for channel, pair in by_channel.items() if pair[1]}
    lean = [angle for angle in (bench.jig, bench.table_lean) if angle is not None]
    return LevelFit(
        change={channel: round_to(step.difference, u) for channel, (step, u) in by_channel.items()},
        change_uncertainty={channel: significant(u, stated.DIGITS) for channel, (_, u) in known.items()},
        change_coverage_factor={channel: round(step.threshold(COVERAGE), 3) for channel, (step, _) in known.items()},
        verdict=str(judge(steps, "" if lean else NO_LEVEL)),
        temperature=None if temperature is None else round(temperature, 3),
        jig_degrees=significant(hypot(*lean), stated.DIGITS) if lean else None,
    )


def mount(base: CalibrationRecord, measurements: Sequence[Measurement], *, jig: float | None) -> CalibrationRecord:
    """Return a calibration with the mounting that the positions show; their gravity is in the application's frame."""
    for why in filter(None, (missing_temperature(base, measurement) for measurement in measurements)):
        raise EstimateError(why)
    seen = observations_of(measurements, base.coefficients.channels)
    up, own = np.array([one.gravity for one in seen]), replace(base.coefficients, mounting=None)
    found, side, sigma = _solved(own, seen, up, jig)
    known = base.uncertain.without(TURN)

    def errors(vector: Array) -> Array:
        """Return the directions and the turn that other coefficients would give, shape (3 positions + 3,)."""
        directions = _directions(with_vector(own, known.names, vector), seen, side)
        turn = attitude.mounting_rotation(directions, up, sigma) @ found.matrix.T
        return np.concatenate([directions.ravel(), attitude.rotation_vector(turn)])

    slopes = central_differences(errors, vector_of(own, known.names), known.u)
    size = len(known.names)
    follows = np.eye(size + 3)
    follows[size:, :size] = slopes[-3:]
    positions = Uncertain.errors(TURNS, found.covariance, inf if found.stated else float(found.dof))
    joint = known.beside(positions).through(follows, (*known.names, *TURNS))
    p = None
    if sigma is not None and jig:
        from scipy.special import chdtrc

        of_base = np.einsum("ik,kl,il->i", slopes[:-3], known.covariance, slopes[:-3]).reshape(-1, 3).sum(axis=1) / 2.0
        p = significant(float(chdtrc(found.dof, np.sum(found.residuals**2 / (sigma**2 + of_base)))), 3)
    fit = MountingFit(
        residuals_degrees={
            one.position: round(degrees(float(r)), 4) for one, r in zip(seen, found.residuals, strict=True)
        },
        degrees_of_freedom=found.dof,
        uncertainty_from="stated jig" if found.stated else "residuals",
        chi_square=significant(found.chi_square, 4) if found.stated and jig else None,
        p_value=p,
    )
    mounting, locked, angles, factors = _angles(found.matrix, joint)
    return replace(
        base,
        coefficients=replace(base.coefficients, mounting=mounting),
        uncertainty=replace(
            base.uncertainty,
            standard={**base.uncertainty.without_mounting().standard, **angles},
            coverage_factor={name: round(k, 3) for name, k in factors.items()},
            covariance=stated.rounded_covariance(joint),
        ),
        derived=base.derived.replaced(gimbal_lock=base.derived.gimbal_lock or locked),
        fit=base.fit.replaced(mounting=fit),
        procedure=base.procedure.replaced(mounting=CompletingRun(positions=tuple(one.position for one in seen))),
        positions=base.positions_with(mounting=[m.record(list(m.summaries)).replaced(u=None) for m in measurements]),
    )


def _angles(matrix: Array, joint: Uncertain) -> tuple[Mounting, bool, dict[str, float], dict[str, float]]:
    """Return a mounting with the digits that its uncertainty warrants, whether it is in gimbal lock, and what is stated
    of it beside the coefficients: standard uncertainties, degrees, and the coverage factors of all."""
    mounting, locked = attitude.mounting_angles(matrix)
    u: dict[str, float] = {}
    factors = joint.by_name(joint.factors)
    if not locked:
        angles = joint.named(TURNS).through(attitude.angle_derivatives(attitude.mounting_matrix(mounting)), ANGLES)
        u = {name: degrees(value) for name, value in angles.by_name(angles.u).items()}
        locked = attitude.is_locked(mounting.pitch, float(angles.u[ANGLES.index("pitch")]))
        # Where roll and yaw cannot be separated their sum or difference is as well known as the pitch.
        digits = dict.fromkeys(ANGLES, u["pitch"]) if locked else u
        mounting = Mounting(
            **{name: radians(round_to(degrees(getattr(mounting, name)), digits[name])) for name in ANGLES}
        )
        factors |= {f"mounting.{name}": k for name, k in angles.by_name(angles.factors).items()}
        if locked:
            u |= dict.fromkeys(("roll", "yaw"), degrees(attitude.UNKNOWN_ANGLE))
            factors |= dict.fromkeys(("mounting.roll", "mounting.yaw"), attitude.UNKNOWN_FACTOR)
    return mounting, locked, {f"mounting.{name}": significant(value, 4) for name, value in u.items()}, factors


def _solved(
    coefficients: Coefficients, seen: Sequence[Observation], up: Array, jig: float | None
) -> tuple[attitude.MountingEstimate, float, Array | None]:
    """Return the mounting, the side of z (-1: two axes hang upside down), and u of each direction, radians."""
    candidates = []
    for side in (1.0,) if len(coefficients.channels) == 3 else (1.0, -1.0):
        start = _directions(coefficients, seen, side)
        sigma = None
        if jig is not None:
            noise = np.diag(np.ones(len(coefficients.channels)))[:, None] * [position.u for position in seen]
            moved = [_directions(coefficients, seen, side, shift) - start for shift in noise]
            square = np.sum(np.square(moved), axis=(0, 2)) / 2.0  # a direction has two angles
            sigma = np.maximum(np.hypot(radians(jig), np.sqrt(square)), 1e-6)
        candidates.append((attitude.solve_mounting(start, up, sigma), side, sigma))
    return min(candidates, key=lambda candidate: float(np.sum(candidate[0].residuals ** 2)))


def _directions(
    coefficients: Coefficients, seen: Sequence[Observation], side: float, shift: Array | float = 0.0
) -> Array:
    """Return up in the sensor's frame, unit vectors of shape (positions, 3), of readings that are shifted.

    The kernel takes the z that two channels do not see for up. Upside down (``side`` -1) that is -z: the z column is
    negated, so that the right coupling is taken out of x and y, and z is turned back.
    """
    if not {"x", "y"} <= set(coefficients.channels):
        raise EstimateError("the mounting is found from the x and y channels at least, and this sensor lacks one")
    sensitivity = coefficients.sensitivity * [side if axis == "z" else 1.0 for axis in coefficients.axes]
    compensation = Compensation(replace(coefficients, sensitivity=sensitivity, mounting=None))
    temperatures = np.array([position.temperature for position in seen], dtype=float)
    gravity = compensation(np.array([position.mean for position in seen]) + shift, temperatures).gravity
    if gravity.shape[1] == 2:
        rest = np.sqrt(np.maximum(1.0 - np.sum(gravity**2, axis=1), 0.0))
        gravity = np.column_stack([gravity, rest])
    return np.asarray(gravity * (1.0, 1.0, side) / np.linalg.norm(gravity, axis=1, keepdims=True))

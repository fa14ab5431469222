"""From measured positions to a calibration: the one path of the bench, of its replay, and of recorded logs.

What a procedure asks for is decided here and nowhere else: whether the positions are free, whether a mounting completes
a base, which order of the drift the data warrant, whether typical temperature curves stand in, what the user states of
the bench, and what a table of means leaves unsaid.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from tiltcal.calibration.angle_units import finished, read_in_degrees, remarks, with_convention
from tiltcal.calibration.fit import fit_jointly
from tiltcal.calibration.measurement import BenchUncertainty, MeasuredSensor, Measurement, require_own_readings
from tiltcal.calibration.priors import design_of
from tiltcal.core.rounding import round_to
from tiltcal.drivers.model import ACCELERATION
from tiltcal.errors import EstimateError
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.procedure import (
    Completion,
    FreePositions,
    LevelCompletion,
    MountingCompletion,
    PositionProcedure,
    Positions,
    Ramp,
)


def calibrate(
    sensors: Sequence[MeasuredSensor],
    procedure: PositionProcedure,
    bench: BenchUncertainty,
    *,
    typical_temperature: bool = False,
    table: bool = False,
    gravity: float | None = None,
    angles: str | None = None,
    settings: Mapping[str, Any] | None = None,
) -> list[CalibrationRecord]:
    """Calibrate the sensors of one fixture by the positions of a procedure, which they share; a record for each."""
    own: Mapping[str, Any] = settings or {}
    for sensor in sensors:
        require_own_readings(sensor)
    measured, sensors = sensors, [read_in_degrees(sensor, procedure, angles) for sensor in sensors]
    step = max(sensor.thermometer_rounding for sensor in sensors)
    known = bench if bench.thermometer is not None else replace(bench, thermometer=step or None)
    sensors = [with_convention(sensor, procedure, known) for sensor in sensors]
    for sensor in sensors if table and isinstance(procedure, Positions) else ():
        design = design_of(sensor.sensor, procedure, known, nominal=sensor.nominal, base=sensor.base)
        unknowns = len(set(design.names) - set(design.priors))
        _require_stated(sensor.measurements, len(sensor.measurements) * len(design.channels) - unknowns)
    found = _by_kind(sensors, procedure, bench, known)
    if own and isinstance(procedure, Completion):
        part = "mounting" if isinstance(procedure, MountingCompletion) else "level"
        own = {part: getattr(found[0].procedure, part).replaced(**own)}
    if typical_temperature:
        from tiltcal.calibration.temperature import with_typical_temperature

        found = list(map(with_typical_temperature, found, sensors))
    if table and not procedure.needs_base:
        found = [_of_table(record, its.measurements) for record, its in zip(found, sensors, strict=True)]
    found = [replace(record, procedure=record.procedure.replaced(**own)) for record in found]
    said = [remarks(before, sensor) for before, sensor in zip(measured, sensors, strict=True)]
    found = list(map(finished, found, said))
    return found if gravity is None else [_of_local_gravity(record, gravity) for record in found]


def _by_kind(
    sensors: Sequence[MeasuredSensor], procedure: PositionProcedure, bench: BenchUncertainty, known: BenchUncertainty
) -> list[CalibrationRecord]:
    """Return what a kind of procedure determines; ``known`` is the bench with the thermometers of the sensors."""
    bases = [(sensor.base, sensor.measurements) for sensor in sensors if sensor.base is not None]
    match procedure:
        case MountingCompletion():
            from tiltcal.calibration.complete import mount

            return [mount(base, measurements, jig=bench.jig) for base, measurements in bases]
        case LevelCompletion():
            from tiltcal.calibration.complete import level

            return [level(base, measurements, procedure, known) for base, measurements in bases]
        case Ramp():
            from tiltcal.calibration.temperature import calibrate_ramp

            return [calibrate_ramp(sensor, procedure, bench) for sensor in sensors]
        case FreePositions():
            from tiltcal.calibration.free import calibrate_free

            return [calibrate_free(sensor, procedure, known) for sensor in sensors]
        case Positions(cross_validated=True):
            from tiltcal.calibration.temperature import calibrate_sweep

            return calibrate_sweep(sensors, procedure, known)
    return fit_jointly(sensors, procedure, known)


def _of_table(calibration: CalibrationRecord, measurements: Sequence[Measurement]) -> CalibrationRecord:
    """Keep in the record of positions what the table states, and nothing else."""
    stated = _require_stated(measurements, calibration.fit.degrees_of_freedom or 0)
    kept = (position.replaced(std=None, u=position.u if stated else None) for position in calibration.positions)
    return replace(calibration, positions=tuple(kept))


def _require_stated(measurements: Sequence[Measurement], dof: int) -> bool:
    """Return whether a table states uncertainties; refused where it has neither these nor a degree of freedom."""
    stated = any(one.u > one.quantisation for measurement in measurements for one in measurement.summaries.values())
    if not stated and dof <= 0:
        raise EstimateError(
            "the table states no uncertainties (ux, uy, uz) and has no position more than there are unknowns: nothing "
            "says how good the result is; add either"
        )
    return stated


def _of_local_gravity(calibration: CalibrationRecord, gravity: float) -> CalibrationRecord:
    """Add the main sensitivities per m/s² and, for readings in m/s², by how much they are off."""
    coefficients = calibration.coefficients
    own = {c: coefficients.own_sensitivity(c) / gravity for c in coefficients.channels if c in coefficients.axes}
    u = {channel: calibration.uncertainty[f"sensitivity.{channel}.{channel}"] / gravity for channel in own}
    off = {c: round_to(100.0 * (value - 1.0), 100.0 * u[c]) for c, value in own.items()}
    derived = calibration.derived.replaced(
        gravity_m_s2=gravity,
        sensitivity_per_m_s2={c: round_to(value, u[c]) for c, value in own.items()},
        scale_error_percent=off if calibration.sensor.unit in ACCELERATION else {},
    )
    return replace(calibration, derived=derived)

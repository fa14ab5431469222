"""The positions as set and measured, their residuals, and the verdict on them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from tiltcal.calibration.summary import fit_lines
from tiltcal.core.rounding import plus_minus
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.results import FitRecord, LevelFit, MountingFit, PositionRecord, PositionSet
from tiltcal.report.number_format import AlignedNumber, at_place, column, measured, plain, signed


@dataclass(frozen=True)
class PositionRow:
    """One position: its setting, means and residuals.

    Attributes
    ----------
    set : str
        The angles, or up.
    mean, residual : sequence of AlignedNumber
        Per channel.
    suspect : bool
        Whether it was further off than stated.
    """

    name: str
    set: str
    temperature: AlignedNumber
    n: str
    mean: Sequence[AlignedNumber]
    residual: Sequence[AlignedNumber]
    suspect: bool


def position_table(calibration: CalibrationRecord) -> list[PositionRow]:
    """Return every measured position, in order."""
    channels, fit, records = calibration.coefficients.channels, calibration.fit, calibration.positions
    names = [record.position for record in records]
    # Positions of a mounting come last and were not fitted; they may bear a name that was.
    fitted = [name in fit.residuals and name not in names[:k] for k, name in enumerate(names)]
    runs = calibration.procedure.mounting, calibration.procedure.level
    mounted, levelled = (0 if run is None else len(run.positions) for run in runs)
    first = len(names) - mounted - levelled
    set_for = [as_set(calibration.procedure.set.get(name, PositionSet())) for name in names[:first]]
    set_for += ["for the mounting"] * mounted + ["level, for the offset"] * levelled
    temperatures = column(_told(record.temperature, 2) for record in records)
    means = [column(_mean(record, channel) for record in records) for channel in channels]
    decimals = _decimals(max((abs(v) for row in fit.residuals.values() for v in row.values()), default=0.0))
    left = [
        column(
            _told(fit.residuals[name].get(channel), decimals) if known else ""
            for name, known in zip(names, fitted, strict=True)
        )
        for channel in channels
    ]
    return [
        PositionRow(
            name,
            set_for[k],
            temperatures[k],
            "" if records[k].n is None else str(records[k].n),
            [mean[k] for mean in means],
            [residuals[k] for residuals in left],
            fitted[k] and name in fit.suspect_positions,
        )
        for k, name in enumerate(names)
    ]


def as_set(position: PositionSet) -> str:
    """Return the attitude of a position as text: the set angles, or the direction that points up."""
    said = [f"{axis} {signed(f'{angle:g}')}°" for axis, angle in (position.tilt or {}).items()]
    if position.gravity is not None:
        said.append(f"up ({', '.join(_short(component) for component in position.gravity)})")
    for label, angle in (("heading", position.heading), ("stage", position.stage)):
        if angle is not None:
            said.append(f"{label} {signed(f'{angle:g}')}°")
    if position.temperature is not None:
        said.append(f"{signed(f'{position.temperature:g}')} °C")
    return ", ".join(said)


def remarks(calibration: CalibrationRecord) -> list[str]:
    """Return the notes and warnings of the file, word for word."""
    fit = calibration.fit
    warned = [fit.warning] if fit.warning else []
    return [*fit.notes, *warned, *(f"assumed: {name}" for name in calibration.derived.assumed)]


def verdict(calibration: CalibrationRecord) -> Iterator[str]:
    """Yield the verdict on the fit, in sentences."""
    fit, unit = calibration.fit, calibration.sensor.unit
    yield from (f"{line[:1].upper()}{line[1:]}." for line in fit_lines(calibration))
    if fit.jig_degrees is not None:
        yield f"Stated standard uncertainty of a set angle: {fit.jig_degrees:g}°."
    if fit.thermometer_celsius is not None:
        yield f"Standard uncertainty of a temperature: {plain(fit.thermometer_celsius, 2)} °C."
    if fit.misfit_rms_mg is not None:
        where = "" if fit.distinct_attitudes is None else f" in {fit.distinct_attitudes} attitudes"
        yield f"The misfit of the length of gravity is {plain(fit.misfit_rms_mg, 3)} mg rms{where}."
    yield from _swept(fit, unit)
    yield from _mounted(fit.mounting)
    yield from _levelled(fit.level, unit)


def _swept(fit: FitRecord, unit: str) -> Iterator[str]:
    chosen = fit.cross_validation
    if chosen is not None:
        listed = ", ".join(f"{plain(error, 3)} for order {order}" for order, error in chosen.error_by_order.items())
        yield (
            f"Cross-validation chose a drift of order {chosen.order}; the mean square error of predicting a left-out "
            f"position, over its variance, is {listed}."
        )
    for channel, loop in fit.hysteresis.items():
        yield f"Hysteresis of {channel}: {plain(loop.difference, 2)} {unit} between {' and '.join(loop.between)}."


def _mounted(fit: MountingFit | None) -> Iterator[str]:
    if fit is None or not fit.residuals_degrees:
        return
    worst = max(fit.residuals_degrees, key=lambda name: abs(fit.residuals_degrees[name]))
    yield (
        f"Mounting: {fit.degrees_of_freedom} degrees of freedom, uncertainty from {fit.uncertainty_from}, largest "
        f"residual {plain(fit.residuals_degrees[worst], 3)}° in {worst}"
        + ("." if fit.chi_square is None else f", χ² {plain(fit.chi_square, 4)}.")
    )


def _levelled(fit: LevelFit | None, unit: str) -> Iterator[str]:
    if fit is None:
        return
    changes = [
        f"{channel} by {signed(plus_minus(change, fit.change_uncertainty.get(channel, 0.0)))} {unit}"
        for channel, change in fit.change.items()
    ]
    yield f"A level position has renewed the offset: it changed in {' and in '.join(changes)}; {fit.verdict}."


def _mean(record: PositionRecord, channel: str) -> str:
    mean, u = record.mean.get(channel), (record.u or {}).get(channel)
    if mean is None:
        return ""
    return measured(mean, u, 7)


def _decimals(scale: float) -> int:
    """Return the number of decimals that gives the largest of some numbers three digits."""
    from math import floor, log10

    return min(max(2 - floor(log10(scale)), 0), 12) if scale > 0.0 else 2


def _told(value: float | None, decimals: int) -> str:
    return "" if value is None else at_place(value, decimals)


def _short(component: float) -> str:
    return at_place(component, 3).rstrip("0").rstrip(".")

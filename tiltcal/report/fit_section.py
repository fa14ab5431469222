"""How well the positions agree: the positions as set and measured, and the verdict on them in words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tiltcal.calibration.summary import INCREDIBLE
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.report.number_format import AlignedNumber, at_place, column, measured, plain, signed
from tiltcal.report.record import in_words, items, number, numbers, section, text


@dataclass(frozen=True)
class PositionRow:
    """One position: as it was set, what was read, and what the model leaves.

    Attributes
    ----------
    name : str
    set : str
        The angles, or up.
    temperature : AlignedNumber
    n : str
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
    """Every position that was measured, in order."""
    channels = calibration.coefficients.channels
    residuals = section(calibration.fit, "residuals")
    suspects = section(calibration.fit, "suspect_positions")
    told = [record for record in calibration.positions if text(record, "position")]
    names = [text(record, "position") or "" for record in told]
    # Positions of a mounting come last and were not fitted; they may bear a name that was.
    fitted = [name in residuals and name not in names[:k] for k, name in enumerate(names)]
    temperatures = column(_told(number(record, "temperature"), 2) for record in told)
    means = [column(_mean(record, channel) for record in told) for channel in channels]
    decimals = _decimals(max((abs(v) for name in residuals for v in numbers(residuals, name).values()), default=0.0))
    left = [
        column(
            _told(number(residuals, name, channel), decimals) if known else ""
            for name, known in zip(names, fitted, strict=True)
        )
        for channel in channels
    ]
    return [
        PositionRow(
            name,
            as_set(section(calibration.procedure, "set", name)) if fitted[k] else "for the mounting",
            temperatures[k],
            text(told[k], "n") or "",
            [one[k] for one in means],
            [one[k] for one in left],
            fitted[k] and name in suspects,
        )
        for k, name in enumerate(names)
    ]


def as_set(position: Mapping[str, Any]) -> str:
    """The attitude of a position in words: the angles that were set, or where up was."""
    said = [f"{axis} {signed(f'{angle:g}')}°" for axis, angle in numbers(position, "tilt").items()]
    gravity = items(position, "gravity")
    if gravity:
        said.append(f"up ({', '.join(_short(component) for component in gravity)})")
    heading = number(position, "heading")
    if heading is not None:
        said.append(f"heading {signed(f'{heading:g}')}°")
    known = ("tilt", "gravity", "heading")
    said += [f"{key} {in_words(value)}" for key, value in position.items() if key not in known]
    return ", ".join(said)


def verdict(calibration: CalibrationRecord) -> list[str]:
    """What the fit says, in sentences."""
    return list(_sentences(calibration.fit, calibration.sensor.unit))


def remarks(calibration: CalibrationRecord) -> list[str]:
    """Notes and warnings of the file, word for word."""
    fit = calibration.fit
    noted = [in_words(note) for note in items(fit, "notes")]
    warned = [said for key in ("warning", "warnings", "note") if (said := text(fit, key))]
    assumed = [f"assumed: {in_words(one)}" for one in items(calibration.derived, "assumed")]
    return [*noted, *warned, *assumed]


def _sentences(fit: Mapping[str, Any], unit: str) -> Iterator[str]:
    dof, chi_square, p = (number(fit, key) for key in ("degrees_of_freedom", "chi_square", "p_value"))
    if chi_square is not None and dof is not None:
        yield _judged(chi_square, dof, p)
    elif dof == 0:
        yield "No degree of freedom is left: the positions fit whatever was read, and nothing checks them."
    elif dof is not None:
        yield (
            f"{dof:g} degrees of freedom are left. No jig was stated to judge them by: the uncertainties rest on the "
            "scatter of the residuals themselves."
        )
    suspects = section(fit, "suspect_positions")
    if suspects:
        off = {name: number(suspects, name, "off_degrees") for name in suspects}
        told = (name if angle is None else f"{name} (by {plain(angle, 3)}°)" for name, angle in off.items())
        yield f"Further off than stated: {', '.join(told)}."
    worst = section(fit, "worst")
    residual = number(worst, "residual")
    if residual is not None:
        yield (
            f"The largest residual is {plain(residual, 4)} {unit}, of channel {text(worst, 'channel')} in "
            f"{text(worst, 'position')}."
        )
    yield from _benches(fit)
    misfit = number(fit, "misfit_rms_mg")
    if misfit is not None:
        attitudes = text(fit, "distinct_attitudes")
        yield f"Gravity is met to {plain(misfit, 3)} mg rms" + (f" in {attitudes} attitudes." if attitudes else ".")
    yield from _swept(fit, unit)
    yield from _mounted(section(fit, "mounting"))


def _judged(chi_square: float, dof: float, p: float | None) -> str:
    found = f"χ² is {plain(chi_square, 4)} with {dof:g} degrees of freedom"
    if p is None:
        return f"{found}."
    if p < INCREDIBLE:
        return (
            f"{found}; so much or more has a probability of {plain(p, 2)}. The positions do not agree with the noise "
            "and the jig as they were stated: the bench was worse than that, or a position is wrong. The uncertainties "
            "have not been widened."
        )
    return (
        f"{found}; so much or more has a probability of {plain(p, 2)}. The positions agree with the noise and the jig "
        "as they were stated."
    )


def _benches(fit: Mapping[str, Any]) -> Iterator[str]:
    jig, shows = number(fit, "jig_degrees"), number(fit, "jig_estimated_degrees")
    thermometer = number(fit, "thermometer_celsius")
    if jig is not None:
        yield f"Stated standard uncertainty of a set angle: {jig:g}°."
    if shows == 0.0:
        yield "The residuals show no error of the jig beyond their noise; none was stated."
    elif shows is not None:
        yield f"The residuals show a jig with a standard deviation of {plain(shows, 3)}°; none was stated."
    if thermometer is not None:
        yield f"Standard uncertainty of a temperature: {plain(thermometer, 2)} °C."
    origin = text(fit, "uncertainty_from")
    if origin:
        yield f"The uncertainties come from: {origin}."


def _swept(fit: Mapping[str, Any], unit: str) -> Iterator[str]:
    chosen, errors = number(fit, "cross_validation", "order"), numbers(fit, "cross_validation", "error_by_order")
    if chosen is not None:
        listed = ", ".join(f"{plain(error, 3)} for order {order}" for order, error in errors.items())
        yield (
            f"Cross-validation chose a drift of order {chosen:g}; the mean square error of foretelling a left-out "
            f"position, over its variance, is {listed}."
        )
    for channel in section(fit, "hysteresis"):
        loop = section(fit, "hysteresis", channel)
        difference = number(loop, "difference")
        if difference is not None:
            between = " and ".join(in_words(one) for one in items(loop, "between"))
            yield f"Hysteresis of {channel}: {plain(difference, 2)} {unit} between {between}."


def _mounted(fit: Mapping[str, Any]) -> Iterator[str]:
    residuals = numbers(fit, "residuals_degrees")
    if residuals:
        worst = max(residuals, key=lambda name: abs(residuals[name]))
        chi_square = number(fit, "chi_square")
        yield (
            f"Mounting: {text(fit, 'degrees_of_freedom')} degrees of freedom, uncertainty from "
            f"{text(fit, 'uncertainty_from')}, largest residual {plain(residuals[worst], 3)}° in {worst}"
            + ("." if chi_square is None else f", χ² {plain(chi_square, 4)}.")
        )


def _mean(record: Mapping[str, Any], channel: str) -> str:
    mean, u = number(record, "mean", channel), number(record, "u", channel)
    if mean is None:
        return ""
    return measured(mean, u) if u else plain(mean, 7)


def _decimals(scale: float) -> int:
    """So many that the largest of some numbers has three digits."""
    from math import floor, log10

    return min(max(2 - floor(log10(scale)), 0), 12) if scale > 0.0 else 2


def _told(value: float | None, decimals: int) -> str:
    return "" if value is None else at_place(value, decimals)


def _short(component: Any) -> str:
    if not isinstance(component, int | float):
        return in_words(component)
    return at_place(component, 3).rstrip("0").rstrip(".")

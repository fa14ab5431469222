"""Calibrations in words: labels of coefficients, their uncertainties, how well the data fit; the matching of pairs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import asin, degrees, radians, sin, sqrt
from typing import NamedTuple

import numpy as np

from tiltcal.calibration.tilt_uncertainty import stated_half_widths, tilt_lines
from tiltcal.core.model import values
from tiltcal.core.pair.matching import STAGES, SUM, Matching
from tiltcal.core.rounding import bracketed, plus_minus
from tiltcal.drivers.model import OF_TILT, SLOPES
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.coefficients import ANGLES
from tiltcal.files.procedure import FreePositions, LevelCompletion, MountingCompletion, Procedure
from tiltcal.files.results import FitRecord, MountingFit

INCREDIBLE = 1e-3  # probability of a chi-square below which it is not credible
NOT_FOLLOWED = "was not seen to follow"  # in the note on a channel that showed one value or two in a whole session
ONE_VALUE = "it showed one value"  # likewise
LOST_HOLDS = "holds are left out for a rail or standstill, which is not credible"
REMARKABLE = 0.05  # probability of a chi-square below which it is remarked
LARGEST_ESTIMATED_JIG = 5.0  # estimated jig above which a calibration is judged failing, degrees
LARGEST_AGREEMENT = 0.3  # and above which it is asked what happened: of a table that moves by itself it is a verdict
NOTHING_FOLLOWED = "no channel followed any movement although the part was turned: is it alive, and on the table?"


def quiet_note(channel: str, count: int) -> str:
    """Return the note on a channel that no position tilts and that showed one value in a whole session, or two."""
    shown = f"{ONE_VALUE}, as a dead converter does"
    if count == 2:
        shown = "it showed two values, as a coarse sensor does and a dead converter that flickers"
    return (
        f"{channel} {NOT_FOLLOWED} any movement: {shown}; tip it while you look at it with tiltcal live, or once in a "
        "new session"
    )


def result_in_words(calibration: CalibrationRecord, procedure: Procedure) -> str:
    """Return what a procedure has determined, in words."""
    match procedure:
        case MountingCompletion():
            return mounting_summary(calibration)
        case LevelCompletion():
            return level_summary(calibration)
        case FreePositions():
            fit = calibration.fit
            return (
                f"{summary(calibration)}\n"
                f"  misfit of the length of gravity {fit.misfit_rms_mg:g} mg rms over {len(fit.residuals)} positions, "
                f"{fit.distinct_attitudes} different attitudes"
            )
    return summary(calibration)


def summary(calibration: CalibrationRecord, *, notes: bool = True) -> str:
    """Return all coefficients and tilts with their uncertainties, how well the positions fit, and the notes."""
    tilts = tilt_lines(stated_half_widths(calibration))
    lines = [*_coefficient_lines(calibration), *tilts, *mounting_lines(calibration)]
    return "\n".join(lines + [f"  {note}" for note in calibration.fit.notes if notes])


def mounting_summary(calibration: CalibrationRecord) -> str:
    """Return how a sensor sits in its application, with standard uncertainties where they are known."""
    sensor = calibration.sensor
    lines = [f"{sensor.model} {sensor.serial}  (± standard uncertainty, k = 1)", *mounting_lines(calibration)]
    if (fit := calibration.fit.mounting) is not None:
        lines += [f"  {line}" for line in (*mounting_fit_lines(fit), *_objections_to_mounting(fit))]
    return "\n".join(lines)


def mounting_fit_lines(fit: MountingFit) -> Iterator[str]:
    """Yield how well the positions of a mounting agree."""
    if fit.residuals_degrees:
        worst = max(fit.residuals_degrees, key=lambda name: fit.residuals_degrees[name])
        yield f"worst residual  {worst}: {fit.residuals_degrees[worst]:.3g}°"
        chi_square = "" if fit.chi_square is None else f", chi-square {fit.chi_square:g}"
        yield f"degrees of freedom {fit.degrees_of_freedom}, uncertainty from {fit.uncertainty_from}{chi_square}"


def level_summary(calibration: CalibrationRecord) -> str:
    """Return by how much the offsets have changed, and whether that is more than their uncertainty."""
    sensor, coefficients, found = calibration.sensor, calibration.coefficients, calibration.fit.level
    if found is None:
        return ""
    at = "" if found.temperature is None else f" at {found.temperature:g} °C"
    lines = [f"{sensor.model} {sensor.serial}, level{at}  (± standard uncertainty, k = 1)"]
    for row, channel in enumerate(coefficients.channels):
        offset, change = float(coefficients.offset[row]), found.change[channel]
        column = coefficients.axes.index(channel) if channel in coefficients.axes else row
        own = coefficients.per_radian * float(coefficients.sensitivity[row, column])
        angle = degrees(asin(max(-1.0, min(change / own, 1.0))))
        lines.append(
            f"  offset {channel}  {plus_minus(offset, calibration.uncertainty.get(f'offset.{channel}'))} "
            f"{sensor.fitted_unit}; was {offset - change:.6g}, changed by "
            f"{plus_minus(change, found.change_uncertainty.get(channel), signed=True)} ({angle:+.3f}°)"
        )
    lines.append(f"  {found.verdict}")
    if askew := calibration.uncertainty.alignment:
        lines.append(
            f"  the sensor may sit up to {askew * sqrt(3.0):.2g}° askew since its calibration (--alignment): nothing "
            f"at level, ±{2.0 * askew * sin(radians(30.0)):.2g}° (95 %) where the other axis is tilted by 30°"
        )
    return "\n".join(lines)


def mounting_lines(calibration: CalibrationRecord) -> Iterator[str]:
    """Yield the angles of the mounting, degrees, or why there are none; nothing of a sensor that was set straight."""
    mounting = calibration.coefficients.mounting
    for angle in ANGLES if mounting is not None else ():
        value, u = degrees(getattr(mounting, angle)), calibration.uncertainty.get(f"mounting.{angle}")
        yield f"  {angle:<6}{value:>12.6g}°" if u is None else f"  {angle:<6}{_pair(value, u)}°"
    if mounting is None and calibration.derived.mounting is not None:
        yield f"  mounting {calibration.derived.mounting}"
    if calibration.derived.gimbal_lock:
        yield "  gimbal lock: at a pitch of ±90° only roll and yaw together are determined"


def _coefficient_lines(calibration: CalibrationRecord) -> Iterator[str]:
    sensor, coefficients, u = calibration.sensor, calibration.coefficients, calibration.uncertainty
    yield f"{sensor.model} {sensor.serial}  (± standard uncertainty, k = 1)"
    for name, value in values(coefficients).items():
        named = label(name, sensor.unit)
        shown = _pair(value, u[name]) if name in u else f"{value:>12.6g}"
        yield f"  {named.short:<17} {shown} {named.unit}".rstrip()
    if coefficients.thermal is not None and coefficients.thermal.lag:
        yield f"  thermal lag       {_pair(coefficients.thermal.lag, u.get('temperature.lag'))} s"
    yield from (f"  {line}" for line in fit_lines(calibration))


def fit_lines(calibration: CalibrationRecord) -> Iterator[str]:
    """Yield how well the positions agree, and what speaks against it."""
    fit, sensor, worst = calibration.fit, calibration.sensor, calibration.fit.worst
    if worst is not None:
        own = calibration.coefficients.per_radian * float(np.max(np.abs(calibration.coefficients.sensitivity)))
        angle = degrees(asin(min(abs(worst.residual) / own, 1.0)))
        yield (
            f"worst residual  {worst.position}, channel {worst.channel}: {worst.residual:g} {sensor.fitted_unit} "
            f"({angle:.3f}° near level)"
        )
    if fit.degrees_of_freedom is not None:
        origin = f", uncertainty from {fit.uncertainty_from}" if fit.uncertainty_from else ""
        chi_square = "" if fit.chi_square is None else f", chi-square {fit.chi_square:g}"
        yield f"degrees of freedom {fit.degrees_of_freedom}{origin}{chi_square}"
    yield from verdict(calibration)


def verdict(calibration: CalibrationRecord) -> Iterator[str]:
    """Yield the verdict on a fit: how well its positions agree, what speaks against it, and remarks."""
    shows = calibration.fit.jig_estimated_degrees
    if shows is not None:
        yield f"the positions agree {f'to {shows:.2g}°' if shows else 'within their noise'}"
    yield from objections(calibration)
    yield from remarks_on_chance(calibration.fit)


def objections(calibration: CalibrationRecord) -> list[str]:
    """Return what speaks against a fit, or against what was stated of its bench; empty where nothing does."""
    fit, found = calibration.fit, []
    p = _probability(fit)
    if p is not None and p < INCREDIBLE:
        shown, warm = "below 1e-9" if p < 1e-9 else f"{p:.1g}", fit.thermometer_estimated_celsius
        cause = "noise, jig or thermometer are worse than stated, and the uncertainties are too small"
        if warm is not None:
            cause = f"temperatures are off by {warm:g} °C, which counts, or noise or jig are worse than stated"
        found.append(
            f"chi-square {fit.chi_square:g} with {fit.degrees_of_freedom} degrees of freedom (probability {shown}) is "
            f"not credible: {cause}"
        )
    shows, bench = fit.jig_estimated_degrees or 0.0, calibration.provenance.bench
    if shows > LARGEST_ESTIMATED_JIG or (
        bench is not None and (bench.moving_table or bench.reference) and shows > LARGEST_AGREEMENT
    ):
        found.append(f"the positions agree to {shows:.2g}° only: one of them was another")
    if fit.suspect_positions:
        named = [f"{position} ({suspect.off_degrees:g}°)" for position, suspect in fit.suspect_positions.items()]
        found.append(f"further off than the stated jig allows, the worst first: {', '.join(named)}")
    found += [note for note in fit.notes if any(mark in note for mark in (ONE_VALUE, LOST_HOLDS, NOTHING_FOLLOWED))]
    return [*found, *_objections_to_mounting(fit.mounting)]


def remarks_on_chance(fit: FitRecord) -> Iterator[str]:
    """Yield that the positions agree worse than a stated jig lets them in 19 of 20 sessions."""
    p = _probability(fit)
    if p is not None and fit.jig_degrees and INCREDIBLE <= p < REMARKABLE:
        yield (
            f"the positions agree worse than a jig of {fit.jig_degrees:g}° lets them (probability {p:.1g}): it is "
            "worse than stated, or the noise is, and the uncertainty is too small"
        )


def _objections_to_mounting(fit: MountingFit | None) -> Iterator[str]:
    if fit is not None and fit.p_value is not None and fit.p_value < INCREDIBLE:
        yield (
            f"mounting: chi-square {fit.chi_square:g} with {fit.degrees_of_freedom} degrees of freedom is not "
            "credible: the jig is worse than stated, a position was not the one that is named, or a sensor of two axes "
            "stands on edge"
        )


def _probability(fit: FitRecord) -> float | None:
    """Return the probability of so large a chi-square or a larger one; None where the file has none."""
    if fit.chi_square is None or not fit.degrees_of_freedom:
        return None
    if fit.p_value is not None:
        return fit.p_value
    from scipy.special import chdtrc

    return float(chdtrc(fit.degrees_of_freedom, fit.chi_square))


def _pair(value: float, u: float | None) -> str:
    number, _, uncertainty = plus_minus(value, u).partition(" ")
    return f"{number:>12} {uncertainty}"


class Label(NamedTuple):
    """A coefficient in words, in short, as a letter with its index, and its unit, empty for a pure number."""

    words: str
    short: str
    symbol: tuple[str, str]
    unit: str


def label(name: str, unit: str = "") -> Label:
    """Return the label of a coefficient of a sensor whose readings have a unit; of slopes it is in degrees."""
    per, unit = "°" if unit in OF_TILT else "g", "°" if unit in SLOPES else unit
    match name.split("."):
        case ["offset", channel]:
            return Label(f"Offset of {channel}", f"offset {channel}", ("u", f"0{channel}"), unit)
        case ["sensitivity", channel, axis]:
            other, pair = "" if channel == axis else f" to {axis}", channel + axis
            return Label(f"Sensitivity of {channel}{other}", f"sensitivity {pair}", ("S", pair), f"{unit}/{per}")
        case ["nonlinearity", channel, power]:
            shape = {"2": "square", "3": "cube"}.get(power, power)
            in_words, short = f"Nonlinearity of {channel}, {shape}", f"nonlinearity {channel}^{power}"
            return Label(in_words, short, ("n", channel + power), "")
        case ["temperature", kind, channel, power]:
            raised = {"1": "", "2": "²", "3": "³"}.get(power, f"^{power}")
            letter, of = ("d", unit) if kind == "offset" else ("e", "1")
            in_words, short = f"Drift of {kind} {channel}, ΔT{raised}", f"{kind} {channel} over T"
            return Label(in_words, short, (letter, channel + power), f"{of}/°C{raised}")
        case ["mounting", "turn", axis]:
            return Label(f"Turn of the mounting about {axis}", name, ("r", axis), "°")
    return Label(name, name, (name, ""), "s" if name == "temperature.lag" else "")


HEADINGS = {"before": "before matching", "after_p": "after p", "after_pq": "after p and q"}


def pair_summary(matching: Matching) -> str:
    """Return the source's Table 1, p and q with their uncertainties, and how far they suppress what is common."""
    pair = matching.pair
    names = {pair.first: pair.first, pair.second: pair.second, SUM: f"{pair.first} + {pair.second}"}
    wide = max(map(len, names.values()))
    lines = [
        f"{pair.first} and {pair.second}, orthogonal {pair.orthogonal}",
        " " * wide + "".join(f"   {HEADINGS[stage]:<28}" for stage in STAGES),
        " " * wide + "".join(f"   {'sin':<13} {'cos':<14}" for _ in STAGES),
    ]
    for name, text in names.items():
        row = [matching.components[stage][name] for stage in STAGES]
        cells = (f"   {bracketed(one.sin, one.u_sin):<13} {bracketed(one.cos, one.u_cos):<14}" for one in row)
        lines.append(f"{text:<{wide}}" + "".join(cells))
    lines.append(f"p = {bracketed(matching.p, matching.u_p)}   q = {bracketed(matching.q, matching.u_q)}")
    return "\n".join(line.rstrip() for line in [*lines, suppressed(matching)])


def suppressed(matching: Matching, write: Callable[[float], str] = "{:.3g}".format) -> str:
    """Return the suppression of the common acceleration in words; ``write`` formats the two factors."""
    suppression, left = matching.suppression, matching.components["after_pq"][SUM]
    floor = " (the noise floor)" if left.amplitude <= left.u_amplitude else ""
    return (
        f"common acceleration suppressed {write(suppression['p'])} times after p, {write(suppression['pq'])} times "
        f"after p and q{floor}"
    )

"""What a page says of a calibration in words: its provenance, the verdict on its fit, and where it holds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import degrees
from typing import Any, NamedTuple

import numpy as np

from tiltcal.calibration.season import FleetHistory
from tiltcal.calibration.tilt_uncertainty import TiltUncertainty
from tiltcal.calibration.wording import fit_lines, mounting_fit_lines, objections
from tiltcal.core.rounding import plus_minus
from tiltcal.files import record
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.moments import moment
from tiltcal.files.pair import PairRecord
from tiltcal.files.results import FileRecord, PairProvenance, PositionSet, Provenance, Reference
from tiltcal.report.numbers import at_place, half_width, plain, signed


class Fact(NamedTuple):
    """One line of the head; ``code`` for text in a fixed-width font."""

    label: str
    value: str
    code: bool = False


def facts(calibration: CalibrationRecord, source: FileRecord) -> list[Fact]:
    """Return what was calibrated, when and by whom, and the rest of the provenance."""
    sensor = calibration.sensor
    readings = f"{', '.join(sensor.channels)}, in {sensor.unit}"
    said = {"Sensor": sensor.model, "Serial number": sensor.serial, "Readings": readings}
    return [*stated(said), *provenance_facts(calibration.provenance, source)]


def result(calibration: CalibrationRecord, tilt: Mapping[str, TiltUncertainty]) -> list[Fact]:
    """Return what a reader asks first: the verdict, and how uncertain the tilt is."""
    said = {"Verdict": "; ".join(objections(calibration)) or "good: nothing in its data speaks against it"}
    for axis, one in tilt.items():
        alone, reading = (half_width(float(np.nanmax(half))) for half in (one.alone, one.reading))
        low, high = (signed(f"{end:.3g}") for end in (one.tilt[0], one.tilt[-1]))
        single = f"; one single reading within ±{reading}°" if reading != alone else ", also of one single reading"
        said[f"Tilt of {axis} within"] = f"±{alone}° (95 %) from {low} to {high}°{single}"
    return stated(said)


def pair_facts(calibration: PairRecord, source: FileRecord) -> list[Fact]:
    """Return how the stage turned, and the rest of the provenance."""
    spin = calibration.spin
    said = {
        "Turns of the stage": plain(spin.turns, 6),
        "Frequency of the spin": f"{plain(spin.frequency, 6)} Hz" if spin.frequency else "",
        "Column of the stage angle": spin.phase or "",
        "Estimated": "turn by turn" if calibration.online else "from the whole record",
    }
    return [*stated(said), *provenance_facts(calibration.provenance, source)]


def stated(facts: Mapping[str, str | None]) -> list[Fact]:
    """Return the facts that have a value."""
    return [Fact(label, value) for label, value in facts.items() if value]


def fleet_facts(history: FleetHistory) -> list[Fact]:
    """Return what is in a folder, and how many sensors are due."""
    sensors = history.histories
    said = {
        "Folder": history.folder,
        "Sensors": str(len(sensors)),
        "Calibrations": str(sum(len(sensor.calibrations) for sensor in sensors)),
        "Interval": f"{history.interval.days} days",
        "Due": f"{sum(map(history.is_due, sensors))} on {history.now:%Y-%m-%d}",
    }
    return stated(said)


def provenance_facts(provenance: Provenance | PairProvenance, source: FileRecord) -> list[Fact]:
    """Return the content of a provenance, times first, and the calibration file that states it."""
    facts = [Fact("Calibrated", period(provenance))]
    for name, value in _leaves(record.plain(provenance.replaced(references={}))):
        if name not in ("started", "ended") and not (name == "made_by" and notice(provenance)):
            label = name.removesuffix(".name").replace("_", " ").replace(".", ": ")
            facts.append(Fact(f"{label[:1].upper()}{label[1:]}", value, code=name.endswith(("sha256", "address"))))
    facts += [Fact(f"Reference: {name}", _reference(name, one)) for name, one in provenance.references.items()]
    facts += [Fact("Calibration file", source.name), Fact("SHA-256 of the file", source.sha256 or "", code=True)]
    return [fact for fact in facts if fact.value]


def _reference(name: str, reference: Reference) -> str:
    unit = " °C" if name == "thermometer" else "°"
    parts = [reference.id]
    parts += [f"certificate {reference.certificate}"] if reference.certificate else []
    parts += [f"±{reference.uncertainty:g}{unit} (95 %)"] if reference.uncertainty is not None else []
    return ", ".join([*parts, *([f"due {reference.due}"] if reference.due else [])])


def period(provenance: Provenance | PairProvenance) -> str:
    """Return the start and end of the session in UTC, to the second."""
    moments = [moment(one) for one in (provenance.started, provenance.ended) if one]
    times = dict.fromkeys(f"{one:%Y-%m-%d %H:%M:%S}" for one in moments)
    return f"{' to '.join(times)} UTC" if times else ""


def dated(name: str, provenance: Provenance) -> str:
    """Return the name of a file, and when it was measured."""
    return ", ".join(filter(None, [name, period(provenance)]))


def notice(provenance: Provenance | PairProvenance) -> str:
    """Return the notice that no real sensor was measured; empty for a real one."""
    made_by = provenance.made_by or ""
    return f"Made by {made_by}." if "virtual" in made_by else ""


def procedure_facts(calibration: CalibrationRecord) -> list[Fact]:
    """Return the procedure and its settings."""
    run = calibration.procedure
    said = {
        "Procedure": " – ".join(filter(None, (run.name, run.title))),
        "Source": run.source,
        "Samples per position": str(run.samples or ""),
        "Still before sampling": None if run.settle_seconds is None else f"{run.settle_seconds:g} s",
    }
    for label, completing in (("Mounting", run.mounting), ("Level", run.level)):
        if completing is not None:
            kept = _leaves(record.plain(completing))
            said[label] = "; ".join(f"{name.replace('_', ' ')} {value}" for name, value in kept)
    return stated(said)


def _leaves(content: Mapping[str, Any], lead: str = "") -> Iterator[tuple[str, str]]:
    """Return the content of a record, by dotted names."""
    for key, value in content.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{lead}{key}.")
        else:
            yield f"{lead}{key}", _in_words(value)


def _in_words(value: Any) -> str:
    """Return a value as text."""
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_in_words(member)}" for key, member in value.items())
    if isinstance(value, list):
        return ", ".join(_in_words(member) for member in value)
    return str(value)


def as_set(position: PositionSet) -> str:
    """Return the attitude of a position as text: the set angles, or the direction that points up."""
    said = [f"{axis} {signed(f'{angle:g}')}°" for axis, angle in (position.tilt or {}).items()]
    if position.gravity is not None:
        shown = (at_place(component, 3).rstrip("0").rstrip(".") for component in position.gravity)
        said.append(f"up ({', '.join(shown)})")
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
    fit, unit = calibration.fit, calibration.sensor.fitted_unit
    yield from (f"{line[:1].upper()}{line[1:]}." for line in fit_lines(calibration))
    if fit.jig_degrees is not None:
        yield f"Stated standard uncertainty of a set angle: {fit.jig_degrees:g}°."
    if fit.thermometer_celsius is not None:
        yield f"Standard uncertainty of a temperature: {plain(fit.thermometer_celsius, 2)} °C."
    if fit.misfit_rms_mg is not None:
        where = "" if fit.distinct_attitudes is None else f" in {fit.distinct_attitudes} attitudes"
        yield f"The misfit of the length of gravity is {plain(fit.misfit_rms_mg, 3)} mg rms{where}."
    if (chosen := fit.cross_validation) is not None:
        listed = ", ".join(f"{plain(error, 3)} for order {order}" for order, error in chosen.error_by_order.items())
        yield (
            f"Cross-validation chose a drift of order {chosen.order}; the mean square error of predicting a left-out "
            f"position, over its variance, is {listed}."
        )
    for channel, loop in fit.hysteresis.items():
        yield f"Hysteresis of {channel}: {plain(loop.difference, 2)} {unit} between {' and '.join(loop.between)}."
    if fit.mounting is not None:
        yield f"Mounting: {'; '.join(line.strip() for line in mounting_fit_lines(fit.mounting))}."
    if (level := fit.level) is not None:
        changes = [
            f"{channel} by {signed(plus_minus(change, level.change_uncertainty.get(channel)))} {unit}"
            for channel, change in level.change.items()
        ]
        yield f"A level position has renewed the offset: it changed in {' and in '.join(changes)}; {level.verdict}."


def covered(calibration: CalibrationRecord) -> list[Fact]:
    """Return the ranges that the positions covered."""
    limits, unit = calibration.limits, calibration.sensor.unit
    thermal = calibration.coefficients.thermal
    said = {
        f"Tilt of {axis}": _span(round(degrees(low), 2), round(degrees(high), 2), "°")
        for axis, (low, high) in limits.tilt.items()
    }
    if temperature := limits.temperature or (thermal.range if thermal else None):
        said["Temperature"] = _span(*temperature, " °C")
    if thermal:
        said["Reference temperature"] = f"{signed(f'{thermal.reference:g}')} °C"
    rails = (f"{channel} {_span(low, high, ' ' + unit)}" for channel, (low, high) in limits.reading.items())
    return stated({**said, "Readings between their rails": ", ".join(rails)})


def not_covered(calibration: CalibrationRecord) -> Iterator[str]:
    """Yield what the calibration does not cover, in sentences."""
    coefficients, limits = calibration.coefficients, calibration.limits
    if limits.tilt:
        yield "Tilts beyond the ranges above; apply flags them."
    else:
        yield "The tilt: no range of tilts was covered."
    if coefficients.thermal is None:
        yield "Temperature: its effect was not measured."
    elif not coefficients.thermal.gain.any():
        yield "Drift of the sensitivity with temperature."
    if coefficients.nonlinearity is None:
        yield "Nonlinearity: each channel is assumed linear."
    if len(coefficients.axes) < 3:
        missing = " and ".join(axis for axis in ("x", "y", "z") if axis not in coefficients.axes)
        yield f"Sensitivity to {missing}: it was not measured and counts as zero."
    if coefficients.mounting is None:
        yield "The mounting in an application: tilt is that of the sensor’s own frame."
    if calibration.fit.jig_degrees is None and calibration.fit.uncertainty_from != "residuals":
        yield "The angles of the jig: none was stated, and they are not in the uncertainty."


def _span(low: float, high: float, unit: str) -> str:
    return f"{signed(f'{low:.6g}')} to {signed(f'{high:.6g}')}{unit}"

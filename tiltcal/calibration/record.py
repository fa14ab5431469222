"""A calibration as it is used: its limits, its compensation, its mounting, and how uncertain its tilts are."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tiltcal.calibration.stated import length_tolerance, stated_uncertainty
from tiltcal.core.angle_uncertainty import CompensationWithUncertainty
from tiltcal.core.compensation import Compensation
from tiltcal.core.model import AXES, Array, Coefficients, Limits, Mounting
from tiltcal.core.uncertain import TURN, Uncertain
from tiltcal.errors import Argument, EstimateError, InputError, UsageError
from tiltcal.files.calibration import UNKNOWN_MODEL, BaseFile, CalibrationRecord, read_calibration
from tiltcal.files.calibration_output import calibration_in
from tiltcal.files.coefficients import ANGLES, LARGEST_ANGLES, in_degrees
from tiltcal.files.document import Document
from tiltcal.files.pair import PairRecord
from tiltcal.files.yaml_text import read_text
from tiltcal.stated_arguments import is_number, named_values, require_boolean, require_path, shown

if TYPE_CHECKING:
    from tiltcal.drivers.model import Model
    from tiltcal.files.procedure import Procedure


def record_in(document: Document) -> CalibrationRecord | PairRecord:
    """Return the calibration of a document, of either kind; an InputError where anything in it is wrong."""
    record = calibration_in(document)
    try:
        if isinstance(record, CalibrationRecord):
            Compensation(record.coefficients)
    except EstimateError as failure:
        raise InputError(failure.words, file=document.file) from failure
    return record


def model_of(calibration: CalibrationRecord) -> Model | None:
    """Return the model of a sensor whose readings have the unit of its data sheet; None where it is not known."""
    from tiltcal.drivers import find_model

    try:
        model = find_model(calibration.sensor.model) if calibration.device is None else calibration.device.model
    except UsageError:
        return None
    return model if model.unit == calibration.sensor.unit else None


def limits_of(calibration: CalibrationRecord) -> Limits:
    """Return where a calibration holds, angles in radians; the rails are the model's where the file names none."""
    limits, sensor = calibration.limits, calibration.sensor
    model = None if limits.reading or sensor.model == UNKNOWN_MODEL else model_of(calibration)
    return limits if model is None else replace(limits, reading=dict.fromkeys(sensor.channels, model.rails))


def compensation_of(calibration: CalibrationRecord, *, first_order: bool = False) -> Compensation:
    """Return the compensation of readings, with the coefficients and limits of a calibration."""
    require_boolean("first_order", first_order)
    limits = limits_of(calibration)
    if limits.length is None:
        tolerance = length_tolerance(calibration)
        limits = replace(limits, length=tolerance)
    return Compensation(calibration.coefficients, limits, first_order=first_order)


def stated_mounting(angles: Mapping[str, float] | str) -> Mounting:
    """Return the mounting of angles in degrees, or of the text of ``--mounting``; what is not named is 0."""
    stated: dict[str, float] = {}
    for name, given in named_values("mounting", angles, ANGLES, "angle", "roll=180").items():
        try:
            angle = stated[name] = float(given)
        except (TypeError, ValueError):
            raise UsageError(option="mounting", why=f"takes degrees for {name}, not {given!r}") from None
        largest = LARGEST_ANGLES[name]
        if not is_number(angle) or abs(angle) > largest:
            why = f"takes degrees between -{largest:g} and {largest:g} for {name}, not {shown(angle)}"
            raise UsageError(option="mounting", why=why)
    return Mounting(**{name: radians(angle) for name, angle in stated.items()})


def mounting_in_words(mounting: Mounting) -> str:
    """Return the angles as ``--mounting`` takes them."""
    return ",".join(f"{name}={in_degrees(getattr(mounting, name)):g}" for name in ANGLES)


POINTS = 121  # tilts of an axis at which the uncertainty is calculated
STEEPEST = 80.0  # largest tilt, degrees; beyond it the uncertainty of the arcsine grows without limit
USUAL = 30.0  # range where the calibration covers none, degrees


@dataclass(frozen=True)
class TiltUncertainty:
    """The uncertainty of the tilt of one axis while the others are level, shape (n,), degrees."""

    tilt: Array
    before: Array | None  # error with the data sheet's coefficients; None where they are not known
    # Half the 95 % interval, from the coefficients alone and with the noise of one reading:
    alone: Array
    reading: Array


def tilt_uncertainty(calibration: CalibrationRecord) -> dict[str, TiltUncertainty]:
    """Return the uncertainty by axis, in the sensor's frame; empty where the file states none of its coefficients."""
    coefficients = replace(calibration.coefficients, mounting=None)
    try:
        stated = (stated_uncertainty(calibration, reading_noise=noise) for noise in (0.0, None))
        alone, reading = (half_widths(coefficients, u.without(TURN), calibration.limits) for u, _ in stated)
    except EstimateError:
        return {}
    channels, model, nominal = coefficients.channels, model_of(calibration), None
    if model is not None and model.scaled:
        angles, size = coefficients.angles, model.sensitivity
        size = size if angles is None else angles.per_degree(size)
        sheet = np.full(len(channels), model.offset), size * np.eye(len(channels))
        nominal = Compensation(Coefficients(channels, channels, *sheet, angles=angles), Limits())
    by_axis = {}
    for axis, (tilt, half) in alone.items():
        readings = coefficients.predict(_tilted(axis, tilt))
        before = None if nominal is None else nominal(readings).tilt[:, nominal.axes.index(axis)] - tilt
        by_axis[axis] = TiltUncertainty(tilt, before, half, reading[axis][1])
    return by_axis


def half_widths(coefficients: Coefficients, uncertain: Uncertain, limits: Limits) -> dict[str, tuple[Array, Array]]:
    """Return by axis tilts over its range and half the 95 % interval of each, shape (n,), degrees."""
    compensation = Compensation(coefficients)
    kernel = CompensationWithUncertainty(compensation, coefficients, uncertain)
    temperature = None if coefficients.thermal is None else np.full(POINTS, coefficients.thermal.reference)
    found = {}
    for place, axis in enumerate(compensation.axes):
        low, high = np.degrees(limits.tilt.get(axis, (radians(-USUAL), radians(USUAL)))).tolist()
        tilt = np.linspace(max(low, -STEEPEST), min(high, STEEPEST), POINTS)
        _, (_, expanded) = kernel(coefficients.predict(_tilted(axis, tilt)), temperature)
        found[axis] = tilt, expanded[place]
    return found


def _tilted(axis: str, tilt: Array) -> Array:
    """Return up where one axis is tilted, degrees, and the others are level, shape (n, 3)."""
    gravity = np.zeros((len(tilt), 3))
    gravity[:, AXES.index(axis)] = np.sin(np.radians(tilt))
    gravity[:, AXES.index("z" if axis != "z" else "x")] = np.cos(np.radians(tilt))
    return gravity


def tilt_lines(by_axis: Mapping[str, tuple[Array, Array]]) -> Iterator[str]:
    """Yield by axis half the 95 % interval of a tilt near level and at the ends of its range, degrees."""
    for axis, (tilt, half) in by_axis.items():
        level, low, high = half[np.argmin(np.abs(tilt))], half[0], half[-1]
        ends = f"{low:.2g}° at {tilt[0]:.0f}°, {high:.2g}° at {tilt[-1]:.0f}°"
        largest = float(np.nanmax(half))
        between = f", at most {largest:.2g}° between" if largest > 1.05 * max(level, low, high) else ""
        yield f"  tilt {axis} within  ± {level:.2g}° near level, {ends}{between}  (95 %)"


def bases_of(procedure: Procedure, path: str | Path | None, serials: Sequence[str]) -> dict[str, BaseFile]:
    """Read the calibrations that a session builds on (``--base``), by serial number: a file, or a folder of them."""
    if path is not None:
        require_path(Argument("base"), path)
    if path is None:
        if procedure.needs_base:
            raise UsageError((f"{procedure.name} needs ", Argument("base"), ", the calibration file of the sensor"))
        return {}
    if not procedure.takes_base:
        raise UsageError((f"{procedure.name} needs no ", Argument("base"), ": it makes a calibration of its own"))
    path = Path(path)
    if path.is_dir():
        files = {serial: path / f"{serial}.yaml" for serial in serials}
    elif len(serials) == 1:
        files = {serials[0]: path}
    else:
        raise UsageError(f"{path} is one file for {len(serials)} sensors: name the folder that has SERIAL.yaml of each")
    bases = {serial: BaseFile(read_text(file), file.name) for serial, file in files.items()}
    for serial, file in files.items():
        base = read_calibration(file)  # an error names the file as it was given
        if base.sensor.serial != serial:
            raise UsageError(f"{file} is of {base.sensor.serial}, and the sensor to measure is {serial}")
        if base.coefficients.mounting is not None and not procedure.needs_base:
            raise UsageError(f"{file} has a mounting, which {procedure.name} would drop: name the file from before it")
    return bases

"""A calibration as it is used: its model, limits, compensation and mounting, and the base of a session."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING

from tiltcal.calibration.stated import length_tolerance
from tiltcal.core.compensation import Compensation
from tiltcal.core.model import Limits, Mounting
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

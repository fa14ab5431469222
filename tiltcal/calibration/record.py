"""The record of a calibration: read from a file of either kind, the limits within which it holds, its compensation."""

from __future__ import annotations

from dataclasses import replace

from tiltcal.core.compensation import Compensation
from tiltcal.core.model import Limits
from tiltcal.errors import EstimateError, InputError, UsageError
from tiltcal.files.calibration import UNKNOWN_MODEL, CalibrationRecord, tilt_record
from tiltcal.files.document import Document
from tiltcal.files.pair import PairRecord, pair_record
from tiltcal.files.uncertainty import length_tolerance
from tiltcal.stated_arguments import require_boolean


def record_in(document: Document) -> CalibrationRecord | PairRecord:
    """Return the calibration of a document, of either kind; an InputError where anything in it is wrong."""
    if document.kind == "pair":
        return pair_record(document)
    record = tilt_record(document)
    try:
        Compensation(record.coefficients)
    except EstimateError as failure:
        raise InputError(str(failure), file=document.file) from failure
    return record


def limits_of(calibration: CalibrationRecord) -> Limits:
    """Return where a calibration holds, angles in radians; the rails are the model's where the file names none."""
    limits, sensor = calibration.limits, calibration.sensor
    if limits.reading or sensor.model == UNKNOWN_MODEL:
        return limits
    from tiltcal.drivers import find_model

    try:
        model = find_model(sensor.model)
    except UsageError:
        return limits
    if model.unit != sensor.unit:
        return limits
    return replace(limits, reading=dict.fromkeys(sensor.channels, model.rails))


def compensation_of(calibration: CalibrationRecord, *, first_order: bool = False) -> Compensation:
    """Return the compensation of readings, with the coefficients and limits of a calibration.

    EstimateError: the sensitivity matrix cannot be inverted.
    """
    require_boolean("--first-order", first_order)
    limits = limits_of(calibration)
    if limits.length is None:
        tolerance = length_tolerance(calibration.uncertainty, calibration.coefficients, limits)
        limits = replace(limits, length=tolerance)
    return Compensation(calibration.coefficients, limits, first_order=first_order)

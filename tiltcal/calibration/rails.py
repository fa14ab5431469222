"""Where a calibration holds: the ranges that its file names, and the rails of its model where it names none."""

from __future__ import annotations

from dataclasses import replace

from tiltcal.core.model import Limits
from tiltcal.drivers import find_model
from tiltcal.errors import UsageError
from tiltcal.files.calibration import CalibrationRecord


def with_rails(calibration: CalibrationRecord) -> Limits:
    """The calibration's limits, with the rails of its model where the file itself names none."""
    limits, sensor = calibration.limits, calibration.sensor
    if limits.reading:
        return limits
    try:
        model = find_model(sensor.model)
    except UsageError:
        return limits  # a model that nobody knows has no rails that anybody knows
    if model.unit != sensor.unit:
        return limits
    return replace(limits, reading=dict.fromkeys(sensor.channels, model.rails))

"""Whether a model of sensor suits a procedure, before anything is measured: its channels, range and sensitivity."""

from __future__ import annotations

from tiltcal.core.attitude import STRAIGHT, Orientation
from tiltcal.core.model import AXES
from tiltcal.core.plausibility import UNKNOWN_OFFSET
from tiltcal.drivers.model import Model
from tiltcal.errors import UsageError
from tiltcal.files.procedure import Procedure


def require_tilt(procedure: Procedure, model: Model) -> None:
    """Refuse a device whose readings are no components of gravity, with a UsageError."""
    if not model.senses_tilt:
        others = [channel for channel in model.channels if channel not in AXES]
        raise UsageError(
            f"{procedure.name} takes tilt sensors, which read x, y and z; {model.name} reads {', '.join(others)} "
            "there: in the columns of its address call what senses gravity x, y or z, and skip the rest with -"
        )
    if procedure.determines.free and tuple(model.channels) != AXES:
        raise UsageError(
            f"free positions need a sensor of three channels x, y and z, and {model.name} has "
            f"{', '.join(model.channels)}: unit gravity does not determine fewer; name a procedure that sets positions"
        )


def unchecked(model: Model) -> str:
    """Return which check of the positions is off, because the address states no nominal value; else nothing."""
    if not model.scaled:
        return "no sensitivity= is stated, so that neither a wrong position nor a small movement is detected"
    if model.offset_spread > UNKNOWN_OFFSET:
        return "no offset= is stated, so that positions are compared with each other alone, and the first with none"
    return ""


def require_suitable(
    procedure: Procedure, model: Model, orientation: Orientation = STRAIGHT, *, based: bool = False
) -> None:
    """Refuse a device that reads no tilt, positions beyond its rails, and an unknown sensitivity, with a UsageError.

    based: a base calibration states the sensitivity.
    """
    require_tilt(procedure, model)
    if not (model.scaled or based or procedure.determines.axes or procedure.determines.completes):
        raise UsageError(
            f"{procedure.name} determines no sensitivity, and that of {model.name} is not known: state it in the "
            "address (sensitivity=..., unit per g), or name the sensor's calibration (--base)"
        )
    for position in procedure.positions:
        gravity = orientation.seen(position.gravity)
        for channel in model.channels:
            expected = model.offset + model.sensitivity * gravity["xyz".index(channel)]
            if not model.rails[0] < expected < model.rails[1]:
                hint = "; a smaller --tilt brings it in range" if procedure.angle is not None else ""
                raise UsageError(
                    f"position {position.name} is outside the range of {model.name}: {channel} would read about "
                    f"{expected:.5g} {model.unit}, and reads from {model.rails[0]:g} to {model.rails[1]:g}{hint}"
                )

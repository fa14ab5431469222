"""The angles that a reference instrument on the same plate reads, and their uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import asin, atan, copysign, degrees, fsum, sin, sqrt

from tiltcal.calibration.measurement import BenchUncertainty
from tiltcal.core.attitude import gravity_from_tilt
from tiltcal.drivers.model import OF_G, OF_TILT, SLOPES, Reading
from tiltcal.errors import InputError
from tiltcal.files.procedure import Position
from tiltcal.journal.header import ReferenceDevice
from tiltcal.journal.playback import Sample

DIGITS = 6  # decimals of a tilt, degrees


def read_axes(device: ReferenceDevice) -> tuple[str, ...]:
    """Return the tilts of the plate that a reference reads."""
    along = {device.orientation.names["xyz".index(c)].strip("+-") for c in device.wired.channels if c in ("x", "y")}
    return tuple(axis for axis in ("x", "y") if axis in along)


def set_by(device: ReferenceDevice, position: Position, samples: Sequence[Sample]) -> Position:
    """Return a position as the reference read it in some samples; a tilt that it does not read stays as it was set."""
    readings = [sample.reference for sample in samples if sample.reference is not None]
    columns = zip(*(reading.values for reading in readings), strict=True)
    means = Reading(tuple(fsum(column) / len(readings) for column in columns))
    seen = list(device.orientation.seen(position.gravity))
    for channel, sine in sines(device, means).items():
        seen["xyz".index(channel)] = sine
    across = seen[0] ** 2 + seen[1] ** 2
    if across >= 1.0:
        raise InputError(
            f"the reference reads {', '.join(f'{one:.6g}' for one in means.values)}, which no attitude has"
        )
    seen[2] = copysign(sqrt(1.0 - across), seen[2])
    columns = zip(*device.orientation.matrix, strict=True)
    x, y, z = (sum(one * part for one, part in zip(seen, column, strict=True)) for column in columns)
    if z < 0.0:
        return replace(position, gravity=(x, y, z), tilt=None)
    tilt = {"x": round(degrees(asin(x)), DIGITS), "y": round(degrees(asin(y)), DIGITS)}
    return replace(position, gravity=gravity_from_tilt(tilt), tilt=tilt)


def sines(device: ReferenceDevice, reading: Reading) -> dict[str, float]:
    """Return the sines of the tilts that a reference reads, by its channels."""
    unit = device.wired.unit
    pairs = zip(device.wired.channels, reading.values, strict=True)
    if unit in OF_G:
        return {channel: value / OF_G[unit] for channel, value in pairs}
    tilts = {channel: value / OF_TILT[unit] for channel, value in pairs}
    return {channel: sin(atan(one) if unit in SLOPES else one) for channel, one in tilts.items()}


def uncertainty_with(device: ReferenceDevice | None, bench: BenchUncertainty) -> BenchUncertainty:
    """Return the uncertainties of a bench where a reference says the angles; the jig is of those that it does not."""
    if device is None:
        return bench
    from tiltcal.core.estimation.positions import InstrumentErrors

    read, each = read_axes(device), device.repeatability
    unread = sqrt(max(0.0, (bench.jig or 0.0) ** 2 - each**2))
    errors = InstrumentErrors(read, device.zero, device.scale, device.alignment, unread)
    # A table that leans is read as well.
    return replace(bench, jig=each, instrument=errors, table_lean=0.0 if len(read) == 2 else bench.table_lean)


def compared(device: ReferenceDevice | None) -> list[str]:
    """Return what a calibration has to say of a reference."""
    if device is None:
        return []
    zero, each, alignment = (f"{one:.3g}°" for one in (device.zero, device.repeatability, device.alignment))
    return [
        f"the angles are those that the reference {device.model} read: zero {zero}, scale {100.0 * device.scale:.2g} % "
        f"and alignment {alignment} count as one error each for the whole session, {each} for each position; the "
        "sensitivity to the other axis is relative to the axes of the reference"
    ]

"""A reference instrument on the same plate: it is read with the sensors, and its reading is the angle that was set."""

from __future__ import annotations

from collections.abc import Sequence
from math import asin, degrees, fsum, sqrt

from tiltcal.bench.settle import Unsettled
from tiltcal.core.samples import drift
from tiltcal.drivers.model import OF_G, OF_TILT
from tiltcal.errors import Argument, UsageError
from tiltcal.files.bench import BenchFile
from tiltcal.journal.header import ReferenceDevice
from tiltcal.journal.playback import Sample
from tiltcal.journal.reference import read_axes, sines

STEADY, SIGMAS = 3.0, 4.0
"""A reading may change by so many repeatabilities while it is sampled, and so may its mean be uncertain; or by so many
of the change's own standard uncertainties."""


def reference_of(bench: BenchFile) -> ReferenceDevice | None:
    """Return the reference of a bench; a UsageError where it reads no tilt, or one of two, and no jig is stated."""
    if (stated := bench.reference) is None:
        return None
    try:
        zero, scale = stated.errors()
    except ValueError as error:
        raise UsageError(f"the reference: {error}") from None
    device = ReferenceDevice(
        serial="reference",
        model=stated.model,
        address=stated.address,
        axes=stated.axes,
        device=stated.device,
        zero=zero,
        scale=scale,
        repeatability=stated.repeatability,
        alignment=stated.alignment,
    )
    if device.wired.unit not in (*OF_TILT, *OF_G):
        raise UsageError(f"the reference reads {device.wired.unit}: state its unit, such as deg, mrad or mm/m")
    read = read_axes(device)
    if not read:
        raise UsageError(f"the reference {device.model} reads no tilt of the plate: it needs x or y, and not along z")
    if len(read) < 2 and bench.jig is None:
        other = "y" if read == ("x",) else "x"
        raise UsageError(
            (f"the reference reads no tilt {other}, which keeps its set angle: state ", Argument("jig"), " for it")
        )
    return device


def require_steady(device: ReferenceDevice, samples: Sequence[Sample]) -> None:
    """Raise Unsettled where the reading of a reference changed or scattered while it was sampled."""
    times = [sample.seconds for sample in samples]
    rows = [sines(device, sample.reference) for sample in samples if sample.reference is not None]
    for channel in rows[0]:
        tilts = [degrees(asin(max(-1.0, min(1.0, row[channel])))) for row in rows]
        mean = fsum(tilts) / len(tilts)
        scatter = sqrt(fsum((tilt - mean) ** 2 for tilt in tilts) / len(tilts))
        change, u = drift(times, tilts) if len(tilts) > 2 else (0.0, 0.0)
        if abs(change) > max(STEADY * device.repeatability, SIGMAS * u):
            raise Unsettled(f"the reference moved by {change:+.2g}° in {channel} while it was sampled: let it rest")
        if scatter > STEADY * device.repeatability * sqrt(len(tilts)):
            raise Unsettled(
                f"the reference scatters by {scatter:.2g}° in {channel}, so that the mean of {len(tilts)} is not "
                f"as good as its repeatability of {device.repeatability:g}°: is it at rest? Else take more --samples"
            )

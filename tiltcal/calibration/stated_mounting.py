"""A mounting that the user states, in place of what a calibration has: ``--mounting`` of ``apply`` and ``combine``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import radians

from tiltcal.core.model import Mounting
from tiltcal.errors import UsageError
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.coefficients import ANGLES, LARGEST_ANGLES, in_degrees
from tiltcal.stated_arguments import is_number, shown


def stated_mounting(angles: Mapping[str, float] | str) -> Mounting:
    """Return the mounting of angles in degrees, or of the text of ``--mounting``; what is not named is 0.

    UsageError: an angle that there is not, is no number, or is out of range.
    """
    if not isinstance(angles, str | Mapping):
        raise UsageError(f"--mounting takes angles by name, such as {{'roll': 180}}, not {angles!r}")
    named = _pairs(angles) if isinstance(angles, str) else dict(angles)
    for name, angle in named.items():
        if name not in ANGLES:
            raise UsageError(f"--mounting: there is no angle {name!r}; the angles are {', '.join(ANGLES)}, in degrees")
        largest = LARGEST_ANGLES[name]
        if not is_number(angle) or abs(angle) > largest:
            raise UsageError(f"--mounting: {name} is between -{largest:g} and {largest:g} degrees, not {shown(angle)}")
    return Mounting(**{name: radians(angle) for name, angle in named.items()})


def with_mounting(calibration: CalibrationRecord, mounting: Mounting) -> CalibrationRecord:
    """Return a calibration with a mounting that is known, and exact; one that it has is replaced."""
    return replace(
        calibration,
        coefficients=replace(calibration.coefficients, mounting=mounting),
        uncertainty=calibration.uncertainty.without_mounting(),
        derived=calibration.derived.replaced(gimbal_lock=False),
        fit=calibration.fit.replaced(mounting=None),
        procedure=calibration.procedure.replaced(mounting=None),
        positions=calibration.positions_with(mounting=()),
    )


def mounting_in_words(mounting: Mounting) -> str:
    """Return the angles as ``--mounting`` takes them."""
    return ",".join(f"{name}={in_degrees(getattr(mounting, name)):g}" for name in ANGLES)


def _pairs(text: str) -> dict[str, float]:
    """Return the numbers of ``roll=180,pitch=0``."""
    named: dict[str, float] = {}
    for pair in filter(None, (part.strip() for part in text.split(","))):
        name, _, angle = (part.strip() for part in pair.partition("="))
        if name in named:
            raise UsageError(f"--mounting: {name} is named twice")
        try:
            named[name] = float(angle)
        except ValueError:
            raise UsageError(f"--mounting: {pair!r} is no angle in degrees; write name=degrees: roll=180") from None
    return named

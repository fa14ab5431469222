"""The types of what calibrations are applied to: the same kind of frame comes back."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from datetime import timedelta
from typing import TypedDict, TypeVar

Frame = TypeVar("Frame")
"""A frame of any kind; without their stubs those of pandas and pyarrow are Any to a type checker."""


class ApplyArguments(TypedDict, total=False):
    """The arguments of :meth:`tiltcal.Calibration.apply` besides the frame."""

    columns: Mapping[str, str] | str
    uncertainty: bool
    first_order: bool
    reading_noise: float | None
    mounting: Mapping[str, float] | str
    magnetometer: Sequence[str] | str
    velocity: Sequence[str] | str
    declination: float | None
    magnetometer_noise: float | None
    average: int | None
    every: str | float | timedelta | None
    unit: str | None
    say: Callable[[str], None]

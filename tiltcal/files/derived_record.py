"""The record of derived quantities in a calibration file, with their uncertainty and coverage factors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from tiltcal.files.coefficients import CHANNELS
from tiltcal.files.declaration import ByChannel, ByName, ListOf, Section, entry
from tiltcal.files.scalars import FROM_ZERO, Flag, Number, Text


@dataclass(frozen=True, kw_only=True)
class DerivedCoverage:
    """Coverage factors of derived quantities, for intervals of 95 %."""

    cross_axis_percent: Mapping[str, float] = entry(ByChannel(FROM_ZERO), "per channel", default={})
    misalignment_degrees: Mapping[str, float] = entry(ByChannel(FROM_ZERO), "per channel", default={})


@dataclass(frozen=True, kw_only=True)
class DerivedUncertainty:
    """Standard uncertainties of derived quantities."""

    cross_axis_percent: Mapping[str, float] = entry(ByChannel(FROM_ZERO), "per channel, %", default={})
    misalignment_degrees: Mapping[str, float] = entry(ByChannel(FROM_ZERO), "per channel, degrees", default={})
    coverage_factor: DerivedCoverage | None = entry(
        Section(DerivedCoverage), "what each is multiplied with for an interval of 95 %", default=None
    )


@dataclass(frozen=True, kw_only=True)
class IntrinsicCoverage:
    """Coverage factors of the intrinsic parameters, for intervals of 95 %."""

    offset: Mapping[str, float] = entry(ByChannel(FROM_ZERO), "per channel", default={})
    sensitivity: Mapping[str, float] = entry(ByChannel(FROM_ZERO), "per channel", default={})
    angle_degrees: Mapping[str, float] = entry(ByName(FROM_ZERO), "per pair of channels", default={})
    rotation_degrees: Mapping[str, float] = entry(ByName(FROM_ZERO), "roll, pitch, yaw", default={})


@dataclass(frozen=True, kw_only=True)
class IntrinsicUncertainty:
    """Standard uncertainties of the intrinsic parameters."""

    offset: Mapping[str, float] = entry(ByChannel(FROM_ZERO), "per channel, unit", default={})
    sensitivity: Mapping[str, float] = entry(ByChannel(FROM_ZERO), "per channel, unit/g", default={})
    angle_degrees: Mapping[str, float] = entry(ByName(FROM_ZERO), "per pair of channels, degrees", default={})
    rotation_degrees: Mapping[str, float] = entry(ByName(FROM_ZERO), "roll, pitch, yaw, degrees", default={})
    coverage_factor: IntrinsicCoverage | None = entry(
        Section(IntrinsicCoverage), "what each is multiplied with for an interval of 95 %", default=None
    )


@dataclass(frozen=True, kw_only=True)
class IntrinsicRecord:
    """The parameters of a three-channel sensor that do not change with its mounting."""

    offset: Mapping[str, float] = entry(CHANNELS, "per channel, unit", default={})
    sensitivity: Mapping[str, float] = entry(CHANNELS, "per channel along its own direction, unit/g", default={})
    angle_degrees: Mapping[str, float] = entry(
        ByName(Number()), "between the directions of two channels, `xy`, `xz`, `yz`, degrees", default={}
    )
    rotation_degrees: Mapping[str, float] = entry(
        ByName(Number()), "where positions were set: roll, pitch, yaw of the sensor in their frame, degrees", default={}
    )
    uncertainty: IntrinsicUncertainty | None = entry(
        Section(IntrinsicUncertainty), "standard uncertainties (k = 1) of the above", default=None
    )
    gimbal_lock: bool = entry(Flag(), "`true` where roll and yaw cannot be separated", default=False)
    left_handed: str | None = entry(
        Text(),
        "why there is no rotation: the channels form a left-handed frame",
        default=None,
        formerly="not_separated",
    )


@dataclass(frozen=True, kw_only=True)
class DerivedRecord:
    """Quantities derived from the coefficients."""

    cross_axis_percent: Mapping[str, float] = entry(
        CHANNELS, "per channel, % (Cross-axis Compensation, eq. 1)", default={}
    )
    misalignment_degrees: Mapping[str, float] = entry(
        CHANNELS, "per channel, between its direction and its axis, degrees", default={}
    )
    uncertainty: DerivedUncertainty | None = entry(
        Section(DerivedUncertainty), "standard uncertainties (k = 1) of the above", default=None
    )
    intrinsic: IntrinsicRecord | None = entry(
        Section(IntrinsicRecord), "of three channels, what does not change with the mounting", default=None
    )
    assumed: tuple[str, ...] = entry(ListOf(Text()), "which coefficients were not measured", default=())
    mounting: str | None = entry(Text(), "from free positions: what can be said of the mounting", default=None)
    gimbal_lock: bool = entry(Flag(), "`true` where roll and yaw of the mounting cannot be separated", default=False)
    gravity_m_s2: float | None = entry(
        Number(above=0.0), "with `fit --gravity`: gravity where the calibration was made, m/s²", default=None
    )
    sensitivity_per_m_s2: Mapping[str, float] = entry(
        CHANNELS, "with `fit --gravity`: per channel, unit/(m/s²)", default={}
    )
    scale_error_percent: Mapping[str, float] = entry(
        CHANNELS, "with `fit --gravity`, of readings in m/s²: per channel, %", default={}
    )

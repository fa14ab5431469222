"""The record of derived quantities in a calibration file, with their uncertainty and coverage factors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from tiltcal.files.record import AboveZero, ByAxis, Finite, FiniteFromZero, Record, Text, about


class DerivedCoverage(Record, kw_only=True):
    """Coverage factors of derived quantities, for intervals of 95 %."""

    cross_axis_percent: Annotated[ByAxis[FiniteFromZero], about("per channel")] = {}
    misalignment_degrees: Annotated[ByAxis[FiniteFromZero], about("per channel")] = {}


class DerivedUncertainty(Record, kw_only=True):
    """Standard uncertainties of derived quantities."""

    cross_axis_percent: Annotated[ByAxis[FiniteFromZero], about("per channel, %")] = {}
    misalignment_degrees: Annotated[ByAxis[FiniteFromZero], about("per channel, degrees")] = {}
    coverage_factor: Annotated[
        DerivedCoverage | None, about("what each is multiplied with for an interval of 95 %")
    ] = None


class IntrinsicCoverage(Record, kw_only=True):
    """Coverage factors of the intrinsic parameters, for intervals of 95 %."""

    offset: Annotated[ByAxis[FiniteFromZero], about("per channel")] = {}
    sensitivity: Annotated[ByAxis[FiniteFromZero], about("per channel")] = {}
    angle_degrees: Annotated[Mapping[str, FiniteFromZero], about("per pair of channels")] = {}
    rotation_degrees: Annotated[Mapping[str, FiniteFromZero], about("roll, pitch, yaw")] = {}


class IntrinsicUncertainty(Record, kw_only=True):
    """Standard uncertainties of the intrinsic parameters."""

    offset: Annotated[ByAxis[FiniteFromZero], about("per channel, unit")] = {}
    sensitivity: Annotated[ByAxis[FiniteFromZero], about("per channel, unit/g")] = {}
    angle_degrees: Annotated[Mapping[str, FiniteFromZero], about("per pair of channels, degrees")] = {}
    rotation_degrees: Annotated[Mapping[str, FiniteFromZero], about("roll, pitch, yaw, degrees")] = {}
    coverage_factor: Annotated[
        IntrinsicCoverage | None, about("what each is multiplied with for an interval of 95 %")
    ] = None


class IntrinsicRecord(Record, kw_only=True):
    """The parameters of a three-channel sensor that do not change with its mounting."""

    offset: Annotated[ByAxis[Finite], about("per channel, unit")] = {}
    sensitivity: Annotated[ByAxis[Finite], about("per channel along its own direction, unit/g")] = {}
    angle_degrees: Annotated[
        Mapping[str, Finite], about("between the directions of two channels, `xy`, `xz`, `yz`, degrees")
    ] = {}
    rotation_degrees: Annotated[
        Mapping[str, Finite], about("where positions were set: roll, pitch, yaw of the sensor in their frame, degrees")
    ] = {}
    uncertainty: Annotated[IntrinsicUncertainty | None, about("standard uncertainties (k = 1) of the above")] = None
    gimbal_lock: Annotated[bool, about("`true` where roll and yaw cannot be separated")] = False
    left_handed: Annotated[
        Text | None, about("why there is no rotation: the channels form a left-handed frame", formerly="not_separated")
    ] = None


class DerivedRecord(Record, kw_only=True):
    """Quantities derived from the coefficients."""

    cross_axis_percent: Annotated[ByAxis[Finite], about("per channel, % (Cross-axis Compensation, eq. 1)")] = {}
    misalignment_degrees: Annotated[
        ByAxis[Finite], about("per channel, between its direction and its axis, degrees")
    ] = {}
    uncertainty: Annotated[DerivedUncertainty | None, about("standard uncertainties (k = 1) of the above")] = None
    intrinsic: Annotated[IntrinsicRecord | None, about("of three channels, what does not change with the mounting")] = (
        None
    )
    assumed: Annotated[tuple[Text, ...], about("which coefficients were not measured")] = ()
    mounting: Annotated[Text | None, about("from free positions: what can be said of the mounting")] = None
    gimbal_lock: Annotated[bool, about("`true` where roll and yaw of the mounting cannot be separated")] = False
    gravity_m_s2: Annotated[
        AboveZero | None, about("with `fit --gravity`: gravity where the calibration was made, m/s²")
    ] = None
    sensitivity_per_m_s2: Annotated[ByAxis[Finite], about("with `fit --gravity`: per channel, unit/(m/s²)")] = {}
    scale_error_percent: Annotated[
        ByAxis[Finite], about("with `fit --gravity`, of readings in m/s²: per channel, %")
    ] = {}

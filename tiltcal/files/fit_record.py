"""The record of a fit in a calibration file: residuals, chi-square, hysteresis, mounting and level."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from tiltcal.files.coefficients import CHANNELS
from tiltcal.files.declaration import ByChannel, ByCoefficient, ByName, ListOf, Section, entry
from tiltcal.files.scalars import FROM_ZERO, Flag, Integer, Number, Range, Text

NOISE_ALONE = "noise alone: no jig is stated, and no position is left over"
"""Where an uncertainty comes from that leaves out how well the positions were set."""


@dataclass(frozen=True, kw_only=True)
class WorstResidual:
    """The largest residual of a fit."""

    position: str = entry(Text(), "its position")
    channel: str = entry(Text(), "its channel")
    residual: float = entry(Number(), "measured − modelled, unit")


@dataclass(frozen=True, kw_only=True)
class SuspectPosition:
    """A position that is further off than the stated jig allows."""

    off_degrees: float = entry(FROM_ZERO, "how far it is off, degrees")
    chi_square: float | None = entry(FROM_ZERO, "its share of chi-square", default=None)


@dataclass(frozen=True, kw_only=True)
class CrossValidation:
    """The choice of the order of the drift."""

    order: int = entry(
        Integer(minimum=1),
        "the order that was chosen; terms above it are 0, with the uncertainty of the highest that was tried",
    )
    error_by_order: Mapping[str, float] = entry(
        ByName(FROM_ZERO),
        "per order the mean square error of predicting a left-out position, over its variance",
        default={},
    )


@dataclass(frozen=True, kw_only=True)
class Hysteresis:
    """The largest difference between two visits to one temperature."""

    difference: float = entry(Number(), "the later visit less the earlier one, unit")
    between: tuple[str, ...] = entry(ListOf(Text(), 2, 2), "the two positions")


@dataclass(frozen=True, kw_only=True)
class RampLeg:
    """A leg of a ramp, and how well it is predicted from the others."""

    way: str = entry(Text(), "`up` or `down`")
    temperature: tuple[float, float] = entry(Range(), "`[low, high]`, °C")
    seconds: float = entry(FROM_ZERO, "how long it lasts")
    pace: float = entry(FROM_ZERO, "°C/min")
    polynomial: Mapping[str, float] = entry(
        ByChannel(FROM_ZERO), "per channel the rms error of the polynomial alone, fitted to the other legs, unit"
    )
    lagged: Mapping[str, float] = entry(ByChannel(FROM_ZERO), "the same with a lag")


@dataclass(frozen=True, kw_only=True)
class RampFitRecord:
    """The thermal lag that a ramp shows."""

    lag: float = entry(Number(), "that was found, s")
    u_lag: float = entry(FROM_ZERO, "its standard uncertainty, s")
    used: bool = entry(Flag(), "whether each leg is predicted better with it, and it is in the calibration")
    explained_percent: Mapping[str, float] = entry(
        CHANNELS, "per channel which part of the square of the loop it explains, %"
    )
    legs: tuple[RampLeg, ...] = entry(ListOf(Section(RampLeg)), "the legs of the record")


@dataclass(frozen=True, kw_only=True)
class MountingFit:
    """The quality of the fit of a mounting."""

    residuals_degrees: Mapping[str, float] = entry(ByName(Number()), "per position, degrees", default={})
    degrees_of_freedom: int | None = entry(Integer(minimum=0), "readings left over", default=None)
    uncertainty_from: str | None = entry(Text(), "`stated jig` or `residuals`", default=None)
    chi_square: float | None = entry(FROM_ZERO, "where the jig was stated", default=None)
    p_value: float | None = entry(
        FROM_ZERO,
        "the probability of so large a chi-square or a larger one, the uncertainty of the base among its causes",
        default=None,
    )


@dataclass(frozen=True, kw_only=True)
class LevelFit:
    """The offset that a level position has renewed, against the one before."""

    change: Mapping[str, float] = entry(CHANNELS, "per channel, the new offset less the one before, unit", default={})
    change_uncertainty: Mapping[str, float] = entry(
        ByChannel(FROM_ZERO), "per channel, its standard uncertainty, unit", default={}
    )
    change_coverage_factor: Mapping[str, float] = entry(
        ByChannel(FROM_ZERO), "per channel, what that is multiplied with for an interval of 95 %", default={}
    )
    verdict: str | None = entry(Text(), "whether the change is more than its uncertainty", default=None)
    temperature: float | None = entry(Number(), "of the position, °C", default=None)
    jig_degrees: float | None = entry(
        FROM_ZERO, "the stated standard uncertainty of how level it was, degrees", default=None
    )


@dataclass(frozen=True, kw_only=True)
class FitRecord:
    """The quality of a fit, and the sources of its uncertainty."""

    residuals: Mapping[str, Mapping[str, float]] = entry(
        ByName(CHANNELS),
        "per position and channel, measured − modelled with the position as it was set, unit",
        default={},
    )
    worst: WorstResidual | None = entry(
        Section(WorstResidual), "the largest of them, where any position is left over", default=None
    )
    degrees_of_freedom: int | None = entry(
        Integer(minimum=0), "readings left over, of all sensors of the bench together", default=None
    )
    chi_square: float | None = entry(
        FROM_ZERO,
        "where the jig was stated: the sum of squares of everything over its stated uncertainty",
        default=None,
    )
    p_value: float | None = entry(FROM_ZERO, "the probability of so large a chi-square or a larger one", default=None)
    suspect_positions: Mapping[str, SuspectPosition] = entry(
        ByName(Section(SuspectPosition)),
        "positions that are further off than the stated jig allows: `off_degrees` and their `chi_square`",
        default={},
        formerly="worse_than_stated",
    )
    uncertainty_from: str | None = entry(
        Text(),
        "`stated noise and jig`, `stated jig, residuals for the noise`, `residuals`, or `noise alone` and why",
        default=None,
    )
    jig_degrees: float | None = entry(
        FROM_ZERO, "the stated standard uncertainty of a set angle, degrees", default=None
    )
    jig_estimated_degrees: float | None = entry(
        FROM_ZERO,
        "where the jig was not stated: the standard deviation of a set angle that the residuals show, degrees",
        default=None,
        formerly="jig_that_shows_degrees",
    )
    thermometer_estimated_celsius: float | None = entry(
        FROM_ZERO,
        "where a jig but no thermometer was stated: the standard deviation of a temperature that residuals show, °C",
        default=None,
    )
    noise_estimated: float | None = entry(
        FROM_ZERO,
        "where a table states no uncertainties of its means: the standard deviation of their noise that the residuals "
        "show, unit",
        default=None,
    )
    thermometer_celsius: float | None = entry(FROM_ZERO, "the standard uncertainty of a temperature, °C", default=None)
    budget: Mapping[str, Mapping[str, float]] = entry(
        ByCoefficient(ByName(Number())),
        "per coefficient, which share of its variance comes from `noise`, `adc`, `jig`, `table`, `heading`, "
        "`thermometer`, `hysteresis`, `base`, `assumed`, `other sessions`",
        default={},
    )
    notes: tuple[str, ...] = entry(ListOf(Text()), "what limits the numbers", default=())
    cross_validation: CrossValidation | None = entry(
        Section(CrossValidation), "after a sweep: how the order of the drift was chosen", default=None
    )
    hysteresis: Mapping[str, Hysteresis] = entry(
        ByChannel(Section(Hysteresis)),
        "after a sweep: per channel the largest difference between two visits to one temperature",
        default={},
    )
    ramp: RampFitRecord | None = entry(
        Section(RampFitRecord), "after a ramp: the thermal lag, and what each leg says of it", default=None
    )
    distinct_attitudes: int | None = entry(
        Integer(minimum=0), "from free positions: how many attitudes differ", default=None
    )
    misfit_rms_mg: float | None = entry(
        FROM_ZERO, "from free positions: how well the length of gravity is met, mg rms", default=None
    )
    warning: str | None = entry(Text(), "what speaks against the result", default=None)
    mounting: MountingFit | None = entry(
        Section(MountingFit), "after the mounting procedure: how well its positions agree", default=None
    )
    level: LevelFit | None = entry(Section(LevelFit), "after `level`: by how much the offset has changed", default=None)

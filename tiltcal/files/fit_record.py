"""The record of a fit in a calibration file: residuals, chi-square, hysteresis, mounting and level."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from tiltcal.files.record import ByAxis, Count, Finite, FiniteFromZero, FromOne, Range, Record, Text, about

NOISE_ALONE = "noise alone: no jig is stated, and no position is left over"
"""Where an uncertainty comes from that leaves out how well the positions were set."""


class WorstResidual(Record, kw_only=True):
    """The largest residual of a fit."""

    position: Annotated[Text, about("its position")]
    channel: Annotated[Text, about("its channel")]
    residual: Annotated[Finite, about("measured − modelled, unit")]


class SuspectPosition(Record, kw_only=True):
    """A position that is further off than the stated jig allows."""

    off_degrees: Annotated[FiniteFromZero, about("how far it is off, degrees")]
    chi_square: Annotated[FiniteFromZero | None, about("its share of chi-square")] = None


class CrossValidation(Record, kw_only=True):
    """The choice of the order of the drift."""

    order: Annotated[
        FromOne,
        about("the order that was chosen; terms above it are 0, with the uncertainty of the highest that was tried"),
    ]
    error_by_order: Annotated[
        Mapping[str, FiniteFromZero],
        about("per order the mean square error of predicting a left-out position, over its variance"),
    ] = {}


class Hysteresis(Record, kw_only=True):
    """The largest difference between two visits to one temperature."""

    difference: Annotated[Finite, about("the later visit less the earlier one, unit")]
    between: Annotated[tuple[Text, Text], about("the two positions")]


class RampLeg(Record, kw_only=True):
    """A leg of a ramp, and how well it is predicted from the others."""

    way: Annotated[Text, about("`up` or `down`")]
    temperature: Annotated[Range, about("`[low, high]`, °C")]
    seconds: Annotated[FiniteFromZero, about("how long it lasts")]
    pace: Annotated[FiniteFromZero, about("°C/min")]
    polynomial: Annotated[
        ByAxis[FiniteFromZero],
        about("per channel the rms error of the polynomial alone, fitted to the other legs, unit"),
    ]
    lagged: Annotated[ByAxis[FiniteFromZero], about("the same with a lag")]


class RampFitRecord(Record, kw_only=True):
    """The thermal lag that a ramp shows."""

    lag: Annotated[Finite, about("that was found, s")]
    u_lag: Annotated[FiniteFromZero, about("its standard uncertainty, s")]
    used: Annotated[bool, about("whether each leg is predicted better with it, and it is in the calibration")]
    explained_percent: Annotated[
        ByAxis[Finite], about("per channel which part of the square of the loop it explains, %")
    ]
    legs: Annotated[tuple[RampLeg, ...], about("the legs of the record")]


class MountingFit(Record, kw_only=True):
    """The quality of the fit of a mounting."""

    residuals_degrees: Annotated[Mapping[str, Finite], about("per position, degrees")] = {}
    degrees_of_freedom: Annotated[Count | None, about("readings left over")] = None
    uncertainty_from: Annotated[Text | None, about("`stated jig` or `residuals`")] = None
    chi_square: Annotated[FiniteFromZero | None, about("where the jig was stated")] = None
    p_value: Annotated[
        FiniteFromZero | None,
        about("the probability of so large a chi-square or a larger one, the uncertainty of the base among its causes"),
    ] = None


class LevelFit(Record, kw_only=True):
    """The offset that a level position has renewed, against the one before."""

    change: Annotated[ByAxis[Finite], about("per channel, the new offset less the one before, unit")] = {}
    change_uncertainty: Annotated[ByAxis[FiniteFromZero], about("per channel, its standard uncertainty, unit")] = {}
    change_coverage_factor: Annotated[
        ByAxis[FiniteFromZero], about("per channel, what that is multiplied with for an interval of 95 %")
    ] = {}
    verdict: Annotated[Text | None, about("whether the change is more than its uncertainty")] = None
    temperature: Annotated[Finite | None, about("of the position, °C")] = None
    jig_degrees: Annotated[
        FiniteFromZero | None, about("the stated standard uncertainty of how level it was, degrees")
    ] = None


class FitRecord(Record, kw_only=True):
    """The quality of a fit, and the sources of its uncertainty."""

    residuals: Annotated[
        Mapping[str, ByAxis[Finite]],
        about("per position and channel, measured − modelled with the position as it was set, unit"),
    ] = {}
    worst: Annotated[WorstResidual | None, about("the largest of them, where any position is left over")] = None
    degrees_of_freedom: Annotated[Count | None, about("readings left over, of all sensors of the bench together")] = (
        None
    )
    chi_square: Annotated[
        FiniteFromZero | None,
        about("where the jig was stated: the sum of squares of everything over its stated uncertainty"),
    ] = None
    p_value: Annotated[FiniteFromZero | None, about("the probability of so large a chi-square or a larger one")] = None
    suspect_positions: Annotated[
        Mapping[str, SuspectPosition],
        about(
            "positions that are further off than the stated jig allows: `off_degrees` and their `chi_square`",
            formerly="worse_than_stated",
        ),
    ] = {}
    uncertainty_from: Annotated[
        Text | None,
        about("`stated noise and jig`, `stated jig, residuals for the noise`, `residuals`, or `noise alone` and why"),
    ] = None
    jig_degrees: Annotated[FiniteFromZero | None, about("the stated standard uncertainty of a set angle, degrees")] = (
        None
    )
    jig_estimated_degrees: Annotated[
        FiniteFromZero | None,
        about(
            "where the jig was not stated: the standard deviation of a set angle that the residuals show, degrees",
            formerly="jig_that_shows_degrees",
        ),
    ] = None
    thermometer_estimated_celsius: Annotated[
        FiniteFromZero | None,
        about(
            "where a jig but no thermometer was stated: the standard deviation of a temperature that residuals show, °C"
        ),
    ] = None
    noise_estimated: Annotated[
        FiniteFromZero | None,
        about(
            "where a table states no uncertainties of its means: the standard deviation of their noise that the "
            "residuals show, unit"
        ),
    ] = None
    thermometer_celsius: Annotated[FiniteFromZero | None, about("the standard uncertainty of a temperature, °C")] = None
    budget: Annotated[
        Mapping[str, Mapping[str, Finite]],
        about(
            "per coefficient, which share of its variance comes from `noise`, `adc`, `jig`, `table`, `heading`, "
            "`thermometer`, `hysteresis`, `base`, `assumed`, `other sessions`"
        ),
    ] = {}
    notes: Annotated[tuple[Text, ...], about("what limits the numbers")] = ()
    priors: Annotated[
        Mapping[str, FiniteFromZero],
        about(
            "per coefficient that the procedure does not determine, its standard uncertainty by the data sheet; its "
            "value before the session is 0, and its error is common to all calibrations of the sensor"
        ),
    ] = {}
    not_covered: Annotated[
        tuple[Text, ...],
        about(
            "errors of the bench that no position shows and that are not in the uncertainty, such as `lean` of the "
            "table"
        ),
    ] = ()
    cross_validation: Annotated[
        CrossValidation | None, about("after a sweep: how the order of the drift was chosen")
    ] = None
    hysteresis: Annotated[
        ByAxis[Hysteresis],
        about("after a sweep: per channel the largest difference between two visits to one temperature"),
    ] = {}
    ramp: Annotated[RampFitRecord | None, about("after a ramp: the thermal lag, and what each leg says of it")] = None
    distinct_attitudes: Annotated[Count | None, about("from free positions: how many attitudes differ")] = None
    left_out_mg: Annotated[
        Mapping[str, Finite],
        about(
            "from free positions: attitudes that do not agree with the others and are not in the fit, and by how much "
            "the length of gravity is off in each, mg"
        ),
    ] = {}
    misfit_rms_mg: Annotated[
        FiniteFromZero | None, about("from free positions: how well the length of gravity is met, mg rms")
    ] = None
    warning: Annotated[Text | None, about("what speaks against the result")] = None
    mounting: Annotated[MountingFit | None, about("after the mounting procedure: how well its positions agree")] = None
    level: Annotated[LevelFit | None, about("after `level`: by how much the offset has changed")] = None

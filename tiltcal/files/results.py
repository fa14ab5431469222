"""The records of a calibration for people and later questions: positions, fit, derived quantities, provenance."""

from __future__ import annotations

from collections.abc import Mapping
from hashlib import sha256
from typing import TYPE_CHECKING, Annotated, Any

from msgspec import Meta

from tiltcal.files.device import DeviceFile
from tiltcal.files.record import (
    AboveZero,
    ByAxis,
    Count,
    Finite,
    FromOne,
    Range,
    Record,
    Size,
    Text,
    about,
    one_of,
    plain,
)
from tiltcal.printable import in_html

if TYPE_CHECKING:
    from tiltcal.core.attitude import Vector

NOISE_ALONE = "noise alone: no jig is stated, and no position is left over"  # leaves out how well they were set
VIRTUAL = "the virtual bench: no real sensor was measured"  # ``made_by`` of a file that no real sensor made

Names = tuple[Text, ...]
ByName = Mapping[str, Size]
BySerial = Mapping[str, Mapping[str, Count]]
Sensors = tuple[str | tuple[str, str], ...]
"""The kind of a calibration, then model and serial number of each of its sensors; a matching of a log states none."""
Direction = Annotated[tuple[Finite, ...], Meta(min_length=3, max_length=3)]


class PositionSet(Record):
    """The attitude of a position as it was set."""

    tilt: Annotated[ByAxis[Finite] | None, about("angles, degrees")] = None
    gravity: Annotated[Direction | None, about("the direction that points up, in the sensor frame")] = None
    heading: Annotated[Finite | None, about("how far the fixture was turned about the vertical, degrees")] = None
    stage: Annotated[Finite | None, about("angle of the rotary stage, degrees")] = None
    temperature: Annotated[Finite | None, about("°C")] = None

    @property
    def up(self) -> Vector | None:
        """Up in the frame of the position, a unit vector; None where the file states no attitude."""
        from tiltcal.core.attitude import gravity_from_tilt, normalised  # the records load no numpy

        if self.tilt is not None:
            return gravity_from_tilt(self.tilt)
        return None if self.gravity is None else normalised(self.gravity)


class CompletingRun(Record):
    """A procedure that completes a calibration, as run."""

    samples: Annotated[FromOne | None, about("per position")] = None
    settle_seconds: Annotated[Size | None, about("over which the reading held still")] = None
    positions: Annotated[Names, about("their names")] = ()


class ProcedureRecord(Record):
    """The procedure as run."""

    name: Annotated[Text | None, about("its name")] = None
    title: Annotated[Text | None, about("its title")] = None
    source: Annotated[Text | None, about("the document it comes from")] = None
    samples: Annotated[FromOne | None, about("samples per position")] = None
    settle_seconds: Annotated[Size | None, about("seconds over which the reading held still")] = None
    set: Annotated[Mapping[str, PositionSet], about("per position `tilt` or `gravity` as it was set")] = {}
    mounting: Annotated[CompletingRun | None, about("the mounting procedure")] = None
    level: Annotated[CompletingRun | None, about("likewise `level`")] = None


# A constrained number beside a tuple of two in a union makes msgspec 0.22 crash: the rows are not bounded here.
Rows = tuple[int | tuple[Count, Count], ...]


class PositionRecord(Record):
    """The readings of one position."""

    position: Annotated[Text, about("its name")]
    mean: Annotated[ByAxis[Finite], about("mean readings, unit")] = {}
    std: Annotated[ByAxis[Size] | None, about("standard deviations of the samples, unit")] = None
    u: Annotated[ByAxis[Size] | None, about("standard uncertainties of the means, unit")] = None
    n: Annotated[Count | None, about("number of samples")] = None
    left_out: Annotated[Count | None, about("samples far off the others, left out or taken again")] = None
    takes: Annotated[FromOne | None, about("how often it was taken, where `again` withdrew a take")] = None
    temperature: Annotated[Finite | None, about("°C")] = None
    time: Annotated[Text | None, about("when it was measured, UTC")] = None
    rows: Annotated[Rows | None, about("its rows `[first, end]` of the log, the end exclusive")] = None
    line: Annotated[FromOne | None, about("its line of the table")] = None

    @property
    def row_ranges(self) -> tuple[tuple[int, int], ...]:
        """Its rows of the log, part by part; empty where it was not measured in a log, or they are no such pairs."""
        match self.rows:
            case (int(first), int(end)) if min(first, end) >= 0:
                return ((first, end),)
            case rows:
                return tuple(part for part in rows or () if isinstance(part, tuple))


class WorstResidual(Record):
    """The largest residual of a fit."""

    position: Annotated[Text, about("its position")]
    channel: Annotated[Text, about("its channel")]
    residual: Annotated[Finite, about("measured − modelled, unit")]


class SuspectPosition(Record):
    """A position that is further off than the stated jig allows."""

    off_degrees: Annotated[Size, about("how far it is off, degrees")]
    chi_square: Annotated[Size | None, about("its share of chi-square")] = None


class CrossValidation(Record):
    """The choice of the order of the drift: terms above it are 0, uncertain by the highest that was tried."""

    order: Annotated[FromOne, about("that was chosen; higher terms are 0, uncertain as the highest that was tried")]
    error_by_order: Annotated[ByName, about("mean square error of a left-out position, over its variance")] = {}


class Hysteresis(Record):
    """The largest difference between two visits to one temperature."""

    difference: Annotated[Finite, about("the later visit less the earlier one, unit")]
    between: Annotated[tuple[Text, Text], about("the two positions")]


class RampLeg(Record):
    """A leg of a ramp, and how well it is predicted from the others."""

    way: Annotated[Text, about("`up` or `down`")]
    temperature: Annotated[Range, about("`[low, high]`, °C")]
    seconds: Annotated[Size, about("how long it lasts")]
    pace: Annotated[Size, about("°C/min")]
    polynomial: Annotated[ByAxis[Size], about("rms error of the polynomial fitted to the other legs, unit")]
    lagged: Annotated[ByAxis[Size], about("the same with a lag")]


class RampFitRecord(Record):
    """The thermal lag that a ramp shows."""

    lag: Annotated[Finite, about("that was found, s")]
    u_lag: Annotated[Size, about("its standard uncertainty, s")]
    used: Annotated[bool, about("whether each leg is predicted better with it, and it is in the calibration")]
    explained_percent: Annotated[ByAxis[Finite], about("per channel its part of the square of the loop, %")]
    legs: Annotated[tuple[RampLeg, ...], about("the legs of the record")]


class MountingFit(Record):
    """The quality of the fit of a mounting."""

    residuals_degrees: Annotated[Mapping[str, Finite], about("per position, degrees")] = {}
    degrees_of_freedom: Annotated[Count | None, about("readings left over")] = None
    uncertainty_from: Annotated[Text | None, about("`stated jig` or `residuals`")] = None
    chi_square: Annotated[Size | None, about("where the jig was stated")] = None
    p_value: Annotated[Size | None, about("of so large a chi-square, the base's uncertainty among its causes")] = None


class LevelFit(Record):
    """The offset that a level position has renewed, against the one before."""

    change: Annotated[ByAxis[Finite], about("per channel, the new offset less the one before, unit")] = {}
    change_uncertainty: Annotated[ByAxis[Size], about("per channel, its standard uncertainty, unit")] = {}
    change_coverage_factor: Annotated[ByAxis[Size], about("per channel, its coverage factor for 95 %")] = {}
    verdict: Annotated[Text | None, about("whether the change is more than its uncertainty")] = None
    temperature: Annotated[Finite | None, about("of the position, °C")] = None
    jig_degrees: Annotated[Size | None, about("the stated standard uncertainty of how level it was, degrees")] = None


class FitRecord(Record):
    """The quality of a fit, and the sources of its uncertainty."""

    residuals: Annotated[Mapping[str, ByAxis[Finite]], about("per position, measured − modelled, unit")] = {}
    worst: Annotated[WorstResidual | None, about("the largest of them, where any position is left over")] = None
    degrees_of_freedom: Annotated[Count | None, about("readings left over, of all sensors of the bench")] = None
    chi_square: Annotated[Size | None, about("squares of all errors over what is stated; with a stated jig")] = None
    p_value: Annotated[Size | None, about("the probability of so large a chi-square or a larger one")] = None
    suspect_positions: Annotated[Mapping[str, SuspectPosition], about("further off than the stated jig allows")] = {}
    uncertainty_from: Annotated[Text | None, about("`stated …`, `residuals`, or `noise alone` and why")] = None
    jig_degrees: Annotated[Size | None, about("stated standard uncertainty of a set angle, degrees")] = None
    table_lean_degrees: Annotated[Size | None, about("that of the lean of the table, degrees")] = None
    heading_degrees: Annotated[Size | None, about("that of a heading, degrees")] = None
    jig_estimated_degrees: Annotated[Size | None, about("of a set angle by the residuals, degrees")] = None
    thermometer_estimated_celsius: Annotated[Size | None, about("of a temperature by the residuals, °C")] = None
    noise_estimated: Annotated[Size | None, about("of a table's means by the residuals, unit")] = None
    thermometer_celsius: Annotated[Size | None, about("the standard uncertainty of a temperature, °C")] = None
    budget: Annotated[
        Mapping[str, Mapping[str, Finite]],
        about("per coefficient the share of its variance from `noise`, `adc`, `jig`, `table`, `heading`, `base`, …"),
    ] = {}
    notes: Annotated[Names, about("what limits the numbers")] = ()
    priors: Annotated[ByName, about("by the data sheet, of what no position determines; common to all files")] = {}
    not_covered: Annotated[
        Names, about("not in the uncertainty: `lean` of the table, `nonlinearity`, `sensitivity.z`")
    ] = ()
    cross_validation: Annotated[CrossValidation | None, about("of a sweep: the choice of the order")] = None
    hysteresis: Annotated[ByAxis[Hysteresis], about("of a sweep: the largest difference between two visits")] = {}
    ramp: Annotated[RampFitRecord | None, about("of a ramp: the thermal lag, and what each leg says of it")] = None
    distinct_attitudes: Annotated[Count | None, about("from free positions: how many attitudes differ")] = None
    left_out_mg: Annotated[Mapping[str, Finite], about("from free positions: attitudes left out, mg off")] = {}
    misfit_rms_mg: Annotated[Size | None, about("from free positions: misfit of the length of gravity, mg rms")] = None
    warning: Annotated[Text | None, about("what speaks against the result")] = None
    mounting: Annotated[MountingFit | None, about("after the mounting procedure: how well its positions agree")] = None
    level: Annotated[LevelFit | None, about("after `level`: by how much the offset has changed")] = None

    def _repr_html_(self) -> str:
        """Return what is stated as a notebook shows it, a row each."""
        return in_html("\n".join(f"  {name}  {one}" for name, value in plain(self).items() for one in _rows(value)))


class DerivedCoverage(Record):
    """Coverage factors of derived quantities, for intervals of 95 %; or other numbers of theirs."""

    cross_axis_percent: Annotated[ByAxis[Size], about("per channel")] = {}
    misalignment_degrees: Annotated[ByAxis[Size], about("per channel")] = {}


class DerivedUncertainty(DerivedCoverage):
    """Standard uncertainties of derived quantities."""

    coverage_factor: Annotated[DerivedCoverage | None, about("of each, for an interval of 95 %")] = None


class IntrinsicCoverage(Record):
    """Coverage factors of the intrinsic parameters, for intervals of 95 %; or other numbers of theirs."""

    offset: Annotated[ByAxis[Finite], about("per channel")] = {}
    sensitivity: Annotated[ByAxis[Finite], about("per channel along its own direction")] = {}
    angle_degrees: Annotated[Mapping[str, Finite], about("between two channels, `xy`, `xz`, `yz`")] = {}
    rotation_degrees: Annotated[Mapping[str, Finite], about("roll, pitch, yaw in the frame of set positions")] = {}


class IntrinsicUncertainty(IntrinsicCoverage):
    """Standard uncertainties of the intrinsic parameters."""

    coverage_factor: Annotated[IntrinsicCoverage | None, about("of each, for an interval of 95 %")] = None


class IntrinsicRecord(IntrinsicCoverage):
    """The parameters of a three-channel sensor that do not change with its mounting."""

    uncertainty: Annotated[IntrinsicUncertainty | None, about("standard uncertainties (k = 1) of the above")] = None
    gimbal_lock: Annotated[bool, about("`true` where roll and yaw cannot be separated")] = False
    left_handed: Annotated[Text | None, about("why there is no rotation")] = None


class DerivedRecord(Record):
    """Quantities derived from the coefficients."""

    cross_axis_percent: Annotated[ByAxis[Finite], about("per channel, % (Cross-axis Compensation, eq. 1)")] = {}
    misalignment_degrees: Annotated[ByAxis[Finite], about("per channel, of its direction from its axis, degrees")] = {}
    uncertainty: Annotated[DerivedUncertainty | None, about("standard uncertainties (k = 1) of the above")] = None
    intrinsic: Annotated[IntrinsicRecord | None, about("what does not change with the mounting: unit, unit/g")] = None
    assumed: Annotated[Names, about("which coefficients were not measured")] = ()
    mounting: Annotated[Text | None, about("from free positions: what can be said of the mounting")] = None
    gimbal_lock: Annotated[bool, about("`true` where roll and yaw of the mounting cannot be separated")] = False
    gravity_m_s2: Annotated[AboveZero | None, about("with `fit --gravity`: gravity at the calibration, m/s²")] = None
    sensitivity_per_m_s2: Annotated[ByAxis[Finite], about("with `fit --gravity`: per channel, unit/(m/s²)")] = {}
    scale_error_percent: Annotated[ByAxis[Finite], about("with `fit --gravity`, of readings in m/s²: %")] = {}


class FileRecord(Record):
    """A file that was read."""

    name: Annotated[Text, about("its name")]
    sha256: Annotated[Text | None, about("the SHA-256 of its bytes")] = None

    @classmethod
    def of_text(cls, name: str, text: str) -> FileRecord:
        """Return the record of a file with this text."""
        return cls(name=name, sha256=sha256(text.encode()).hexdigest())


class LogRecord(FileRecord):
    """A log that was read."""

    rows: Annotated[Count | None, about("how many rows it has")] = None
    missing: Annotated[Count | None, about("how many of them were left out")] = None


class SegmentsRecord(Record):
    """The origin of the still segments of a log: a file, or how they were found."""

    name: Annotated[Text | None, about("of their file")] = None
    sha256: Annotated[Text | None, about("the SHA-256 of their file")] = None
    found: Annotated[Text | None, about("by what they were found")] = None
    window_rows: Annotated[FromOne | None, about("rows in which the sensor held still")] = None
    threshold: Annotated[Size | None, about("the largest standard deviation, unit")] = None
    times_noise: Annotated[Size | None, about("the threshold over the noise")] = None
    holds: Annotated[Count | None, about("how many were found, where some are trimmed or left out")] = None
    trimmed: Annotated[Mapping[str, Text], about("holds of which some rows count, and why")] = {}
    left_out: Annotated[Mapping[str, Text], about("holds that do not count, and why")] = {}


class BenchSensorRecord(Record):
    """One sensor on the stage of a pair calibration."""

    serial: Annotated[Text, about("its serial number")]
    model: Annotated[Text | None, about("its model")] = None
    address: Annotated[Text | None, about("its address")] = None


class BenchRecord(Record):
    """The bench that measured."""

    address: Annotated[Text | None, about("of the sensor")] = None
    axes: Annotated[Names, about("of the fixture along the sensor's axes, where it does not sit straight")] = ()
    thermometer: Annotated[Text | None, about("address of the thermometer")] = None
    reference: Annotated[Text | None, about("address of the reference instrument")] = None
    moving_table: Annotated[bool, about("whether a table set the positions by itself")] = False
    device: Annotated[DeviceFile | None, about("of a text device what its file says")] = None
    sensors: Annotated[tuple[BenchSensorRecord, ...], about("of a pair: the sensors on the stage")] = ()


class Reference(Record):
    """A standard that a bench measures by, with its certificate."""

    id: Annotated[Text, about("of the instrument")]
    certificate: Annotated[Text | None, about("its number")] = None
    uncertainty: Annotated[Size | None, about("expanded (95 %), degrees; of a thermometer °C")] = None
    due: Annotated[Text | None, about("the day on which it is to be calibrated again")] = None


Standard = Annotated[str, one_of("table", "level", "thermometer")]  # what a bench measures by


class Provenance(Record):
    """The provenance of a tilt calibration."""

    made_by: Annotated[Text | None, about("`measurement`, `the virtual bench …`, `fit of …`, `match of …`")] = None
    operator: Annotated[Text | None, about("who led the session")] = None
    bench: Annotated[BenchRecord | None, about("`address`, `axes` and `thermometer`; of a pair `sensors`")] = None
    references: Annotated[Mapping[Standard, Reference], about("the standards of the bench, by what they are")] = {}
    base: Annotated[FileRecord | None, about("the calibration that it builds on (`--base`)")] = None
    sources: Annotated[tuple[FileRecord, ...], about("the calibrations that `combine` put together")] = ()
    log: Annotated[LogRecord | None, about("the log")] = None
    logs: Annotated[tuple[LogRecord, ...], about("several logs of one session, whose rows count on")] = ()
    table: Annotated[FileRecord | None, about("the table of positions")] = None
    segments: Annotated[SegmentsRecord | None, about("the segments: their file, or how they were found")] = None
    software: Annotated[Text | None, about("program and version")] = None
    started: Annotated[Text | None, about("when the session began, UTC")] = None
    ended: Annotated[Text | None, about("when the session ended, UTC")] = None
    journal: Annotated[FileRecord | None, about("the journal")] = None
    link_statistics: Annotated[
        Mapping[str, Count] | None, about("[of the link](../explanation.md#lost-and-damaged)")
    ] = None


class SamplesRecord(Record):
    """The numbers of samples of a rotation."""

    used: Annotated[Count, about("samples that were used")]
    left_out: Annotated[Count, about("samples that were left out")]


class PairProvenance(Provenance):
    """The provenance of a pair calibration."""

    link_statistics: Annotated[BySerial | None, about("by serial number, likewise")] = None  # type: ignore[assignment]
    stage_angle: Annotated[Text | None, about("how the stage angle was found, where it was estimated")] = None
    procedure: Annotated[Text | None, about("the name of the rotation procedure")] = None
    samples: Annotated[SamplesRecord | None, about("`used` and `left_out`")] = None
    stopped: Annotated[Text | None, about("why the rotation ended")] = None
    not_matched: Annotated[Names, about("pairs that could not be matched, and why")] = ()


def _rows(value: Any) -> list[str]:
    """Return a value of a record as the cells of its rows: of a mapping of mappings one each."""
    if not isinstance(value, Mapping):
        return [str(value)]
    flat = {name: one for name, one in value.items() if not isinstance(one, Mapping)}
    rows = ["  ".join(f"{name} {one}" for name, one in flat.items())] if flat else []
    return [*rows, *(f"{name}  {row}" for name, one in value.items() if name not in flat for row in _rows(one))]

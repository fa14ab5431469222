"""The records of a calibration file: quality of the fit, derived quantities, provenance.

No angle is computed with them. A report shows them, ``check`` judges them and a later fit builds on them.
"""

from __future__ import annotations

from collections.abc import Mapping
from hashlib import sha256
from typing import Any

from tiltcal.files.declaration import (
    ANY,
    FROM_ZERO,
    ByChannel,
    ByName,
    Context,
    Flag,
    Format,
    Integer,
    ListOf,
    Number,
    Range,
    Section,
    Text,
    entry,
)
from tiltcal.files.node import Node
from tiltcal.frozen import frozen

CHANNELS = ByChannel(Number())
"""A number for some channels of the sensor."""


NOISE_ALONE = "noise alone: no jig is stated, and no position is left over"
"""Where an uncertainty comes from that leaves out how well the positions were set."""

VIRTUAL = "the virtual bench: no real sensor was measured"
"""``made_by`` of a file that no real sensor made."""


@frozen(kw_only=True)
class WorstResidual:
    """The largest residual of a fit."""

    position: str = entry(Text(), "its position")
    channel: str = entry(Text(), "its channel")
    residual: float = entry(Number(), "measured − modelled, unit")


@frozen(kw_only=True)
class SuspectPosition:
    """A position that is further off than the stated jig allows."""

    off_degrees: float = entry(FROM_ZERO, "how far it is off, degrees")
    chi_square: float | None = entry(FROM_ZERO, "its share of chi-square", default=None)


@frozen(kw_only=True)
class CrossValidation:
    """The choice of the order of the drift."""

    order: int = entry(Integer(minimum=1), "the order that was chosen")
    error_by_order: Mapping[str, float] = entry(
        ByName(FROM_ZERO),
        "per order the mean square error of predicting a left-out position, over its variance",
        default={},
    )


@frozen(kw_only=True)
class Hysteresis:
    """The largest difference between two visits to one temperature."""

    difference: float = entry(Number(), "the later visit less the earlier one, unit")
    between: tuple[str, ...] = entry(ListOf(Text(), 2, 2), "the two positions")


@frozen(kw_only=True)
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


@frozen(kw_only=True)
class RampFitRecord:
    """The thermal lag that a ramp shows."""

    lag: float = entry(Number(), "that was found, s")
    u_lag: float = entry(FROM_ZERO, "its standard uncertainty, s")
    used: bool = entry(Flag(), "whether it betters every leg that it was not fitted to, and is in the calibration")
    explained_percent: Mapping[str, float] = entry(
        CHANNELS, "per channel which part of the square of the loop it explains, %"
    )
    legs: tuple[RampLeg, ...] = entry(ListOf(Section(RampLeg)), "the legs of the record")


@frozen(kw_only=True)
class MountingFit:
    """The quality of the fit of a mounting."""

    residuals_degrees: Mapping[str, float] = entry(ByName(Number()), "per position, degrees", default={})
    degrees_of_freedom: int | None = entry(Integer(minimum=0), "readings left over", default=None)
    uncertainty_from: str | None = entry(Text(), "`stated jig` or `residuals`", default=None)
    chi_square: float | None = entry(FROM_ZERO, "where the jig was stated", default=None)


@frozen(kw_only=True)
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


@frozen(kw_only=True)
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
        Text(), "`stated noise and jig`, `residuals`, or `noise alone` and why", default=None
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
    thermometer_celsius: float | None = entry(FROM_ZERO, "the standard uncertainty of a temperature, °C", default=None)
    budget: Mapping[str, Mapping[str, float]] = entry(
        ByName(ByName(Number())),
        "per coefficient, which share of its variance comes from `noise`, `adc`, `jig`, `table`, `thermometer`, "
        "`assumed`",
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


@frozen(kw_only=True)
class DerivedCoverage:
    """Coverage factors of derived quantities, for intervals of 95 %."""

    cross_axis_percent: Mapping[str, float] = entry(ByChannel(FROM_ZERO), "per channel", default={})
    misalignment_degrees: Mapping[str, float] = entry(ByChannel(FROM_ZERO), "per channel", default={})


@frozen(kw_only=True)
class DerivedUncertainty:
    """Standard uncertainties of derived quantities."""

    cross_axis_percent: Mapping[str, float] = entry(ByChannel(FROM_ZERO), "per channel, %", default={})
    misalignment_degrees: Mapping[str, float] = entry(ByChannel(FROM_ZERO), "per channel, degrees", default={})
    coverage_factor: DerivedCoverage | None = entry(
        Section(DerivedCoverage), "what each is multiplied with for an interval of 95 %", default=None
    )


@frozen(kw_only=True)
class IntrinsicCoverage:
    """Coverage factors of the intrinsic parameters, for intervals of 95 %."""

    offset: Mapping[str, float] = entry(ByChannel(FROM_ZERO), "per channel", default={})
    sensitivity: Mapping[str, float] = entry(ByChannel(FROM_ZERO), "per channel", default={})
    angle_degrees: Mapping[str, float] = entry(ByName(FROM_ZERO), "per pair of channels", default={})
    rotation_degrees: Mapping[str, float] = entry(ByName(FROM_ZERO), "roll, pitch, yaw", default={})


@frozen(kw_only=True)
class IntrinsicUncertainty:
    """Standard uncertainties of the intrinsic parameters."""

    offset: Mapping[str, float] = entry(ByChannel(FROM_ZERO), "per channel, unit", default={})
    sensitivity: Mapping[str, float] = entry(ByChannel(FROM_ZERO), "per channel, unit/g", default={})
    angle_degrees: Mapping[str, float] = entry(ByName(FROM_ZERO), "per pair of channels, degrees", default={})
    rotation_degrees: Mapping[str, float] = entry(ByName(FROM_ZERO), "roll, pitch, yaw, degrees", default={})
    coverage_factor: IntrinsicCoverage | None = entry(
        Section(IntrinsicCoverage), "what each is multiplied with for an interval of 95 %", default=None
    )


@frozen(kw_only=True)
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


@frozen(kw_only=True)
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


@frozen(kw_only=True)
class PositionSet:
    """The attitude of a position as it was set."""

    tilt: Mapping[str, float] | None = entry(ByChannel(Number()), "angles, degrees", default=None)
    gravity: tuple[float, ...] | None = entry(
        ListOf(Number(), 3, 3), "the direction that points up, in the sensor frame", default=None
    )
    heading: float | None = entry(Number(), "how far the fixture was turned about the vertical, degrees", default=None)
    stage: float | None = entry(Number(), "angle of the rotary stage, degrees", default=None)
    temperature: float | None = entry(Number(), "°C", default=None)


@frozen(kw_only=True)
class CompletingRun:
    """A procedure that completes a calibration, as run."""

    samples: int | None = entry(Integer(minimum=1), "per position", default=None)
    settle_seconds: float | None = entry(FROM_ZERO, "over which the reading held still", default=None)
    positions: tuple[str, ...] = entry(ListOf(Text()), "their names", default=())


@frozen(kw_only=True)
class ProcedureRecord:
    """The procedure as run."""

    name: str | None = entry(Text(), "its name", default=None)
    title: str | None = entry(Text(), "its title", default=None)
    source: str | None = entry(Text(), "the document it comes from", default=None)
    samples: int | None = entry(Integer(minimum=1), "samples per position", default=None)
    settle_seconds: float | None = entry(FROM_ZERO, "seconds over which the reading held still", default=None)
    set: Mapping[str, PositionSet] = entry(
        ByName(Section(PositionSet)), "per position `tilt` or `gravity` as it was set", default={}
    )
    mounting: CompletingRun | None = entry(
        Section(CompletingRun), "`samples`, `settle_seconds` and `positions` of the mounting procedure", default=None
    )
    level: CompletingRun | None = entry(Section(CompletingRun), "likewise of `level`", default=None)


@frozen
class RowRanges(Format[tuple[tuple[int, int], ...]]):
    """Rows of a log: ``[first, end]``, or a list of such where the position was interrupted."""

    def read(self, node: Node, context: Context = ANY) -> tuple[tuple[int, int], ...]:
        items = node.items()
        parts = items if any(isinstance(item.content, list) for item in items) else [node]
        return tuple(self._part(part) for part in parts)

    def write(self, value: tuple[tuple[int, int], ...]) -> list[Any]:
        parts = [list(part) for part in value]
        return parts[0] if len(parts) == 1 else parts

    def schema(self) -> dict[str, Any]:
        part = {"type": "array", "items": {"type": "integer", "minimum": 0}, "minItems": 2, "maxItems": 2}
        return {"anyOf": [part, {"type": "array", "items": part}]}

    @staticmethod
    def _part(node: Node) -> tuple[int, int]:
        rows = [item.integer(minimum=0) for item in node.items()]
        if len(rows) != 2:
            raise node.error(f"rows are two numbers [first, end], found {len(rows)}")
        return rows[0], rows[1]


@frozen(kw_only=True)
class PositionRecord:
    """The readings of one position."""

    position: str = entry(Text(), "its name")
    mean: Mapping[str, float] = entry(CHANNELS, "mean readings, unit", default={})
    std: Mapping[str, float] | None = entry(
        ByChannel(FROM_ZERO), "standard deviations of the samples, unit", default=None
    )
    u: Mapping[str, float] | None = entry(
        ByChannel(FROM_ZERO), "standard uncertainties of the means, unit", default=None
    )
    n: int | None = entry(Integer(minimum=0), "number of samples", default=None)
    left_out: int | None = entry(
        Integer(minimum=0), "samples that were far off the others and were taken again", default=None
    )
    temperature: float | None = entry(Number(), "°C", default=None)
    time: str | None = entry(Text(), "when it was measured, UTC", default=None)
    rows: tuple[tuple[int, int], ...] | None = entry(
        RowRanges(), "its rows `[first, end]` of the log, the end exclusive", default=None
    )
    line: int | None = entry(Integer(minimum=1), "its line of the table", default=None)


@frozen(kw_only=True)
class FileRecord:
    """A file that was read."""

    name: str = entry(Text(), "its name")
    sha256: str | None = entry(Text(), "the SHA-256 of its bytes", default=None)

    @classmethod
    def of_text(cls, name: str, text: str) -> FileRecord:
        """Return the record of a file with this text."""
        return cls(name=name, sha256=sha256(text.encode()).hexdigest())


@frozen(kw_only=True)
class LogRecord(FileRecord):
    """A log that was read."""

    rows: int | None = entry(Integer(minimum=0), "how many rows it has", default=None)
    missing: int | None = entry(Integer(minimum=0), "how many of them were left out", default=None)


@frozen(kw_only=True)
class SegmentsRecord:
    """The origin of the still segments of a log: a file, or how they were found."""

    name: str | None = entry(Text(), "of their file", default=None)
    sha256: str | None = entry(Text(), "the SHA-256 of their file", default=None)
    found: str | None = entry(Text(), "by what they were found", default=None)
    window_rows: int | None = entry(Integer(minimum=1), "rows in which the sensor held still", default=None)
    threshold: float | None = entry(FROM_ZERO, "the largest standard deviation, unit", default=None)
    times_noise: float | None = entry(FROM_ZERO, "the threshold over the noise", default=None)


@frozen(kw_only=True)
class BenchSensorRecord:
    """One sensor on the stage of a pair calibration."""

    serial: str = entry(Text(), "its serial number")
    model: str | None = entry(Text(), "its model", default=None)
    address: str | None = entry(Text(), "its address", default=None)


@frozen(kw_only=True)
class BenchRecord:
    """The bench that measured."""

    address: str | None = entry(Text(), "of the sensor", default=None)
    axes: tuple[str, ...] = entry(
        ListOf(Text()), "of the fixture that the sensor's axes point along, where it does not sit straight", default=()
    )
    thermometer: str | None = entry(Text(), "address of the thermometer", default=None)
    sensors: tuple[BenchSensorRecord, ...] = entry(
        ListOf(Section(BenchSensorRecord)), "of a pair: the sensors on the stage", default=()
    )


@frozen(kw_only=True)
class Provenance:
    """The provenance of a tilt calibration."""

    made_by: str | None = entry(Text(), "`measurement`, `the virtual bench …`, `fit of …`", default=None)
    operator: str | None = entry(Text(), "who led the session", default=None)
    bench: BenchRecord | None = entry(Section(BenchRecord), "`address`, `axes` and `thermometer`", default=None)
    base: FileRecord | None = entry(
        Section(FileRecord), "the calibration that it builds on (`--base`): `name`, `sha256`", default=None
    )
    sources: tuple[FileRecord, ...] = entry(
        ListOf(Section(FileRecord)), "the calibrations that `combine` put together: `name`, `sha256`", default=()
    )
    log: LogRecord | None = entry(Section(LogRecord), "the log: `name`, `rows`, `missing`, `sha256`", default=None)
    table: FileRecord | None = entry(Section(FileRecord), "the table of positions: `name`, `sha256`", default=None)
    segments: SegmentsRecord | None = entry(
        Section(SegmentsRecord), "the segments: `name` and `sha256`, or how they were `found`", default=None
    )
    software: str | None = entry(Text(), "program and version", default=None)
    started: str | None = entry(Text(), "when the session began, UTC", default=None)
    ended: str | None = entry(Text(), "when the session ended, UTC", default=None)
    journal: FileRecord | None = entry(Section(FileRecord), "the journal: `name`, `sha256`", default=None)
    link_statistics: Mapping[str, int] | None = entry(
        ByName(Integer(minimum=0)),
        "[what became of what a sensor said](../explanation.md#lost-and-damaged)",
        default=None,
        formerly="reception",
    )


@frozen(kw_only=True)
class SamplesRecord:
    """The numbers of samples of a rotation."""

    used: int = entry(Integer(minimum=0), "samples that were used")
    left_out: int = entry(Integer(minimum=0), "samples that were left out")


@frozen(kw_only=True)
class PairProvenance:
    """The provenance of a pair calibration."""

    made_by: str | None = entry(Text(), "`measurement`, `the virtual bench …`, `match of …`", default=None)
    operator: str | None = entry(Text(), "who led the session", default=None)
    bench: BenchRecord | None = entry(
        Section(BenchRecord), "`sensors`: `serial`, `model` and `address` of each", default=None
    )
    software: str | None = entry(Text(), "program and version", default=None)
    log: LogRecord | None = entry(Section(LogRecord), "the log: `name`, `rows`, `missing`, `sha256`", default=None)
    stage_angle: str | None = entry(Text(), "how the stage angle was found, where it was estimated", default=None)
    started: str | None = entry(Text(), "when the session began, UTC", default=None)
    ended: str | None = entry(Text(), "when the session ended, UTC", default=None)
    journal: FileRecord | None = entry(Section(FileRecord), "the journal: `name`, `sha256`", default=None)
    link_statistics: Mapping[str, Mapping[str, int]] | None = entry(
        ByName(ByName(Integer(minimum=0))),
        "per serial number, [what became of what the sensors said](../explanation.md#lost-and-damaged)",
        default=None,
        formerly="reception",
    )
    procedure: str | None = entry(Text(), "the name of the rotation procedure", default=None)
    samples: SamplesRecord | None = entry(Section(SamplesRecord), "`used` and `left_out`", default=None)
    stopped: str | None = entry(Text(), "why the rotation ended", default=None)
    not_matched: tuple[str, ...] = entry(ListOf(Text()), "pairs that could not be matched, and why", default=())

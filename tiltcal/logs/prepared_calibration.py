"""From a calibration to the kernel that applies it: of a tilt sensor, or of pairs of accelerometers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date, timedelta
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING

import tiltcal
from tiltcal.calibration.record import compensation_of
from tiltcal.calibration.stated_mounting import mounting_in_words, stated_mounting, with_mounting
from tiltcal.calibration.summary import objections
from tiltcal.core.pair.compensation import PairCompensation
from tiltcal.errors import EstimateError, InputError, UsageError
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.pair import PairRecord
from tiltcal.files.uncertainty import stated_uncertainty
from tiltcal.logs.cf_attributes import COUNT, DEGREE
from tiltcal.logs.columns import HEADING, TIME, SensorColumns
from tiltcal.logs.compensation_kernel import Kernel, PairKernel, RowRemarks, TiltKernel
from tiltcal.stated_arguments import is_number, require_boolean, require_from_zero, require_text_or_none, shown

if TYPE_CHECKING:
    from tiltcal.core.angle_uncertainty import CompensationWithUncertainty
    from tiltcal.core.compensation import Compensation
    from tiltcal.core.earth_compensation import EarthFrameCompensation
    from tiltcal.logs.means import GroupSize


_EXAMPLES = {"magnetometer": "mx,my,mz", "velocity": "u,v,w"}


@dataclass(frozen=True)
class ApplyOptions:
    """How a calibration is to be applied; the attributes are arguments of :func:`tiltcal.apply_log`."""

    first_order: bool = False
    uncertainty: bool = False
    reading_noise: float | None = None
    mounting: Mapping[str, float] | str = ""
    serial: str | None = None
    stability: float | None = None
    start: str | date | None = None
    magnetometer: Sequence[str] | str = ()
    velocity: Sequence[str] | str = ()
    declination: float | None = None
    magnetometer_noise: float | None = None
    average: int | None = None
    every: str | float | timedelta | None = None

    def __post_init__(self) -> None:
        require_boolean("--first-order", self.first_order)
        require_boolean("--uncertainty", self.uncertainty)
        require_text_or_none("--serial", self.serial)
        for option in ("reading_noise", "stability", "magnetometer_noise"):
            require_from_zero(f"--{option.replace('_', '-')}", getattr(self, option))
        for option, value in (("--stability", self.stability), ("--reading-noise", self.reading_noise)):
            if value is not None and not self.uncertainty:
                raise UsageError(f"{option} needs --uncertainty")

    def averaging(self) -> GroupSize | None:
        """Return how rows are put into means; None where they are not."""
        if self.average is None and self.every is None:
            return None
        from tiltcal.logs.means import GroupSize

        return GroupSize.of(self.average, self.every)

    def vectors(self) -> dict[str, tuple[str, ...]]:
        """Return the columns of the vectors that are asked for, by role.

        UsageError: a vector has not three columns, or an option needs another.
        """
        given = {"magnetometer": self.magnetometer, "velocity": self.velocity}
        found = {role: _three_columns(role, names) for role, names in given.items() if names}
        if self.declination is not None and not found:
            raise UsageError("--declination needs --magnetometer or --velocity")
        if self.declination is not None and not (is_number(self.declination) and abs(self.declination) <= 180.0):
            raise UsageError(f"--declination is between -180 and 180 degrees, not {shown(self.declination)}")
        if self.magnetometer_noise is not None and not (self.uncertainty and self.magnetometer):
            raise UsageError("--magnetometer-noise needs --magnetometer and --uncertainty")
        return found

    def without_uncertainty(self) -> ApplyOptions:
        """Return these options for the results alone."""
        return replace(self, uncertainty=False, reading_noise=None, stability=None, magnetometer_noise=None)

    def require_file(self) -> None:
        """Raise UsageError for what is for a folder of calibrations."""
        for name in ("serial", "stability", "start"):
            if getattr(self, name) is not None:
                raise UsageError(f"--{name} is for a folder of calibrations (--calibrations)")


@dataclass(frozen=True)
class PreparedCalibration:
    """A calibration, ready for the rows of one log: a kernel may remember those that have passed.

    Attributes
    ----------
    channels : tuple of str
        The readings that it takes.
    units : mapping of str to str
        Of each reading; of pairs that of the stage angle alone: the unit of the others does not matter.
    angles : tuple of str
        The added columns that are angles.
    watched : tuple of str
        The columns to be summed up.
    origin : mapping of str to str
        What a file made with it should state: ``software``; of a file ``calibration`` and ``sha256``; of a sensor
        ``serial``.
    roles : tuple of str
        The roles that the log must have besides readings, such as ``time``; the temperature is taken where it is there.
    optional_roles : tuple of str
        Roles that are taken where the log has them.
    vectors : mapping of str to tuple of str
        The three columns of ``magnetometer`` and ``velocity``, where these are asked for.
    averaging : GroupSize or None
        How rows are put into means before the kernel sees them.
    readings : PreparedCalibration or None
        What judges the readings of which means are made.
    remarks : mapping of str to RowRemarks
        The remarks on the rows, by what the names of a sensor's columns begin with.
    sensors : tuple of SensorColumns
        Where the readings of each sensor stand among the channels; empty for a sensor whose columns have no lead.
    lagged : bool
        Whether the kernel follows a thermal lag, so that times have to go on.
    """

    kernel: Kernel
    channels: tuple[str, ...]
    units: Mapping[str, str]
    angles: tuple[str, ...]
    watched: tuple[str, ...]
    origin: Mapping[str, str]
    roles: tuple[str, ...] = ()
    optional_roles: tuple[str, ...] = ()
    vectors: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    averaging: GroupSize | None = None
    sensors: tuple[SensorColumns, ...] = ()
    lagged: bool = False
    readings: PreparedCalibration | None = None
    remarks: Mapping[str, RowRemarks] = field(default_factory=dict)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of all columns that are added to the log."""
        return self.kernel.columns if self.averaging is None else (COUNT, *self.kernel.columns)


def _three_columns(role: str, names: Sequence[str] | str) -> tuple[str, ...]:
    listed = names.split(",") if isinstance(names, str) else names
    columns = tuple(str(name).strip() for name in listed) if isinstance(listed, Iterable) else ()
    if len(set(columns)) != 3 or not all(columns):
        raise UsageError(f"--{role} names three columns, along x, y and z, such as {_EXAMPLES[role]}; not {names!r}")
    return columns


def prepare(
    calibration: CalibrationRecord | PairRecord,
    options: ApplyOptions,
    say: Callable[[str], None] = lambda line: None,
    *,
    file: Path | None = None,
    origin: Mapping[str, str] | None = None,
    remarks: RowRemarks | None = None,
) -> PreparedCalibration:
    """Make a calibration ready.

    Parameters
    ----------
    say : callable
        Called with each remark about what had to be assumed.
    file : Path, optional
        The calibration's file, for messages.
    origin : mapping of str to str, optional
        What is known of that file.
    remarks : RowRemarks, optional
        On the rows of other calibrations too.

    UsageError: the calibration is of pairs, and the options are for tilt.
    InputError: the calibration cannot be applied.
    """
    vectors, averaging = options.vectors(), options.averaging()
    stated = {"software": f"tiltcal {tiltcal.__version__}", **(origin or {})}
    if isinstance(calibration, PairRecord):
        return _of_pairs(calibration, options, stated, str(file or "the calibration"))
    if not isinstance(calibration, CalibrationRecord):
        raise UsageError(f"name a calibration or its file, not {calibration!r}")
    if options.mounting:
        calibration = _mounted(calibration, options.mounting, say)
    coefficients, sensor = calibration.coefficients, calibration.sensor
    stated["serial"] = sensor.serial
    for objection in objections(calibration):
        say(f"note: the calibration of {sensor.serial}: {objection}")
    remarks, readings = remarks or RowRemarks(), None
    if averaging is not None:
        readings = prepare(calibration, ApplyOptions(options.first_order))
        calibration = replace(calibration, limits=replace(calibration.limits, length=inf))
    try:
        compensation = compensation_of(calibration, first_order=options.first_order)
        uncertain = _uncertain(calibration, compensation, options.reading_noise, say) if options.uncertainty else None
        if uncertain is not None and averaging is not None:
            say("note: the noise of readings counts as white: a mean of n rows has 1/√n of it")
        earth = _earth(compensation, uncertain, options, say) if vectors else None
    except EstimateError as failure:
        raise InputError(str(failure), file=file) from failure
    lag = 0.0 if coefficients.thermal is None else coefficients.thermal.lag
    return PreparedCalibration(
        TiltKernel(compensation, uncertain, earth, lag, averaging is not None, remarks),
        coefficients.channels,
        dict.fromkeys(coefficients.channels, sensor.unit),
        compensation.angles,
        (*(uncertain.expanded if uncertain else ()), *(earth.expanded if earth else ())),
        stated,
        _roles(vectors, averaging),
        (TIME,) if lag else (),
        vectors,
        averaging,
        readings=readings,
        remarks={"": remarks},
        lagged=bool(lag),
    )


def _of_pairs(
    calibration: PairRecord, options: ApplyOptions, origin: Mapping[str, str], file: str
) -> PreparedCalibration:
    for name in ("first_order", "uncertainty", "mounting", "magnetometer", "velocity", "average", "every"):
        if getattr(options, name):
            raise UsageError(
                f"--{name.replace('_', '-')} is for tilt calibrations; {file} is of pairs, which have no tilt"
            )
    matched = PairCompensation(calibration.matchings, calibration.spin.phase)
    units = {channel: DEGREE for channel in matched.channels if channel == calibration.spin.phase}
    return PreparedCalibration(PairKernel(matched), matched.channels, units, (), (), origin)


def _mounted(
    calibration: CalibrationRecord, angles: Mapping[str, float] | str, say: Callable[[str], None]
) -> CalibrationRecord:
    """Return the calibration in a known mounting; report one that is replaced."""
    own = calibration.coefficients.mounting
    if own is not None:
        say(f"note: --mounting replaces the mounting of the calibration, {mounting_in_words(own)}")
    return with_mounting(calibration, stated_mounting(angles))


def _roles(vectors: Mapping[str, tuple[str, ...]], averaging: GroupSize | None) -> tuple[str, ...]:
    """Return the roles that a log must have besides readings."""
    heading = () if "magnetometer" in vectors or not vectors else (HEADING,)
    return (*heading, TIME) if averaging is not None and averaging.seconds else heading


def _earth(
    compensation: Compensation,
    uncertain: CompensationWithUncertainty | None,
    options: ApplyOptions,
    say: Callable[[str], None],
) -> EarthFrameCompensation:
    """Return what adds heading and earth velocities; report which north they count from."""
    from tiltcal.core.earth_compensation import EarthFrameCompensation
    from tiltcal.core.earth_uncertainty import EarthUncertainty

    if options.magnetometer and options.declination is None:
        say("note: heading counts from magnetic north: there is no --declination")
    if not options.magnetometer and options.declination:
        say(f"note: the declination of {options.declination:g}° is added to the heading of the log")
    if uncertain is not None and options.magnetometer and options.magnetometer_noise is None:
        say("note: the magnetometer counts as exact (--magnetometer-noise)")
    return EarthFrameCompensation(
        compensation,
        averaged=options.averaging() is not None,
        magnetometer=bool(options.magnetometer),
        velocity=bool(options.velocity),
        declination=options.declination or 0.0,
        uncertainty=(
            None if uncertain is None else EarthUncertainty(uncertain.propagation, options.magnetometer_noise or 0.0)
        ),
    )


def _uncertain(
    calibration: CalibrationRecord, compensation: Compensation, reading_noise: float | None, say: Callable[[str], None]
) -> CompensationWithUncertainty:
    """Return the kernel that adds uncertainties; report what it has to assume."""
    from tiltcal.core.angle_uncertainty import CompensationWithUncertainty

    stated, remarks = stated_uncertainty(calibration.uncertainty, calibration.coefficients, reading_noise=reading_noise)
    for remark in remarks:
        say(f"note: {remark}")
    return CompensationWithUncertainty(compensation, calibration.coefficients, stated)

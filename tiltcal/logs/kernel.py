"""From a calibration to the kernel that applies it: columns from the values of some rows of a log, by role."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

import tiltcal
from tiltcal.calibration.record import compensation_of, mounting_in_words, stated_mounting, with_mounting
from tiltcal.calibration.summary import objections
from tiltcal.core.angle_uncertainty import uncertainty_columns, with_shares
from tiltcal.core.compensation import Compensated, Compensation
from tiltcal.core.flags import MISSING, NO_DIRECTION, NO_TEMPERATURE, SUSPECT, Mask, mark
from tiltcal.core.model import Array
from tiltcal.core.pair.compensation import PairCompensation
from tiltcal.core.thermal_lag import ThermalLag
from tiltcal.errors import EstimateError, InputError, UsageError
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.pair import PairRecord
from tiltcal.files.uncertainty import stated_uncertainty
from tiltcal.logs.apply_summary import ColumnWidths
from tiltcal.logs.cf_attributes import COUNT, DEGREE
from tiltcal.logs.columns import HEADING, TIME, SensorColumns
from tiltcal.logs.log import Table
from tiltcal.logs.means import GroupSize
from tiltcal.logs.options import ApplyOptions, require_consistent, vectors
from tiltcal.options import complete
from tiltcal.printable import counted

if TYPE_CHECKING:
    from tiltcal.core.angle_uncertainty import CompensationWithUncertainty
    from tiltcal.core.compensation import KernelChunk
    from tiltcal.core.earth_frame import EarthFrameCompensation

_USUAL = 0.005  # g, by which the median length of gravity of a log may differ from 1 g without a remark


@dataclass(frozen=True)
class RoleValues:
    """The values of some rows of a log, by role; NaN where one is missing.

    Attributes
    ----------
    readings : ndarray, shape (n, channels)
        Raw readings, in the order of the calibration's channels.
    temperature : ndarray, shape (n,), or None
        °C; None where the log has none.
    time : ndarray, shape (n,), or None
        Seconds; None where the kernel does not ask for it.
    magnetometer, velocity : ndarray, shape (n, 3), or None
        In the unit of their columns; None where they are not asked for.
    heading : ndarray, shape (n,), or None
        Degrees; None where it is not asked for.
    count : ndarray of int, shape (n,), of several sensors (n, sensors), or None
        Of how many rows of the log each row is the mean; None where it is none.
    """

    readings: Array
    temperature: Array | None = None
    time: Array | None = None
    magnetometer: Array | None = None
    velocity: Array | None = None
    heading: Array | None = None
    count: NDArray[np.int64] | None = None

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.readings)


class Kernel(Protocol):
    """Columns from the rows of one log, block after block in order; a kernel may remember the rows before."""

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns that a call gives; ``flag`` and ``reason`` are among them."""
        ...

    def __call__(self, values: RoleValues) -> Table:
        """Return the columns of some rows, under the names and in the order of :attr:`columns`."""
        ...


class RowRemarks:
    """The remarks on all rows of a log: on the length of gravity, and on a sign that nothing shows."""

    def __init__(self) -> None:
        self._squares = ColumnWidths(11, (-8, 24))
        self._unknown = 0

    def add(self, chunk: KernelChunk, *, on_edge: bool) -> None:
        """Count some rows, before a heading marks them."""
        if len(chunk.own) == 3:
            self._squares.add(np.einsum("an,an->n", chunk.own, chunk.own))
        if on_edge:
            self._unknown += int(np.count_nonzero(chunk.out.reason & NO_DIRECTION))

    def __iter__(self) -> Iterator[str]:
        """Yield the remarks."""
        length = (self._squares.median or 1.0) ** 0.5
        if abs(length - 1.0) > _USUAL:
            yield f"|g| is {round(length, 3):g}: supply, unit, place or zero differ from the calibration's"
        if self._unknown:
            rows = counted(self._unknown, "row")
            yield f"in {rows} the sensor is more than 45° from level, mounted on edge: nothing shows the sign of its z"


class LagCorrection:
    """The temperature of the sensing element in place of the thermometer's; it remembers the rows before.

    Parameters
    ----------
    lag : float
        Of the element behind the thermometer, seconds.
    """

    def __init__(self, lag: float) -> None:
        self._lag = ThermalLag(lag) if lag else None

    def __call__(self, values: RoleValues) -> tuple[RoleValues, Mask | None]:
        """Return the rows with the element's temperature, and which have the thermometer's; None where none is late."""
        temperature = values.temperature
        if self._lag is None or temperature is None:
            return values, None
        if values.time is None:
            return values, np.isfinite(temperature)
        element = self._lag(values.time, temperature)
        lost = np.isfinite(temperature) & ~np.isfinite(element)
        return replace(values, temperature=np.where(lost, temperature, element)), lost


class TiltKernel:
    """The compensation of a tilt sensor, and what is added to it, in this order.

    Parameters
    ----------
    uncertain : CompensationWithUncertainty, optional
        Adds the uncertainty of every angle.
    earth : EarthFrameCompensation, optional
        Adds heading and earth velocities.
    averaged : bool
        Rows are means of :attr:`RoleValues.count` rows: uncertainties have a random and a common share.
    lag : float
        By how much its element is later than the thermometer, s. Rows without a time are compensated with the
        temperature of the thermometer, and have flag 3 and reason 16.
    remarks : RowRemarks, optional
        Counts the rows.
    """

    def __init__(
        self,
        compensation: Compensation,
        uncertain: CompensationWithUncertainty | None = None,
        earth: EarthFrameCompensation | None = None,
        lag: float = 0.0,
        averaged: bool = False,
        remarks: RowRemarks | None = None,
    ) -> None:
        self._compensation, self._uncertain, self._earth = compensation, uncertain, earth
        self._correct_lag = LagCorrection(lag)
        self._averaged = averaged
        self._remarks = remarks or RowRemarks()
        names = [*compensation.columns]
        if uncertain is not None:
            names += uncertainty_columns(compensation.angles, averaged=averaged)
        self._own = len(names)
        self.columns = (*names, *(() if earth is None else earth.columns))

    def __call__(self, values: RoleValues) -> Table:
        values, lost = self._correct_lag(values)
        out = Compensated.empty(len(values), len(self._compensation.axes))
        table = self._compensation.table(out)
        own = self._own - len(table)
        added = np.empty((len(self.columns) - len(table), len(values)))
        with np.errstate(all="ignore"):
            for chunk in self._compensation.chunks(values.readings, values.temperature, out):
                rows = chunk.rows
                self._remarks.add(chunk, on_edge=self._compensation.on_edge)
                if values.count is not None:
                    chunk = replace(chunk, share=1.0 / np.maximum(values.count[rows], 1))
                if self._uncertain is not None:
                    self._add_uncertainties(self._uncertain, chunk, added[:own, rows])
                if self._earth is not None:
                    given = (values.magnetometer, values.heading, values.velocity)
                    added[own:, rows] = self._earth(
                        chunk, *(None if values is None else values[rows] for values in given)
                    )
        if lost is not None:
            mark(out, lost & (out.flag != MISSING), SUSPECT, NO_TEMPERATURE)
        return table | dict(zip(self.columns[len(table) :], added, strict=True))

    def _add_uncertainties(self, uncertain: CompensationWithUncertainty, chunk: KernelChunk, out: Array) -> None:
        if self._averaged:
            out[...] = with_shares(
                uncertain.of_angles(chunk, rounded=False), uncertain.of_angles(replace(chunk, share=0.0), rounded=False)
            )
        else:
            uncertain.of_angles(chunk, out.reshape(2, -1, out.shape[1]))


class PairKernel:
    """The matched sums of pairs of accelerometers."""

    def __init__(self, compensation: PairCompensation) -> None:
        self._compensation = compensation
        self.columns = compensation.columns

    def __call__(self, values: RoleValues) -> Table:
        return self._compensation(values.readings)


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


def prepare(
    calibration: CalibrationRecord | PairRecord,
    options: ApplyOptions,
    *,
    file: Path | None = None,
    origin: Mapping[str, str] | None = None,
    remarks: RowRemarks | None = None,
) -> PreparedCalibration:
    """Make a calibration ready.

    Parameters
    ----------
    file : Path, optional
        The calibration's file, for messages.
    origin : mapping of str to str, optional
        What is known of that file.
    remarks : RowRemarks, optional
        On the rows of other calibrations too.

    UsageError: the calibration is of pairs, and the options are for tilt.
    InputError: the calibration cannot be applied.
    """
    require_consistent(options)
    named, size, say = vectors(options), GroupSize.of(options["average"], options["every"]), options["say"]
    stated = {"software": f"tiltcal {tiltcal.__version__}", **(origin or {})}
    if isinstance(calibration, PairRecord):
        return _of_pairs(calibration, options, stated, str(file or "the calibration"))
    if not isinstance(calibration, CalibrationRecord):
        raise UsageError(f"name a calibration or its file, not {calibration!r}")
    if options["mounting"]:
        calibration = _mounted(calibration, options)
    coefficients, sensor = calibration.coefficients, calibration.sensor
    stated["serial"] = sensor.serial
    for objection in objections(calibration):
        say(f"note: the calibration of {sensor.serial}: {objection}")
    remarks, readings = remarks or RowRemarks(), None
    if size is not None:
        readings = prepare(calibration, complete(ApplyOptions, {"first_order": options["first_order"]}))
        calibration = replace(calibration, limits=replace(calibration.limits, length=inf))
    try:
        compensation = compensation_of(calibration, first_order=options["first_order"])
        uncertain = _uncertain(calibration, compensation, options) if options["uncertainty"] else None
        if uncertain is not None and size is not None:
            say("note: the noise of readings counts as white: a mean of n rows has 1/√n of it")
        earth = _earth(compensation, uncertain, options) if named else None
    except EstimateError as failure:
        raise InputError(str(failure), file=file) from failure
    lag = 0.0 if coefficients.thermal is None else coefficients.thermal.lag
    return PreparedCalibration(
        TiltKernel(compensation, uncertain, earth, lag, size is not None, remarks),
        coefficients.channels,
        dict.fromkeys(coefficients.channels, sensor.unit),
        compensation.angles,
        (*(uncertain.expanded if uncertain else ()), *(earth.expanded if earth else ())),
        stated,
        (
            *((HEADING,) if named and "magnetometer" not in named else ()),
            *((TIME,) if size is not None and size.seconds else ()),
        ),
        (TIME,) if lag else (),
        named,
        size,
        readings=readings,
        remarks={"": remarks},
        lagged=bool(lag),
    )


def _of_pairs(
    calibration: PairRecord, options: ApplyOptions, origin: Mapping[str, str], file: str
) -> PreparedCalibration:
    for name in ("first_order", "uncertainty", "mounting", "magnetometer", "velocity", "average", "every"):
        if options[name]:
            raise UsageError(
                f"--{name.replace('_', '-')} is for tilt calibrations; {file} is of pairs, which have no tilt"
            )
    matched = PairCompensation(calibration.matchings, calibration.spin.phase)
    units = {channel: DEGREE for channel in matched.channels if channel == calibration.spin.phase}
    return PreparedCalibration(PairKernel(matched), matched.channels, units, (), (), origin)


def _mounted(calibration: CalibrationRecord, options: ApplyOptions) -> CalibrationRecord:
    """Return the calibration in the stated mounting; report one that is replaced."""
    replaced = calibration.coefficients.mounting
    if replaced is not None:
        options["say"](f"note: --mounting replaces the mounting of the calibration, {mounting_in_words(replaced)}")
    return with_mounting(calibration, stated_mounting(options["mounting"]))


def _earth(
    compensation: Compensation, uncertain: CompensationWithUncertainty | None, options: ApplyOptions
) -> EarthFrameCompensation:
    """Return what adds heading and earth velocities; report which north they count from."""
    from tiltcal.core.earth_frame import EarthFrameCompensation

    say, noise, declination = options["say"], options["magnetometer_noise"], options["declination"]
    if options["magnetometer"] and declination is None:
        say("note: heading counts from magnetic north: there is no --declination")
    if not options["magnetometer"] and declination:
        say(f"note: the declination of {options['declination']:g}° is added to the heading of the log")
    if uncertain is not None and options["magnetometer"] and noise is None:
        say("note: the magnetometer counts as exact (--magnetometer-noise)")
    return EarthFrameCompensation(
        compensation,
        averaged=options["average"] is not None or options["every"] is not None,
        magnetometer=bool(options["magnetometer"]),
        velocity=bool(options["velocity"]),
        declination=declination or 0.0,
        uncertain=uncertain,
        field_noise=noise or 0.0,
    )


def _uncertain(
    calibration: CalibrationRecord, compensation: Compensation, options: ApplyOptions
) -> CompensationWithUncertainty:
    """Return the kernel that adds uncertainties; report what it has to assume."""
    from tiltcal.core.angle_uncertainty import CompensationWithUncertainty

    noise = options["reading_noise"]
    stated, remarks = stated_uncertainty(calibration.uncertainty, calibration.coefficients, reading_noise=noise)
    for remark in remarks:
        options["say"](f"note: {remark}")
    return CompensationWithUncertainty(compensation, calibration.coefficients, stated)

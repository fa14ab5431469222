"""From a calibration to the kernel that applies it: columns from the values of some rows of a log, by role."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from math import inf, nan
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import tiltcal
from tiltcal.calibration.record import compensation_of, stated_mounting
from tiltcal.calibration.stated import stated_uncertainty
from tiltcal.calibration.wording import objections
from tiltcal.column_names import TIME
from tiltcal.core.angle_uncertainty import CompensationWithUncertainty, uncertainty_columns, uncertainty_table
from tiltcal.core.compensation import CHUNK, UNCERTAIN_CHUNK, Compensated, Compensation, KernelChunk
from tiltcal.core.earth_frame import EarthFrameCompensation
from tiltcal.core.flags import NO_DIRECTION, NO_TEMPERATURE, SUSPECT, mark_columns
from tiltcal.core.model import Array
from tiltcal.core.pair.compensation import PairCompensation
from tiltcal.core.thermal_lag import ThermalLag
from tiltcal.errors import Argument, EstimateError, InputError, UsageError
from tiltcal.files.calibration import CalibrationRecord
from tiltcal.files.pair import PairRecord
from tiltcal.logs.cf_attributes import COUNT
from tiltcal.logs.columns import HEADING
from tiltcal.logs.log import Table
from tiltcal.logs.options import ApplyOptions, GroupSize, vectors
from tiltcal.options import complete
from tiltcal.printable import counted

_USUAL = 0.005  # g, by which the median length of gravity of a log may differ from 1 g without a remark
_STEP, _LONGEST = 0.0005, 40_000  # g, in which lengths are counted, and so many steps


@dataclass(frozen=True)
class RoleValues:
    """The values of n rows of a log, by role: NaN where one is missing, None where the log has none.

    ``readings`` (n, channels) are in the order of the channels, ``temperature`` (n,) in °C, ``time`` (n,) in seconds,
    ``magnetometer`` and ``velocity`` (n, 3) in the unit of their columns, ``heading`` (n,) in degrees; ``count`` (n,)
    is of how many rows each row is the mean.
    """

    readings: Array
    temperature: Array | None = None
    time: Array | None = None
    magnetometer: Array | None = None
    velocity: Array | None = None
    heading: Array | None = None
    count: NDArray[np.int64] | None = None

    def __len__(self) -> int:
        return len(self.readings)


Kernel = Callable[[RoleValues], Table]
"""Columns from the rows of one log, block after block in order; a kernel may remember the rows before."""


class RowRemarks:
    """The remarks on all rows of a log: on the length of gravity, and on a sign that nothing shows."""

    def __init__(self) -> None:
        self._lengths = np.zeros(_LONGEST, np.int64)  # how many rows have each length
        self._unknown = 0

    def add(self, chunk: KernelChunk, *, on_edge: bool) -> None:
        """Count some rows, before a heading marks them."""
        if len(chunk.own) == 3:
            lengths = np.sqrt(np.einsum("an,an->n", chunk.own, chunk.own)) / _STEP
            steps = np.minimum(lengths[lengths == lengths], _LONGEST - 1).astype(np.int64)
            self._lengths += np.bincount(steps, minlength=_LONGEST)
        if on_edge:
            self._unknown += int(np.count_nonzero(chunk.out.reason & NO_DIRECTION))

    def __iter__(self) -> Iterator[str]:
        """Yield the remarks."""
        so_far = np.cumsum(self._lengths)
        length = (float(np.searchsorted(so_far, so_far[-1] / 2.0)) + 0.5) * _STEP
        if so_far[-1] and abs(length - 1.0) > _USUAL:
            yield f"|g| is {round(length, 3):g}: supply, unit, place or zero differ from the calibration's"
        if self._unknown:
            rows = counted(self._unknown, "row")
            yield f"in {rows} the sensor is more than 45° from level, mounted on edge: nothing shows the sign of its z"


def with_lag(kernel: Kernel, lag: float, file: str) -> Kernel:
    """Return a kernel that takes the temperature of the sensing element, s later than its thermometer, for one log.

    An InputError where the times of the log, which is called ``file``, do not go on.
    """
    if not lag:
        return kernel
    follow, last, rows = ThermalLag(lag), nan, 0

    def lagged(values: RoleValues) -> Table:
        nonlocal last, rows
        temperature, time = values.temperature, values.time
        if time is not None:
            known = np.flatnonzero(np.isfinite(time))
            steps = np.diff(time[known], prepend=last)
            if np.any(steps <= 0.0):
                wrong = int(np.argmax(steps <= 0.0))
                how = f"time stands still or goes back at row {rows + int(known[wrong])}"
                advice = ("sort the log, or name a column of times that go on (", Argument("columns", "time=NAME"), ")")
                raise InputError((f"{how}, and the calibration follows a thermal lag: ", *advice), file=file)
            last, rows = float(time[known[-1]]) if len(known) else last, rows + len(time)
        if temperature is None:
            return kernel(values)
        late = np.isfinite(temperature)
        if time is not None:
            element = follow(time, temperature)
            late &= ~np.isfinite(element)
            values = replace(values, temperature=np.where(late, temperature, element))
        return mark_columns(kernel(values), late, SUSPECT, NO_TEMPERATURE)

    return lagged


class TiltKernel:
    """The compensation of a tilt sensor, then the uncertainty of its angles, then heading and earth velocities.

    Where ``averaged`` rows are means of :attr:`RoleValues.count` rows, and uncertainties have a random and a common
    share. ``remarks`` counts the rows.
    """

    def __init__(
        self,
        compensation: Compensation,
        uncertain_angles: CompensationWithUncertainty | None = None,
        earth: EarthFrameCompensation | None = None,
        averaged: bool = False,
        remarks: RowRemarks | None = None,
    ) -> None:
        self._compensation, self._uncertain_angles, self._earth = compensation, uncertain_angles, earth
        self.angles, self._averaged, self._remarks = compensation.angles, averaged, remarks or RowRemarks()
        uncertain = () if uncertain_angles is None else uncertainty_columns(self.angles, averaged=averaged)
        self._uncertain = len(uncertain)
        self.columns = (*compensation.columns, *uncertain, *(() if earth is None else earth.columns))

    def __call__(self, values: RoleValues) -> Table:
        out = Compensated.empty(len(values), len(self._compensation.axes))
        table = self._compensation.table(out)
        added = np.empty((len(self.columns) - len(table), len(values)))
        with np.errstate(all="ignore"):
            size = CHUNK if self._uncertain_angles is None else UNCERTAIN_CHUNK
            for chunk in self._compensation.chunks(values.readings, values.temperature, out, size):
                rows = chunk.rows
                self._remarks.add(chunk, on_edge=self._compensation.on_edge)
                if values.count is not None:
                    chunk = replace(chunk, share=1.0 / np.maximum(values.count[rows], 1))
                if self._uncertain_angles is not None:
                    uncertainty = self._uncertain_angles.of_angles
                    added[: self._uncertain, rows] = uncertainty_table(uncertainty, chunk, averaged=self._averaged)
                if self._earth is not None:
                    given = (values.magnetometer, values.heading, values.velocity)
                    added[self._uncertain :, rows] = self._earth(chunk, *(g if g is None else g[rows] for g in given))
        return table | dict(zip(self.columns[len(table) :], added, strict=True))


@dataclass(frozen=True)
class PreparedSensor:
    """A sensor, or pairs, ready for the rows of one log.

    ``added`` are the columns of its kernel; ``unit`` is that of the readings, None of pairs; ``origin`` is what a file
    made with it should state: software, calibration, sha256, serial; ``lag`` is by how much the element is later than
    the thermometer, s; ``judge`` judges the readings of which means are made; ``named`` are columns of the log of the
    fit; its own names begin with ``lead``. In the log ``columns`` are where its readings stand and, where it has one of
    its own, its ``thermometer``.
    """

    kernel: Kernel
    added: tuple[str, ...]
    channels: tuple[str, ...]
    unit: str | None
    origin: Mapping[str, str]
    angles: tuple[str, ...] = ()
    lag: float = 0.0
    judge: Kernel | None = None
    remarks: RowRemarks = field(default_factory=RowRemarks)
    named: Mapping[str, str] = field(default_factory=dict)
    lead: str = ""
    columns: tuple[int, ...] = ()
    thermometer: int | None = None


@dataclass(frozen=True)
class PreparedCalibration:
    """The calibrations of the sensors of a log, ready for its rows.

    ``roles`` are those that the log must have besides readings, such as ``time``; ``vectors`` are the three columns of
    ``magnetometer`` and ``velocity``, where these are asked for; ``averaging`` is how rows are put into means before.
    """

    sensors: tuple[PreparedSensor, ...]
    roles: tuple[str, ...] = ()
    vectors: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    averaging: GroupSize | None = None

    def led(self, wanted: Callable[[PreparedSensor], tuple[str, ...]]) -> tuple[str, ...]:
        """Return names of all sensors, each with the lead of its sensor."""
        return tuple(f"{sensor.lead}{name}" for sensor in self.sensors for name in wanted(sensor))

    @property
    def channels(self) -> tuple[str, ...]:
        """The readings."""
        return self.led(lambda sensor: sensor.channels)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of all columns that are added to the log."""
        return (*(() if self.averaging is None else (COUNT,)), *self.led(lambda sensor: sensor.added))

    @property
    def origin(self) -> dict[str, str]:
        """What a file made with them should state."""
        joined = {key: ", ".join(one.origin[key] for one in self.sensors) for key in self.sensors[0].origin}
        return {**joined, "software": self.sensors[0].origin["software"]}


def prepare(
    calibration: CalibrationRecord | PairRecord,
    options: ApplyOptions,
    *,
    file: Path | None = None,
    origin: Mapping[str, str] | None = None,
) -> PreparedCalibration:
    """Make a calibration ready; ``file`` is its file, for messages, ``origin`` what is known of it."""
    named, size, say = vectors(options), GroupSize.of(options["average"], options["every"]), options["say"]
    stated = {"software": f"tiltcal {tiltcal.__version__}", **(origin or {})}
    if isinstance(calibration, PairRecord):
        return PreparedCalibration((_of_pairs(calibration, options, stated, str(file or "the calibration")),))
    if not isinstance(calibration, CalibrationRecord):
        raise UsageError(f"name a calibration or its file, not {calibration!r}")
    if options["mounting"]:
        calibration = calibration.with_mounting(stated_mounting(options["mounting"]))
    coefficients, sensor = calibration.coefficients, calibration.sensor
    for objection in objections(calibration):
        say(f"note: the calibration of {sensor.serial}: {objection}")
    remarks = RowRemarks()
    try:
        kernel = tilt_kernel(calibration, options, remarks if size is None else RowRemarks())
        plain = complete(ApplyOptions, {"first_order": options["first_order"]})
        judge = None if size is None else tilt_kernel(calibration, plain, remarks)
    except EstimateError as failure:
        raise InputError(failure.words, file=file) from failure
    prepared = PreparedSensor(
        kernel,
        added=kernel.columns,
        channels=coefficients.channels,
        unit=sensor.unit,
        origin={**stated, "serial": sensor.serial},
        angles=kernel.angles,
        lag=0.0 if coefficients.thermal is None else coefficients.thermal.lag,
        judge=judge,
        remarks=remarks,
        named=sensor.columns,
    )
    roles = [HEADING] if named and "magnetometer" not in named else []
    roles += [TIME] if size is not None and size.seconds else []
    return PreparedCalibration((prepared,), tuple(roles), named, size)


def tilt_kernel(calibration: CalibrationRecord, options: ApplyOptions, remarks: RowRemarks) -> TiltKernel:
    """Return the kernel of a calibration; report what its uncertainty has to assume. An EstimateError where none is."""
    averaged = options["average"] is not None or options["every"] is not None
    if averaged:  # the lengths of readings are judged, not that of their mean
        calibration = replace(calibration, limits=replace(calibration.limits, length=inf))
    compensation = compensation_of(calibration, first_order=options["first_order"])
    uncertain_angles = earth = None
    if options["uncertainty"]:
        noise = options["reading_noise"]
        stated, assumed = stated_uncertainty(calibration, reading_noise=noise)
        for remark in assumed:
            options["say"](f"note: {remark}")
        uncertain_angles = CompensationWithUncertainty(compensation, calibration.coefficients, stated)
    if options["magnetometer"] or options["velocity"]:
        earth = _earth(compensation, uncertain_angles, options, averaged)
    return TiltKernel(compensation, uncertain_angles, earth, averaged, remarks)


def _of_pairs(calibration: PairRecord, options: ApplyOptions, origin: Mapping[str, str], file: str) -> PreparedSensor:
    for name in ("first_order", "uncertainty", "mounting", "magnetometer", "velocity", "average", "every"):
        if options[name]:
            raise UsageError(
                f"--{name.replace('_', '-')} is for tilt calibrations; {file} is of pairs, which have no tilt"
            )
    matched = PairCompensation(calibration.matchings, calibration.spin.phase)
    return PreparedSensor(lambda values: matched(values.readings), matched.columns, matched.channels, None, origin)


def _earth(
    compensation: Compensation,
    uncertain_angles: CompensationWithUncertainty | None,
    options: ApplyOptions,
    averaged: bool,
) -> EarthFrameCompensation:
    """Return what adds heading and earth velocities; report which north they count from."""
    say, noise, declination = options["say"], options["magnetometer_noise"], options["declination"]
    if options["magnetometer"] and declination is None:
        say("note: heading counts from magnetic north: there is no --declination")
    if uncertain_angles is not None and options["magnetometer"] and noise is None:
        say("note: the magnetometer counts as exact (--magnetometer-noise)")
    return EarthFrameCompensation(
        compensation,
        averaged=averaged,
        magnetometer=bool(options["magnetometer"]),
        velocity=bool(options["velocity"]),
        declination=declination or 0.0,
        uncertain=uncertain_angles,
        field_noise=noise or 0.0,
    )

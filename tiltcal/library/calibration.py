"""A calibration as a program holds it, and the functions that read, compare and combine such calibrations."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import degrees
from operator import attrgetter
from pathlib import Path
from typing import Any, TypeVar, Unpack, overload

from tiltcal.calibration.comparison import Comparison, compare_records
from tiltcal.calibration.record import compensation_of, limits_of, record_in, stated_mounting
from tiltcal.calibration.wording import pair_summary, summary
from tiltcal.core.compensation import Compensation
from tiltcal.core.model import Coefficients
from tiltcal.core.pair.compensation import PairCompensation
from tiltcal.core.pair.matching import Matching
from tiltcal.errors import UsageError
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity
from tiltcal.files.calibration_output import write_calibration
from tiltcal.files.coefficients import Uncertainty
from tiltcal.files.document import read_document
from tiltcal.files.pair import PairRecord
from tiltcal.files.results import DerivedRecord, FitRecord, PairProvenance, PositionRecord, ProcedureRecord, Provenance
from tiltcal.logs.options import ApplyOptions
from tiltcal.options import complete, takes
from tiltcal.printable import in_html

Frame = TypeVar("Frame")  # the same kind comes back; without their stubs those of pandas and pyarrow are Any


@dataclass(frozen=True, eq=False)
class SavedCalibration:
    """What calibrations of both kinds have: the content of a file."""

    record: Any

    def save(self, path: str | Path, say: Callable[[str], None] | None = None) -> None:
        """Write the calibration file, whole or not at all.

        Parameters
        ----------
        path : str or Path
            It replaces a calibration of the same sensor, and no other file.
        say : callable, optional
            Takes a sentence about the file that is replaced.

        Raises
        ------
        UsageError
            The file cannot be written there.
        """
        write_calibration(path, self.record.text, self.record.sensors, say)

    def report(self, path: str | Path) -> None:
        """Write the HTML page that is filed with the sensor; it needs no other file, and prints on A4.

        Raises
        ------
        UsageError
            The extra ``report`` is not installed, or the page cannot be written there.
        """
        from tiltcal.report.page import write_page

        write_page(path, self.record)

    def __eq__(self, other: object) -> bool:
        """Whether both give the same file."""
        return isinstance(other, type(self)) and self.record.text == other.record.text

    def __hash__(self) -> int:
        return hash(self.record.text)

    _repr_html_ = in_html


def _of_record(name: str, doc: str) -> Any:
    """Return a property that a calibration has from its record."""
    return property(attrgetter(f"record.{name}"), doc=doc)


class Applicable:
    """What applies to the raw readings of a tilt sensor: one calibration by its record, or a folder of them."""

    @overload
    def apply(self, frame: Mapping[str, Any], **options: Unpack[ApplyOptions]) -> dict[str, Any]: ...

    @overload
    def apply(self, frame: Frame, **options: Unpack[ApplyOptions]) -> Frame: ...

    @takes(ApplyOptions)
    def apply(self, frame: Any, **options: Any) -> Any:
        """Turn the raw readings of a frame into tilt with quality flags, as ``tiltcal apply`` does with a log.

        Parameters
        ----------
        frame : polars.DataFrame, pandas.DataFrame, pyarrow.Table, xarray.Dataset or mapping of str to array_like
            A column for each reading, for the temperature in °C where there is one, and for the time where calibrations
            of several times apply.
        **options

        Returns
        -------
        frame
            The same kind, with ``g_x`` and ``tilt_x`` (degrees) of each axis, ``flag`` and ``reason`` behind its own
            columns. Its own arrays are not copied where a dict or Dataset holds them: to change one, copy it first.

        Raises
        ------
        UsageError
            The frame is of no known kind, or has a column of a name that the result needs.
        InputError
            A column is not there or holds no numbers, the readings are in another unit than the calibration's, or no
            calibration fits them.
        """
        from tiltcal.logs.apply import apply_frame

        applied: Any = getattr(self, "record", self)
        return apply_frame(applied, frame, complete(ApplyOptions, options))


class Sensitivities(dict[tuple[str, str], float]):
    """Sensitivities by channel and axis, unit/g."""

    def __missing__(self, key: object) -> float:
        raise KeyError(f"{key!r}: a sensitivity has two indices, channel and axis, such as ['x', 'y']")


@dataclass(frozen=True)
class CalibratedRange:
    """Where a calibration holds.

    Attributes
    ----------
    tilt : dict of str to tuple of float
        Lowest and highest tilt by axis, degrees.
    temperature : tuple of float or None
        Lowest and highest temperature, °C.
    reading : dict of str to tuple of float
        The rails by channel, unit.
    directions : tuple of tuple of float, str or None
        Of three axes the directions of gravity that were met, in the sensor's own frame, or ``all``.
    """

    tilt: dict[str, tuple[float, float]]
    temperature: tuple[float, float] | None
    reading: dict[str, tuple[float, float]]
    directions: tuple[tuple[float, float, float], ...] | str | None = None

    def __str__(self) -> str:
        ranges = [(f"tilt {axis}", range, "°") for axis, range in self.tilt.items()]
        ranges += [] if self.temperature is None else [("temperature", self.temperature, " °C")]
        ranges += [(f"reading {channel}", range, "") for channel, range in self.reading.items()]
        return "\n".join(f"  {name}  {low:g}{unit}  to  {high:g}{unit}" for name, (low, high), unit in ranges)

    _repr_html_ = in_html


class Calibration(SavedCalibration, Applicable):
    """The calibration of one tilt sensor.

    Attributes
    ----------
    record : CalibrationRecord
        The content of its file. What it records of the fit, the procedure, the positions and the provenance is at hand
        here under the same names.

    Examples
    --------
    >>> cal = tiltcal.read("S-0042.yaml")
    >>> cal.offset["x"], cal.sensitivity["x", "y"], cal.uncertainty["offset.x"]
    >>> tilted = cal.apply(frame, columns={"x": "VoutX"}, uncertainty=True)
    """

    record: CalibrationRecord

    def __init__(self, record: CalibrationRecord) -> None:
        super().__init__(record)
        thermal, arrays = self.coefficients.thermal, [self.coefficients.offset, self.coefficients.sensitivity]
        arrays += [] if thermal is None else [thermal.drift, thermal.gain]
        arrays += [] if self.coefficients.nonlinearity is None else [self.coefficients.nonlinearity]
        for array in arrays:  # one that a caller wrote into would change later results
            array.setflags(write=False)

    def __reduce__(self) -> tuple[type[Calibration], tuple[CalibrationRecord]]:
        return Calibration, (self.record,)  # the arrays of a copy are read-only, too

    sensor: SensorIdentity = _of_record("sensor", "Model, serial number, unit of the readings, and channels.")
    coefficients: Coefficients = _of_record(
        "coefficients", "The coefficients as arrays, which are read-only, for computation; angles in radians."
    )
    uncertainty: Uncertainty = _of_record(
        "uncertainty",
        "Standard uncertainty (k = 1) of each coefficient by its dotted name, such as ``offset.x``, in its unit.",
    )
    derived: DerivedRecord = _of_record(
        "derived",
        "What follows from the coefficients: cross-axis sensitivity in %, misalignment and intrinsic parameters.",
    )
    fit: FitRecord = _of_record(
        "fit",
        "How well the positions agree: residuals, degrees of freedom, chi-square, where the uncertainty comes from.",
    )
    procedure: ProcedureRecord = _of_record("procedure", "The procedure as it was run, with the angles that were set.")
    positions: tuple[PositionRecord, ...] = _of_record(
        "positions", "Mean, standard deviation, number of samples and temperature of each position."
    )
    provenance: Provenance = _of_record("provenance", "Who made the calibration, when, and from which data.")

    @property
    def offset(self) -> dict[str, float]:
        """Reading at 0 g and the reference temperature by channel, in the sensor's unit."""
        return dict(zip(self.coefficients.channels, self.coefficients.offset.tolist(), strict=True))

    @property
    def sensitivity(self) -> Sensitivities:
        """Sensitivity by channel and axis, unit/g."""
        rows = zip(self.coefficients.channels, self.coefficients.sensitivity.tolist(), strict=True)
        axes = self.coefficients.axes
        return Sensitivities(
            {(channel, axis): one for channel, row in rows for axis, one in zip(axes, row, strict=True)}
        )

    @cached_property
    def limits(self) -> CalibratedRange:
        """Where the calibration holds, angles in degrees; the rails are the model's where the file names none."""
        limits = limits_of(self.record)
        tilt = {axis: (degrees(low), degrees(high)) for axis, (low, high) in limits.tilt.items()}
        return CalibratedRange(tilt, limits.temperature, limits.reading, limits.directions)

    def compensation(self, *, first_order: bool = False) -> Compensation:
        """Return the compensation of readings in arrays, with these coefficients and limits.

        Parameters
        ----------
        first_order : bool
            Use Cross-axis Compensation, eq. 6, in place of the whole matrix.

        Raises
        ------
        EstimateError
            The sensitivity matrix cannot be inverted.
        """
        return compensation_of(self.record, first_order=first_order)

    def plot(self) -> Any:
        """Draw the error of the tilt over its range before and after the calibration, degrees, for a notebook.

        Raises
        ------
        UsageError
            The extra ``report`` is not installed, or the file states no uncertainty.
        """
        from tiltcal.calibration.tilt_uncertainty import tilt_uncertainty
        from tiltcal.report.calibration_figures import tilt_figure
        from tiltcal.report.figure import require_extra

        require_extra()
        figure = tilt_figure(self.record, tilt_uncertainty(self.record))
        if figure is None:
            raise UsageError(f"the calibration of {self.sensor.serial} states no uncertainty: there is nothing to plot")
        return figure

    def with_mounting(self, angles: Mapping[str, float] | str) -> Calibration:
        """Return this calibration for a sensor that sits in a known way; a mounting that it has is replaced.

        Parameters
        ----------
        angles : mapping of str to float, or str
            Roll, pitch and yaw, degrees, such as ``{"roll": 180}`` or ``"roll=180"``; they count as exact, and those
            that are not named as 0.

        Raises
        ------
        UsageError
            An angle that there is not, or out of range.
        """
        return Calibration(self.record.with_mounting(stated_mounting(angles)))

    def __repr__(self) -> str:
        sensor = self.sensor
        return f"<Calibration of {sensor.model} {sensor.serial}: {', '.join(sensor.channels)} in {sensor.unit}>"

    def __str__(self) -> str:
        return summary(self.record)


class PairCalibration(SavedCalibration):
    """The matching of one or two accelerometer pairs on a rotary stage.

    Attributes
    ----------
    record : PairRecord
        The content of its file.
    """

    record: PairRecord

    matchings: tuple[Matching, ...] = _of_record(
        "matchings", "The pairs: ``p`` and ``q`` with their uncertainties, components before and after, suppression."
    )
    phase: str | None = _of_record("spin.phase", "The column of the stage angle; None where the spin was estimated.")
    frequency: float | None = _of_record("spin.frequency", "Spin frequency, Hz; None where the data have no time.")
    provenance: PairProvenance = _of_record("provenance", "Who made the matching, when, and from which data.")

    def compensation(self) -> PairCompensation:
        """Return the matched sums and the gradient signal of readings in arrays."""
        return PairCompensation(self.matchings, self.phase)

    @overload
    def apply(self, frame: Mapping[str, Any], *, columns: Mapping[str, str] | str = "") -> dict[str, Any]: ...

    @overload
    def apply(self, frame: Frame, *, columns: Mapping[str, str] | str = "") -> Frame: ...

    def apply(self, frame: Any, *, columns: Mapping[str, str] | str = "", **options: Any) -> Any:
        """Add the matched sum of each pair to a frame and, with both pairs, the gradient, whole and turn by turn.

        Parameters
        ----------
        frame
            As :meth:`Calibration.apply` takes it: a column for each accelerometer by its name in the pairs,
            and of both pairs one for the stage angle, degrees.
        columns : mapping of str to str, or str
            The column of each of them, such as ``{"a1": "Q1"}``; without it, the column of its name.
        **options
            Those of :meth:`tiltcal.Calibration.apply`, all of which are for tilt: one that is given is refused.

        Returns
        -------
        frame
            The same kind, with the new columns, ``flag`` and ``reason`` behind its own.

        Raises
        ------
        UsageError, InputError
            As :meth:`Calibration.apply`; or an option is for tilt.
        """
        from tiltcal.logs.apply import apply_frame

        return apply_frame(self.record, frame, complete(ApplyOptions, {"columns": columns, **options}))

    def __repr__(self) -> str:
        pairs = ", ".join(f"{matching.pair.first} and {matching.pair.second}" for matching in self.matchings)
        return f"<PairCalibration of {pairs}>"

    def __str__(self) -> str:
        return "\n\n".join(pair_summary(matching) for matching in self.matchings)


def read(path: str | Path) -> Calibration:
    """Read and check a calibration file of either kind.

    Returns
    -------
    Calibration
        Of the file of pairs a PairCalibration, which no type checker can infer: where it matters, use `isinstance`.

    Raises
    ------
    InputError
        Anything in it is wrong; the message names file, line and key. Of a journal or a log, what takes it.
    """
    record: Any = record_in(read_document(path))
    made: Any = PairCalibration(record) if isinstance(record, PairRecord) else Calibration(record)
    return made  # type: ignore[no-any-return]


def compare(old: Calibration, new: Calibration) -> Comparison:
    """Compare two calibrations of one sensor.

    The verdict allows for the number of coefficients that are compared: of two calibrations of an unchanged sensor it
    calls 5 % different.

    Raises
    ------
    UsageError
        They are not tilt calibrations of one sensor; the message names what differs.

    Examples
    --------
    >>> print(tiltcal.compare(tiltcal.read("spring.yaml"), tiltcal.read("autumn.yaml")))
    """
    for calibration in (old, new):
        if not isinstance(calibration, Calibration):
            raise UsageError(
                f"compare takes two tilt calibrations, as tiltcal.read returns them, not a {type(calibration).__name__}"
            )
    return compare_records(old.record, new.record)


def combine(
    calibrations: Sequence[Calibration | str | Path] | Calibration | str | Path,
    *,
    mounting: Mapping[str, float] | str = "",
) -> Calibration:
    """Combine calibrations of one sensor from several sessions.

    The positions of all of them are fitted again, as those of one session; positions of one journal count once. A
    calibration without positions that were set (free positions, a ramp, a renewed level) enters by its coefficients and
    their covariance. What a session has assumed, such as a nominal sensitivity or that of its base, is no information.

    Parameters
    ----------
    calibrations : sequence of Calibration, str or Path
        Calibrations, or their files. One alone is enough with a mounting, and needs no sequence.
    mounting : mapping of str to float, or str
        How the sensor sits, degrees, such as ``{"roll": 180}`` or ``"roll=180"``, in place of the calibrations' own.

    Returns
    -------
    Calibration

    Raises
    ------
    UsageError
        They are not of one sensor, or chi-square rises over that of the separate fits by as much as it does in one of a
        thousand combinations of sessions that agree; the message names files and figures.
    EstimateError
        A calibration states no uncertainty, or together they determine no sensor.

    Examples
    --------
    >>> both = tiltcal.combine(["S-0042.yaml"], mounting="roll=180")
    """
    from tiltcal.calibration.combine import combine_records

    if isinstance(calibrations, str | Path | Calibration):
        calibrations = [calibrations]
    if not isinstance(calibrations, Iterable):
        raise UsageError(f"combine takes tilt calibrations or their files, not {calibrations!r}")
    records = [one.record if isinstance(one, Calibration) else one for one in calibrations]
    return Calibration(combine_records(records, mounting))

"""From a calibration to the kernel that applies it: of a tilt sensor, or of pairs of accelerometers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import tiltcal
from tiltcal.calibration.calibration import Calibration, read
from tiltcal.errors import EstimateError, InputError, UsageError
from tiltcal.files.uncertainty import stated_uncertainty
from tiltcal.logs.columns import TIME
from tiltcal.logs.kernel import Kernel, PairKernel, TiltKernel
from tiltcal.logs.streams import sha256_of

if TYPE_CHECKING:
    from tiltcal.calibration.pair_calibration import PairCalibration
    from tiltcal.core.angle_uncertainty import CompensationWithUncertainty
    from tiltcal.core.compensation import Compensation


@dataclass(frozen=True)
class ApplyOptions:
    """How a calibration is to be applied.

    Attributes
    ----------
    first_order : bool
        Cross-axis Compensation eq. 6 in place of the whole matrix.
    uncertainty : bool
        Add the uncertainty of every angle.
    reading_noise : float or None
        Standard uncertainty of a reading of the log, in its unit; None for that of a sample at the bench.
    mounting : mapping of str to float or str
        Roll, pitch and yaw in place of the calibration's, degrees; empty for its own.
    serial : str or None
        With a folder of calibrations: of the sensor, where the log does not state it.
    stability : float or None
        With a folder: the standard deviation of the offset's change in one day, mg; None to estimate it.
    start : str or None
        With a folder: when the time of the log is 0, ISO 8601; None where its time counts from 1970 or is a date.
    """

    first_order: bool = False
    uncertainty: bool = False
    reading_noise: float | None = None
    mounting: Mapping[str, float] | str = ""
    serial: str | None = None
    stability: float | None = None
    start: str | None = None

    def require_file(self) -> None:
        """Refuse what is for a folder of calibrations.

        Raises
        ------
        UsageError
        """
        for name in ("serial", "stability", "start"):
            if getattr(self, name) is not None:
                raise UsageError(f"--{name} is for a folder of calibrations (--calibrations)")


@dataclass(frozen=True)
class PreparedCalibration:
    """A calibration, ready for the rows of one log: a kernel may remember those that have passed.

    Attributes
    ----------
    kernel : Kernel
    channels : tuple of str
        The readings that it takes.
    unit : str or None
        Of the readings; None for pairs, whose unit does not matter.
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
    """

    kernel: Kernel
    channels: tuple[str, ...]
    unit: str | None
    angles: tuple[str, ...]
    watched: tuple[str, ...]
    origin: Mapping[str, str]
    roles: tuple[str, ...] = ()
    optional_roles: tuple[str, ...] = ()
    vectors: Mapping[str, tuple[str, str, str]] = field(default_factory=dict)


def prepare_file(
    path: str | Path, options: ApplyOptions, say: Callable[[str], None] = lambda line: None
) -> PreparedCalibration:
    """Read a calibration file, of a sensor or of pairs, and make it ready.

    Raises
    ------
    UsageError
        The file is of pairs, and the options are for tilt.
    InputError
        Anything in the file is wrong.
    """
    path = Path(path)
    return prepare(read(path), options, say, file=path, origin={"calibration": path.name, "sha256": sha256_of(path)})


def prepare(
    calibration: Calibration | PairCalibration,
    options: ApplyOptions,
    say: Callable[[str], None] = lambda line: None,
    *,
    file: Path | None = None,
    origin: Mapping[str, str] | None = None,
) -> PreparedCalibration:
    """Make a calibration ready.

    Parameters
    ----------
    calibration : Calibration or PairCalibration
    options : ApplyOptions
    say : callable
        Called with each remark about what had to be assumed.
    file : Path, optional
        The calibration's file, for messages.
    origin : mapping of str to str, optional
        What is known of that file.

    Raises
    ------
    UsageError
        The calibration is of pairs, and the options are for tilt.
    InputError
        The calibration cannot be applied.
    """
    stated = {"software": f"tiltcal {tiltcal.__version__}", **(origin or {})}
    if not isinstance(calibration, Calibration):
        return _of_pairs(calibration, options, stated, str(file or "the calibration"))
    if options.mounting:
        calibration = _mounted(calibration, options.mounting, say)
    coefficients, sensor = calibration.coefficients, calibration.sensor
    stated["serial"] = sensor.serial
    try:
        compensation = calibration.compensation(first_order=options.first_order)
        uncertain = _uncertain(calibration, compensation, options.reading_noise, say) if options.uncertainty else None
    except EstimateError as failure:
        raise InputError(str(failure), file=file) from failure
    lag = 0.0 if coefficients.thermal is None else coefficients.thermal.lag
    return PreparedCalibration(
        TiltKernel(compensation if uncertain is None else uncertain, lag),
        coefficients.channels,
        sensor.unit,
        compensation.angles,
        () if uncertain is None else uncertain.expanded,
        stated,
        optional_roles=(TIME,) if lag else (),
    )


def _of_pairs(
    calibration: PairCalibration, options: ApplyOptions, origin: Mapping[str, str], file: str
) -> PreparedCalibration:
    for name, given in (
        ("--first-order", options.first_order),
        ("--uncertainty", options.uncertainty),
        ("--mounting", options.mounting),
    ):
        if given:
            raise UsageError(f"{name} is for tilt calibrations; {file} is of pairs, which have no tilt")
    matched = calibration.compensation()
    return PreparedCalibration(PairKernel(matched), matched.channels, None, (), (), origin)


def _mounted(calibration: Calibration, angles: Mapping[str, float] | str, say: Callable[[str], None]) -> Calibration:
    """Return the calibration in a known mounting; report one that is replaced."""
    from tiltcal.calibration.known_mounting import mounting_in_words

    own = calibration.coefficients.mounting
    if own is not None:
        say(f"note: --mounting replaces the mounting of the calibration, {mounting_in_words(own)}")
    return calibration.with_mounting(angles)


def _uncertain(
    calibration: Calibration, compensation: Compensation, reading_noise: float | None, say: Callable[[str], None]
) -> CompensationWithUncertainty:
    """Return the kernel that adds uncertainties; report what it has to assume."""
    from tiltcal.core.angle_uncertainty import CompensationWithUncertainty

    stated = stated_uncertainty(calibration.record.uncertainty, calibration.coefficients, reading_noise=reading_noise)
    for remark in stated.remarks:
        say(f"note: {remark}")
    return CompensationWithUncertainty(compensation, calibration.coefficients, stated.inputs)

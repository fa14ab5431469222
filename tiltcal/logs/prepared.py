"""From a calibration file to the kernel that applies it: of a tilt sensor, or of pairs of accelerometers."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import tiltcal
from tiltcal.calibration.calibration import Calibration
from tiltcal.core.angle_uncertainty import CompensationWithUncertainty
from tiltcal.core.compensation import Compensation
from tiltcal.core.pair.compensation import PairCompensation
from tiltcal.errors import EstimateError, InputError, UsageError
from tiltcal.files.calibration import CalibrationRecord, calibration_of
from tiltcal.files.document import checked_kind, read_document
from tiltcal.files.node import Node
from tiltcal.files.pair import pair_of
from tiltcal.files.uncertainty import stated_uncertainty
from tiltcal.logs.apply import Kernel
from tiltcal.logs.digest import sha256_of


@dataclass(frozen=True)
class ApplyOptions:
    """How a calibration is to be applied.

    Attributes
    ----------
    calibration : Path
        Its file.
    first_order : bool
        Cross-axis Compensation eq. 6 in place of the whole matrix.
    uncertainty : bool
        Add the uncertainty of every angle.
    reading_noise : float or None
        Standard uncertainty of a reading of the log, in its unit; None for that of a sample at the bench.
    """

    calibration: Path
    first_order: bool = False
    uncertainty: bool = False
    reading_noise: float | None = None


@dataclass(frozen=True)
class PreparedCalibration:
    """A calibration, ready for the rows of one log: a pair's kernel remembers those that it has seen.

    Attributes
    ----------
    kernel : Kernel
    channels : tuple of str
        The readings that it takes.
    watched : tuple of str
        The columns to be summed up.
    origin : mapping of str to str
        What a file made with it should say: ``software``, ``calibration``, ``sha256`` and, of a sensor, ``serial``.
    """

    kernel: Kernel
    channels: tuple[str, ...]
    watched: tuple[str, ...]
    origin: Mapping[str, str]

    @property
    def as_note(self) -> dict[str, str]:
        """The origin as key-value metadata."""
        return {"tiltcal": json.dumps(dict(self.origin))}


def prepare(wish: ApplyOptions, say: Callable[[str], None] = lambda line: None) -> PreparedCalibration:
    """Read a calibration file and make it ready.

    Parameters
    ----------
    wish : ApplyOptions
    say : callable
        Told what had to be taken for granted.

    Raises
    ------
    UsageError
        The file is of pairs, and what is wished is for tilt.
    InputError
        Anything in the file is wrong.
    """
    path = wish.calibration
    document = read_document(path)
    kind = document.entries().get("kind")
    origin = {"software": f"tiltcal {tiltcal.__version__}", "calibration": path.name, "sha256": sha256_of(path)}
    if kind is not None and kind.names("pair"):
        return _of_pairs(document, wish, origin)
    known = calibration_of(checked_kind(document, "tilt"))
    channels = known.coefficients.channels
    origin["serial"] = known.sensor.serial
    try:
        compensation = Calibration(known).compensation(first_order=wish.first_order)
        if not wish.uncertainty:
            return PreparedCalibration(compensation, channels, (), origin)
        uncertain = _uncertain(known, compensation, wish.reading_noise, say)
    except EstimateError as failure:
        raise InputError(str(failure), file=path) from failure
    return PreparedCalibration(uncertain, channels, uncertain.expanded, origin)


def _of_pairs(document: Node, wish: ApplyOptions, origin: Mapping[str, str]) -> PreparedCalibration:
    for name, given in (("--first-order", wish.first_order), ("--uncertainty", wish.uncertainty)):
        if given:
            raise UsageError(f"{name} is for tilt calibrations; {wish.calibration} is of pairs, which have no tilt")
    pairs = pair_of(checked_kind(document, "pair"))
    matched = PairCompensation(pairs.matchings, pairs.phase)
    return PreparedCalibration(matched, matched.channels, (), origin)


def _uncertain(
    known: CalibrationRecord, compensation: Compensation, reading_noise: float | None, say: Callable[[str], None]
) -> CompensationWithUncertainty:
    """The kernel that tells uncertainties too; says what it has to take for granted."""
    stated = stated_uncertainty(known.uncertainty, known.coefficients, reading_noise=reading_noise)
    for remark in stated.remarks:
        say(f"note: {remark}")
    return CompensationWithUncertainty(compensation, known.coefficients, stated.doubt)

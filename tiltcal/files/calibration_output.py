"""What a calibration file may replace: another of the same sensors, and nothing else."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from tiltcal.errors import Argument, EstimateError, InputError, UsageError
from tiltcal.files.atomic import check_writable, write_whole
from tiltcal.files.calibration import CalibrationRecord, tilt_record
from tiltcal.files.document import Document, parse_document, read_document
from tiltcal.files.pair import PairRecord, pair_record
from tiltcal.files.results import Sensors


def calibration_in(document: Document) -> CalibrationRecord | PairRecord:
    """Return the content of a calibration file of either kind, checked; an InputError names file, line and key."""
    return pair_record(document) if document.kind == "pair" else tilt_record(document)


def write_calibration(
    path: str | Path, text: str, sensors: Sensors, remark: Callable[[str], None] | None = None
) -> None:
    """Write a calibration file, whole or not at all; the errors are those of :func:`require_replaceable`.

    EstimateError: the text would be refused by whatever reads it.
    """
    replaced = require_replaceable(path, sensors)
    try:
        calibration_in(parse_document(text))
    except InputError as contradiction:
        raise EstimateError(f"{path} is not written, for the result contradicts itself: {contradiction}") from None
    write_whole(path, text)
    if replaced and remark:
        remark(replaced)


def require_replaceable(path: str | Path, sensors: Sensors | None = None, *read: str | Path) -> str:
    """Check that a calibration file can be written, and return what is to say of the one that it replaces.

    ``read`` are files that the command reads. Without ``sensors``, which are not known yet, any calibration passes.

    UsageError: it cannot be written, or one of those, no calibration, or that of another sensor is there.
    """
    check_writable(path, *read)
    if not os.path.isfile(path) or not os.path.getsize(path):
        return ""
    advice = ("move it away, or name another file with ", Argument("output"))
    try:
        there = calibration_in(read_document(path))
    except InputError:
        raise UsageError(f"cannot write {path}: the file there is no calibration", advice=advice) from None
    if sensors is not None and (found := there.sensors) != sensors:
        why = f"cannot write {path}: the file there is the calibration of {_named(found)}, not of {_named(sensors)}"
        raise UsageError(why, advice=advice)
    return f"{path}: the calibration of {there.provenance.ended or 'no date'} is replaced"


def _named(sensors: Sensors) -> str:
    kind, *each = sensors
    names = ", ".join(" ".join(one) for one in each)
    return names if kind == "tilt" else f"pairs of {names or 'a log'}"

"""The calibration files in a folder, by serial number and date, found without parsing them.

A file as tiltcal writes it names its sensor in its third line and its date near its end, which is enough for an index:
10,000 files take a third of a second, and nothing is stored that could go stale or damaged. A file that is laid out
otherwise is parsed.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

from tiltcal.errors import InputError, UsageError
from tiltcal.files.calibration import CalibrationRecord, tilt_record
from tiltcal.files.document import read_document
from tiltcal.files.moments import moment
from tiltcal.files.yaml_text import SIZE_LIMIT

SUFFIXES = (".yaml", ".yml")

_HEAD, _TAIL = 256, 1024  # bytes of a file in which its sensor and its date stand
_PLAIN = rb"([^\s,{}\[\]\"'\\&*!|>%@`#?:-][^,{}\[\]\"'\\#:\n]*)"
_SENSOR = re.compile(rb"\Atiltcal: 1\nkind: tilt\nsensor: \{model: " + _PLAIN + rb", serial: " + _PLAIN + rb", unit: ")
_TILT = re.compile(rb"\bkind\W+tilt\b")
_KIND = re.compile(rb"^kind: \w+", re.MULTILINE)
_DATES = re.compile(rb'\n  started: "([^"\n]+)"\n  ended: "([^"\n]+)"\n')


class CalibrationFile(NamedTuple):
    """A calibration file of a folder, and when its session ended (UTC)."""

    serial: str
    date: datetime
    path: str


class FolderIndex(NamedTuple):
    """The calibrations of a folder by serial number and date, and files that may be ones and cannot be used."""

    files: tuple[CalibrationFile, ...]
    problems: tuple[InputError, ...]


def index_folder(folder: str | Path) -> FolderIndex:
    """Find the calibrations in a folder and the folders below it, in regular files of at most ``SIZE_LIMIT`` bytes.

    Other files, of pairs, benches, procedures and twins as well, are passed over; a file that is empty or no YAML may
    have been a calibration.
    """
    files: list[CalibrationFile] = []
    problems: list[InputError] = []
    for path in _yaml_files(folder):
        try:
            content = _content(path)
            found = _scanned(content, path) or _read(content, path)
        except InputError as problem:
            problems.append(problem)
            continue
        if found is not None:
            files.append(found)
    return FolderIndex(tuple(sorted(files)), tuple(problems))


def date_of(record: CalibrationRecord, path: str | Path) -> tuple[str, datetime]:
    """Return when a calibration began, as it stands in the file, and when it ended, UTC; else its positions."""
    times = [position.time for position in record.positions if position.time]
    ended = record.provenance.ended or max(times, default=None)
    if ended is None:
        raise InputError(
            'the calibration has no date: write provenance.ended, such as ended: "2026-05-01T12:00:00Z"', file=path
        )
    return record.provenance.started or min(times, default=ended), moment(ended, path)


def _yaml_files(folder: str | Path) -> Iterator[str]:
    def refuse(failure: OSError) -> None:
        raise UsageError(f"{failure.filename}: cannot be read as a folder: {failure.strerror}") from None

    for place, folders, names in os.walk(os.fspath(folder), onerror=refuse, followlinks=True):
        folders[:] = [name for name in folders if not name.startswith(".")]
        for name in names:
            if name.lower().endswith(SUFFIXES) and not name.startswith("."):
                yield os.path.join(place, name)


def _content(path: str) -> bytes:
    try:
        status = os.stat(path)
        if stat.S_ISREG(status.st_mode) and status.st_size <= SIZE_LIMIT:
            return Path(path).read_bytes()
    except OSError as failure:
        raise InputError(f"cannot be read: {failure.strerror}", file=path) from None
    raise InputError(f"this is no regular file of at most {SIZE_LIMIT:,} bytes", file=path)


def _scanned(content: bytes, path: str) -> CalibrationFile | None:
    """Return what the head and the tail of a file state; None where they are laid out otherwise, or it is not UTF-8."""
    sensor, dates = _SENSOR.match(content[:_HEAD]), _DATES.search(content[-_TAIL:])
    if sensor is None or dates is None:
        return None
    try:
        content.decode()
    except UnicodeDecodeError:  # whatever parses it says where
        return None
    return CalibrationFile(sensor[2].decode(), moment(dates[2].decode(), path), path)


def _read(content: bytes, path: str) -> CalibrationFile | None:
    """Return what a file states that is parsed; None where it is no calibration of a tilt sensor."""
    if not content.strip():
        raise InputError("the file is empty", file=path)
    if not _TILT.search(content) and _KIND.search(content):
        return None
    document = read_document(path)
    if not isinstance(document.data, dict) or document.kind != "tilt":
        return None
    record = tilt_record(document)
    return CalibrationFile(record.sensor.serial, date_of(record, path)[1], path)

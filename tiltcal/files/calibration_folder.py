"""The calibration files in a folder, by serial number, found without parsing them.

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


class FolderIndex(NamedTuple):
    """Paths of the calibrations of a folder by serial number, and files that may be ones and cannot be used."""

    paths: dict[str, list[str]]
    problems: tuple[InputError, ...]


def index_folder(folder: str | Path) -> FolderIndex:
    """Find the calibrations in a folder and the folders below it, in regular files of at most ``SIZE_LIMIT`` bytes.

    Other files, of pairs, benches, procedures and twins as well, are passed over; a file that is empty or no YAML may
    have been a calibration.
    """
    files: list[tuple[str, str]] = []
    problems: list[InputError] = []
    for path in _yaml_files(folder):
        try:
            content = _content(path)
            serial = _scanned(content, path) or _read(content, path)
        except InputError as problem:
            problems.append(problem)
            continue
        if serial is not None:
            files.append((serial, path))
    paths: dict[str, list[str]] = {}
    for serial, path in sorted(files):
        paths.setdefault(serial, []).append(path)
    return FolderIndex(paths, tuple(problems))


def date_of(record: CalibrationRecord, path: str | Path) -> datetime:
    """Return when a calibration ended, UTC; else when its last position did."""
    ended = record.provenance.ended or max((one.time for one in record.positions if one.time), default=None)
    if ended is None:
        raise InputError(
            'the calibration has no date: write provenance.ended, such as ended: "2026-05-01T12:00:00Z"', file=path
        )
    return moment(ended, path)


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


def _scanned(content: bytes, path: str) -> str | None:
    """Return the serial number in the head of a file with a date in its tail; None of another layout, or not UTF-8."""
    sensor, dates = _SENSOR.match(content[:_HEAD]), _DATES.search(content[-_TAIL:])
    if sensor is None or dates is None:
        return None
    try:
        content.decode()
    except UnicodeDecodeError:  # whatever parses it says where
        return None
    moment(dates[2].decode(), path)
    return sensor[2].decode()


def _read(content: bytes, path: str) -> str | None:
    """Return the serial number of a file that is parsed; None where it is no calibration of a tilt sensor."""
    if not content.strip():
        raise InputError("the file is empty", file=path)
    if not _TILT.search(content) and _KIND.search(content):
        return None
    document = read_document(path)
    if not isinstance(document.data, dict) or document.kind != "tilt":
        return None
    record = tilt_record(document)
    date_of(record, path)
    return record.sensor.serial

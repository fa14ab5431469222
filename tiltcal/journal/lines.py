"""The session journal: append-only JSON Lines that survive any truncation and show any change.

::

    {"tiltcal-journal": 2, ..., "check": "5d41a0c2"}      header
    [48000, "s", "100000", "008f20", "0c11be07"]          bus transaction: nanoseconds since the line before, the
                                                          bus's letter, bytes out, bytes in, (device number if not 0)
    [0, "!", "100000", "why", "…"]                        a bus transaction that failed
    [0, "a", {"to": "position", "answer": "ready"}, "…"]  what the operator answered; "again" withdraws a position
    [0, "p", {"position": "x-tilt1", "lines": [8, 19], …}, "…"]    an accepted position, and the lines of its samples
    [9, "resumed", "…"]                                   the session was interrupted, and goes on from here
    [0, "end", {"events": 812, "sha256": "…"}, "…"]       the session came to its end

The last element of each line is the CRC-32 of all lines up to and including it, without the checks themselves, so a
changed, lost or reordered line is named. A line without its newline was torn off by a crash; it is dropped.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, TypeVar
from zlib import crc32

import msgspec
from msgspec import Meta, Struct

from tiltcal.errors import Argument, JournalError, UsageError
from tiltcal.files.atomic import BINARY, append_whole, sync_data, write_all
from tiltcal.files.record import Count, Number, Record, one_of

T = TypeVar("T")

VERSION = 2
HARDWARE_ERROR = "!"
ANSWER = "a"
POSITION = "p"
RESUMED = "resumed"
END = "end"

LINE_LIMIT = 16_000_000  # bytes of a line; the first one holds the procedure and, of a mounting, the base calibration

_ARRAY_CHECK = len(',"00000000"]\n')
_OBJECT_CHECK = len(',"check":"00000000"}\n')
_CHANGED = "the line is damaged: its check does not fit its content"
_ACCEPTS, _ENDS = (re.compile(rb'\[\s*[0-9]+\s*,\s*"%s"\s*,' % kind.encode()) for kind in (POSITION, END))


@dataclass(frozen=True, slots=True)
class Event:
    """A line of a journal after its header: its number, nanoseconds since the line before, its kind, the rest."""

    line: int
    dt_ns: int
    kind: str
    payload: tuple[Any, ...]

    def content(self, record: type[T]) -> T:
        """Return what follows the kind, of an answer or an accepted position."""
        return msgspec.convert(self.payload[0], record)


@dataclass
class Written:
    """What stands in a journal before its end record: CRC-32 and SHA-256, bytes of whole lines, events."""

    crc: int
    digest: hashlib._Hash
    size: int
    events: int = 0

    def add(self, line: bytes, crc: int) -> None:
        """Count a line of an event."""
        self.crc, self.size, self.events = crc, self.size + len(line), self.events + 1
        self.digest.update(line)


class Journal:
    """A journal, whose events are read and checked once, by iterating over it; a JournalError names a damaged line.

    ``coming`` is the next accepted position, at or behind the event that is read; None behind the last one. When all
    are read, ``ended`` is whether the session came to its end, and ``torn`` whether a last line was dropped.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        try:
            with open(path, "rb") as stream:
                line = stream.readline(LINE_LIMIT)
        except OSError as error:
            raise JournalError(f"cannot be read: {error.strerror}", file=path) from None
        if not _is_whole(line, self.path, 1):
            raise JournalError("holds no complete header: nothing was captured; start the session anew", file=path)
        self.header, self.written = _header(line, self.path)
        self.coming: AcceptedPosition | None = None
        self.ended = self.torn = False

    @property
    def sha256(self) -> str:
        """SHA-256 of everything before the end record, or of all whole lines where there is none."""
        return self.written.digest.hexdigest()

    def __iter__(self) -> Iterator[Event]:
        held: list[bytes] = []  # the lines of one position alone: a night of six sensors has millions
        for line in self._checked():
            held.append(line)
            if _ACCEPTS.match(line):
                self.coming = _event_of(line, self.path, self.written.events + 1).content(AcceptedPosition)
                yield from self._events(held)
        self.coming = None
        yield from self._events(held)

    def _events(self, held: list[bytes]) -> Iterator[Event]:
        """Yield the events of the last lines that were checked, and hold them no more."""
        for number, line in enumerate(held, self.written.events + 2 - len(held)):
            yield _event_of(line, self.path, number)
        held.clear()

    def _checked(self) -> Iterator[bytes]:
        """Yield the line of each event when its check fits."""
        number, written = 1, self.written
        with open(self.path, "rb") as stream:
            stream.readline(LINE_LIMIT)
            while line := stream.readline(LINE_LIMIT):
                number += 1
                if not _is_whole(line, self.path, number):
                    self.torn = True
                    return
                if self.ended:
                    raise _damage("something follows the end record; nothing may", self.path, number)
                crc = crc32(line[:-_ARRAY_CHECK] + b"]", written.crc)
                if line[-_ARRAY_CHECK:] != f',"{crc:08x}"]\n'.encode():
                    raise _damage(_CHANGED, self.path, number)
                if _ENDS.match(line):
                    (end,) = _event_of(line, self.path, number).payload
                    if end != {"events": written.events, "sha256": self.sha256}:
                        raise _damage("the end record does not fit the lines before it", self.path, number)
                    self.ended = True
                else:
                    written.add(line, crc)
                    yield line


def _is_whole(line: bytes, path: Path, number: int) -> bool:
    """Return whether a line was not torn off."""
    if len(line) == LINE_LIMIT and not line.endswith(b"\n"):
        raise _damage("the line is longer than any of a journal", path, number)
    return line.endswith(b"\n")


class JournalWriter:
    """A journal that is appended to; the operating system has an event when :meth:`append` returns."""

    def __init__(self, path: Path, descriptor: int, written: Written) -> None:
        self.path = path
        self._descriptor = descriptor
        self._written = written

    @classmethod
    def create(cls, path: str | Path, header: Mapping[str, Any]) -> JournalWriter:
        """Start a journal with its header; a UsageError where the file exists, or cannot be made."""
        path = Path(path)
        body = _dumps({"tiltcal-journal": VERSION, **header}).encode()
        crc = crc32(body)
        line = body[:-1] + f',"check":"{crc:08x}"}}\n'.encode()
        try:
            descriptor = os.open(path, _APPEND | os.O_CREAT | os.O_EXCL, 0o644)
        except FileExistsError:
            advice = ("resume it with ", Argument("resume", str(path)), ", or name another ", Argument("journal"))
            raise UsageError(f"{path} exists", advice=advice) from None
        except OSError as error:
            raise UsageError(f"{path}: the journal cannot be made: {error.strerror}") from None
        try:
            _lock(descriptor, path)
            write_all(descriptor, line)
            os.fsync(descriptor)
        except BaseException as error:
            os.close(descriptor)
            path.unlink()
            if isinstance(error, OSError):
                raise UsageError(f"{path}: the journal cannot be made: {error.strerror}") from None
            raise
        return cls(path, descriptor, Written(crc, hashlib.sha256(line), len(line)))

    @classmethod
    def resume(cls, journal: Journal) -> JournalWriter:
        """Append to a journal after its last whole line; a JournalError where another process writes it, or has."""
        try:
            descriptor = os.open(journal.path, _APPEND)
        except OSError as error:
            raise JournalError(f"cannot be continued: {error.strerror}", file=journal.path) from None
        try:
            _lock(descriptor, journal.path)
            os.lseek(descriptor, journal.written.size, os.SEEK_SET)
            if b"\n" in os.read(descriptor, LINE_LIMIT):
                why = "another process has written to it since it was read: resume it again"
                raise JournalError(why, file=journal.path)
            os.ftruncate(descriptor, journal.written.size)
        except BaseException:
            os.close(descriptor)
            raise
        before = journal.written
        return cls(journal.path, descriptor, replace(before, digest=before.digest.copy()))

    @property
    def line(self) -> int:
        """The line of the last event, or of the header."""
        return self._written.events + 1

    def append(self, dt_ns: int, kind: str, *payload: Any) -> None:
        """Write one event, whole or, with a JournalError where the disk is full or fails, not at all."""
        event = [dt_ns, kind, *payload]
        # Of a transaction, integers and hexadecimal digits, both give the same bytes, this one in a tenth of the time.
        body = _dumps(event).encode() if kind in _LINES else msgspec.json.encode(event)
        crc = crc32(body, self._written.crc)
        line = body[:-1] + f',"{crc:08x}"]\n'.encode()
        try:
            append_whole(self._descriptor, line, self._written.size)
        except OSError as error:
            raise self._failed(error) from error
        self._written.add(line, crc)

    def secure(self) -> None:
        """Wait until all that was written is on the disk; a JournalError where the disk is full or fails."""
        try:
            sync_data(self._descriptor)
        except OSError as error:
            raise self._failed(error) from error

    def finish(self, dt_ns: int) -> None:
        """Write the end record."""
        self.append(dt_ns, END, {"events": self._written.events, "sha256": self._written.digest.hexdigest()})
        self.secure()

    def close(self) -> None:
        """Close the file; a second call does nothing."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    def _failed(self, error: OSError) -> JournalError:
        return JournalError(f"cannot be written: {error.strerror}; make room on the disk, then resume", file=self.path)


try:
    fcntl: Any = import_module("fcntl")
except ImportError:  # Windows
    fcntl = None

_dumps = json.JSONEncoder(ensure_ascii=False, separators=(",", ":"), allow_nan=False).encode
_APPEND = os.O_RDWR | os.O_APPEND | BINARY


def _lock(descriptor: int, path: Path) -> None:
    """Keep other sessions from writing this journal, where the system has such locks."""
    if fcntl is None:
        return
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        raise JournalError("another tiltcal is writing this journal; wait until it ends", file=path) from None


def _header(line: bytes, path: Path) -> tuple[dict[str, Any], Written]:
    if not line.startswith(b'{"tiltcal-journal":'):
        raise _damage("is no tiltcal journal", path, 1)
    body = line[:-_OBJECT_CHECK] + b"}"
    crc = crc32(body)
    if line[-_OBJECT_CHECK:] != f',"check":"{crc:08x}"}}\n'.encode():
        raise _damage(_CHANGED, path, 1)
    header: dict[str, Any] = _loads(body, path, 1)
    version = header.pop("tiltcal-journal")
    if version != VERSION:
        raise _damage(f"is of journal version {version}; this tiltcal reads version {VERSION}", path, 1)
    return header, Written(crc, hashlib.sha256(line), len(line))


def _event_of(line: bytes, path: Path, number: int) -> Event:
    found = _loads(line[:-_ARRAY_CHECK] + b"]", path, number)
    try:
        msgspec.convert(found, _LINES.get(found[1], _Transaction))
        return Event(number, found[0], found[1], tuple(found[2:]))
    except (LookupError, TypeError, msgspec.ValidationError):
        raise _damage("the line is no event of a journal, though its check fits", path, number) from None


def _loads(body: bytes, path: Path, number: int) -> Any:
    """Parse the JSON of a line, without numbers that are not finite."""
    try:
        return msgspec.json.decode(body)
    except RecursionError:
        raise _damage("the line is nested too deeply", path, number) from None
    except (ValueError, msgspec.MsgspecError) as error:
        raise _damage(f"the line is not JSON: {error}", path, number) from None


def _damage(why: str, path: Path, number: int) -> JournalError:
    return JournalError(why, file=path, line=number)


class OperatorAnswer(Record, kw_only=True):
    """An answer of the operator to a question: a word, and what was actually set where that is not as asked.

    Angles are in degrees; ``temperature``, in °C, was typed. ``position`` is the one set, or taken ``again``.
    """

    to: str = ""
    answer: str
    position: str = ""
    tilt: Mapping[Annotated[str, one_of("x", "y")], Number] = {}
    gravity: tuple[Number, Number, Number] | None = None
    temperature: Number | None = None


class AcceptedSensor(Struct):
    """What a sensor gave in an accepted position: the means of its channels, the samples that count, and the others."""

    mean: Mapping[str, Number] = {}
    n: Count = 0
    left_out: Count = 0

    @property
    def taken(self) -> int:
        """All samples that were taken."""
        return self.n + self.left_out


class AcceptedPosition(Struct):
    """An accepted position: the lines of its samples, none of a rotation, and which of them were left out, from 0.

    ``sensors`` are by serial number.
    """

    position: str
    sensors: Mapping[str, AcceptedSensor] = {}
    lines: tuple[Count, Count] | None = None
    without: tuple[Count, ...] = ()
    ended: str = ""

    @property
    def first(self) -> AcceptedSensor:
        """That of the first sensor; all have as many samples."""
        return next(iter(self.sensors.values()), AcceptedSensor())


Bytes = Annotated[str, Meta(pattern="^([0-9a-f]{2})*$")]  # in hexadecimal


class _Transaction(Struct, array_like=True, forbid_unknown_fields=True):
    dt_ns: Count
    kind: Annotated[str, Meta(pattern="^[a-z]$")]
    out: Bytes
    back: Bytes
    device: Count = 0


class _FailedTransaction(Struct, array_like=True, forbid_unknown_fields=True):
    dt_ns: Count
    kind: str
    out: Bytes
    why: str
    device: Count = 0


_LINES: dict[str, Any] = {
    HARDWARE_ERROR: _FailedTransaction,
    ANSWER: tuple[Count, str, OperatorAnswer],
    POSITION: tuple[Count, str, AcceptedPosition],
    END: tuple[Count, str, dict[str, Any]],
    RESUMED: tuple[Count, str],
}
"""The elements of a line by its kind; all other kinds are buses."""

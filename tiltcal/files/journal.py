"""The session journal: append-only JSON Lines that survive any truncation and show any change.

::

    {"tiltcal-journal": 1, ..., "check": "5d41a0c2"}      header
    [48000, "s", "100000", "008f20", "0c11be07"]          bus transaction: nanoseconds since the line before, the
                                                          bus's letter, bytes out, bytes in, (device number if not 0)
    [0, "!", "100000", "why", "…"]                        a bus transaction that failed
    [0, "a", {"to": "position", "answer": "ready"}, "…"]  what the operator answered
    [0, "p", {"position": "x-tilt1", …}, "…"]             an accepted position
    [0, "live", "…"]                                      a reading follows that only the operator looked at
    [9, "resumed", "…"]                                   the session was interrupted, and goes on from here
    [0, "end", {"events": 812, "sha256": "…"}, "…"]       the session came to its end

The last element of each line is the CRC-32 of all lines up to and including it, without the checks themselves, so a
changed, lost or reordered line is named. A line without its newline was torn off by a crash; it is dropped.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zlib import crc32

from tiltcal.errors import JournalError, UsageError

VERSION = 1
HARDWARE_ERROR = "!"
ANSWER = "a"
POSITION = "p"
LIVE_READING = "live"
RESUMED = "resumed"
END = "end"

_ARRAY_CHECK = len(',"00000000"]')
_OBJECT_CHECK = len(',"check":"00000000"}')


@dataclass(frozen=True, slots=True)
class Event:
    """One line of a journal after its header.

    Attributes
    ----------
    line : int
        Line number in the file, counted from 1.
    dt_ns : int
        Nanoseconds since the line before.
    kind : str
        The second element: a bus's letter, or one of the kinds above.
    payload : tuple
        The elements between the kind and the check.
    """

    line: int
    dt_ns: int
    kind: str
    payload: tuple[Any, ...]


@dataclass(frozen=True)
class Journal:
    """A journal that was read and found sound.

    Attributes
    ----------
    path : Path
    header : dict
    events : tuple of Event
        Without the end record.
    end : dict or None
        The end record; None where the session was interrupted.
    size : int
        Bytes of whole lines; what follows is a torn line.
    torn : bool
        Whether a torn line was dropped.
    crc : int
        Running CRC-32 after the last whole line.
    sha256 : str
        Of everything before the end record, or of all whole lines where there is none.
    """

    path: Path
    header: dict[str, Any]
    events: tuple[Event, ...]
    end: dict[str, Any] | None
    size: int
    torn: bool
    crc: int
    sha256: str


def read_journal(path: str | Path) -> Journal:
    """Read a journal and check every line of it.

    Raises
    ------
    JournalError
        The file cannot be read, is no journal, or a line is damaged (named).
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise JournalError(f"cannot be read: {error.strerror}", file=path) from None
    size = data.rfind(b"\n") + 1
    lines = data[:size].split(b"\n")[:-1]
    if not lines:
        raise JournalError("holds no complete header: nothing was captured; start the session anew", file=path)
    header, crc = _header(lines[0], path)
    events: list[Event] = []
    end: dict[str, Any] | None = None
    digest = hashlib.sha256(lines[0] + b"\n")
    for number, line in enumerate(lines[1:], start=2):
        if end is not None:
            raise JournalError("something follows the end record; nothing may", file=path, line=number)
        event, crc = _event(line, crc, path, number)
        if event.kind == END:
            end = _checked_end(event, len(events), digest.hexdigest(), path)
        else:
            events.append(event)
            digest.update(line + b"\n")
    return Journal(path, header, tuple(events), end, size, size < len(data), crc, digest.hexdigest())


class JournalWriter:
    """Appends to a journal; every event is in the kernel's hands when :meth:`append` returns.

    Use :meth:`create` or :meth:`resume`.
    """

    def __init__(self, path: Path, descriptor: int, crc: int, events: int, digest: hashlib._Hash, size: int) -> None:
        self.path = path
        self._descriptor = descriptor
        self._size = size
        self._crc = crc
        self._events = events
        self._digest = digest

    @classmethod
    def create(cls, path: str | Path, header: Mapping[str, Any]) -> JournalWriter:
        """Start a journal. It appears with its whole header or not at all.

        Raises
        ------
        UsageError
            The file exists, or cannot be made.
        """
        path = Path(path)
        if path.exists():
            raise UsageError(f"{path} exists: resume it with --resume {path}, or name another --journal")
        body = _dumps({"tiltcal-journal": VERSION, **header}).encode()
        crc = crc32(body)
        line = body[:-1] + f',"check":"{crc:08x}"}}\n'.encode()
        whole = path.with_name(f".{path.name}.new")
        try:
            descriptor = os.open(whole, os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND | os.O_CLOEXEC, 0o644)
            write_all(descriptor, line)
            os.fsync(descriptor)
            os.rename(whole, path)
        except OSError as error:
            whole.unlink(missing_ok=True)
            raise UsageError(f"{path}: the journal cannot be made: {error.strerror}") from None
        _lock(descriptor, path)
        return cls(path, descriptor, crc, 0, hashlib.sha256(line), len(line))

    @classmethod
    def resume(cls, journal: Journal) -> JournalWriter:
        """Go on with a journal after its last whole line; the torn one is cut off.

        Raises
        ------
        JournalError
            Another process writes it, or it cannot be opened for writing.
        """
        try:
            descriptor = os.open(journal.path, os.O_RDWR | os.O_APPEND | os.O_CLOEXEC)
        except OSError as error:
            raise JournalError(f"cannot be continued: {error.strerror}", file=journal.path) from None
        _lock(descriptor, journal.path)
        os.ftruncate(descriptor, journal.size)
        digest = hashlib.sha256()
        digest.update(journal.path.read_bytes()[: journal.size])
        return cls(journal.path, descriptor, journal.crc, len(journal.events), digest, journal.size)

    def append(self, dt_ns: int, kind: str, *payload: Any) -> None:
        """Write one event, whole or not at all.

        Raises
        ------
        JournalError
            The disk is full or fails; the journal ends with the event before.
        """
        body = _dumps([dt_ns, kind, *payload]).encode()
        crc = crc32(body, self._crc)
        line = body[:-1] + f',"{crc:08x}"]\n'.encode()
        try:
            write_all(self._descriptor, line)
        except OSError as error:
            with suppress(OSError):
                os.ftruncate(self._descriptor, self._size)
            raise self._failed(error) from error
        self._size += len(line)
        self._crc = crc
        self._digest.update(line)
        self._events += 1

    def secure(self) -> None:
        """Have what was written so far on the disk.

        Raises
        ------
        JournalError
            The disk is full or fails.
        """
        try:
            os.fdatasync(self._descriptor)
        except OSError as error:
            raise self._failed(error) from error

    def finish(self, dt_ns: int) -> str:
        """Write the end record and return the SHA-256 of everything before it."""
        sha256 = self._digest.hexdigest()
        self.append(dt_ns, END, {"events": self._events, "sha256": sha256})
        self.secure()
        return sha256

    def close(self) -> None:
        """Let the file go; closing twice is allowed."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    def _failed(self, error: OSError) -> JournalError:
        return JournalError(f"cannot be written: {error.strerror}; make room on the disk, then resume", file=self.path)


def write_all(descriptor: int, data: bytes) -> None:
    """Write all of it: the operating system may take a part at a time."""
    view = memoryview(data)
    while view:
        view = view[os.write(descriptor, view) :]


def _dumps(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, separators=(",", ":"), allow_nan=False)


def _lock(descriptor: int, path: Path) -> None:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        raise JournalError("another tiltcal is writing this journal; let it end first", file=path) from None


def _header(line: bytes, path: Path) -> tuple[dict[str, Any], int]:
    body = line[:-_OBJECT_CHECK] + b"}"
    if not line.startswith(b'{"tiltcal-journal":'):
        raise JournalError("is no tiltcal journal", file=path, line=1)
    crc = crc32(body)
    if line[-_OBJECT_CHECK:] != f',"check":"{crc:08x}"}}'.encode():
        raise JournalError("the line is damaged: its check does not fit its content", file=path, line=1)
    header: dict[str, Any] = json.loads(body)
    version = header.pop("tiltcal-journal")
    if version != VERSION:
        raise JournalError(f"is of journal version {version}; this tiltcal reads version {VERSION}", file=path, line=1)
    return header, crc


def _event(line: bytes, crc: int, path: Path, number: int) -> tuple[Event, int]:
    body = line[:-_ARRAY_CHECK] + b"]"
    crc = crc32(body, crc)
    if line[-_ARRAY_CHECK:] != f',"{crc:08x}"]'.encode():
        raise JournalError("the line is damaged: its check does not fit its content", file=path, line=number)
    dt_ns, kind, *payload = json.loads(body)
    return Event(number, dt_ns, kind, tuple(payload)), crc


def _checked_end(event: Event, events: int, sha256: str, path: Path) -> dict[str, Any]:
    end: dict[str, Any] = event.payload[0]
    if end != {"events": events, "sha256": sha256}:
        raise JournalError("the end record does not fit the lines before it", file=path, line=event.line)
    return end

"""Captures of a logic analyser: value change dump files (IEEE 1364), as sigrok and others write them."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from fractions import Fraction
from io import BufferedReader
from itertools import islice
from operator import attrgetter
from typing import Any

from tiltcal.drivers.bus import CaptureEnded
from tiltcal.drivers.bus.address import Address
from tiltcal.drivers.bus.gpio import RECORD, Edge, pack_edges
from tiltcal.drivers.bus.nodes import import_library
from tiltcal.errors import BusError

PREFACE = 20  # lines before the header that are skipped
_IDENTITY = attrgetter("st_ino", "st_size", "st_mtime_ns")
MOST_NS = 1 << 63  # the record of an edge holds times up to 292 years


def open_vcd(address: Address) -> VcdLink:
    """Open a capture; ``x`` and ``y`` name its signals, with the scope (``top.D0``) if several scopes have the name."""
    x, y = address.text("x"), address.text("y")
    if x == y:
        address.refuse(f"x and y are both signal {x!r}; they are two wires")
    return VcdLink(address.path, x, y)


class VcdLink:
    """The edges of two signals of one bit in a capture, from its start to its end; see :func:`open_vcd`."""

    letter = "e"

    def __init__(self, path: str, x: str, y: str) -> None:
        self._path = path
        self._names = (x, y)
        self._file: BufferedReader | None = None
        self._open()

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Take the records of the next edges; see :class:`~tiltcal.drivers.bus.Link`.

        With a ``count`` of 0, if the file has changed since it was opened, reading starts again with the new capture.
        """
        if not count:
            with suppress(OSError):
                if _IDENTITY(os.stat(self._path)) != self._identity:
                    self.close()
                    self._open()
            return b""
        edges = list(islice(self._edges, max(count // RECORD.size, 1)))
        if not edges:
            raise CaptureEnded(
                f"{self._path}: the capture is at its end: capture a longer one under the same name, then repeat the "
                "position"
            )
        return pack_edges(edges)

    def close(self) -> None:
        """Release the file; closing twice is allowed."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def _open(self) -> None:
        try:
            self._file = open(self._path, "rb")  # noqa: SIM115 - it stays open as long as the link
            self._identity = _IDENTITY(os.fstat(self._file.fileno()))
        except OSError as cause:
            raise BusError(f"{self._path} cannot be read ({cause.strerror}): is the path right?") from cause
        try:
            _skip_preface(self._path, self._file)
            self._edges = _edges(self._path, self._file, self._names)
        except OSError as cause:
            self.close()
            raise BusError(f"{self._path} is no file that can be read from its start ({cause})") from cause
        except BaseException:
            self.close()
            raise


def _skip_preface(path: str, file: BufferedReader) -> None:
    """Go to the first line of the header: sigrok-cli prints a line before it when it writes to a pipe."""
    for _ in range(PREFACE):
        start = file.tell()
        if file.readline(4096).lstrip().startswith(b"$"):
            file.seek(start)
            return
    raise BusError(f"{path}: it is not a value change dump: none of its first lines begins with $")


def _edges(path: str, file: BufferedReader, names: tuple[str, str]) -> Iterator[Edge]:
    """Iterate over the edges of the named signals; the header is read at once."""
    reader = import_library("vcd.reader", "a logic analyser's capture needs the Python package pyvcd", "tiltcal[vcd]")

    def tokens() -> Iterator[Any]:
        try:
            yield from reader.tokenize(file)
        except (reader.VCDParseError, ValueError, AssertionError, OSError) as cause:
            raise BusError(f"{path}: it is not a value change dump, or is damaged: {cause}") from cause

    sound = tokens()
    signals, scale = _header(path, sound, reader.TokenKind)
    lines = {_code(path, signals, name): line for line, name in enumerate(names)}
    if len(lines) < len(names):
        raise BusError(f"{path}: signals {' and '.join(names)} are one and the same wire")
    return _changes(path, sound, reader.TokenKind, lines, scale)


def _header(path: str, tokens: Iterator[Any], kinds: Any) -> tuple[dict[str, str], Fraction]:
    """Return the identifier of each signal by its full name, and the duration of a time step, ns."""
    signals: dict[str, str] = {}
    scopes: list[str] = []
    scale = Fraction(1)
    for token in tokens:
        if token.kind is kinds.SCOPE:
            scopes.append(token.scope.ident)
        elif token.kind is kinds.UPSCOPE and scopes:
            scopes.pop()
        elif token.kind is kinds.TIMESCALE:
            exponents = {"s": 9, "ms": 6, "us": 3, "ns": 0, "ps": -3, "fs": -6}
            scale = int(token.timescale.magnitude) * Fraction(10) ** exponents[token.timescale.unit.value]
            if not scale:
                raise BusError(f"{path}: its time scale is 0: capture it again, or correct its $timescale")
        elif token.kind is kinds.VAR and token.var.size == 1:
            signals[".".join([*scopes, token.var.ref_str])] = token.var.id_code
        elif token.kind is kinds.ENDDEFINITIONS:
            return signals, scale
    raise BusError(f"{path}: its header does not end: was the capture cut short?")


def _code(path: str, signals: dict[str, str], name: str) -> str:
    """Return the identifier of a signal by its name, with or without its scopes."""
    found = {full: code for full, code in signals.items() if full == name or full.endswith(f".{name}")}
    if not found:
        known = ", ".join(full.rpartition(".")[2] for full in signals) or "none of one bit"
        raise BusError(f"{path}: no signal is called {name!r} (it has {known})")
    if len(set(found.values())) > 1 and name not in found:
        raise BusError(f"{path}: {name!r} is in several scopes: name one of {', '.join(found)}")
    return found.get(name) or next(iter(found.values()))


def _changes(path: str, tokens: Iterator[Any], kinds: Any, lines: dict[str, int], scale: Fraction) -> Iterator[Edge]:
    """Iterate over the edges; a signal's first value, and a value after x or z, is not an edge."""
    time, number = 0, 0
    level: dict[int, str] = {}
    for token in tokens:
        if token.kind is kinds.CHANGE_TIME:
            time = token.data
            if not 0 <= time * scale < MOST_NS:
                raise BusError(f"{path}: it has a change at {time} steps of {scale} ns: is its time scale right?")
        elif token.kind in (kinds.CHANGE_SCALAR, kinds.CHANGE_VECTOR) and token.data.id_code in lines:
            line, value = lines[token.data.id_code], str(token.data.value)
            before, level[line] = level.get(line), value
            if {before, value} == {"0", "1"}:
                number += 1
                yield Edge(round(time * scale), line, value == "1", number)

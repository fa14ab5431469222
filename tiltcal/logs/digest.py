"""The checksum of a log, taken while it is read."""

from __future__ import annotations

from hashlib import sha256
from typing import BinaryIO, Protocol


class Readable(Protocol):
    """What a log is read from."""

    def read(self, size: int = -1, /) -> bytes: ...


class Digested:
    """Hands a stream's bytes on and keeps their SHA-256.

    Parameters
    ----------
    stream : Readable
    """

    def __init__(self, stream: Readable | BinaryIO) -> None:
        self._stream = stream
        self._digest = sha256()

    @property
    def sha256(self) -> str:
        """Of the bytes so far, hexadecimal."""
        return self._digest.hexdigest()

    def read(self, size: int = -1, /) -> bytes:
        data = self._stream.read(size)
        self._digest.update(data)
        return data

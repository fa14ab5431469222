"""The checksum of a log, taken while it is read, or of a file."""

from __future__ import annotations

from hashlib import file_digest, sha256
from pathlib import Path
from typing import BinaryIO, Protocol


class ByteReader(Protocol):
    """What a log is read from."""

    def read(self, size: int = -1, /) -> bytes: ...


class HashingReader:
    """Hands a stream's bytes on and keeps their SHA-256.

    Parameters
    ----------
    stream : ByteReader
    """

    def __init__(self, stream: ByteReader | BinaryIO) -> None:
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


def sha256_of(path: Path) -> str:
    """The checksum of a whole file, hexadecimal."""
    with open(path, "rb") as stream:
        return file_digest(stream, "sha256").hexdigest()

"""The text of a log: its bytes, in whatever encoding, become lines in UTF-8 with LF, read block by block."""

from __future__ import annotations

from codecs import BOM_UTF16_BE, BOM_UTF16_LE, IncrementalDecoder, getincrementaldecoder
from collections.abc import Iterator
from hashlib import sha256

from tiltcal.errors import InputError
from tiltcal.logs.formats.binary import refuse_binary
from tiltcal.logs.formats.csv_rows import UTF8_BOM
from tiltcal.logs.log import LogSource

_TOP = 1 << 16  # bytes in which the dialect is looked for
_LONGEST_ROW = 16 << 20


class CsvText:
    """The text of a log, read by ``block`` bytes at a time.

    ``first`` are its first lines, in which the dialect is looked for, ``marked`` is whether they begin with a mark of
    UTF-8, ``line_end`` is LF or CRLF, as the first has it. ``line`` is the next line that is read, for messages;
    ``replaced`` counts the bytes that are none in the encoding.
    """

    def __init__(self, source: LogSource, block: int) -> None:
        self._source, self._block = source, block
        self._digest = sha256() if source.size is None else None  # a pipe gives its bytes once
        self._decoder: IncrementalDecoder | None = None
        self.line, self.bytes_read, self.replaced = 1, 0, 0
        self._pending = top = self._top()
        cut = top.rfind(b"\n", 0, _TOP) + 1
        whole = top[:cut] if top.count(b"\n", 0, cut) > 1 else top[: top.rfind(b"\n") + 1] or top
        self.marked, self._charset = whole.startswith(UTF8_BOM), charset_of(whole)
        lines = [line.removesuffix("\r") for line in self.in_utf8(whole).decode().removeprefix("\ufeff").split("\n")]
        self.replaced = 0  # these lines come again
        self.first = lines[:-1] if whole.endswith(b"\n") else lines
        self.line_end = "\r\n" if top.partition(b"\n")[0].endswith(b"\r") and b"\n" in top else "\n"
        if "\0" in lines[0]:
            raise self.error("this is no CSV text: save the log as CSV in UTF-8")
        if "\r" in lines[0]:
            raise self.error("the lines end in CR alone: save the log with LF or CRLF")

    @property
    def sha256(self) -> str | None:
        """The checksum of a stream, hexadecimal; None of a file."""
        return None if self._digest is None else self._digest.hexdigest()

    @property
    def encoding(self) -> str:
        """The encoding of the log."""
        return {"cp1252": "Windows-1252", "utf-8": "UTF-8"}[self._charset] if self._decoder is None else "UTF-16"

    def skip(self, lines: int) -> None:
        """Begin behind some lines."""
        place = 0
        for _ in range(lines):
            place = self._pending.find(b"\n", place) + 1 or len(self._pending)
        self._pending = self._pending[place:] if lines else self._pending.removeprefix(UTF8_BOM)
        self.line += lines

    def lines(self) -> Iterator[tuple[bytes, bool]]:
        """Whole lines, and whether they are the very last one, which had no end."""
        pending, more = b"", self._pending or self._read()
        while more:
            if cut := more.rfind(b"\n") + 1:
                yield b"".join((pending, memoryview(more)[:cut])), False
                pending = more[cut:]
            else:
                pending += more
            self._refuse_endless(pending)
            more = self._read()
        if pending and not self._source.interrupted:
            yield pending + b"\n", True

    def in_utf8(self, data: bytes) -> bytes:
        """Return lines in UTF-8 with LF, where a byte that is none in the encoding of the log is a U+FFFD."""
        if not data.isascii():
            try:
                data = data if self._charset == "utf-8" and data.decode() else data.decode(self._charset).encode()
            except UnicodeDecodeError:
                text = data.decode(self._charset, errors="replace")
                self.replaced += text.count("\ufffd") - data.count("\ufffd".encode())
                data = text.encode()
        return data.replace(b"\r\n", b"\n") if b"\r" in data else data

    def error(self, message: str) -> InputError:
        """Return what is wrong with the next line."""
        return InputError(message, file=self._source.name, line=self.line)

    def _read(self) -> bytes:
        """Return the next bytes, none at the end; of UTF-16 in UTF-8."""
        data = self._source.stream.read(self._block)
        self.bytes_read += len(data)
        if self._digest is not None:
            self._digest.update(data)
        if self._decoder is None:
            return data
        text = self._decoder.decode(data, final=not data)
        while data and not text and (more := self._source.stream.read(self._block)):  # half of a character is no end
            text = self._decoder.decode(more)
        return text.encode(errors="replace")

    def _top(self) -> bytes:
        """Read the first lines, and what comes with them."""
        data = b""
        while (len(data) < _TOP or data.count(b"\n") < 2) and (more := self._read()):
            if not data:
                refuse_binary(more, self._source.name)
                if (encoding := _wide(more)) is not None:
                    self._decoder = getincrementaldecoder(encoding)("replace")
                    more = self._decoder.decode(more).encode(errors="replace")
            data += more
            pending = data[data.rfind(b"\n") + 1 :]
            if len(pending) > _LONGEST_ROW:
                self.line = 1 + data.count(b"\n")
                self._refuse_endless(pending)
        if not data.removeprefix(UTF8_BOM).strip():
            raise InputError("the log is empty", file=self._source.name)
        return data

    def _refuse_endless(self, pending: bytes) -> None:
        """Stop at what is no log, before it fills the memory."""
        if len(pending) > _LONGEST_ROW:
            raise self.error(f"the row does not end within {_LONGEST_ROW >> 20} MB: is this a CSV log?")


def charset_of(head: bytes) -> str:
    """Return the encoding of text without a mark, by its first lines: UTF-8, else Windows-1252.

    One byte that is damaged, among characters that are UTF-8, does not change that they are.
    """
    try:
        head.decode()
    except UnicodeDecodeError:
        text = head.decode(errors="replace")
        beyond = sum(character > "\x7f" for character in text)
        return "utf-8" if beyond > 2 * text.count("\ufffd") else "cp1252"
    return "utf-8"


def _wide(data: bytes) -> str | None:
    """Return which UTF-16 data are in, by their mark or by the zeros in every other byte; None where in none."""
    if data.startswith((BOM_UTF16_LE, BOM_UTF16_BE)):
        return "utf-16"
    high = {"utf-16-le": data[1:1024:2], "utf-16-be": data[:1024:2]}
    return next((encoding for encoding, zeros in high.items() if any(data[:1024]) and zeros and not any(zeros)), None)

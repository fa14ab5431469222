"""YAML 1.2 as text: it is read as plain data whose scalars stay text, and written in a fixed style.

PyYAML alone reads ``1e-8`` as text, ``0042`` as 34, ``12:30`` as 750 and the second of two equal keys in silence. Here
its parser gives only the events. Anchors, aliases and tags are refused: no file of ours needs them, and a bomb is made
of them.

What is written has small mappings in one line, large ones opened. It reads back equal, also under YAML 1.1: a text that
either version would take for a number, a date, a truth value or nothing is quoted, and ``1e-08`` is ``1.0e-08``. So are
the letters ``y`` and ``n``, which the parsers of R and Go take for truth values.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import takewhile
from math import isfinite
from numbers import Integral, Real
from pathlib import Path
from typing import Any

import yaml

from tiltcal.errors import InputError
from tiltcal.stated_arguments import require_path, require_printable

Place = tuple[str | int, ...]  # the keys and numbers of items that lead to a value
SIZE_LIMIT = 4_000_000  # bytes; the largest calibration file seen is a hundredth of it
NODE_LIMIT = 200_000
DEPTH_LIMIT = 32
SENT = ("ask", "answer", "ends")  # the keys of a device file with what goes over a line, control characters and all

_NULL = re.compile(r"null|Null|NULL|~|")

WIDTH = 120
_COMMENT_COLUMN = 46
_KEY_LIMIT = 100  # YAML itself ends at 1024 bytes, escapes included
_READ_AS_OTHER = {"y", "n", "yes", "no", "on", "off", "true", "false", "null"}
_BARE = re.compile(r"[^\W\d_]([\w./+()°%=-]| (?=[\w./+()°%=-]))*")
_UNPRINTABLE = re.compile("[\x7f-\x9f\u2028\u2029\ufeff\ufffe\uffff]")
_FOLD = re.compile(r"(?<=[^\s\\]) (?=[^\s])")


def dotted(place: Place) -> str | None:
    """Return a place as messages name it, such as ``positions[0].mean``; None of the whole document."""
    steps = (f"[{step}]" if isinstance(step, int) else f".{step}" for step in place)
    return "".join(steps).removeprefix(".") or None


def is_sent(place: Place) -> bool:
    """Return whether a text of a device file goes over a line, in a file of its own or as the key ``device``."""
    return bool(place) and place[-1] in SENT and (len(place) == 1 or place[-2] == "device")


def read_text(path: str | Path) -> str:
    """Return the text of a file of at most ``SIZE_LIMIT`` bytes of UTF-8; an InputError where it cannot be read."""
    require_path("a file", path)
    try:
        with open(path, "rb") as stream:
            data = stream.read(SIZE_LIMIT + 1)
    except FileNotFoundError:
        raise InputError("no such file", file=path) from None
    except IsADirectoryError:
        raise InputError("this is a folder; name a file in it", file=path) from None
    except (OSError, ValueError) as failure:
        raise InputError(f"cannot be read: {getattr(failure, 'strerror', None) or failure}", file=path) from None
    if len(data) > SIZE_LIMIT:
        raise InputError(f"the file is too large: at most {SIZE_LIMIT:,} bytes are read", file=path)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as failure:
        line = data.count(b"\n", 0, failure.start) + 1
        byte = data[failure.start]
        raise InputError(f"not UTF-8 (byte 0x{byte:02x}); save the file as UTF-8", file=path, line=line) from None


def parse(text: str, file: str | None = None) -> tuple[Any, dict[Place, int]]:
    """Return the data of one document, and the lines of its values; an InputError names what is refused."""
    composer = _Composer(file)
    roots: list[Any] = []
    try:
        # The C library, where PyYAML was built with it.
        events = yaml.parse(text, Loader=getattr(yaml, "CBaseLoader", yaml.BaseLoader))
        for event in events:
            if isinstance(event, yaml.DocumentStartEvent) and roots:
                raise composer.error("a second document begins; keep one document per file", _line(event))
            if isinstance(event, yaml.NodeEvent):
                roots.append(composer.value(event, events, ()))
    except yaml.MarkedYAMLError as failure:
        mark = failure.problem_mark or failure.context_mark
        problem = failure.problem or failure.context or "the parser gives no reason"
        # What is missing at the end is reported for the last line, not for the one after it.
        line = None if mark is None else min(mark.line + 1, len(text.splitlines()))
        raise composer.error(f"not YAML: {problem}", line) from None
    except (yaml.YAMLError, UnicodeError) as failure:
        line = None
        if isinstance(failure, yaml.reader.ReaderError):
            line = text.encode().count(b"\n", 0, failure.position) + 1
        raise composer.error(f"not YAML: {getattr(failure, 'reason', failure)}", line) from None
    if not roots:
        raise composer.error("the file is empty", None)
    return roots[0], composer.lines


class _Composer:
    """Builds the data from the parser's events; how deep and how many they are is limited."""

    def __init__(self, file: str | None) -> None:
        self._file = file
        self.lines: dict[Place, int] = {}
        self._count = 0

    def value(self, event: Any, events: Iterator[yaml.Event], place: Place) -> Any:
        """Return the value that begins with an event, and take the events up to its end."""
        line = self._checked(event)
        self.lines.setdefault(place, line)
        if isinstance(event, yaml.ScalarEvent):
            if not event.value.isprintable() and not is_sent(place):
                require_printable(event.value, dotted(place), self._file, line)
            return None if not event.style and _NULL.fullmatch(event.value) else str(event.value)
        if len(place) >= DEPTH_LIMIT:
            raise self.error(f"nested deeper than {DEPTH_LIMIT}", line)
        parts = takewhile(lambda part: not isinstance(part, yaml.CollectionEndEvent), events)
        if isinstance(event, yaml.SequenceStartEvent):
            return [self.value(part, events, (*place, number)) for number, part in enumerate(parts)]
        data: dict[str, Any] = {}
        for part in parts:
            name = self._key(part, place)
            data[name] = self.value(next(events), events, (*place, name))
        return data

    def _key(self, event: Any, parent: Place) -> str:
        line = self._checked(event)
        if not isinstance(event, yaml.ScalarEvent):
            raise self.error("a key is a list or a mapping; keys are text", line, parent)
        name = str(event.value)
        if not name.isprintable():
            require_printable(name, dotted(parent), self._file, line)
        if (place := (*parent, name)) in self.lines:
            raise self.error(f"the key {name!r} is given twice, on lines {self.lines[place]} and {line}", line, place)
        self.lines[place] = line
        return name

    def _checked(self, event: Any) -> int:
        """Return the line of a value or a key; anchors, aliases, tags and bombs are refused."""
        line = _line(event)
        if isinstance(event, yaml.AliasEvent):
            raise self.error(f"the alias *{event.anchor} is not allowed; write the value out", line)
        if event.anchor is not None:
            raise self.error(f"the anchor &{event.anchor} is not allowed; write the value out", line)
        if event.tag is not None:
            raise self.error(f"the tag {event.tag} is not allowed; write the value alone", line)
        self._count += 1
        if self._count > NODE_LIMIT:
            raise self.error(f"more than {NODE_LIMIT:,} values in one file", line)
        return line

    def error(self, message: str, line: int | None, place: Place = ()) -> InputError:
        return InputError(message, file=self._file, line=line, key=dotted(place))


def _line(event: yaml.Event) -> int:
    return 1 if event.start_mark is None else int(event.start_mark.line) + 1


def yaml_text(data: Mapping[str, Any], comments: Mapping[str, str] | None = None) -> str:
    """Return a mapping as a YAML document, which ends in a newline; the same data gives the same text.

    It has str keys and None, bool, int, float, str, and mappings and sequences of these; ``comments`` stand at the end
    of a key's line, by the key's dotted path. An InputError where a value is none of these, or not finite.
    """
    return "\n".join(_opened(data, 0, "", comments or {})) + "\n" if data else "{}\n"


def _opened(data: Any, indent: int, path: str, comments: Mapping[str, str]) -> Iterator[str]:
    """Yield the lines of the members of a mapping or a list, each behind its key or its dash."""
    margin, is_mapping = " " * indent, isinstance(data, Mapping)
    for name, value in data.items() if is_mapping else enumerate(data):
        key = f"{path}.{name}".removeprefix(".") if is_mapping else f"{path}[{name}]"
        lead = f"{margin}{_key(name, key)}:" if is_mapping else f"{margin}-"
        if not _is_collection(value) or _fits(value, lead, key):
            first, *rest = _folded(value, lead, indent, key)
        elif isinstance(value, Mapping) and not is_mapping:
            first, *rest = _opened(value, indent + 2, key, {})
            first = f"{lead} {first[indent + 2 :]}"
        elif isinstance(value, Mapping) or any(map(_is_collection, value)):
            first, *rest = lead, *_opened(value, indent + 2, key, comments if is_mapping else {})
        else:
            texts = [_scalar(item, f"{key}[{index}]") for index, item in enumerate(value)]
            pieces = [*(f"{text}, " for text in texts[:-1]), f"{texts[-1]}]"]
            first, *rest = _filled(pieces, f"{lead} [", " " * (indent + 2))
        comment = comments.get(key, "")
        commented = f"{first:<{_COMMENT_COLUMN}}  # {comment}"
        yield commented if comment and comment.isprintable() and len(commented) <= WIDTH else first
        yield from rest


def _folded(value: Any, lead: str, indent: int, key: str) -> Iterator[str]:
    """Yield a value that stands in one line, or the lines of a long text, which is quoted and folded at its spaces."""
    text = _flow(value, key)
    if len(lead) + 1 + len(text) <= WIDTH or not isinstance(value, str):
        yield f"{lead} {text}"
        return
    words = _FOLD.split(_quoted(value, key))
    yield from _filled([*(f"{word} " for word in words[:-1]), words[-1]], f"{lead} ", " " * (indent + 2))


def _filled(pieces: Sequence[str], first: str, margin: str) -> Iterator[str]:
    """Yield lines of as many pieces as fit; the line break stands for the last blank of a line."""
    line = first
    for number, piece in enumerate(pieces):
        if number and len(line) + len(piece.rstrip()) > WIDTH:
            yield line.rstrip(" ")
            line = margin
        line += piece
    yield line


def _fits(value: Any, lead: str, key: str) -> bool:
    """Return whether a collection fits in one line: it is shallow, and short enough."""
    members = value.values() if isinstance(value, Mapping) else value
    deep = [member for member in members if _is_collection(member)]
    if isinstance(value, Mapping):
        deep = [
            member for member in deep if member and (isinstance(member, Mapping) or any(map(_is_collection, member)))
        ]
    return not deep and len(lead) + 1 + len(_flow(value, key)) <= WIDTH


def _flow(value: Any, key: str) -> str:
    """Return a value in one line."""
    if isinstance(value, Mapping):
        members = (f"{_key(name, key)}: {_flow(item, f'{key}.{name}')}" for name, item in value.items())
        return "{" + ", ".join(members) + "}"
    if _is_collection(value):
        return "[" + ", ".join(_flow(item, f"{key}[{index}]") for index, item in enumerate(value)) + "]"
    return _scalar(value, key)


def _is_collection(value: Any) -> bool:
    return isinstance(value, Mapping | list | tuple)


def _key(name: Any, key: str) -> str:
    if not isinstance(name, str) or len(name) > _KEY_LIMIT:
        raise InputError(f"cannot be written: a key is a text of at most {_KEY_LIMIT} characters", key=key[:_KEY_LIMIT])
    require_printable(name)
    return _scalar(name, key)


def _scalar(value: Any, key: str) -> str:
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, Integral):  # of numpy, too
        return int.__repr__(int(value))
    if isinstance(value, Real):
        if not isfinite(value):
            raise InputError(f"{float(value)} cannot be written to a file; a number must be finite", key=key)
        digits, exponent, power = float.__repr__(float(value)).partition("e")
        # YAML 1.1 takes 1e-08 for a text because it has no decimal point.
        return f"{digits}{'.0' if exponent and '.' not in digits else ''}{exponent}{power}"
    if not isinstance(value, str):
        raise InputError(f"a {type(value).__name__} cannot be written to a file", key=key)
    return value if _BARE.fullmatch(value) and value.lower() not in _READ_AS_OTHER else _quoted(value, key)


def _quoted(text: str, key: str) -> str:
    """Return a text in double quotes, with the escapes of JSON, which YAML shares."""
    if any("\ud800" <= character <= "\udfff" for character in text):
        raise InputError(f"the text {text!r} is not Unicode and cannot be written to a file", key=key)
    return _UNPRINTABLE.sub(lambda found: f"\\u{ord(found.group()):04x}", json.dumps(text, ensure_ascii=False))

"""YAML text of a fixed style: small mappings in one line, large ones opened, 120 columns wide.

What is written reads back equal under YAML 1.2, and the same under YAML 1.1: a text that either would take for a
number, a date, a truth value or nothing is quoted, and ``1e-08`` is written ``1.0e-08``. The letters ``y`` and ``n``
alone are left bare: they are keys in every file, and no parser at work today takes them for truth values.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from math import isfinite
from numbers import Integral, Real
from typing import Any

from tiltcal.errors import InputError
from tiltcal.stated_arguments import require_printable

WIDTH = 120
_COMMENT_COLUMN = 46
_KEY_LIMIT = 100
"""YAML itself ends at 1024 bytes, escapes included."""
_READ_AS_OTHER = {"yes", "no", "on", "off", "true", "false", "null"}
_BARE = re.compile(r"[^\W\d_]([\w./+()°%=-]| (?=[\w./+()°%=-]))*")
_UNPRINTABLE = re.compile("[\x7f-\x9f\u2028\u2029\ufeff\ufffe\uffff]")
_FOLD = re.compile(r"(?<=[^\s\\]) (?=[^\s])")


def yaml_text(data: Mapping[str, Any], comments: Mapping[str, str] | None = None) -> str:
    """Return a mapping as a YAML document, which ends in a newline; the same data gives the same text.

    It has str keys and None, bool, int, float, str, and mappings and sequences of these; ``comments`` stand at the end
    of a key's line, by the key's dotted path. An InputError where a value is none of these, or not finite.
    """
    return "\n".join(_opened_mapping(data, 0, "", comments or {})) + "\n" if data else "{}\n"


def _opened_mapping(data: Mapping[str, Any], indent: int, path: str, comments: Mapping[str, str]) -> Iterator[str]:
    for name, value in data.items():
        key = f"{path}{name}"
        lead = f"{' ' * indent}{_key(name, key)}:"
        first, *rest = _value_lines(value, lead, indent, key, comments)
        yield _with_comment(first, comments.get(key))
        yield from rest


def _opened_list(data: Sequence[Any], indent: int, path: str) -> Iterator[str]:
    lead = f"{' ' * indent}-"
    for index, item in enumerate(data):
        key = f"{path}[{index}]"
        if isinstance(item, Mapping) and item and not _fits(item, lead, key):
            first, *rest = _opened_mapping(item, indent + 2, f"{key}.", {})
            yield f"{lead} {first[indent + 2 :]}"
            yield from rest
        else:
            yield from _value_lines(item, lead, indent, key, {})


def _value_lines(value: Any, lead: str, indent: int, key: str, comments: Mapping[str, str]) -> Iterator[str]:
    """Yield the lines of a value after ``lead``, which is its key or the dash of its list."""
    if not _is_collection(value):
        yield from _scalar_lines(value, lead, indent, key)
    elif _fits(value, lead, key):
        yield f"{lead} {_flow(value, key)}"
    elif isinstance(value, Mapping):
        yield lead
        yield from _opened_mapping(value, indent + 2, f"{key}.", comments)
    elif any(_is_collection(item) for item in value):
        yield lead
        yield from _opened_list(value, indent + 2, key)
    else:
        yield from _filled_list(value, lead, indent, key)


def _scalar_lines(value: Any, lead: str, indent: int, key: str) -> Iterator[str]:
    """Yield the lines of a scalar; a long text is quoted and folded at its spaces."""
    text = _scalar(value, key)
    if len(lead) + 1 + len(text) <= WIDTH or not isinstance(value, str):
        yield f"{lead} {text}"
        return
    words = _FOLD.split(_quoted(value, key))
    yield from _filled([*(f"{word} " for word in words[:-1]), words[-1]], f"{lead} ", " " * (indent + 2))


def _filled_list(value: Sequence[Any], lead: str, indent: int, key: str) -> Iterator[str]:
    """Yield the lines of a list of scalars, each as full as the width allows."""
    texts = [_scalar(item, f"{key}[{index}]") for index, item in enumerate(value)]
    pieces = [*(f"{text}, " for text in texts[:-1]), f"{texts[-1]}]"]
    yield from _filled(pieces, f"{lead} [", " " * (indent + 2))


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
    if isinstance(value, Mapping):
        inner = [item for item in value.values() if _is_collection(item) and item]
        shallow = not any(isinstance(item, Mapping) or any(map(_is_collection, item)) for item in inner)
    else:
        shallow = not any(map(_is_collection, value))
    return shallow and len(lead) + 1 + len(_flow(value, key)) <= WIDTH


def _flow(value: Any, key: str) -> str:
    if isinstance(value, Mapping):
        return (
            "{" + ", ".join(f"{_key(name, key)}: {_flow(item, f'{key}.{name}')}" for name, item in value.items()) + "}"
        )
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
        return _number(float(value), key)
    if not isinstance(value, str):
        raise InputError(f"a {type(value).__name__} cannot be written to a file", key=key)
    return value if _BARE.fullmatch(value) and value.lower() not in _READ_AS_OTHER else _quoted(value, key)


def _number(value: float, key: str) -> str:
    if not isfinite(value):
        raise InputError(f"{float(value)} cannot be written to a file; a number must be finite", key=key)
    digits, exponent, power = float.__repr__(value).partition("e")
    # YAML 1.1 takes 1e-08 for a text because it has no decimal point.
    return f"{digits}{'.0' if exponent and '.' not in digits else ''}{exponent}{power}"


def _quoted(text: str, key: str) -> str:
    """Return a text in double quotes, with the escapes of JSON, which YAML shares."""
    if any("\ud800" <= character <= "\udfff" for character in text):
        raise InputError(f"the text {text!r} is not Unicode and cannot be written to a file", key=key)
    return _UNPRINTABLE.sub(lambda found: f"\\u{ord(found.group()):04x}", json.dumps(text, ensure_ascii=False))


def _with_comment(line: str, comment: str | None) -> str:
    if comment is None:
        return line
    commented = f"{line:<{_COMMENT_COLUMN}}  # {comment}"
    return commented if len(commented) <= WIDTH and comment.isprintable() else line

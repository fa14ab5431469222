"""The words of a message on what a type refuses in a document, and which texts are numbers."""

from __future__ import annotations

import re
import sys
from collections.abc import Collection
from difflib import get_close_matches
from math import inf, isfinite
from typing import Any
from unicodedata import normalize

import msgspec

from tiltcal.stated_arguments import LEAST

FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
WHOLE = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+")
NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")

_DIGIT_LIMIT = 200
_NEEDED = {float: "a number", int: "a whole number", bool: "true or false", list: "a list", dict: "a mapping"}


class Quoted(str):
    """A scalar in quotes, which is a text; msgspec alone would take a number in quotes."""

    __slots__ = ()


def numeral(value: Any, base: Any) -> float | None:
    """Return the number that a value is, a whole one where the type is int; infinity above 200 digits; None if none."""
    number: float | None = None
    if isinstance(value, int | float) and not isinstance(value, bool):
        number = value
    elif type(value) is str and WHOLE.fullmatch(value) and len(value) <= _DIGIT_LIMIT:
        number = int(value, 0 if value[1:2] in ("o", "x") else 10)
    elif type(value) is str and (WHOLE.fullmatch(value) or FLOAT.fullmatch(value)):
        number = inf if value[1:2] in ("o", "x") else float(value)
    if number is None or not abs(number) <= sys.float_info.max:
        return None if number is None else inf
    return float(number) if base is float else int(number) if number == int(number) else None


def refusal(value: Any, needed: Any) -> str:
    """Return why a value is refused: a type is needed, or one of a few words."""
    if isinstance(needed, Collection) and isinstance(value, str):
        near = hint(value, needed)
        return f"unknown value {value!r}{near}; it is one of {', '.join(map(str, needed))}"
    if isinstance(value, str) and not value.strip() and needed is str:
        return "the text is empty; write a text"
    advice = ""
    if isinstance(value, str) and needed in (float, int):
        advice = "; it must be finite" if NOT_FINITE.fullmatch(value) else _advice(value)
    kind = _NEEDED.get(needed, "text") if isinstance(needed, type) else "text"
    return f"{kind} is needed here, found {_shown(value)}{advice}"


def unknown(name: str, keys: Collection[str]) -> str:
    """Return the message on a key that is not among those of a section."""
    return f"unknown key {name!r}{hint(name, keys)}; known here: {', '.join(keys) or 'none'}"


def hint(word: str, words: Collection[str]) -> str:
    """Return the word that is meant, where one is near."""
    near = get_close_matches(word, list(words), n=1)
    alike = "" if word.isascii() else f", with other letters than {word!a}"
    return f" (did you mean {near[0]!r}{alike}?)" if near else ""


def beyond(value: Any, number: float, metas: tuple[msgspec.Meta, ...]) -> str:
    """Return why a number is refused that is beyond a bound."""
    if not isfinite(number):
        return f"{_shown(value)} is too large a number"
    for meta in metas:
        if meta.ge is not None and number < meta.ge:
            least = f"more than 0, at least {meta.ge:.10g}" if meta.ge == LEAST else f"at least {meta.ge:.10g}"
            return f"{_shown(value)} is too small; it must be {least}"
        if meta.gt is not None and number <= meta.gt:
            return f"{_shown(value)} is too small; it must be more than {meta.gt:.10g}"
        if meta.le is not None and number > meta.le:
            return f"{_shown(value)} is too large; it must be at most {meta.le:.10g}"
    return f"{_shown(value)} is too large a number"


def _advice(text: str) -> str:
    """Return how a text that looks like a number becomes one."""
    quoted, text = isinstance(text, Quoted), text.strip()
    if FLOAT.fullmatch(text):
        return "; take off the quotes" if quoted else ""
    if not text.isascii() and FLOAT.fullmatch(normalize("NFKC", text)):
        return "; these are other characters than the digits 0 to 9"
    if FLOAT.fullmatch(text.replace(",", ".")):
        return "; write the point as '.'"
    return "; write the number alone" if re.match(FLOAT.pattern + r" ?[°%a-zA-Z]", text) else ""


def _shown(value: Any) -> str:
    if value is None:
        return "nothing"
    if isinstance(value, dict | list):
        return "a mapping" if isinstance(value, dict) else "a list"
    if not isinstance(value, str):
        return str(value)
    text = value if len(value) <= 40 else value[:37] + "..."
    if isinstance(value, Quoted):
        return f"the text {str(text)!r}"
    return text if FLOAT.fullmatch(value) or NOT_FINITE.fullmatch(value) else repr(text)

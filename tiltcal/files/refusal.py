"""What a type refuses in a document: the place, and the words of the message.

msgspec converts a sound document at once. Where it refuses one, the data are taken part by part, which finds the
place, also in a mapping with free keys, and converts what YAML allows and msgspec does not: numbers such as ``.5`` or
``0x1d``, keys by their former names, and optional keys that hold nothing.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Collection, Mapping
from difflib import get_close_matches
from math import inf, isfinite
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin
from unicodedata import normalize

import msgspec

from tiltcal.errors import InputError
from tiltcal.stated_arguments import LEAST

FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
WHOLE = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+")
NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")

_DIGIT_LIMIT = 200
_NEEDED = {float: "a number", int: "a whole number", bool: "true or false", list: "a list", dict: "a mapping"}

Alternative = tuple[Any, tuple[msgspec.Meta, ...]]
"""A type without its annotations, and these."""


class Quoted(str):
    """A scalar in quotes, which is a text; msgspec alone would take a number in quotes."""

    __slots__ = ()


def repaired(value: Any, kind: Any, error: Callable[..., InputError], *place: str | int) -> Any:
    """Return data as msgspec takes them; an InputError names the first place that a type refuses."""
    alternatives, shape = _alternatives(kind), _shape_of(value)
    base, metas = next((one for one in alternatives if _shape(one[0]) is shape), alternatives[0])
    if base is Any:
        return value
    if _shape(base) != shape:
        raise error(refusal(value, _shape(base) or base), *place)
    if shape is dict:
        return _mapping(value, base, error, *place)
    if shape is list:
        return _list(value, base, metas, error, *place)
    literals = [
        word for one, _ in alternatives if getattr(one, "__origin__", None) is Literal for word in get_args(one)
    ]
    return value if value in literals else _scalar(value, base, metas, error, *place)


def _mapping(value: dict[str, Any], base: Any, error: Callable[..., InputError], *place: str | int) -> dict[str, Any]:
    if get_origin(base) is not None:
        name_kind, kind = get_args(base)
        names = _words(_alternatives(name_kind)[0][1])
        kinds, needed = dict.fromkeys(names or value, kind), set() if names else set(value)
    else:
        fields = msgspec.structs.fields(base)
        kinds, needed = (
            {one.encode_name: one.type for one in fields},
            {one.encode_name for one in fields if one.required},
        )
        value = _renamed(value, kinds, error, *place)
    for name in value:
        if name not in kinds:
            raise error(unknown(name, kinds), *place, name)
    missing = [name for name in kinds if name in needed and name not in value]
    if missing:
        raise error(f"the key {missing[0]!r} is missing; it is required here", *place)
    return {
        name: repaired(value[name], one, error, *place, name)
        for name, one in kinds.items()
        if name in value and (name in needed or value[name] is not None)
    }


def _renamed(
    value: dict[str, Any], kinds: Mapping[str, Any], error: Callable[..., InputError], *place: str | int
) -> Any:
    """Return a section by the present names of its keys."""
    former = {
        meta.extra["formerly"]: name
        for name, kind in kinds.items()
        for meta in getattr(kind, "__metadata__", ())
        if meta.extra and meta.extra.get("formerly")
    }
    for name in value:
        if former.get(name) in value:
            raise error(
                f"this is the key {former[name]!r} by its present and its former name: leave one out", *place, name
            )
    return {former.get(name, name): member for name, member in value.items()}


def _list(
    value: list[Any], base: Any, metas: tuple[msgspec.Meta, ...], error: Callable[..., InputError], *place: str | int
) -> list[Any]:
    kinds = get_args(base)
    least = most = None if kinds[-1] is Ellipsis else len(kinds)
    for meta in metas:
        least, most = meta.min_length or least, meta.max_length or most
    if len(value) < (least or 0) or len(value) > (len(value) if most is None else most):
        bounds = f"{least}" if least == most else f"at least {least}" if most is None else f"{least or 0} to {most}"
        bounds = f"at most {most}" if not least else bounds
        raise error(f"a list of {bounds} values is needed here, found {len(value)}", *place)
    fixed = kinds[:1] * len(value) if kinds[-1] is Ellipsis else kinds
    return [repaired(item, kind, error, *place, n) for n, (item, kind) in enumerate(zip(value, fixed, strict=True))]


def _scalar(
    value: Any, base: Any, metas: tuple[msgspec.Meta, ...], error: Callable[..., InputError], *place: str | int
) -> Any:
    number = numeral(value, base) if base in (float, int) else value
    if number is None:
        raise error(refusal(value, base), *place)
    try:
        if base is bool and isinstance(value, Quoted):
            raise msgspec.ValidationError
        msgspec.convert(number, Annotated[(base, *metas)] if metas else base, strict=False)
    except msgspec.ValidationError:
        if base in (float, int):
            raise error(_beyond(value, number, metas), *place) from None
        says = next((meta.extra["says"] for meta in metas if meta.extra and "says" in meta.extra), "")
        if says and isinstance(value, str) and value.strip():
            raise error(f"{value!r} is not {says}", *place) from None
        raise error(refusal(value, _words(metas) or get_args(base) or base), *place) from None
    return number


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


def _beyond(value: Any, number: float, metas: tuple[msgspec.Meta, ...]) -> str:
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


def _alternatives(kind: Any, metas: tuple[msgspec.Meta, ...] = ()) -> list[Alternative]:
    """Return what a type is, without its annotations and without None."""
    if hasattr(kind, "__metadata__"):
        return _alternatives(kind.__origin__, (*kind.__metadata__, *metas))
    if get_origin(kind) in (Union, UnionType):
        return [one for member in get_args(kind) if member is not NoneType for one in _alternatives(member, metas)]
    return [(kind, metas)]


def _shape(base: Any) -> type[Any] | None:
    """Return whether a type is a mapping or a list; None for a scalar."""
    origin = get_origin(base)
    if (isinstance(base, type) and issubclass(base, msgspec.Struct)) or origin in (dict, Mapping):
        return dict
    return list if origin in (tuple, list) else None


def _shape_of(value: Any) -> type[Any] | None:
    return next((one for one in (dict, list) if isinstance(value, one)), None)


def _words(metas: tuple[msgspec.Meta, ...]) -> tuple[str, ...]:
    return next((meta.extra["words"] for meta in metas if meta.extra and "words" in meta.extra), ())

"""One value of a document with its location."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, TypeVar
from unicodedata import normalize

from tiltcal.errors import InputError, TiltcalError, UsageError

S = TypeVar("S")
T = TypeVar("T")

DEPTH_LIMIT = 32

_DIGIT_LIMIT = 400
_NULL = re.compile(r"null|Null|NULL|~|")
_TRUE = re.compile(r"true|True|TRUE")
_FALSE = re.compile(r"false|False|FALSE")
_INTEGER = re.compile(r"[-+]?[0-9]+")
_BASED = re.compile(r"0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f]")
_NO_TEXT = re.compile("[\ud800-\udfff]")  # what Python makes of bytes that are not UTF-8
_NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_OTHER_THAN_TEXT = re.compile(
    f"(?P<null>{_NULL.pattern})|(?P<truth>{_TRUE.pattern}|{_FALSE.pattern})"
    f"|(?P<integer>{_INTEGER.pattern}|{_BASED.pattern})|{_FLOAT.pattern}|{_NOT_FINITE.pattern}"
)


@dataclass(frozen=True, slots=True)
class Scalar:
    """A scalar as it stands in the file; only a plain one (without quotes) can be other than text."""

    text: str
    plain: bool


@dataclass(frozen=True, slots=True)
class Node:
    """One value of a document with its file, line and key.

    Every reading method raises :class:`InputError` with file, line and key where the value is not what is asked for.

    Attributes
    ----------
    file : str or None
        As the user named it.
    line : int or None
        Line of the value's key, or of the value where it has no key, counted from 1.
    key : str or None
        Dotted path, such as ``calibration.offset.x``; None for the whole document.
    """

    content: Scalar | list[Node] | dict[str, Node]
    file: str | None
    line: int | None
    key: str | None

    def error(self, message: str) -> InputError:
        """Return an error with this location, to be raised."""
        return InputError(message, file=self.file, line=self.line, key=self.key)

    def converted(self, convert: Callable[[S], T], value: S) -> T:
        """Return what a function makes of a value that was read here; its error gets this location."""
        try:
            return convert(value)
        except TiltcalError as failure:
            raise self.error(str(failure)) from None

    @property
    def is_null(self) -> bool:
        """Whether the value is ``null``, ``~`` or absent after its key."""
        return self._plain(_NULL) is not None

    @property
    def is_blank(self) -> bool:
        """Whether the value is the text ``""``."""
        return self.content == Scalar("", plain=False)

    @property
    def is_mapping(self) -> bool:
        """Whether the value is a mapping."""
        return isinstance(self.content, dict)

    def names(self, *words: str) -> bool:
        """Return whether the value is one of these words."""
        return isinstance(self.content, Scalar) and self.content.text in words

    def text(self) -> str:
        """Return the characters of a scalar, with or without quotes: ``0042`` stays ``"0042"``."""
        if not isinstance(self.content, Scalar) or self.is_null:
            raise self._unexpected("text")
        if not self.content.text.strip():
            raise self.error("the text is empty; write a text")
        require_printable(self.content.text, self.file, self.line, self.key)
        return self.content.text

    def number(self, *, minimum: float | None = None, above: float | None = None) -> float:
        """Return a finite number written without quotes, of at least ``minimum`` and more than ``above``."""
        literal = self._plain(_FLOAT)
        value = float(self._based()) if literal is None else float(literal)
        if not math.isfinite(value):
            raise self.error(f"{self._shown()} is too large a number")
        self._bounded(value, minimum, above)
        return value

    def integer(self, *, minimum: int | None = None) -> int:
        """Return a whole number written without quotes, decimal point and exponent."""
        literal = self._plain(_INTEGER)
        value = self._based("a whole number") if literal is None else self._whole(literal)
        self._bounded(value, minimum, None)
        return value

    def flag(self) -> bool:
        """Return ``true`` or ``false`` as a bool."""
        if self._plain(_TRUE) is not None:
            return True
        if self._plain(_FALSE) is not None:
            return False
        raise self._unexpected("true or false")

    def choice(self, options: Sequence[str]) -> str:
        """Return one of a few words."""
        value = self.text()
        if value not in options:
            raise self.error(f"unknown value {value!r}{_hint(value, options)}; it is one of {', '.join(options)}")
        return value

    def items(self) -> list[Node]:
        """Return the members of a list."""
        if not isinstance(self.content, list):
            raise self._unexpected("a list")
        return self.content

    def interval(self) -> tuple[float, float]:
        """Return two numbers ``[low, high]`` in that order."""
        bounds = [item.number() for item in self.items()]
        if len(bounds) != 2:
            raise self.error(f"a range has two numbers [low, high], found {len(bounds)}")
        low, high = bounds
        if low > high:
            raise self.error(f"the range [{low:g}, {high:g}] is the wrong way round; write [low, high]")
        return low, high

    def entries(self) -> dict[str, Node]:
        """Return the members of a mapping with any keys."""
        if not isinstance(self.content, dict):
            raise self._unexpected("a mapping")
        return self.content

    def mapping(
        self, *, required: Sequence[str] = (), optional: Sequence[str] = (), former: Mapping[str, str] | None = None
    ) -> dict[str, Node]:
        """Return the members of a mapping with fixed keys; an optional one that holds null is taken as absent.

        Parameters
        ----------
        former : mapping of str to str
            The present names of keys by those that files of earlier versions have.
        """
        former, entries = former or {}, {}
        for written, node in self.entries().items():
            name = former.get(written, written)
            if name in entries:
                raise node.error(f"this is the key {name!r} by its present and its former name: leave one out")
            entries[name] = node
        known = [*required, *optional]
        for name, node in entries.items():
            if name not in known:
                raise node.error(f"unknown key {name!r}{_hint(name, known)}; known here: {', '.join(known) or 'none'}")
        missing = [name for name in required if name not in entries]
        if missing:
            raise self.error(f"the key {missing[0]!r} is missing; it is required here")
        return {name: node for name, node in entries.items() if name in required or not node.is_null}

    def plain(self) -> Any:
        """Return the value as plain Python data; scalars by the YAML 1.2 core schema.

        Raises
        ------
        InputError
            NaN or an infinity: a record with one is a mistake of the code that wrote it.
        """
        if isinstance(self.content, dict):
            return {name: node.plain() for name, node in self.content.items()}
        if isinstance(self.content, list):
            return [node.plain() for node in self.content]
        return self._resolved()

    def _resolved(self) -> str | int | float | bool | None:
        if not isinstance(self.content, Scalar):
            return None
        found = _OTHER_THAN_TEXT.fullmatch(self.content.text) if self.content.plain else None
        if found is None:
            return self.content.text
        match found.lastgroup:
            case "null":
                return None
            case "truth":
                return self.flag()
            case "integer":
                return self.integer()
        return self.number()

    def _plain(self, grammar: re.Pattern[str]) -> str | None:
        """Return the text of a plain scalar that matches a grammar, or None."""
        content = self.content
        fits = isinstance(content, Scalar) and content.plain and grammar.fullmatch(content.text) is not None
        return content.text if isinstance(content, Scalar) and fits else None

    def _based(self, expected: str = "a number") -> int:
        """Return an octal or hexadecimal whole number."""
        literal = self._plain(_BASED)
        if literal is None:
            raise self._unexpected(expected)
        return self._whole(literal)

    def _whole(self, literal: str) -> int:
        if len(literal) > _DIGIT_LIMIT // 2:
            raise self.error(f"a number of {len(literal)} digits is too large")
        return int(literal, 0) if literal.startswith(("0o", "0x")) else int(literal)

    def _bounded(self, value: float, minimum: float | None, above: float | None) -> None:
        if minimum is not None and value < minimum:
            raise self.error(f"{self._shown()} is too small; it must be at least {minimum:g}")
        if above is not None and value <= above:
            raise self.error(f"{self._shown()} is too small; it must be more than {above:g}")

    def _unexpected(self, expected: str) -> InputError:
        advice = ""
        if self._plain(_NOT_FINITE) is not None:
            advice = "; it must be finite"
        elif isinstance(self.content, Scalar) and "number" in expected:
            advice = _number_advice(self.content)
        return self.error(f"{expected} is needed here, found {self._shown()}{advice}")

    def _shown(self) -> str:
        if isinstance(self.content, dict):
            return "a mapping"
        if isinstance(self.content, list):
            return "a list"
        if self.is_null:
            return "nothing"
        text = self.content.text if len(self.content.text) <= 40 else self.content.text[:37] + "..."
        if not self.content.plain:
            return f"the text {text!r}"
        return text if self._plain(_FLOAT) or self._plain(_NOT_FINITE) else repr(text)


def document_of(data: Any, file: str | None = None, line: int | None = None) -> Node:
    """Return plain data as a document, so that the code that checks a file checks a record too.

    Errors name ``file`` and ``line``, where the record stands; data of other types, or too deep, is one.
    """
    return _node_of(data, file, line, None, 0)


def _node_of(data: Any, file: str | None, line: int | None, key: str | None, depth: int) -> Node:
    if depth > DEPTH_LIMIT:
        raise InputError(f"nested deeper than {DEPTH_LIMIT}", file=file, line=line, key=key)
    content: Scalar | list[Node] | dict[str, Node]
    if isinstance(data, Mapping):
        for name in data:
            require_printable(str(name), file, line, key)
        content = {
            str(name): _node_of(value, file, line, member_key(key, str(name)), depth + 1)
            for name, value in data.items()
        }
    elif isinstance(data, list | tuple):
        content = [_node_of(value, file, line, item_key(key, index), depth + 1) for index, value in enumerate(data)]
    elif isinstance(data, str):
        content = Scalar(data, plain=False)
    elif data is None or isinstance(data, bool):
        content = Scalar({None: "null", True: "true", False: "false"}[data], plain=True)
    elif isinstance(data, float) and not math.isfinite(data):
        content = Scalar(".nan" if math.isnan(data) else ".inf", plain=True)
    elif isinstance(data, int | float):
        content = Scalar(repr(data), plain=True)
    else:
        raise InputError(f"a number or a text is needed, not a {type(data).__name__}", file=file, line=line, key=key)
    return Node(content, file, line, key)


def require_printable(text: str, file: str | None, line: int | None, key: str | None) -> None:
    """Refuse control characters, which can command a terminal, and what is no text, with an InputError.

    Line feed and tab are allowed.
    """
    if _NO_TEXT.search(text):
        raise InputError(f"{text!r} is not UTF-8", file=file, line=line, key=key)
    found = CONTROL.search(text)
    if found:
        raise InputError(
            f"the control character {found.group()!r} is not allowed in a text", file=file, line=line, key=key
        )


def require_name(text: object, what: str) -> None:
    """Refuse what cannot stand in a file as a name.

    Raises
    ------
    UsageError
        It is no text, or an empty one.
    InputError
        It has a control character.
    """
    if not isinstance(text, str) or not text.strip():
        raise UsageError(f"{what} is {text!r}: write a text")
    require_printable(text, None, None, what)


def _number_advice(scalar: Scalar) -> str:
    """Return how a text that looks like a number becomes one."""
    text = scalar.text.strip()
    if _FLOAT.fullmatch(text):
        return "; take off the quotes" if not scalar.plain else ""
    if not text.isascii() and _FLOAT.fullmatch(normalize("NFKC", text)):
        return "; these are other characters than the digits 0 to 9"
    if _FLOAT.fullmatch(text.replace(",", ".")):
        return "; write the point as '.'"
    return "; write the number alone" if re.match(_FLOAT.pattern + r" ?[°%a-zA-Z]", text) else ""


def member_key(key: str | None, name: str) -> str:
    """Return the dotted path of a mapping's member."""
    return name if key is None else f"{key}.{name}"


def item_key(key: str | None, index: int) -> str:
    """Return the dotted path of a list's item, counted from 0."""
    return f"{key or ''}[{index}]"


def _hint(word: str, known: Sequence[str]) -> str:
    near = get_close_matches(word, known, n=1)
    alike = "" if word.isascii() else f", with other letters than {word!a}"
    return f" (did you mean {near[0]!r}{alike}?)" if near else ""

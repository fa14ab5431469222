"""Arguments that a caller states: the library refuses the same ones as the options of the command line."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from numbers import Integral, Real
from os import PathLike
from typing import Any, cast

from tiltcal.errors import Argument, InputError, UsageError
from tiltcal.printable import did_you_mean
from tiltcal.units import CONVENTIONS

LEAST, MOST = 1e-9, 1e9
"""Bounds of the size of a number that is stated, in a file or an option, and is not 0."""

CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f]")
_NO_TEXT = re.compile("[\ud800-\udfff]")  # what Python makes of bytes that are not UTF-8


def of_python(value: Any) -> Any:
    """Return a number or an array of numpy as one of Python, and anything else as it is."""
    return value.tolist() if hasattr(value, "tolist") else value


def is_number(value: object, least: float = -MOST) -> bool:
    """Return whether a value is a number, 0 or of a size between LEAST and MOST, and not below the least one."""
    number = cast(float, value)  # a whole number of 310 digits can be compared, but is no float
    return isinstance(value, Real) and least <= number and (number == 0 or LEAST <= abs(number) <= MOST)


def require_above_zero(option: str, value: object) -> None:
    """Refuse a value that is no number above 0, with a UsageError; None is not stated."""
    if value is not None and not (is_number(value, 0.0) and value):
        raise UsageError(option=option, why=f"takes a number from {LEAST:g} to {MOST:g}, not {shown(value)}")


def require_from_zero(option: str, value: object) -> None:
    """Refuse a value that is no number from 0, with a UsageError; None is not stated."""
    if value is not None and not is_number(value, 0.0):
        raise UsageError(option=option, why=f"takes 0 or a number from {LEAST:g} to {MOST:g}, not {shown(value)}")


def require_whole(option: str, value: object, least: int, what: str) -> None:
    """Refuse a value that is no whole number from the least one, with a UsageError; None is not stated.

    ``what`` names what it counts, for the message.
    """
    if value is not None and not (isinstance(value, Integral) and least <= int(value) <= MOST):
        raise UsageError(option=option, why=f"takes a number of {what} from {least} to {MOST:g}, not {shown(value)}")


def shown(value: object) -> str:
    """Return a refused value as it is written on the command line and in a program alike: -1 is -1.0."""
    try:
        return f"{value:.15g}" if isinstance(value, Real) else repr(value)
    except OverflowError:
        return "one beyond 1e308"


def require_boolean(option: str, value: object) -> None:
    """Refuse a value that is no boolean of Python or numpy, with a UsageError: the text "no" would count as true."""
    if not isinstance(of_python(value), bool):
        raise UsageError(option=option, why=f"takes True or False, not {value!r}")


def require_text(option: str, value: object) -> None:
    """Refuse a value that is no text, with a UsageError."""
    if not isinstance(value, str):
        raise UsageError(option=option, why=f"takes a text, not {value!r}")


def require_text_or_none(option: str, value: object) -> None:
    """Refuse a value that is no text, with a UsageError; None is not stated."""
    if value is not None:
        require_text(option, value)


def named_values(option: str, given: object, names: Sequence[str], what: str, example: str) -> dict[str, Any]:
    """Return values by name of a mapping, or of a text such as ``roll=180,yaw=90``; a UsageError where it is none.

    ``what`` is what a name stands for, and ``example`` a pair, for the messages.
    """
    if not isinstance(given, str | Mapping):
        raise UsageError(option=option, why=f"takes {what}s by name, such as {example}, not {given!r}")
    pairs = [part.strip() for part in given.split(",")] if isinstance(given, str) else []
    named: dict[str, Any] = {} if isinstance(given, str) else dict(given)
    for pair in filter(None, pairs):
        name, _, value = (part.strip() for part in pair.partition("="))
        if not value:
            raise UsageError(option=option, why=f"takes pairs, not {pair!r}", advice=f"write {example}")
        if name in named:
            raise UsageError(option=option, why=f"names {name} twice")
        named[name] = value
    for name in named:
        if name not in names:
            near = did_you_mean(str(name), names)
            raise UsageError(option=option, why=f"has no {what} {name!r}{near}; the {what}s are {', '.join(names)}")
    return named


def require_path(what: str | Argument, value: object) -> None:
    """Refuse a value that is no name of a file, with a UsageError; ``what`` says which file, for the message."""
    if not isinstance(value, str | PathLike):
        raise UsageError((what, f" is named by a text or a Path, not {value!r}"))


def require_printable(
    text: str, key: str | None = None, file: str | PathLike[str] | None = None, line: int | None = None
) -> None:
    """Refuse control characters, which can command a terminal, and what is no text, with an InputError.

    Line feed and tab are allowed.
    """
    if _NO_TEXT.search(text):
        raise InputError(f"{text!r} is not UTF-8", file=file, line=line, key=key)
    control = CONTROL.search(text)
    if control:
        raise InputError(
            f"the control character {control.group()!r} is not allowed in a text", file=file, line=line, key=key
        )


def require_name(text: object, what: str) -> None:
    """Refuse what cannot stand in a file as a name: no text, an empty one, or one with a control character.

    The error is a UsageError, or of a control character an InputError.
    """
    if not isinstance(text, str) or not text.strip():
        raise UsageError(f"{what} is {text!r}: write a text")
    require_printable(text, what)


def require_convention(option: str, convention: Any) -> None:
    """Refuse a convention of angles that is none."""
    if convention is not None and convention not in CONVENTIONS:
        raise UsageError(option=option, why=f"is {' or '.join(CONVENTIONS)}, not {shown(convention)}")

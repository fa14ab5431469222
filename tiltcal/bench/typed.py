"""Angles, temperatures and directions as people type them, read alike at the terminal, on the page and of a program."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from tiltcal.errors import InputError

KINDS = {
    "tilt": ("an angle such as 29.5 or 29,5°", ("", "°", "deg")),
    "temperature": ("a temperature in °C such as 21.5 or 21,5 °C", ("", "°C", "C")),
    "gravity": ("a number such as 0.5", ("",)),
}
"""By key of an answer: what to type, and the units that may stand behind the number."""

_NUMBER = re.compile(r"([-+−]?(?:[0-9]+[.,]?[0-9]*|[.,][0-9]+))(.*)", re.DOTALL)


def number_in(text: str, kind: str) -> float:
    """Return the number that a text is, in degrees or °C; an InputError says why it is none."""
    wanted, units = KINDS[kind]
    typed = text.strip()
    found = _NUMBER.fullmatch(typed)
    rest = "".join(found[2].split()) if found else ""
    if found and rest in units:
        return float(found[1].replace(",", ".").replace("−", "-"))
    why = (
        "nothing is typed" if not typed
        else "it is no number" if found is None
        else "it has two decimal marks" if rest[0] in ".,"
        else f"{rest!r} behind the number is not taken"
    )  # fmt: skip
    raise InputError(f"{typed[:40]!r} is not accepted, {why}: type {wanted}")


def with_numbers(said: Mapping[str, Any]) -> dict[str, Any]:
    """Return an answer whose angles, temperature and direction are numbers where they were texts.

    InputError: one cannot be read; the error names it.
    """

    def read(value: object, key: str, name: str) -> object:
        if value is None and name != key:  # what JSON makes of a number that is none
            raise InputError("null is no number: leave out what is as it was asked for", key=name)
        try:
            return number_in(value, key) if isinstance(value, str) else value
        except InputError as error:
            raise InputError(error.message, key=name) from None

    answer = dict(said)
    for key in KINDS.keys() & answer.keys():
        match answer[key]:
            case Mapping() as tilts:
                answer[key] = {axis: read(value, key, f"{key} of {axis}") for axis, value in tilts.items()}
            case list() | tuple() as direction:
                answer[key] = [read(value, key, f"{key} {number}") for number, value in enumerate(direction, 1)]
            case value:
                answer[key] = read(value, key, key)
    return answer

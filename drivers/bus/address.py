"""Addresses: one line of text that states where a sensor is connected.

::

    scheme ":" place [ "?" name "=" value { "&" name "=" value } ]

    spi:///dev/spidev0.0?mode=0&speed=500000
    i2c:///dev/i2c-1?address=0x1d
    ads1115+i2c:///dev/i2c-1?address=0x48&x=0&y=1&supply=2
    serial:socket://192.168.1.7:4000?columns=x,y
    modbus:tcp://192.168.1.7:502?columns=x@0:int16*0.001
    sim:?twin=truth.yaml&seed=7         or shorter  sim:twin=truth.yaml&seed=7
    /dev/ttyUSB0?columns=x,y,z          a serial port alone, COM3 as well: serial:///dev/ttyUSB0?columns=x,y,z

A ``%`` with two hexadecimal digits stands for a byte, so a place or value may hold ``?`` (%3F), ``&`` (%26) and ``%``
(%25) itself.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from math import isfinite
from typing import NoReturn, TypeVar
from urllib.parse import unquote

from tiltcal.drivers.bus import BUSES
from tiltcal.errors import UsageError
from tiltcal.stated_arguments import require_text

R = TypeVar("R")
N = TypeVar("N", int, float)
_PORT = re.compile(r"/dev/(?!spi|i2c|gpio)|COM\d+(\?|$)")  # a serial port alone, which is an address of its own
_SCHEME = re.compile(r"[a-z][a-z0-9]*(\+[a-z][a-z0-9]*)*")
_INTEGER = re.compile(r"[+-]?(0[xX][0-9a-fA-F]+|[0-9]+)")
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
SCHEMES = (*BUSES, "sim")  # last part of every known scheme


@dataclass(frozen=True)
class Address:
    """One parsed address: as the user wrote it, its scheme, what it names, and its options in the order written.

    path: the device or file; for ``serial`` what pyserial opens; empty if the scheme needs none.
    """

    written: str
    scheme: str
    path: str
    options: dict[str, str] = field(default_factory=dict)

    def __str__(self) -> str:
        return self.written

    @property
    def simulated(self) -> bool:
        """Whether the address is that of a virtual twin."""
        return self.scheme == "sim"

    def allow(self, *names: str) -> None:
        """Refuse every option that is not among ``names``, with the nearest one that is."""
        for name in self.options:
            if name not in names:
                known = f"{self.scheme}: takes {', '.join(names)}" if names else f"{self.scheme}: takes no options"
                self.refuse(f"unknown option {name!r} ({_near(name, names) or known})")

    def text(self, name: str, default: str | None = None) -> str:
        """Return the text of an option, which without a default is required."""
        value = self.options.get(name, default)
        if value is None:
            self.refuse(f"option {name!r} is missing (add {'&' if self.options else '?'}{name}=...)")
        if name in self.options and not value:
            self.refuse(f"option {name!r} is empty")
        return value

    def integer(self, name: str, default: int | None = None, *, low: int | None = None, high: int | None = None) -> int:
        """Return a whole number within limits, decimal or hexadecimal (``0x1d``); without a default it is required."""
        if default is not None and name not in self.options:
            return default
        text = self.text(name)
        if not _INTEGER.fullmatch(text) or len(text) > 20:
            self.refuse(f"option {name}={text} is not a whole number")
        return self._bounded(name, int(text, 16 if "x" in text.lower() else 10), low, high)

    def number(
        self, name: str, default: float | None = None, *, low: float | None = None, high: float | None = None
    ) -> float:
        """Return a finite number within limits, such as ``4.98`` or ``5e-3``; without a default it is required."""
        if default is not None and name not in self.options:
            return default
        text = self.text(name)
        if not _NUMBER.fullmatch(text) or not isfinite(float(text)):
            self.refuse(f"option {name}={text} is not a finite number")
        return self._bounded(name, float(text), low, high)

    def choice(self, name: str, meanings: Mapping[str, R], default: R) -> R:
        """Return the meaning of the word that an option gives; one that is none of the words is refused."""
        if name not in self.options:
            return default
        word = self.text(name)
        if word not in meanings:
            self.refuse(f"option {name}={word} is not one of {', '.join(meanings)}")
        return meanings[word]

    def refuse(self, why: str) -> NoReturn:
        """Raise a UsageError that quotes the address."""
        _refuse(self.written, why)

    def _bounded(self, name: str, value: N, low: float | None, high: float | None) -> N:
        for wrong, why in (
            (low is not None and value < low, f"small (at least {low})"),
            (high is not None and value > high, f"large (at most {high})"),
        ):
            if wrong:
                self.refuse(f"option {name}={self.options[name]} is too {why}")
        return value


def parse_address(text: str) -> Address:
    """Parse an address; the bus that opens it checks the options.

    UsageError: the address is malformed.
    """
    require_text("address", text)
    if _PORT.match(text):
        return replace(parse_address(f"serial:{text}"), written=text)
    scheme, colon, rest = text.partition(":")
    if not colon:
        advice = f"did you mean 'spi://{text}'?" if text.startswith("/dev/spi") else "such as spi:///dev/spidev0.0"
        _refuse(text, f"no scheme before a colon ({advice})")
    if not _SCHEME.fullmatch(scheme) or scheme.rpartition("+")[2] not in SCHEMES:
        advice = _near(scheme, SCHEMES) or f"known: {', '.join(SCHEMES)}"
        _refuse(text, f"unknown scheme {scheme!r} ({advice})")
    if any(not character.isprintable() for character in unquote(text)):
        _refuse(text, "it contains a control character")
    place, question, query = rest.partition("?")
    if scheme == "sim" and not question and place:
        place, query = "", place
    return Address(text, scheme, _path(text, scheme, place), _options(text, query))


def _path(text: str, scheme: str, place: str) -> str:
    """Return the place without the empty authority of ``scheme:///path``."""
    if place.startswith("//") and not place.startswith("///"):
        host = place[2:].partition("/")[0]
        advice = f"{scheme}:///{place[2:]}" if scheme != "serial" else f"serial:{place[2:]}"
        _refuse(text, f"{host!r} after '//' names a host (did you mean {advice!r}?)")
    path = unquote(place.removeprefix("//"))
    if scheme == "sim" and path:
        _refuse(text, f"a simulated sensor has no place, only options (found {path!r})")
    if scheme != "sim" and not path:
        _refuse(text, f"no device after '{scheme}:'")
    return path


def _options(text: str, query: str) -> dict[str, str]:
    options: dict[str, str] = {}
    for part in query.split("&") if query else ():
        name, equals, value = part.partition("=")
        name = unquote(name)
        if not name or not equals:
            _refuse(text, f"option {part!r} is not of the form name=value")
        if name in options:
            _refuse(text, f"option {name!r} is given twice")
        options[name] = unquote(value)
    return options


def _near(name: str, names: Collection[str]) -> str | None:
    near = get_close_matches(name, names, n=1)
    return f"did you mean {near[0]!r}?" if near else None


def _refuse(text: str, why: str) -> NoReturn:
    raise UsageError(f"address {text!r}: {why}")

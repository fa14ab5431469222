"""Numbers with the digits that their uncertainty allows, aligned on the decimal point."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from decimal import Decimal
from math import isfinite

from tiltcal.core.rounding import bracketed, round_to_place

LABORATORY = 2
"""Digits of an uncertainty on the page (GUM, 7.2.6)."""

MINUS, TIMES = "−", " × 10"
SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_MOST_DECIMALS = 9
"""Largest number of digits before a power of ten is used."""


def measured(value: float, uncertainty: float | None, digits: int = 6) -> str:
    """Return a value with two digits of its standard uncertainty in brackets, a true minus, and powers of ten.

    Where it has none, it has this number of significant digits.
    """
    if uncertainty is None or not (isfinite(uncertainty) and uncertainty > 0.0 and isfinite(value)):
        return plain(value, digits)
    if Decimal(f"{uncertainty:.{LABORATORY - 1}e}").adjusted() - (LABORATORY - 1) >= -_MOST_DECIMALS:
        return signed(bracketed(value, uncertainty, LABORATORY))
    power = max(Decimal(abs(value)).adjusted(), Decimal(uncertainty).adjusted())
    mantissa = bracketed(value * 10.0**-power, uncertainty * 10.0**-power, LABORATORY)
    return signed(mantissa) + TIMES + str(power).translate(SUPERSCRIPT)


def plain(value: float, digits: int) -> str:
    """Return a number with this number of significant digits, in plain decimals where possible."""
    if not isfinite(value):
        return str(value)
    exact = Decimal(f"{value:.{digits - 1}e}")
    if exact and exact.adjusted() - digits < -2 * _MOST_DECIMALS:
        return signed(f"{exact.scaleb(-exact.adjusted()):f}") + TIMES + str(exact.adjusted()).translate(SUPERSCRIPT)
    text = f"{exact:f}"
    return signed(text.rstrip("0").rstrip(".") if "." in text else text)


def half_width(value: float) -> str:
    """Return half the width of an interval with two digits: ``0.28``, ``310``."""
    if not (isfinite(value) and value > 0.0):
        return ""
    rounded = Decimal(f"{value:.{LABORATORY - 1}e}")
    if rounded.adjusted() - (LABORATORY - 1) < -_MOST_DECIMALS:
        return f"{rounded.scaleb(-rounded.adjusted()):f}{TIMES}{str(rounded.adjusted()).translate(SUPERSCRIPT)}"
    return f"{rounded:f}" if rounded.adjusted() < LABORATORY else f"{rounded:.0f}"


def at_place(value: float, decimals: int) -> str:
    """Return a number with this number of decimals, without a minus before zeros."""
    return signed(round_to_place(value, -decimals))


def signed(text: str) -> str:
    """Return the text of a number with a minus sign as wide as a digit."""
    return text.replace("-", MINUS)


def grouped(count: int) -> str:
    """Return a count with thin spaces between thousands."""
    return f"{count:,}".replace(",", "\u202f")


@dataclass(frozen=True)
class AlignedNumber:
    """A number in a column: the part before its decimal point, and the rest.

    whole, rest: together the number's text.
    before, behind: characters that the widest number of the column has on either side.
    """

    whole: str
    rest: str
    before: int
    behind: int

    def __str__(self) -> str:
        return self.whole + self.rest


def column(texts: Iterable[str]) -> list[AlignedNumber]:
    """Return the numbers of a column, aligned on their decimal points."""
    parts = [_parted(text) for text in texts]
    before = max((len(whole) for whole, _ in parts), default=0)
    behind = max((len(rest) for _, rest in parts), default=0)
    return [AlignedNumber(whole, rest, before, behind) for whole, rest in parts]


def _parted(text: str) -> tuple[str, str]:
    """Return the place of the decimal point, or of the end of the digits."""
    for index, character in enumerate(text):
        if not (character.isdigit() or character in MINUS + "+± "):
            return text[:index], text[index:]
    return text, ""

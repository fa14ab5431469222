"""Numbers on a page: with the digits that their uncertainty allows, aligned on the decimal point."""

from __future__ import annotations

from collections.abc import Iterable
from decimal import Decimal
from html import escape
from math import floor, isfinite, log10

from tiltcal.core.rounding import bracketed, round_to_place

LABORATORY = 2
"""Digits of an uncertainty on the page (GUM, 7.2.6)."""

MINUS = "−"
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
    return signed(mantissa) + _power_of_ten(power)


def _power_of_ten(power: int) -> str:
    return f" × 10{str(power).translate(SUPERSCRIPT)}"


def plain(value: float, digits: int) -> str:
    """Return a number with this number of significant digits, in plain decimals where possible."""
    if not isfinite(value):
        return str(value)
    exact = Decimal(f"{value:.{digits - 1}e}")
    if exact and exact.adjusted() - digits < -2 * _MOST_DECIMALS:
        return signed(f"{exact.scaleb(-exact.adjusted()):f}") + _power_of_ten(exact.adjusted())
    text = f"{exact:f}"
    return signed(text.rstrip("0").rstrip(".") if "." in text else text)


def three_digits(values: Iterable[float]) -> int:
    """Return the number of decimals that gives the largest of some numbers three digits."""
    scale = max(map(abs, values), default=0.0)
    return min(max(2 - floor(log10(scale)), 0), 12) if scale > 0.0 else 2


def half_width(value: float) -> str:
    """Return half the width of an interval with two digits: ``0.28``, ``310``."""
    if not (isfinite(value) and value > 0.0):
        return ""
    rounded = Decimal(f"{value:.{LABORATORY - 1}e}")
    if rounded.adjusted() - (LABORATORY - 1) < -_MOST_DECIMALS:
        return f"{rounded.scaleb(-rounded.adjusted()):f}{_power_of_ten(rounded.adjusted())}"
    return f"{rounded:f}" if rounded.adjusted() < LABORATORY else f"{rounded:.0f}"


def at_place(value: float, decimals: int) -> str:
    """Return a number with this number of decimals, without a minus before zeros."""
    return signed(round_to_place(value, -decimals))


def at_place_if_stated(value: float | None, decimals: int) -> str:
    """Return a number with this number of decimals; nothing of one that is not stated or not finite."""
    return "" if value is None or not isfinite(value) else at_place(value, decimals)


def signed(text: str) -> str:
    """Return the text of a number with a minus sign as wide as a digit."""
    return text.replace("-", MINUS)


def grouped(count: int) -> str:
    """Return a count with thin spaces between thousands."""
    return f"{count:,}".replace(",", "\u202f")


class Html(str):
    """Text that is markup; whatever else a page is given is escaped."""

    def __html__(self) -> str:
        return self


def aligned(texts: Iterable[str]) -> list[Html]:
    """Return the numbers of a column, aligned on their decimal points."""
    parts = [_parted(text) for text in texts]
    before = max((len(whole) for whole, _ in parts), default=0)
    behind = max((len(rest) for _, rest in parts), default=0)
    return [
        Html(
            f'<span class="w" style="width:{before + 0.4}ch">{escape(whole)}</span>'
            f'<span class="r" style="width:{behind}ch">{escape(rest)}</span>'
        )
        for whole, rest in parts
    ]


def _parted(text: str) -> tuple[str, str]:
    """Return a number in two parts, at its decimal point or the end of its digits."""
    for index, character in enumerate(text):
        if not (character.isdigit() or character in MINUS + "+± "):
            return text[:index], text[index:]
    return text, ""

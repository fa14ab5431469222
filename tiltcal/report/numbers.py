"""Numbers on a page: with the digits that their uncertainty allows, aligned on the decimal point."""

from __future__ import annotations

from collections.abc import Iterable
from decimal import Decimal
from html import escape
from math import floor, isfinite, log10

from tiltcal.core.rounding import bracketed, round_to_place

LABORATORY = 2  # digits of an uncertainty on the page (GUM, 7.2.6)
MINUS = "−"
SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_MOST_DECIMALS = 9  # largest number of digits before a power of ten is used


def measured(value: float, uncertainty: float | None, digits: int = 6) -> str:
    """Return a value with two digits of its standard uncertainty in brackets, a true minus, and powers of ten.

    Where it has none, it has this number of significant digits.
    """
    if not uncertainty or not (isfinite(uncertainty) and isfinite(value)):
        return plain(value, digits)
    if Decimal(f"{uncertainty:.{LABORATORY - 1}e}").adjusted() - (LABORATORY - 1) >= -_MOST_DECIMALS:
        return signed(bracketed(value, uncertainty, LABORATORY))
    power = Decimal(max(abs(value), uncertainty)).adjusted()
    return _to_power(bracketed(value * 10.0**-power, uncertainty * 10.0**-power, LABORATORY), power)


def plain(value: float, digits: int) -> str:
    """Return a number with this number of significant digits, without zeros at its end."""
    number, times, power = _rounded(value, digits).partition(" × ")
    return (number.rstrip("0").rstrip(".") if "." in number else number) + times + power


def half_width(value: float) -> str:
    """Return half the width of an interval with two digits: ``0.28``, ``310``."""
    return _rounded(value, LABORATORY) if isfinite(value) and value > 0.0 else ""


def _rounded(value: float, digits: int) -> str:
    """Return a number with this number of significant digits, in plain decimals where they are not too many."""
    if not isfinite(value):
        return str(value)
    exact = Decimal(f"{value:.{digits - 1}e}")
    if not exact or exact.adjusted() - (digits - 1) >= -_MOST_DECIMALS:
        return signed(f"{exact:f}")
    power = exact.adjusted()
    return _to_power(f"{exact.scaleb(-power):f}", power)


def _to_power(mantissa: str, power: int) -> str:
    """Return a number with its power of ten, which is left out where it is 1."""
    return signed(mantissa) + (f" × 10{str(power).translate(SUPERSCRIPT)}" if power else "")


def three_digits(values: Iterable[float]) -> int:
    """Return the number of decimals that gives the largest of some numbers three digits."""
    scale = max(map(abs, values), default=0.0)
    return min(max(2 - floor(log10(scale)), 0), 12) if scale > 0.0 else 2


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

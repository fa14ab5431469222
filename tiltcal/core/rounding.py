"""Numbers with the digits that their uncertainty warrants, and none that only a binary fraction adds."""

from __future__ import annotations

from decimal import Context, Decimal
from math import ceil, floor, isfinite

_GUARD_DIGITS = 3  # digits kept after the first one of the uncertainty: rounding adds less than a thousandth of it
_DIGITS_WITHOUT_UNCERTAINTY = 12
_NO_DIGIT = 1e-6  # part of the last digit that a binary fraction may add
_ANY = Context(prec=1000)  # digits enough for any double
_MOST_ZEROS = 4  # largest number of zeros before the first digit; smaller numbers have a power of ten


def round_to(value: float, uncertainty: float) -> float:
    """Round a value so that its last digit is the fourth of its standard uncertainty; never to -0.0.

    Where the uncertainty is zero, negative or not finite, 12 significant digits are kept.
    """
    if not (isfinite(uncertainty) and uncertainty > 0.0):
        return significant(value, _DIGITS_WITHOUT_UNCERTAINTY)
    if not isfinite(value):
        return float(value)
    exact = Decimal(repr(float(value)))
    place = Decimal(repr(float(uncertainty))).adjusted() - _GUARD_DIGITS
    return _positive_zero(exact.quantize(Decimal((0, (1,), place)), context=_ANY))


def outwards(low: float, high: float, digits: int, step: float = 0.0) -> tuple[float, float]:
    """Return a range that a reading of some step met, rounded so that it holds what reads alike."""
    scale = 10.0**digits
    return floor((low - step / 2.0) * scale + _NO_DIGIT) / scale, ceil((high + step / 2.0) * scale - _NO_DIGIT) / scale


def significant(value: float, digits: int) -> float:
    """Round a value to so many significant decimal digits, 1 or more; never -0.0."""
    if not isfinite(value):
        return float(value)
    return _positive_zero(Context(prec=digits).create_decimal(repr(float(value))))


def bracketed(value: float, uncertainty: float, digits: int = 1) -> str:
    """Return a value with so many ``digits`` of its standard uncertainty in units of its last digit: ``3.3830(3)``.

    Without an uncertainty (zero, or not finite) the value has six digits and no brackets.
    """
    if not (isfinite(uncertainty) and uncertainty > 0.0 and isfinite(value)):
        return f"{value:.6g}"
    rounded = Decimal(f"{uncertainty:.{digits - 1}e}")
    place = rounded.adjusted() - (digits - 1)
    return f"{round_to_place(value, place)}({int(rounded if place > 0 else rounded.scaleb(-place))})"


def plus_minus(value: float, uncertainty: float | None, *, signed: bool = False) -> str:
    """Return a value and its uncertainty with two digits of the uncertainty (GUM, 7.2.6): ``1020.68 ± 0.42``.

    Two small numbers share a power of ten: ``(2.10 ± 0.34)e-6``. Without an uncertainty (zero, or not finite) the value
    has six digits. Where ``signed``, a value above zero has a plus.
    """
    plus = "+" if signed and value > 0.0 else ""
    if not uncertainty or not (isfinite(uncertainty) and isfinite(value)):
        return f"{plus}{value:.6g} ± {uncertainty or 0.0:.2g}"
    power = max(Decimal(number).adjusted() for number in (value, uncertainty) if number)
    if power < -_MOST_ZEROS:
        return f"({plus_minus(value * 10.0**-power, uncertainty * 10.0**-power, signed=signed)})e{power}"
    place = Decimal(f"{uncertainty:.1e}").adjusted() - 1
    return f"{plus}{round_to_place(value, place)} ± {round_to_place(uncertainty, place)}"


def round_to_place(value: float, place: int) -> str:
    """Return a number in plain decimals, rounded to this power of ten; without a minus before zeros."""
    shown = f"{Decimal(value).quantize(Decimal((0, (1,), place)), context=_ANY):f}"
    return shown if any(digit in shown for digit in "123456789") else shown.lstrip("-")


def _positive_zero(number: Decimal) -> float:
    return float(number) + 0.0

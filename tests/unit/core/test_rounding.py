"""Numbers are written with the digits that their uncertainty warrants."""

from math import copysign, floor, inf, log10, nan

from hypothesis import given
from hypothesis import strategies as st

from tiltcal.core.rounding import bracketed, outwards, plus_minus, round_to, significant


def test_last_digit_is_the_fourth_of_the_uncertainty_or_one_of_so_many() -> None:
    for value, uncertainty, rounded in (
        (1024.6123456, 0.08, 1024.61235),  # the last digit at 10**(-2 - 3)
        (818.2049, 9.99, 818.205),
        (123456.0, 20000.0, 123460.0),
        (2.5e-9, 1e-10, 2.5e-9),
        (1.0 / 3.0, 0.0, 0.333333333333),
        (2.0 / 3.0, nan, 0.666666666667),
        (inf, 1.0, inf),
    ):
        assert round_to(value, uncertainty) == rounded, (value, uncertainty)
    for value, digits, rounded in ((1234.5678, 6, 1234.57), (-0.0, 3, 0.0), (1e22 / 3, 3, 3.33e21), (-inf, 3, -inf)):
        assert significant(value, digits) == rounded
    for low, high, digits, step, found in (
        (1.2345, 1.2355, 3, 0.0, (1.234, 1.236)),
        (0.1 + 0.2, 0.7 + 0.1, 1, 0.0, (0.3, 0.8)),  # by what binary digits add
        (5.0, 24.0, 1, 0.5, (4.7, 24.3)),
    ):
        assert outwards(low, high, digits, step) == found


@given(st.floats(-1e12, 1e12), st.floats(1e-15, 1e12))
def test_rounding_moves_by_less_than_a_thousandth_of_the_uncertainty(value: float, uncertainty: float) -> None:
    rounded = round_to(value, uncertainty)
    assert abs(rounded - value) <= 0.5001e-3 * 10 ** floor(log10(uncertainty) + 1e-12) + 1e-15 * abs(value)
    assert round_to(rounded, uncertainty) == rounded
    assert rounded != 0.0 or copysign(1.0, rounded) == 1.0


def test_a_value_has_the_decimals_of_its_uncertainty() -> None:
    for value, uncertainty, shown in (
        (100.02147, 0.00035, "100.02147 ± 0.00035"),  # the mass of GUM 7.2.2, in g
        (10.0572123, 0.0274, "10.057 ± 0.027"),  # the resistance of GUM 7.2.6, in ohm
        (-0.0012, 0.42, "0.00 ± 0.42"),
        (12.0, 0.996, "12.0 ± 1.0"),
        (123456.0, 2340.0, "123500 ± 2300"),
        (2.1e-6, 3.44e-7, "(2.10 ± 0.34)e-6"),
        (0.0, 3.44e-7, "(0.0 ± 3.4)e-7"),
        (0.3333333333, 0.0, "0.333333 ± 0"),
        (2.0**120, 34.0, "1329227995784915872903807060280344576 ± 34"),
    ):
        assert plus_minus(value, uncertainty) == shown
    assert plus_minus(0.0012, 0.00042, signed=True) == "+0.00120 ± 0.00042"
    assert plus_minus(-3.0, 0.4, signed=True) == "-3.00 ± 0.40"
    assert plus_minus(2.1e-6, 3.44e-7, signed=True) == "(+2.10 ± 0.34)e-6"


def test_one_digit_of_uncertainty_by_hand() -> None:
    for value, uncertainty, text in (
        (3.38301, 3e-4, "3.3830(3)"),
        (-0.0747, 2.6e-4, "-0.0747(3)"),
        (-0.00001, 2e-4, "0.0000(2)"),
        (0.99996, 9.6e-4, "1.000(1)"),
        (1234.5, 20.0, "1230(20)"),
        (-0.010207148, 8.9e-7, "-0.0102071(9)"),
        (0.5, 0.0, "0.5"),
        (0.5, float("inf"), "0.5"),
    ):
        assert bracketed(value, uncertainty) == text

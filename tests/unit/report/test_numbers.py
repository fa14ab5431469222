"""Numbers on the page, against those that the guides print."""

from __future__ import annotations

import re

import pytest

from tiltcal.core.rounding import bracketed
from tiltcal.report.numbers import aligned, at_place, grouped, half_width, measured, plain


@pytest.mark.parametrize(
    ("value", "u", "text"),
    [
        (100.02147, 0.00035, "100.02147(35)"),  # GUM, 7.2.2
        (6.67430e-11, 0.00015e-11, "6.67430(15) × 10⁻¹¹"),  # CODATA 2018, G
        (-1026.2672, 0.101, "−1026.27(10)"),
        (819.0, 2.364, "819.0(24)"),
        (1234.5, 23.4, "1234(23)"),
        (1234.5, 234.0, "1230(230)"),
        (-0.0011728, 0.0003494, "−0.00117(35)"),
        (-0.00001, 0.0021, "0.0000(21)"),
        (0.9996, 0.00996, "1.000(10)"),
        (24.0, 0.0, "24"),
        (-0.5, float("inf"), "−0.5"),
    ],
)
def test_two_digits_of_uncertainty(value: float, u: float, text: str) -> None:
    assert measured(value, u) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.2756, "0.28"), (1.0, "1.0"), (9.96, "10"), (31.4, "31"), (314.0, "310"), (1e-12, "1.0 × 10⁻¹²"), (0.0, "")],
)
def test_half_widths(value: float, text: str) -> None:
    assert half_width(value) == text


@pytest.mark.parametrize(
    ("value", "digits", "text"), [(0.26, 2, "0.26"), (2e-9, 2, "0.000000002"), (-1500.0, 2, "−1500"), (0.0, 4, "0")]
)
def test_plain(value: float, digits: int, text: str) -> None:
    assert plain(value, digits) == text


def test_no_minus_in_front_of_nothing() -> None:
    assert at_place(-0.0004, 3) == "0.000"
    assert at_place(-0.0006, 3) == "−0.001"


def test_thousands_are_parted() -> None:
    assert grouped(10_000_000) == "10\u202f000\u202f000"
    assert bracketed(1.5, 0.25, 2) == "1.50(25)"


def test_a_column_is_aligned_on_its_points() -> None:
    cells = aligned(["1026.12(75)", "−7.9", "3", "", "0.2(1) × 10⁻³"])
    parts = [re.fullmatch(r'<span .*width:4.4ch">(.*)</span><span .*width:12ch">(.*)</span>', cell) for cell in cells]
    assert [part[1] for part in parts if part] == ["1026", "−7", "3", "", "0"]
    assert [part[2] for part in parts if part] == [".12(75)", ".9", "", "", ".2(1) × 10⁻³"]

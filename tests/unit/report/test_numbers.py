"""Numbers on the page, against those that the guides print."""

import re
from math import inf

from tiltcal.report.numbers import aligned, at_place, at_place_if_stated, grouped, half_width, measured, plain


def test_two_digits_of_uncertainty() -> None:
    for value, u, text in (
        (100.02147, 0.00035, "100.02147(35)"),  # GUM, 7.2.2
        (6.67430e-11, 0.00015e-11, "6.67430(15) × 10⁻¹¹"),  # CODATA 2018, G
        (0.0, 1.3e-10, "0.0(13) × 10⁻¹⁰"),  # what matching leaves
        (-1026.2672, 0.101, "−1026.27(10)"),
        (819.0, 2.364, "819.0(24)"),
        (1234.5, 234.0, "1230(230)"),
        (-0.00001, 0.0021, "0.0000(21)"),
        (0.9996, 0.00996, "1.000(10)"),
        (1.2345678912, 1.2e-8, "1.234567891(12)"),
        (0.0012345678912, 1.2e-9, "1.2345679(12) × 10⁻³"),
        (1.2345678912, 1.2e-9, "1.2345678912(12)"),
        (24.0, 0.0, "24"),
        (-0.5, float("inf"), "−0.5"),
        (float("inf"), 0.1, "inf"),
    ):
        assert measured(value, u) == text


def test_half_widths_plain_numbers_and_counts() -> None:
    widths = (0.2756, "0.28"), (1.0, "1.0"), (9.96, "10"), (314.0, "310"), (1e-12, "1.0 × 10⁻¹²"), (0.0, "")
    for value, text in widths:
        assert half_width(value) == text
    for value, digits, text in (
        (0.26, 2, "0.26"),
        (1.2e-8, 2, "0.000000012"),
        (1.2e-9, 2, "1.2 × 10⁻⁹"),
        (2e-9, 2, "2 × 10⁻⁹"),
        (-1500.0, 2, "−1500"),
        (0.0, 4, "0"),
    ):
        assert plain(value, digits) == text
    assert (at_place(-0.0004, 3), at_place(-0.0006, 3)) == ("0.000", "−0.001")
    assert [at_place_if_stated(value, 2) for value in (-1.5, None, inf)] == ["−1.50", "", ""]
    assert grouped(10_000_000) == "10\u202f000\u202f000"


def test_a_column_is_aligned_on_its_points() -> None:
    cells = aligned(["1026.12(75)", "−7.9", "3", "", "0.2(1) × 10⁻³"])
    parts = [re.fullmatch(r'<span .*width:4.4ch">(.*)</span><span .*width:12ch">(.*)</span>', cell) for cell in cells]
    assert [part[1] for part in parts if part] == ["1026", "−7", "3", "", "0"]
    assert [part[2] for part in parts if part] == [".12(75)", ".9", "", "", ".2(1) × 10⁻³"]

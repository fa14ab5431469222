"""Figures as a reader sees them."""

from __future__ import annotations

import pytest

from tiltcal.report.figure import in_characters


@pytest.mark.parametrize(
    ("mathematics", "characters"),
    [
        (r"$\mathdefault{10^{-3}}$", "10⁻³"),
        (r"$\mathdefault{4\times10^{-12}}$", "4×10⁻¹²"),
        (r"$\mathdefault{10^{0}}$", "10⁰"),
        (r"$\mathdefault{-10^{1}}$", "-10¹"),
        ("0.5", "0.5"),
        ("", ""),
    ],
)
def test_a_label_of_a_logarithmic_axis_is_written_in_characters(mathematics: str, characters: str) -> None:
    """matplotlib writes these as mathematics, which stays as it is in our figures."""
    assert in_characters(mathematics) == characters

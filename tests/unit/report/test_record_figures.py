"""The source's Table 1 and figure 6."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiltcal.calibration.wording import pair_summary
from tiltcal.core.pair.demodulate import Demodulation, demodulate
from tiltcal.core.pair.matching import match
from tiltcal.core.pair.model import Pair
from tiltcal.core.rounding import bracketed
from tiltcal.report.record_figures import PairDrawing, draw_matching


def test_one_digit_of_uncertainty_by_hand() -> None:
    for value, uncertainty, text in (
        (3.38301, 3e-4, "3.3830(3)"),
        (-0.0747, 2.6e-4, "-0.0747(3)"),
        (-0.00001, 2e-4, "0.0000(2)"),
        (1.23456, 9.6e-4, "1.235(1)"),
        (0.99996, 1e-4, "1.0000(1)"),
        (1234.5, 20.0, "1230(20)"),
        (-0.010207148, 8.9e-7, "-0.0102071(9)"),
        (0.5, 0.0, "0.5"),
        (0.5, float("inf"), "0.5"),
    ):
        assert bracketed(value, uncertainty) == text


@given(st.floats(-1e6, 1e6), st.floats(1e-9, 1e4))
def test_what_is_printed_is_the_value_within_its_uncertainty(value: float, uncertainty: float) -> None:
    number, digit = bracketed(value, uncertainty).removesuffix(")").split("(")
    decimals = len(number.partition(".")[2])
    assert float(digit) * 10.0**-decimals == pytest.approx(uncertainty, rel=0.5)
    assert abs(float(number) - value) <= 0.51 * uncertainty * 2


def table_1_record() -> Demodulation:
    """Components of the "before matching" columns of Table 1, with noise that a1 and a2 have partly in common.

    In the table a1 and a2 are uncertain by 3e-4 and their sum by 2e-4 only: most of what moves them is the common
    acceleration. 2e-4² = 2 own², 3e-4² = own² + shared².
    """
    n, turns = 4096, 64
    own, shared = (np.sqrt(variance * n / 2) for variance in (2e-8, 7e-8))
    angle = turns * np.arange(n) / n
    draw = np.random.default_rng(1)
    phase = 2 * np.pi * angle
    basis = np.stack([np.sin(phase), np.cos(phase), np.ones(n)], axis=1)

    def noise(size: float) -> np.ndarray:
        """Noise that happens to have no component at the turning, so that the digits are those of the table."""
        drawn = draw.standard_normal(n)
        return size * (drawn - basis @ np.linalg.lstsq(basis, drawn, rcond=None)[0])

    common = noise(shared)
    a1 = 3.3830 * np.sin(phase) - 0.0747 * np.cos(phase) + common + noise(own)
    a2 = -3.4150 * np.sin(phase) + 0.0753 * np.cos(phase) - common + noise(own)
    a4 = 0.04 * np.sin(phase) - 3.39 * np.cos(phase) + noise(own)
    return demodulate(("a1", "a2", "a4"), angle, [a1, a2, a4])


def test_a_record_of_table_1_reads_as_table_1_does() -> None:
    """The table's own sum, -0.0322, is not that of its a1 and a2, which is -0.0320: the authors fitted it apart."""
    _, *lines, _, _ = pair_summary(match(table_1_record(), Pair("a1", "a2", "a4"))).splitlines()
    before = {line[:9].strip(): line[9:].split()[:2] for line in lines[2:]}
    assert before["a1"] == ["3.3830(3)", "-0.0747(3)"]
    assert before["a2"] == ["-3.4150(3)", "0.0753(3)"]
    assert before["a1 + a2"] == ["-0.0320(2)", "0.0006(2)"]
    assert lines[4].split()[-2:] == ["0.0000(2)", "0.0000(2)"]


def test_the_figure_has_every_curve_and_both_estimators(tmp_path: Path) -> None:
    densities = {name: np.full(200, 1e-6) for name in ("a1", "sum after p", "sum after p and q")}
    course = [(0.01 / k, 0.02 / k, 0.01, 0.02) for k in (1.0, 2.0, 3.0)]
    drawing = PairDrawing(np.linspace(0.0, 25.0, 200), densities, 0.0025, "1/row", course, 1e-3)
    draw_matching(tmp_path / "both.svg", drawing)
    drawn = (tmp_path / "both.svg").read_text(encoding="utf-8")
    ElementTree.fromstring(drawn)
    for text in (*densities, "frequency [1/row]", "p, loops", "q, recursive", "stated uncertainty", "turns"):
        assert text in drawn

"""A bent characteristic: taken out by the kernel, written and read, refused where a reading has several angles."""

from __future__ import annotations

from math import asin, degrees

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tiltcal.core.compensation import Compensation
from tiltcal.core.model import Coefficients
from tiltcal.errors import InputError
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity, dump_calibration, tilt_record
from tiltcal.files.document import parse_document


def part(terms: list[list[float]]) -> Coefficients:
    return Coefficients(
        ("x", "y"),
        ("x", "y"),
        np.array([1026.0, 1019.0]),
        np.array([[817.0, 12.0], [-9.0, 822.0]]),
        nonlinearity=np.array(terms),
    )


def reading(g_x: float, g_y: float, terms: list[list[float]]) -> list[float]:
    """Written out by hand: the signal of each channel, bent by its own square and cube."""
    s_x, s_y = 817.0 * g_x + 12.0 * g_y, -9.0 * g_x + 822.0 * g_y
    a_x, a_y = s_x / 817.0, s_y / 822.0
    bend = [terms[0][0] * a_x**2 + terms[0][1] * a_x**3, terms[1][0] * a_y**2 + terms[1][1] * a_y**3]
    return [1026.0 + s_x + 817.0 * bend[0], 1019.0 + s_y + 822.0 * bend[1]]


terms = st.lists(st.lists(st.floats(-0.03, 0.03), min_size=2, max_size=2), min_size=2, max_size=2)


@given(terms, st.floats(-0.7, 0.7), st.floats(-0.7, 0.7))
def test_the_kernel_takes_the_bend_out(bends: list[list[float]], g_x: float, g_y: float) -> None:
    found = Compensation(part(bends))(np.array([reading(g_x, g_y, bends)]))
    assert found.tilt[0] == pytest.approx([degrees(asin(g_x)), degrees(asin(g_y))], abs=1e-6)


@pytest.mark.parametrize("bad", [[[0.6, 0.0]], [[0.0, -0.4]], [[1.5, 0.7]]])
def test_a_reading_with_several_angles_is_refused(bad: list[list[float]]) -> None:
    text = dump_calibration(CalibrationRecord(SensorIdentity("m", "s", "V", ("x",)), _single(bad)))
    with pytest.raises(InputError, match=r"calibration\.nonlinearity"):
        tilt_record(parse_document(text))


def _single(terms: list[list[float]]) -> Coefficients:
    return Coefficients(("x",), ("x",), np.array([2.5]), np.array([[2.0]]), nonlinearity=np.array(terms))

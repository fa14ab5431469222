"""The formulas of the source documents, on examples worked by hand."""

from math import degrees, isnan, pi, radians, sin

import numpy as np
import pytest

from tiltcal.core import closed_forms as forms

THIRTY = pi / 6  # its sine is one half, which keeps the arithmetic below to what a pencil can do


def test_cross_axis_compensation() -> None:
    """A SCA100T of 2 V/g at 2.5 V: 3.5 V at +30°, 1.5 V at -30°, 4.5 V and 0.5 V straight up and down."""
    # 2.5 + 2 sin 30° = 3.5 V up, 2.5 - 2 sin 90° = 0.5 V down: 3 V over 1.5 g.
    assert forms.sensitivity_from_pair(3.5, 0.5, THIRTY, pi / 2) == pytest.approx(2.0, rel=1e-15)
    assert forms.offset_from_pair(3.5, 0.5, THIRTY, pi / 2) == pytest.approx(2.5, rel=1e-15)
    # Six positions at ±90°: S_X = 2, S_Y = 0.06, S_Z = 0.08 V/g; sqrt(0.0036 + 0.0064) = 0.1; 0.1 / 2 = 5 %.
    pairs = ((4.5, 0.5), (2.56, 2.44), (2.58, 2.42))
    sensitivities = (forms.sensitivity_from_upright_pair(*pair) for pair in pairs)
    assert forms.cross_axis_sensitivity(*sensitivities) == pytest.approx(5.0, rel=1e-12)
    assert degrees(forms.tilt_from_channel(3.5, 2.5, 2.0)) == pytest.approx(30.0, abs=1e-12)
    assert all(isnan(forms.tilt_from_channel(reading, 2.5, 2.0)) for reading in (4.500001, 0.499999, float("nan")))


def test_equations_5_and_6_take_a_minus() -> None:
    """S_XY = 0.04 V/g, S_XX = 2 V/g, g_y = 0.4: the document's plus doubles the error, the minus removes it."""
    u_x, u_y = 2.5 + np.array([[2.0, 0.04], [-0.04, 2.0]]) @ (0.25, 0.4)
    minus = forms.first_order_compensation(u_x, u_y, 2.5, 0.04, 2.0)
    errors = [abs((reading - 2.5) / 2.0 - 0.25) for reading in (u_x, 2 * u_x - minus, minus)]
    assert errors == pytest.approx([0.0080, 0.0159, 0.0001], abs=5e-5)
    tilt = forms.tilt_from_channel(u_y, 2.5, 2.0)
    assert forms.first_order_compensation_from_tilt(u_x, tilt, 0.04) == pytest.approx(minus, rel=1e-14)


def test_the_tilt_meter() -> None:
    """An ADXL202 of 500 mV/g, 2500 mV level at 0 °C and +10 mV/°C."""
    angle = radians(45.3)
    assert forms.scale_from_tilt(2500.0 + 500.0 * sin(angle), 2500.0, angle) == pytest.approx(500.0, rel=1e-14)
    assert forms.tempco_from_two_temperatures(2740.0, 2555.0, 24.0, 5.5) == 10.0
    assert degrees(forms.referenced_tilt(2990.0, 24.0, 2500.0, 500.0, 10.0, 0.0)) == pytest.approx(30.0)
    assert degrees(forms.referenced_tilt(2700.0, 15.0, 2500.0, 500.0, 10.0, 20.0)) == pytest.approx(30.0)
    assert isnan(forms.referenced_tilt(3001.0, 0.0, 2500.0, 500.0, 10.0, 0.0))

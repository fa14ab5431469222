"""The formulas of the source documents, on examples worked by hand."""

from __future__ import annotations

from math import degrees, isnan, pi, radians, sin

import numpy as np
import pytest

from tiltcal.core.closed_forms import (
    cross_axis_sensitivity,
    first_order_compensation,
    first_order_compensation_from_tilt,
    offset_from_pair,
    referenced_tilt,
    scale_from_tilt,
    sensitivity_from_pair,
    sensitivity_from_upright_pair,
    tempco_from_two_temperatures,
    tilt_from_channel,
)
from tiltcal.errors import EstimateError

THIRTY = pi / 6  # its sine is one half, which keeps the arithmetic below to what a pencil can do


class TestCrossAxisDocument:
    """A SCA100T of 2 V/g at 2.5 V: 3.5 V at +30°, 1.5 V at -30°, 4.5 V and 0.5 V straight up and down."""

    def test_eq_2_takes_the_magnitudes_of_two_different_tilts(self) -> None:
        # 2.5 + 2 sin 30° = 3.5 V up, 2.5 - 2 sin 90° = 0.5 V down: 3 V over 1.5 g.
        assert sensitivity_from_pair(3.5, 0.5, THIRTY, pi / 2) == pytest.approx(2.0, rel=1e-15)

    def test_the_offset_that_goes_with_eq_2_and_eq_3(self) -> None:
        assert offset_from_pair(3.5, 0.5, THIRTY, pi / 2) == pytest.approx(2.5, rel=1e-15)
        assert offset_from_pair(4.5, 0.5, pi / 2, pi / 2) == 2.5

    def test_eq_1_in_percent(self) -> None:
        # Six positions at ±90°: S_X = 2, S_Y = 0.06, S_Z = 0.08 V/g; sqrt(0.0036 + 0.0064) = 0.1; 0.1 / 2 = 5 %.
        s_x = sensitivity_from_upright_pair(4.5, 0.5)
        s_y = sensitivity_from_upright_pair(2.56, 2.44)
        s_z = sensitivity_from_upright_pair(2.58, 2.42)
        assert cross_axis_sensitivity(s_x, s_y, s_z) == pytest.approx(5.0, rel=1e-12)

    def test_eq_4(self) -> None:
        assert degrees(tilt_from_channel(3.5, 2.5, 2.0)) == pytest.approx(30.0, abs=1e-12)

    @pytest.mark.parametrize("reading", [4.500001, 0.499999, float("nan")])
    def test_eq_4_traps_an_argument_that_no_tilt_explains(self, reading: float) -> None:
        assert isnan(tilt_from_channel(reading, 2.5, 2.0))

    @pytest.mark.parametrize(("tilt1", "tilt2"), [(0.0, 0.0), (-THIRTY, THIRTY), (THIRTY, 2.0)])
    def test_eq_2_refuses_what_are_no_magnitudes(self, tilt1: float, tilt2: float) -> None:
        with pytest.raises(EstimateError):
            sensitivity_from_pair(3.5, 1.5, tilt1, tilt2)


class TestSignOfEquations5And6:
    """S_XY = 0.04 V/g, S_XX = 2 V/g, g_y = 0.4: the document's plus doubles the error, the minus removes it."""

    G_X, G_Y = 0.25, 0.4
    S = np.array([[2.0, 0.04], [-0.04, 2.0]])
    OFFSET = np.array([2.5, 2.5])
    U_X, U_Y = OFFSET + S @ (G_X, G_Y)

    def error(self, reading_x: float) -> float:
        return abs((reading_x - 2.5) / 2.0 - self.G_X)

    def test_the_three_errors(self) -> None:
        minus = first_order_compensation(self.U_X, self.U_Y, 2.5, 0.04, 2.0)
        plus = 2 * self.U_X - minus
        assert self.error(self.U_X) == pytest.approx(0.0080, abs=5e-5)
        assert self.error(plus) == pytest.approx(0.0159, abs=5e-5)
        assert self.error(minus) == pytest.approx(0.0001, abs=5e-5)

    def test_eq_5_is_eq_6_by_way_of_the_angle(self) -> None:
        by_angle = first_order_compensation_from_tilt(self.U_X, tilt_from_channel(self.U_Y, 2.5, 2.0), 0.04)
        assert by_angle == pytest.approx(first_order_compensation(self.U_X, self.U_Y, 2.5, 0.04, 2.0), rel=1e-14)


class TestTiltMeterPaper:
    """An ADXL202 of 500 mV/g, 2500 mV level at 0 °C and +10 mV/°C."""

    def test_the_scale_is_the_difference_over_the_sine_of_the_angle_set(self) -> None:
        set_angle = radians(45.3)
        assert scale_from_tilt(2500.0 + 500.0 * sin(set_angle), 2500.0, set_angle) == pytest.approx(500.0, rel=1e-14)

    def test_the_temperature_coefficient_from_24_and_5_5_degrees(self) -> None:
        assert tempco_from_two_temperatures(2740.0, 2555.0, 24.0, 5.5) == 10.0

    def test_the_arcsine_is_trapped(self) -> None:
        assert isnan(referenced_tilt(3001.0, 0.0, 2500.0, 500.0, 10.0))

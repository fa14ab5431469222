"""The filter from the thermometer to the sensing element, against the differential equation."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tiltcal.core.thermal_lag import ThermalLag


def chamber(seconds):
    """A chamber that goes from 5 to 25 °C and back in 2000 s each way."""
    return 5.0 + 20.0 * np.abs((seconds / 2000.0 + 1.0) % 2.0 - 1.0)


TIMES = np.sort(np.random.default_rng(3).uniform(0.0, 6000.0, 3000))
SECONDS = TIMES[(TIMES < 1500.0) | (TIMES > 1600.0)]
"""Irregular, with a gap of 100 s."""


def test_the_element_follows_the_differential_equation():
    span, exact = (SECONDS[0], SECONDS[-1]), {"t_eval": SECONDS, "max_step": 20.0, "rtol": 1e-8, "atol": 1e-8}
    delayed = solve_ivp(lambda t, e: (chamber(t) - e) / 120.0, span, [chamber(span[0])], **exact).y[0]
    assert np.max(np.abs(ThermalLag(120.0)(SECONDS, chamber(SECONDS)) - delayed)) < 0.005
    # The smoothed derivative is wrong for a moment after each turn; on the ramps it is exact.
    error = ThermalLag(-120.0)(SECONDS, delayed) - chamber(SECONDS)
    assert np.sqrt(np.mean(error**2)) < np.sqrt(np.mean((delayed - chamber(SECONDS)) ** 2)) / 10
    assert np.abs(error[(SECONDS % 2000.0 > 1500.0) & (SECONDS > 1500.0)]).max() < 2e-3


@pytest.mark.parametrize("lag", [120.0, -120.0, 0.0])
def test_blocks_of_rows_continue_each_other_over_missing_rows_and_begin_anew_where_time_goes_back(lag):
    whole, stream = ThermalLag(lag)(SECONDS, chamber(SECONDS)), ThermalLag(lag)
    parts = [stream(SECONDS[a:b], chamber(SECONDS[a:b])) for a, b in pairwise([0, 1, 2, 700, 701, 2900, len(SECONDS)])]
    assert np.concatenate(parts) == pytest.approx(whole, abs=1e-9)
    times, warm = np.array([0.0, 60.0, 90.0, 120.0, 0.0, 60.0]), np.array([0.0, 10.0, np.nan, 20.0, 50.0, 50.0])
    found = ThermalLag(lag)(times, warm)
    assert np.isnan(found).tolist() == [False, False, True, False, False, False]
    assert found[3:] == pytest.approx([*ThermalLag(lag)(times[[0, 1, 3]], warm[[0, 1, 3]])[2:], 50.0, 50.0])

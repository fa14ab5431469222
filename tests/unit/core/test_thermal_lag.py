"""The filter from the thermometer to the sensing element, against the differential equation."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tiltcal.core.thermal_lag import ThermalLag


def chamber(seconds):
    """A chamber that goes from 5 to 25 °C and back in 2000 s each way."""
    return 5.0 + 20.0 * np.abs((seconds / 2000.0 + 1.0) % 2.0 - 1.0)


@pytest.fixture(scope="module")
def seconds():
    """Irregular times, with a gap of 100 s."""
    times = np.sort(np.random.default_rng(3).uniform(0.0, 6000.0, 3000))
    return times[(times < 1500.0) | (times > 1600.0)]


@pytest.fixture(scope="module")
def delayed(seconds):
    """The solution of 120 s dE/dt + E = chamber."""
    span, start = (seconds[0], seconds[-1]), [chamber(seconds[0])]
    settings = {"t_eval": seconds, "max_step": 20.0, "rtol": 1e-8, "atol": 1e-8}
    return solve_ivp(lambda t, e: (chamber(t) - e) / 120.0, span, start, **settings).y[0]


def test_the_element_follows_the_differential_equation(seconds, delayed):
    assert np.max(np.abs(ThermalLag(120.0)(seconds, chamber(seconds)) - delayed)) < 0.005
    error = ThermalLag(-120.0)(seconds, delayed) - chamber(seconds)
    # The smoothed derivative is wrong for a moment after each turn.
    assert np.sqrt(np.mean(error**2)) < np.sqrt(np.mean((delayed - chamber(seconds)) ** 2)) / 10


@pytest.mark.parametrize("lag", [120.0, -120.0])
def test_blocks_of_rows_continue_each_other(seconds, lag):
    whole, stream = ThermalLag(lag)(seconds, chamber(seconds)), ThermalLag(lag)
    parts = [stream(seconds[a:b], chamber(seconds[a:b])) for a, b in pairwise([0, 1, 2, 700, 701, 2900, len(seconds)])]
    assert np.concatenate(parts) == pytest.approx(whole, abs=1e-9)


def test_a_missing_row_and_time_that_goes_back():
    element = ThermalLag(10.0)(np.arange(5.0), np.array([20.0, 20.0, np.nan, 20.0, 20.0]))
    assert element == pytest.approx([20.0, 20.0, np.nan, 20.0, 20.0], nan_ok=True)
    back = ThermalLag(100.0)(np.array([0.0, 60.0, 120.0, 0.0, 60.0]), np.array([0.0, 10.0, 20.0, 50.0, 50.0]))
    assert back[3:] == pytest.approx([50.0, 50.0])

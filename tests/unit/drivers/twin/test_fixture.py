"""The virtual chamber, and what follows it, against the differential equation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.twin.fixture import Fixture, _rotated

LEVEL = (0.0, 0.0, 1.0)


@pytest.mark.parametrize(("pace", "constant"), [(2.0, 0.0), (0.0, 200.0), (0.0, 90.0)])
def test_what_follows_the_chamber_obeys_its_differential_equation(pace, constant):
    clock = VirtualClock()
    fixture = Fixture(clock, ambient=20.0, time_constant=constant)
    seconds = np.arange(0.0, 2000.0, 20.0)
    chamber, element = [], []
    for now in seconds:
        clock.seek(round(now * 1e9))
        if now == 100.0:
            fixture.move(LEVEL, 40.0, pace)
        if now == 1200.0:
            fixture.move(LEVEL, 10.0, pace)
        chamber.append(fixture.temperature())
        element.append(fixture.temperature(90.0))

    def slope(t, e):
        return (np.interp(t, seconds, chamber) - e) / 90.0

    found = solve_ivp(slope, (0.0, 1980.0), [20.0], t_eval=seconds, max_step=5.0, rtol=1e-8).y[0]
    assert element == pytest.approx(found, abs=0.05)
    if pace:
        assert chamber[20] == pytest.approx(20.0 + 2.0 * 300.0 / 60.0)


def test_angles_are_turned_about_x_then_y_then_z():
    """As scipy has it, whose lower-case letters are rotations about axes that stay."""
    angles, up = [0.3, -0.2, 0.7], (0.48, -0.6, 0.64)
    assert _rotated(up, angles) == pytest.approx(Rotation.from_euler("xyz", angles).apply(up))


def test_without_a_lag_it_has_the_temperature_of_the_chamber():
    fixture = Fixture(VirtualClock(), ambient=21.5)
    assert fixture.temperature(60.0) == fixture.temperature() == 21.5

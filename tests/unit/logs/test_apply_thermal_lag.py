"""A calibration with a thermal lag, applied to logs."""

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from support import FIXTURES

from tiltcal.errors import InputError
from tiltcal.library.calibration import Calibration, read
from tiltcal.library.recorded import apply_log
from tiltcal.logs.kernel import RoleValues, with_lag

LAG = 120.0
SECONDS = np.arange(0.0, 600.0, 5.0)
THERMOMETER = 6.0 + SECONDS / 30.0
ELEMENT = 6.0 + (SECONDS - LAG * (1.0 - np.exp(-SECONDS / LAG))) / 30.0
"""On a ramp of 2 °C/min, by the solution of the differential equation."""

READINGS = {"x": np.full_like(SECONDS, 1300.0), "y": np.full_like(SECONDS, 900.0)}


def lagging(lag: float) -> Calibration:
    calibration = read(FIXTURES / "mavs.yaml")
    coefficients = calibration.coefficients
    thermal = replace(coefficients.thermal, lag=lag)
    return Calibration(replace(calibration.record, coefficients=replace(coefficients, thermal=thermal)))


def write(path, columns):
    np.savetxt(path, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="")
    return path


def applied(lag, log, say=lambda line: None):
    output = log.with_name(f"tilt-{lag:g}-{log.name}")
    apply_log(lagging(lag), log, output, say=say)
    return np.genfromtxt(output, delimiter=",", names=True)


def test_the_log_is_compensated_with_the_temperature_of_the_element(tmp_path):
    late = write(tmp_path / "late.csv", {"time": SECONDS, **READINGS, "temperature": THERMOMETER})
    true = write(tmp_path / "true.csv", {"time": SECONDS, **READINGS, "temperature": ELEMENT})
    found, expected = applied(LAG, late), applied(0.0, true)
    assert found["tilt_x"] == pytest.approx(expected["tilt_x"], abs=1e-9)
    assert found["flag"].tolist() == expected["flag"].tolist()


def plain(values):
    return {"t": values.temperature, "flag": np.ones(len(values)), "reason": np.zeros(len(values), np.uint16)}


def test_times_that_do_not_go_on_are_refused_with_their_row_in_whatever_block():
    """Without a pace there is no lag: such logs were compensated as if the temperature began anew there."""
    for place, time in ((7, 30.0), (7, 12.0), (1, 0.0), (40, 195.0), (50, 220.0), (60, 245.0), (None, 0.0)):
        times = SECONDS.copy()
        times[45:50] = np.nan
        times[place or slice(0)] = time
        follow, found = with_lag(plain, LAG, "log.csv"), []
        with pytest.raises(InputError) if place else nullcontext() as refused:
            for rows in (slice(0, 40), slice(40, 80), slice(80, 120)):
                values = RoleValues(np.empty((40, 2)), THERMOMETER[rows], times[rows])
                found.append(follow(values))
        if place:
            assert str(refused.value) == (
                f"log.csv: time stands still or goes back at row {place}, and the calibration follows a thermal lag: "
                "sort the log, or name a column of times that go on (columns time=NAME)"
            )
    untimed = with_lag(plain, LAG, "log.csv")(RoleValues(np.empty((40, 2)), THERMOMETER[:40]))
    assert (untimed["t"].tolist(), {*untimed["reason"]}) == (THERMOMETER[:40].tolist(), {16})
    late = np.concatenate([table["t"] for table in found])
    assert np.delete(late, slice(45, 50)) == pytest.approx(np.delete(ELEMENT, slice(45, 50)), abs=1e-9)
    assert np.flatnonzero(np.concatenate([table["reason"] for table in found])).tolist() == [*range(45, 50)]

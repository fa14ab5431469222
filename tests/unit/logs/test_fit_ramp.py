"""``fit ramp``: from a log to a calibration, and back by ``apply``."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from support.recordings import recording

from tiltcal.errors import EstimateError, InputError, UsageError
from tiltcal.library.calibration import read
from tiltcal.library.recorded import fit

LAG = 120.0
SECONDS = np.arange(0.0, 9600.0, 4.0)
CHAMBER = 5.0 + 40.0 * np.abs((SECONDS / 2400.0 + 1.0) % 2.0 - 1.0)

BASE = """\
tiltcal: 1
kind: tilt
sensor: {model: built-here, serial: S-1, unit: count, channels: [x, y]}
calibration:
  offset: {x: 1024.0, y: 1020.0}
  sensitivity: {x: {x: 819.0, y: 0.0}, y: {x: 0.0, y: 819.0}}
"""

HUNG = [{"position": "hung", "start": 0, "end": 160, "gx": 0.0, "gy": 1.0, "gz": 0.0}]
"""+Y up."""


def late():
    """The chamber's temperature, later by the lag, by the differential equation."""
    span = (0.0, 9600.0)

    def slope(t, e):
        return (np.interp(t, SECONDS, CHAMBER) - e) / LAG

    return solve_ivp(slope, span, [5.0], t_eval=SECONDS, max_step=60.0, rtol=1e-7).y[0]


def log_of(element, thermometer):
    """A level SCA100T-D02 with an element of this temperature."""
    warmer, draw = element - 24.0, np.random.default_rng(8)
    return {
        "seconds": SECONDS,
        "x": 1024.0 + 2.0 * warmer + 0.02 * warmer**2 + 0.5 * draw.normal(size=len(SECONDS)),
        "y": 1020.0 - 3.0 * warmer + 0.5 * draw.normal(size=len(SECONDS)),
        "temperature": thermometer,
    }


@pytest.fixture(scope="module")
def record():
    """The element follows the chamber later, and its thermometer at once."""
    return log_of(late(), CHAMBER)


@pytest.fixture(scope="module")
def calibration(record):
    return fitted(record)


def fitted(log, **settings):
    named = {"sensor": "sca100t-d02"} if "base" not in settings else {}
    return fit("ramp", log, serial="S-1", columns={"time": "seconds"}, **{"jig": 0.0} | named | settings)


@pytest.fixture
def base(tmp_path):
    (tmp_path / "base.yaml").write_text(BASE)
    return tmp_path / "base.yaml"


def test_the_file_has_the_lag_and_what_each_leg_says_of_it(calibration, tmp_path):
    calibration.save(tmp_path / "S-1.yaml")
    found = read(tmp_path / "S-1.yaml")
    ramp = found.record.fit.ramp
    assert found.coefficients.thermal.lag == pytest.approx(LAG, rel=0.01)
    assert found.uncertainty["temperature.lag"] < 1.2
    assert (ramp.used, [leg.way for leg in ramp.legs]) == (True, ["up", "down", "up", "down"])
    assert all(leg.lagged["y"] < leg.polynomial["y"] / 5.0 for leg in ramp.legs)
    assert ramp.explained_percent == pytest.approx({"x": 100.0, "y": 100.0}, abs=0.1)
    assert found.record.fit.notes[0].endswith("when it is fitted to the other legs")
    assert {one.position.rsplit("-", 1)[0] for one in found.positions} == {"up-1", "down-2", "up-3", "down-4"}


def test_the_error_that_all_temperatures_share_is_not_amplified_by_a_thermometer_that_is_later():
    """An offset of 0.2 °C; the inverse filter takes the slope of it, which is none: 2.2 °C were stated."""
    found = fitted(log_of(CHAMBER, late()), thermometer=0.2)
    assert found.coefficients.thermal.lag == pytest.approx(-LAG, rel=0.02)
    assert 0.2 < found.record.uncertainty.single_reading["temperature"] < 0.5


def test_the_step_of_a_thermometer_that_is_not_stated_is_in_the_uncertainty_of_a_temperature(record, base):
    """Rounding to 0.9 °C has a standard deviation of 0.9/√12 °C = 0.26 °C."""
    found = fitted(record | {"temperature": np.round(record["temperature"] / 0.9) * 0.9}, base=base)
    assert found.record.uncertainty.single_reading["temperature"] == pytest.approx(0.26, abs=0.02)


def test_a_base_with_a_nonlinearity_has_it_in_the_offset_and_its_uncertainty(record, base):
    """+Y up: the reading is o + 819 (1 + 0.001), by hand, and 0.002 of 819 are 1.64 counts of the offset."""
    base.write_text(
        f"{BASE}  nonlinearity: {{x: [0.001], y: [0.001]}}\nuncertainty:\n  nonlinearity: {{x: [0.002], y: [0.002]}}\n"
    )
    minutes = {name: values[::15] for name, values in record.items()}
    found = fitted(minutes | {"y": minutes["y"] + 819.0 * 1.001}, base=base, segments=HUNG, thermometer=0.0)
    assert found.coefficients.nonlinearity[1, 0] == 0.001
    assert found.uncertainty["nonlinearity.y.2"] == 0.002
    assert found.offset["y"] == pytest.approx(1020.0, abs=0.2)
    assert found.uncertainty["offset.y"] == pytest.approx(1.638, rel=0.02)
    assert found.uncertainty["offset.x"] < 0.2
    # Without a base the data sheet's 819 count/g come off the reading of y; their drift is -0.00022 t + 0.0022 %/°C of
    # them at t °C, and of parts within 0.014 %/°C of it; a jig of 0.2° and a lean of 0.1° turn x into y.
    found = fitted(minutes, segments=HUNG)
    gain = np.hypot((-0.00022 * 24.0 + 0.0022) / 100.0, 0.014 / 100.0)
    assert found.uncertainty["temperature.offset.y.1"] == pytest.approx(819.0 * gain, rel=0.02)
    stated = found.uncertainty.covariance
    offset, own = (stated.parameters.index(name) for name in ("offset.y", "sensitivity.y.y"))
    assert stated.matrix[offset][own] == pytest.approx(-stated.matrix[own][own], rel=0.01)
    leaning = fitted(minutes, segments=HUNG, jig=0.2, table_lean=0.1)
    assert leaning.uncertainty["offset.x"] == pytest.approx(819.0 * np.radians(np.hypot(0.2, 0.1)), rel=0.01)
    assert found.offset["y"] == pytest.approx(1020.0 - 819.0, abs=0.5)
    assert found.uncertainty["offset.y"] == pytest.approx(found.uncertainty["sensitivity.y.y"], rel=0.05)


def test_a_base_with_a_covariance_has_it_in_the_offset(record, base):
    """+Y up: the offset of y is off by what the sensitivity of y is off, 2 counts, and so are both together."""
    base.write_text(
        f"{BASE}uncertainty:\n  sensitivity: {{x: {{y: 2.0}}, y: {{y: 2.0}}}}\n  covariance:\n"
        "    parameters: [sensitivity.x.y, sensitivity.y.y]\n    matrix: [[4.0, 2.0], [2.0, 4.0]]\n"
    )
    minutes = {name: values[::15] for name, values in record.items()}
    hung = minutes | {"y": minutes["y"] + 819.0}
    found = fitted(hung, base=base, segments=HUNG, thermometer=0.0)
    assert found.uncertainty["offset.y"] == pytest.approx(2.0, rel=0.02)
    assert found.uncertainty["offset.x"] == pytest.approx(2.0, rel=0.02)
    # A sensitivity that changes by 0.1 %/°C, known to 0.05 %/°C, is in the drift of what hangs.
    warm = "  temperature:\n    reference: 24\n    sensitivity: {x: [0.001], y: [0.001]}\n"
    base.write_text(f"{BASE}{warm}uncertainty:\n  temperature: {{sensitivity: {{x: [5.0e-4], y: [5.0e-4]}}}}\n")
    drift = fitted(hung, base=base, segments=HUNG, thermometer=0.0).uncertainty["temperature.offset.y.1"]
    assert drift == pytest.approx(819.0 * np.hypot(1e-3, 5e-4), rel=0.01)


def test_a_ramp_off_level_keeps_the_offset_of_its_base_unless_its_attitude_is_stated(record, base):
    """On a shelf at 25°, by hand: x reads 819 sin 25° more; its gain of 0.02 %/°C changes that by 0.07 count/°C."""
    shelf, minutes = 819.0 * np.sin(np.radians(25.0)), {name: values[::15] for name, values in record.items()}
    minutes["x"] = minutes["x"] + shelf
    base.write_text(f"{BASE}uncertainty:\n  offset: {{x: 0.1, y: 0.1}}\n")
    found = fitted(minutes, base=base, jig=None)
    assert (found.offset["x"], found.uncertainty["offset.x"]) == (1024.0, 0.1)
    assert [note for note in found.fit.notes if "the base keeps its offset" in note and "(0.423, 0.000, 0.906)" in note]
    assert found.uncertainty["temperature.offset.x.1"] == pytest.approx(2e-4 * shelf, rel=0.05)
    level = found.apply({"x": [1024.0], "y": [1020.0], "temperature": [24.0], "seconds": [0.0]})
    assert abs(level["tilt_x"][0]) < 0.1
    for at, stated in ((20.0, "refused"), (25.0, "taken")):
        up = {"gx": np.sin(np.radians(at)), "gy": 0.0, "gz": np.cos(np.radians(at))}
        segments = [{"position": "shelf", "start": 0, "end": 160, **up}]
        if stated == "refused":
            with pytest.raises(EstimateError, match=r"x reads 4\.6° away"):
                fitted(minutes, base=base, segments=segments)
        else:
            assert fitted(minutes, base=base, segments=segments).offset["x"] == pytest.approx(1024.0, abs=0.3)


@pytest.mark.parametrize(
    ("changed", "settings", "message"),
    [
        # The SCA100T's thermometer reads 197 - 1.083 T counts: 148 to 192 of them would be too hot for any sensor.
        ({"temperature": 197.0 - 1.083 * CHAMBER}, {}, "convert counts or kelvin to °C"),
        ({"x": np.full(len(SECONDS), 1024.0)}, {}, "x reads 1024 in all 2400 rows"),
        ({}, {"columns": "time=t0"}, "there is no column 't0'"),
        ({}, {"table": True, "columns": ""}, "takes a continuous record, not a table"),
        (
            {},
            {"segments": [{"position": f"part-{row}", "start": row, "end": row + 999} for row in (0, 1000)]},
            "one continuous record, and these are 2 segments",
        ),
    ],
)
def test_what_is_no_ramp_is_refused(record, changed, settings, message):
    with pytest.raises((EstimateError, InputError, UsageError), match=message):
        fit("ramp", record | changed, serial="S-1", sensor="sca100t-d02", **{"columns": "time=seconds"} | settings)


def test_the_recorded_ramp_gets_no_lag_and_is_on_no_leg_worse_than_a_polynomial(base):
    """Its README: a lag helps two axes on one leg and harms on the other; part of the loop is hysteresis."""
    base.write_text(
        "tiltcal: 1\nkind: tilt\nsensor: {model: recorded, serial: S-1, unit: m/s2, channels: [x, y, z]}\n"
        "calibration:\n  offset: {x: 0.0, y: 0.0, z: 0.0}\n  sensitivity:\n    x: {x: 9.81, y: 0.0, z: 0.0}\n"
        "    y: {x: 0.0, y: 9.81, z: 0.0}\n    z: {x: 0.0, y: 0.0, z: 9.81}\n"
    )
    log, rows = recording("thermal_ramp.csv"), {"columns": "time=row", "base": base, "serial": "S-1"}
    up = [{"position": "up", "start": 0, "end": 8400, "gx": 0.0, "gy": 0.0, "gz": 1.0}]
    with pytest.raises(EstimateError, match=r"z reads 1\.1e\+02° away.*with segments"):
        fit("ramp", log, segments=up, **rows)
    down = [{"position": "down", "start": 0, "end": 8400, "gx": 0.0, "gy": 0.0, "gz": -1.0}]
    found = fit("ramp", log, segments=down, **rows)
    ramp = found.record.fit.ramp
    ends = [(leg.way, round(leg.temperature[0]), round(leg.temperature[1])) for leg in ramp.legs]
    assert ends == [("down", -18, 52), ("up", -18, 74), ("down", 34, 74)]
    assert not ramp.used
    assert found.coefficients.thermal.lag == 0.0
    # The loop that is left is in the uncertainty: the residuals of z are up to 0.1 m/s².
    assert found.uncertainty["offset.z"] > 0.02

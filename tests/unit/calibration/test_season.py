"""The calibration between two others, against calculations by hand."""

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
from scipy.stats import norm, t
from support import FIXTURES
from support.measured import mean_of

from tiltcal.calibration.complete import level
from tiltcal.calibration.measurement import BenchUncertainty
from tiltcal.calibration.season import DAY, DatedCalibration, SensorHistory
from tiltcal.core.model import Coefficients, Thermal
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity, read_calibration
from tiltcal.files.coefficients import Uncertainty
from tiltcal.files.procedure import find_procedure

FOUR_DIGITS = 0.5e-3
"""Half of the last of the four digits that a file states of an uncertainty, relative to a number that begins with 1."""

BASE = read_calibration(FIXTURES / "plane.yaml")


def history(*records: CalibrationRecord, days: tuple[float, ...] = (0.0, 100.0)) -> SensorHistory:
    """Calibrations of a sensor, the first of them made when time began."""
    dates = [datetime.fromtimestamp(day * DAY, UTC) for day in days]
    dated = zip(records, dates, strict=True)
    return SensorHistory(tuple(DatedCalibration(record, date, "a.yaml", "a.yaml") for record, date in dated))


def renewed(base: CalibrationRecord, shift: float) -> CalibrationRecord:
    """The base after a level at which every channel reads more by a shift, in counts."""
    readings = base.coefficients.predict(np.array([[0.0, 0.0, 1.0]]))[0] + shift
    one = mean_of("level", (0.0, 0.0, 1.0), readings, 0.1, temperature=24.0)
    return level(base, [one], find_procedure("level"), BenchUncertainty(jig=0.05))


def test_halfway_to_its_renewed_level_a_sensitivity_is_as_uncertain_as_at_both_ends() -> None:
    """Both ends have one error of S; the offsets' own errors are independent."""
    after = renewed(BASE, 2.0)
    halfway = history(BASE, after).at(50.0 * DAY).uncertainty
    for name in ("sensitivity.x.x", "sensitivity.x.z", "nonlinearity.y.3"):
        assert halfway[name] == pytest.approx(BASE.uncertainty[name], rel=1e-3)
    assert halfway["offset.x"] < max(BASE.uncertainty["offset.x"], after.uncertainty["offset.x"])


def own(offset: float, u: float) -> CalibrationRecord:
    """A sensor of one channel, 800 unit/g more than its offset."""
    known = Coefficients(("x",), ("x",), np.array([offset]), np.array([[800.0 + offset]]))
    sensor = SensorIdentity("sca100t-d02", "S-1", "count", ("x",))
    return CalibrationRecord(sensor, known, Uncertainty({"offset.x": u, "sensitivity.x.x": u}))


def test_two_calibrations_of_their_own_have_independent_errors() -> None:
    """By hand: halfway between u = 0.3 and u = 0.4 there is sqrt(0.3² + 0.4²) / 2 = 0.25."""
    season, stated = history(own(0.0, 0.3), own(6.0, 0.4)), 1000.0 * 0.1 / 806.0  # 0.1 unit of 806 after a day
    assert season.at(50.0 * DAY).coefficients.offset == pytest.approx([3.0])
    rectangular = 6.0 / np.sqrt(3.0)  # the whole change of 6
    for day, stability, u in (
        (50.0, 0.0, 0.25),
        (50.0, None, np.hypot(0.25, rectangular)),
        (0.0, None, 0.3),
        (125.0, None, np.hypot(0.4, rectangular)),  # a quarter of 100 days later
        (125.0, stated, np.hypot(0.4, 0.5)),  # 25 days after the last
        (50.0, stated, np.hypot(0.25, 0.5)),  # half of what 25 days make of 100 in their middle
    ):
        assert season.at(day * DAY, stability).uncertainty["offset.x"] == pytest.approx(u, rel=FOUR_DIGITS), day
    assert season.at(50.0 * DAY, stated).uncertainty["sensitivity.x.x"] == pytest.approx(0.25, rel=FOUR_DIGITS)


def test_the_changes_of_several_show_how_far_a_zero_wanders() -> None:
    """6² in 100 days and 4² in 200 are 0.22 a day, of two degrees of freedom: a bridge between, a walk behind them."""
    season = history(own(0.0, 0.3), own(6.0, 0.4), own(2.0, 0.3), days=(0.0, 100.0, 300.0))
    assert season.suggested_stability() == pytest.approx(1000.0 * np.sqrt(0.22) / 802.0)
    for day, ends, walked in ((125.0, np.hypot(0.875 * 0.4, 0.125 * 0.3), 0.22 * 25.0 * 0.875), (310.0, 0.3, 2.2)):
        found = season.at(day * DAY).uncertainty
        u = np.hypot(ends, np.sqrt(walked))
        assert found["offset.x"] == pytest.approx(u, rel=FOUR_DIGITS)
        half = np.hypot(norm.ppf(0.975) * ends, t.ppf(0.975, 2) * np.sqrt(walked))
        assert found.coverage_factor["offset.x"] == pytest.approx(half / u, abs=6e-4)


def test_a_quarter_of_the_way_the_lag_has_changed_by_a_quarter_and_the_limits_are_of_both() -> None:
    def late(lag: float, tilt: tuple[float, float]) -> CalibrationRecord:
        thermal = Thermal(24.0, (5.0, 40.0), np.array([[0.1], [0.2]]), np.zeros((2, 1)), lag)
        coefficients, limits = replace(BASE.coefficients, thermal=thermal), replace(BASE.limits, tilt={"x": tilt})
        return replace(BASE, coefficients=coefficients, limits=limits, uncertainty=Uncertainty({}))

    season = history(late(100.0, (-30.0, 20.0)), late(200.0, (-10.0, 40.0)))
    assert repr(season) == "<SensorHistory of SIM-42: 2 calibrations, 1970-01-01 to 1970-04-11>"
    found = season.at(25.0 * DAY)
    assert found.coefficients.thermal is not None
    assert found.coefficients.thermal.lag == pytest.approx(125.0)
    assert found.limits.tilt == {"x": (-10.0, 20.0)}


def test_a_series_is_at_the_reference_temperature_of_the_last() -> None:
    """A drift of 0.1 count/°C between 24 and 34 °C."""
    ends = [Thermal(at, (5.0, 40.0), np.array([[0.1], [0.2]]), np.zeros((2, 1))) for at in (24.0, 34.0)]
    season = history(*(replace(BASE, coefficients=replace(BASE.coefficients, thermal=thermal)) for thermal in ends))
    series = season.series("offset.x")
    assert series is not None
    assert series[0] == pytest.approx(BASE.coefficients.offset[0] + np.array([1.0, 0.0]))


def test_of_two_sessions_only_what_the_data_sheet_states_is_shared() -> None:
    """The column of z is the prior's alone in both; that of y was measured twice."""
    other = replace(BASE, coefficients=replace(BASE.coefficients, sensitivity=BASE.coefficients.sensitivity + 0.01))
    halfway = history(BASE, other).at(50.0 * DAY, 0.0).uncertainty
    assert halfway["sensitivity.x.z"] == pytest.approx(BASE.uncertainty["sensitivity.x.z"], rel=1e-3)
    assert halfway["sensitivity.x.y"] == pytest.approx(BASE.uncertainty["sensitivity.x.y"] / np.sqrt(2.0), rel=0.02)

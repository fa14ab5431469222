"""Whether two calibrations differ, over benches that are simulated here, by hand."""

from dataclasses import replace

import numpy as np
import pytest
from support import FIXTURES
from support.measured import mean_of, measured

import tiltcal
from tiltcal.calibration.calibrate import calibrate
from tiltcal.calibration.comparison import compare_records
from tiltcal.calibration.complete import level
from tiltcal.calibration.measurement import BenchUncertainty, MeasuredSensor
from tiltcal.files.calibration import SensorIdentity, read_calibration
from tiltcal.files.coefficients import Uncertainty
from tiltcal.files.procedure import Position, find_procedure
from tiltcal.library.calibration import Calibration

SENSOR = SensorIdentity("sca100t-d02", "S", "count", ("x", "y"))


def part_measured(
    rng: np.random.Generator, name: str, sensitivity: np.ndarray, temperature: float = 24.0, angle: float | None = None
) -> Calibration:
    """A part that drifts by 0.5 count/°C, in the positions of a procedure, with a jig of 0.1° that is stated.

    A position that only changes the temperature leaves the part as it lies.
    """
    procedure, turn = find_procedure(name, angle), np.zeros(3)

    def read(position: Position) -> np.ndarray:
        nonlocal turn
        turn = turn if position.name == "level-cold" else np.radians(rng.normal(0.0, 0.1, 3))
        up = np.array(position.gravity) + np.cross(turn, position.gravity)
        met = temperature if position.temperature is None else position.temperature
        return np.asarray(1024.0 + sensitivity @ up + 0.5 * (met - 24.0))

    found = measured(procedure.positions, read, rng, 0.06)
    found = [replace(one, temperature=one.temperature or temperature) for one in found]
    return Calibration(calibrate([MeasuredSensor(SENSOR, found)], procedure, BenchUncertainty(0.1))[0])


OFFSETS = {"offset.x", "offset.y"}
OF_Z = {"sensitivity.x.z", "sensitivity.y.z"}
PLANE = {f"sensitivity.{channel}.{axis}" for channel in "xy" for axis in "xy"}
DRIFT = {"temperature.offset.x.1", "temperature.offset.y.1"}


@pytest.mark.parametrize(
    ("old", "new", "not_comparable"),
    [
        # All positions of plane have g_z = cos 30°, so its offset holds 87 % of the column of z.
        ("plane", "plane", set()),
        ("plane", "cross-axis", OFFSETS | OF_Z),
        ("six-face", "plane", OFFSETS | OF_Z),
        ("plane", "plane 45", OFFSETS),
        # From level to 45° z loses 29 %, which the sensitivities of zero-45 take up.
        ("zero-45", "cross-axis", OFFSETS | PLANE | OF_Z),
        ("zero-45", "plane", OFFSETS | PLANE),
        ("zero-45", "mavs", DRIFT),
        ("complete", "cross-axis", DRIFT),
    ],
)
def test_only_what_means_the_same_is_compared(old: str, new: str, not_comparable: set[str]) -> None:
    """Of unchanged parts with 3 % of cross-axis sensitivity at most 5 % are called changed: 2 of 10 have p = 0.09."""
    rng = np.random.default_rng(6)
    changed = 0
    for _ in range(10):
        sensitivity = np.array([[819.0, 0.0, 0.0], [0.0, 819.0, 0.0]]) + 819.0 * rng.uniform(-0.03, 0.03, (2, 3))
        first, second = (
            part_measured(rng, name, sensitivity, temperature, float(angle) if angle else None)
            for (name, _, angle), temperature in ((old.partition(" "), 14.0), (new.partition(" "), 14.0))
        )
        found = tiltcal.compare(first, second)
        assert set(found.not_comparable) == not_comparable
        assert {change.name for change in found.changes}.isdisjoint(not_comparable)
        changed += found.verdict.word == "changed"
    assert changed <= 2


def test_a_file_with_a_drift_is_compared_at_the_temperature_of_the_other() -> None:
    """Measured at 4 °C, where a drift of 0.5 count/°C makes 10 counts: 7 u of 0.1° twice."""
    rng = np.random.default_rng(7)
    sensitivity = np.array([[819.0, 12.0, -20.0], [9.0, 815.0, 24.0]])
    warm, cold = part_measured(rng, "complete", sensitivity), part_measured(rng, "cross-axis", sensitivity, 4.0)
    for pair in ((warm, cold), (cold, warm)):
        found = tiltcal.compare(*pair)
        assert found.verdict.word == "unchanged"
        (offset,) = (change for change in found.changes if change.name == "offset.x")
        assert offset.before == pytest.approx(1024.0 - 10.0, abs=6.0)


def test_where_nothing_means_the_same_there_is_no_verdict() -> None:
    rng = np.random.default_rng(8)
    sensitivity = np.array([[819.0, 12.0, -20.0], [9.0, 815.0, 24.0]])
    found = tiltcal.compare(*(part_measured(rng, name, sensitivity) for name in ("zero-45", "cross-axis")))
    assert found.verdict.word == "unknown"
    assert found.in_words.startswith("unknown; not comparable: offset.x, ")
    assert "no verdict: no coefficient means the same in both files" in str(found)
    assert set(found.as_data()["not_comparable"]) == OFFSETS | PLANE | OF_Z


def test_an_offset_that_a_level_renewed_holds_the_whole_column_of_z() -> None:
    """As that of zero-45 does; of plane it is cos 30°."""
    rng = np.random.default_rng(9)
    sensitivity = np.array([[819.0, 12.0, -20.0], [9.0, 815.0, 24.0]])
    plane, zero_45 = (part_measured(rng, name, sensitivity) for name in ("plane", "zero-45"))
    seen = mean_of("level", (0.0, 0.0, 1.0), 1024.0 + sensitivity[:, 2], 0.06)
    renewed = Calibration(level(plane.record, [seen], find_procedure("level"), BenchUncertainty(0.1)))
    for old, new, not_comparable in ((plane, renewed, OFFSETS), (renewed, zero_45, PLANE)):
        assert set(tiltcal.compare(old, new).not_comparable) == not_comparable


def test_a_lag_is_compared_by_its_uncertainty_and_a_bent_sensor_with_another_bent_one() -> None:
    """0.4962 s beside 0.4962 s; without one of both the change is not judged."""
    late = read_calibration(FIXTURES / "ramp.yaml")
    later = replace(late, coefficients=replace(known := late.coefficients, thermal=replace(known.thermal, lag=65.0)))
    silent = {name: u for name, u in late.uncertainty.items() if name != "temperature.lag"}
    for other, u in ((later, 0.4962 * np.sqrt(2.0)), (replace(later, uncertainty=Uncertainty(silent)), None)):
        *_, lag = compare_records(late, other).changes
        assert (lag.name, lag.before, lag.after) == ("temperature.lag", 60.035, 65.0)
        assert lag.u == (None if u is None else pytest.approx(u))
    untold = Uncertainty({name: u for name, u in late.uncertainty.items() if name != "offset.x"})
    told = {one.name: one.u for one in compare_records(late, replace(later, uncertainty=untold)).changes}
    assert told["offset.x"] is None
    bent = read_calibration(FIXTURES / "multi-angle.yaml")
    straight = replace(bent, coefficients=replace(bent.coefficients, nonlinearity=None))
    kinds = ("sensitivity.x.x", "sensitivity.y.y", *(f"nonlinearity.{c}.{power}" for c in "xy" for power in (2, 3)))
    assert set(compare_records(bent, straight).not_comparable) == OFFSETS.union(kinds)
    assert not compare_records(bent, bent).not_comparable

"""Calibrations from several sessions: against one joint session, the weighted mean by hand, and by simulation."""

from collections.abc import Sequence
from dataclasses import replace
from math import hypot, sqrt
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2
from support import FIXTURES
from support.measured import mean_of, measured

import tiltcal
from tiltcal.calibration.calibrate import calibrate
from tiltcal.calibration.complete import mount
from tiltcal.calibration.measurement import BenchUncertainty, MeasuredSensor, Measurement
from tiltcal.core.model import Array, Coefficients, Mounting, Thermal, values
from tiltcal.drivers import find_model
from tiltcal.drivers.model import Model
from tiltcal.errors import EstimateError, UsageError
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity
from tiltcal.files.coefficients import Uncertainty
from tiltcal.files.procedure import Position, Procedure, find_procedure
from tiltcal.files.results import DerivedRecord, FileRecord, FitRecord, PositionRecord, Provenance
from tiltcal.library.calibration import Calibration, combine

SENSOR = SensorIdentity("sca100t-d02", "S-1", "count", ("x", "y"))
TRUTH = Coefficients(
    ("x", "y"),
    ("x", "y"),
    np.array([1026.0, 1020.0]),
    np.array([[817.0, 11.0], [-8.0, 821.0]]),
    Thermal(24.0, (5.0, 24.0), np.array([[0.3], [-0.1]]), np.zeros((2, 0))),
)
JIG, NOISE = 0.02, 0.05
STATED = replace(find_model("sca100t-d02"), sensitivity_spread=8.0 / 819.0, rails=(101.0, 2047.0))
NOMINAL = replace(STATED, cross_axis_limit=0.0, nonlinearity=())
"""A part whose data sheet states no cross-axis sensitivity and no nonlinearity: what is not determined is zero."""


def session(procedure: Procedure, seed: int, at: float | None = None, truth: Coefficients = TRUTH) -> list[Measurement]:
    """What the true sensor reads in the positions, with noise and an attitude off for each that is set anew."""
    rng = np.random.default_rng(seed)
    before, turn = None, np.zeros(3)

    def read(position: Position) -> Array:
        nonlocal before, turn
        if position.gravity != before:
            turn, before = np.radians(JIG) * rng.normal(size=3), position.gravity
        temperature = position.temperature if at is None else at
        gravity = np.array(position.gravity) + np.cross(turn, position.gravity)
        return truth.predict(gravity[None], None if temperature is None else np.array([temperature]))[0]

    found = measured(procedure.positions, read, rng, NOISE)
    return found if at is None else [replace(one, temperature=at) for one in found]


def calibrated(
    procedure: Procedure,
    measurements: list[Measurement],
    base: CalibrationRecord | None = None,
    model: Model = NOMINAL,
    jig: float | None = JIG,
) -> Calibration:
    one = MeasuredSensor(SENSOR, measurements, model, base=base)
    return Calibration(calibrate([one], procedure, BenchUncertainty(jig))[0])


ZERO_45, TWO = find_procedure("zero-45"), find_procedure("two-temperature")
SCALE = calibrated(ZERO_45, session(ZERO_45, 1, 24.0))
DRIFT = calibrated(TWO, session(TWO, 2))
OF_BASE = calibrated(TWO, session(TWO, 2), SCALE.record)


@pytest.mark.parametrize("model", [NOMINAL, STATED], ids=["silent data sheet", "data sheet"])
@pytest.mark.parametrize("with_base", [True, False])
def test_two_sessions_give_what_one_joint_session_gives(with_base: bool, model: Model) -> None:
    """Whether the overnight run took the part's own sensitivity or the nominal one: it is no information."""
    scale = calibrated(ZERO_45, session(ZERO_45, 1, 24.0), model=model)
    drift = calibrated(TWO, session(TWO, 2), scale.record if with_base else None, model=model)
    both = replace(ZERO_45, positions=(*ZERO_45.positions, *TWO.positions), drift=1, reference=24.0)
    # Joined they are one session but for the levels, each of which was set by itself: the second has a heading of 360°.
    night = [replace(one, heading=360.0) for one in session(TWO, 2)]
    joint = calibrated(both, [*session(ZERO_45, 1, 24.0), *night], model=model)
    found = combine([scale, drift])
    assert set(found.fit.priors) == set(joint.fit.priors)
    for name, value in values(joint.coefficients).items():
        u = joint.uncertainty[name]
        assert values(found.coefficients)[name] == pytest.approx(
            value, abs=(0.005 if model is NOMINAL else 0.02) * u
        ), name
        assert found.uncertainty[name] == pytest.approx(u, rel=0.005), name
    assert found.derived.assumed == ()
    assert found.fit.degrees_of_freedom == joint.fit.degrees_of_freedom
    assert found.fit.chi_square == pytest.approx(joint.fit.chi_square, rel=0.01)


def shifted(record: CalibrationRecord, by: Sequence[float]) -> Calibration:
    """The calibration that readings give which are larger by a constant on each channel."""
    shift = dict(zip(record.sensor.channels, by, strict=True))
    positions = tuple(
        one.replaced(mean={channel: value + shift[channel] for channel, value in one.mean.items()})
        for one in record.positions
    )
    offset = record.coefficients.offset + np.array(by)
    return Calibration(replace(record, positions=positions, coefficients=replace(record.coefficients, offset=offset)))


def by_values(record: CalibrationRecord) -> CalibrationRecord:
    """A file without positions."""
    return replace(record, positions=())


@pytest.mark.parametrize("ratio", [3.65, 3.8])
def test_sound_sessions_are_seldom_refused(ratio: float) -> None:
    """Two offsets are common: chi-square with 2 degrees of freedom is above 3.717² in 0.1 %."""
    shift = SCALE.coefficients.offset - OF_BASE.coefficients.offset
    u = hypot(OF_BASE.uncertainty["offset.x"], SCALE.uncertainty["offset.x"])
    moved = shifted(OF_BASE.record, (shift[0] + ratio * u, shift[1]))
    if ratio < 3.717:
        combine([SCALE, moved])
        return
    with pytest.raises(UsageError, match=r"contradict .*\n  offset\.x is .* apart by .* \(E_n 1\.9\)") as refused:
        combine([SCALE, moved])
    assert "offset.y" not in str(refused.value)
    assert str(refused.value).endswith("one of the sessions is wrong, or the sensor has changed between them")


def test_sessions_that_show_no_jig_agree_up_to_half_a_degree() -> None:
    """What the data sheet allows takes up the residuals of `plane`; 30 counts of 819 per g are 2.1°."""
    plane = find_procedure("plane")

    def measured_without_jig(seed: int, shift: float) -> Calibration:
        truth = replace(TRUTH, offset=TRUTH.offset + np.array([shift, 0.0]))
        return calibrated(plane, session(plane, seed, 24.0, truth), model=STATED, jig=None)

    for seed in range(6):
        combine([measured_without_jig(seed, 0.0), measured_without_jig(seed + 10, 0.0)])
    with pytest.raises(UsageError, match="contradict"):
        combine([measured_without_jig(0, 0.0), measured_without_jig(10, 30.0)])


def test_positions_of_one_journal_count_once() -> None:
    journal = Provenance(journal=FileRecord(name="s.jsonl", sha256="a" * 64))
    once = Calibration(replace(SCALE.record, provenance=journal))
    again = Calibration(replace(SCALE.record, provenance=journal.replaced(operator="another")))
    twice, alone = combine([once, again, DRIFT]), combine([once, DRIFT])
    assert values(twice.coefficients) == values(alone.coefficients)
    assert dict(twice.uncertainty) == dict(alone.uncertainty)
    assert len(twice.positions) == len(alone.positions)
    unnamed = Calibration(replace(OF_BASE.record, sensor=SENSOR.replaced(model="recorded")))
    assert combine([unnamed, SCALE]).sensor == SENSOR


def stated(known: dict[str, tuple[float, float]], thermal: Thermal | None, *met: float, **more: object) -> Calibration:
    """A sensor of one channel by its values with their u, and the temperatures of its positions, °C."""
    offset, sensitivity = (np.array([known[name][0]]) for name in ("offset.x", "sensitivity.x.x"))
    own = Coefficients(("x",), ("x",), offset, sensitivity[:, None], thermal)
    rows = tuple(PositionRecord(position=f"p{k}", u={"x": 0.1}, temperature=at) for k, at in enumerate(met))
    record = CalibrationRecord(
        SENSOR.replaced(channels=("x",)), own, Uncertainty({n: u for n, (_, u) in known.items()})
    )
    return Calibration(replace(record, positions=rows, **more))


def test_values_of_files_are_weighed_as_generalised_least_squares_has_it() -> None:
    """Free positions show the straight line through their temperatures, a run its square, the third one temperature."""
    free = {"offset.x": (11.0, 0.3), "sensitivity.x.x": (800.0, 1.0), "temperature.offset.x.1": (0.33, 0.02)}
    run = {"offset.x": (12.4, 0.4), "temperature.offset.x.1": (0.42, 0.03), "temperature.offset.x.2": (0.01, 0.001)}
    third, none = {"offset.x": (11.7, 0.2), "sensitivity.x.x": (801.5, 1.5)}, np.zeros((1, 0))
    drifts = Thermal(20.0, (10.0, 30.0), np.array([[0.33]]), none), Thermal(24.0, (5.0, 40.0), SQUARE, none)
    assumed = DerivedRecord(assumed=("sensitivity: nominal of the model",))
    attitudes = FitRecord(distinct_attitudes=12, residuals={"p0": {"x": 0.2}})
    one = stated(free, drifts[0], 10.0, 20.0, 30.0, fit=attitudes)
    other = stated(run | {"sensitivity.x.x": (790.0, 5.0)}, drifts[1], 24.0, derived=assumed)
    found = combine([one, other, stated(third, None, 20.0, 24.0, fit=FitRecord(thermometer_celsius=0.5))])
    # By offset, sensitivity, drift and its square from 24 °C: the line of (T - 24)² at 10, 20, 30 °C is -8 dT + 248/3.
    rows = [[1, 0, -4, 248 / 3], [0, 1, 0, 0], [0, 0, 1, -8]]
    rows += [[1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [1, 0, -2, 4], [0, 1, 0, 0]]
    seen, u = np.transpose([*free.values(), *run.values(), *third.values()])
    u[6] = np.hypot(0.2, 0.33 * np.hypot(2.0, 0.5))  # by the first drift, over two temperatures and their thermometer
    whole = np.array(rows) / u[:, None]
    theta, (rise,), *_ = np.linalg.lstsq(whole, seen / u, rcond=None)
    names = ("offset.x", "sensitivity.x.x", "temperature.offset.x.1", "temperature.offset.x.2")
    expected = np.sqrt(np.diag(np.linalg.inv(whole.T @ whole)))
    assert [found.uncertainty[name] for name in names] == pytest.approx(expected, rel=1e-3)
    assert [values(found.coefficients)[name] for name in names] == pytest.approx(theta, abs=1e-3)
    assert (found.fit.chi_square, found.fit.p_value) == pytest.approx((rise, chi2.sf(rise, 4)), rel=1e-3)
    assert (found.fit.degrees_of_freedom, found.fit.uncertainty_from) == (4, "stated by the calibrations")
    assert found.coefficients.thermal.range == (5.0, 40.0)


SQUARE = np.array([[0.42, 0.01]])


def with_thermal(record: CalibrationRecord, **changed: object) -> Calibration:
    thermal = replace(record.coefficients.thermal, **changed)  # type: ignore[type-var]
    return Calibration(replace(record, coefficients=replace(record.coefficients, thermal=thermal)))


VALUES = by_values(DRIFT.record)
SILENT = Calibration(replace(VALUES, uncertainty=replace(VALUES.uncertainty, standard={}, covariance=None)))
OFF = Calibration(replace(DRIFT.record, limits=replace(DRIFT.record.limits, reading={"x": (3000.0, 4000.0)})))
ORDER = {
    what: [with_thermal(by_values(OF_BASE.record), **{what: np.full((2, order), 1e-4)}) for order in orders]
    for what, orders in (("drift", (2, 1)), ("gain", (1, 2)))
}
PARTLY = Calibration(
    replace(VALUES, uncertainty=Uncertainty({name: VALUES.uncertainty[name] for name in ("offset.x", "offset.y")}))
)
WHOLE = Calibration(replace(tiltcal.read(FIXTURES / "cross-axis.yaml").record, sensor=SENSOR))
LATE = [with_thermal(DRIFT.record, lag=lag) for lag in (100.0, 200.0)]
TURNED = [SCALE.with_mounting("roll=180"), OF_BASE.with_mounting("roll=90")]


@pytest.mark.parametrize(
    ("sessions", "said"),
    [
        ([SCALE, SCALE], r"^zero-45 and zero-45 \(2\) are one calibration: name it once"),
        ([combine([SCALE, DRIFT]), DRIFT], "would count twice"),
        ([SCALE, SILENT], "two-temperature: the file states no uncertainty"),
        ([Calibration(by_values(SCALE.record)), Calibration(VALUES)], "no calibration has positions that were set"),
        ([SCALE], "name two calibrations or more, or a mounting"),
        ([SCALE, OFF], r"limits\.reading\.x: the calibrations have no readings in common"),
        (
            [WHOLE, Calibration(by_values(SCALE.record))],
            "^zero-45 determines the sensitivity to x, y and another .* x, y, z;",
        ),
        (
            [SCALE, DRIFT, PARTLY],
            r"^two-temperature \(3\) states no uncertainty of temperature\.offset\.x\.1, which another",
        ),
        (
            LATE,
            r"^the lags contradict: two-temperature has 100 s and two-temperature \(2\) has 200 s; combine one of them",
        ),
        (
            [SCALE, Calibration(replace(DRIFT.record, sensor=SENSOR.replaced(model="adxl355")))],
            "its model is sca100t-d02 in",
        ),
        ([5, SCALE], "combine takes tilt calibrations or their files, not 5"),
        *(([SCALE, *two], f"the {what} of .* has order .* combine one") for what, two in ORDER.items()),
        (
            TURNED,
            "mountings contradict: zero-45 has roll=180,.* and two-temperature has roll=90,.*; state one with mounting",
        ),
    ],
)
def test_refused(sessions: list[Calibration], said: str) -> None:
    with pytest.raises((UsageError, EstimateError), match=said):
        combine(sessions)


def test_an_offset_without_a_temperature_is_left_out() -> None:
    found = combine([calibrated(ZERO_45, session(ZERO_45, 1)), OF_BASE])
    assert found.offset == pytest.approx(OF_BASE.offset, abs=1e-3)
    assert "zero-45 states no temperature: its offset is left out" in found.fit.notes


def test_an_offset_whose_level_nobody_stated_gives_way_where_it_contradicts() -> None:
    """The cooler stood 0.6° askew, 9 counts, and its session states no jig; the drift does not suffer."""
    run = calibrated(TWO, session(TWO, 2), SCALE.record, jig=None)
    found = combine([SCALE, shifted(run.record, (9.0, 0.0))])
    assert found.offset == pytest.approx(SCALE.offset, abs=0.3)
    assert found.coefficients.thermal.drift[0, 0] == pytest.approx(0.3, abs=0.02)
    of_whom = [note.split()[0] for note in found.fit.notes if "does not state how level it was" in note]
    assert of_whom == ["two-temperature"]  # the other states its jig


def test_a_run_at_level_with_the_nominal_sensitivity_goes_with_a_whole_matrix() -> None:
    """Its offset holds S_xz, because it was level: 0 g is S_xz below."""
    whole = tiltcal.read(FIXTURES / "cross-axis.yaml")
    warmer = float(np.mean([one.temperature for one in whole.positions])) - 24.0
    at_24 = whole.coefficients.offset - np.array([0.3, -0.1]) * warmer
    level = at_24 + whole.coefficients.sensitivity[:, 2]
    run = replace(DRIFT.record, sensor=whole.sensor)
    moved = shifted(run, level - run.coefficients.offset)
    for one in (moved, Calibration(by_values(moved.record))):
        found = combine([whole, one])
        assert list(found.offset.values()) == pytest.approx(at_24, abs=0.02)
        assert found.coefficients.axes == ("x", "y", "z")


def test_the_turn_of_a_mounting_is_correlated_with_the_coefficients_of_its_own_session_alone() -> None:
    """Of two sessions that weigh alike, half of each covariance with the turn is left, and all of the turn's own."""
    up = ((0.0, 0.0, 1.0), (0.5, 0.0, sqrt(0.75)), (0.0, 0.5, sqrt(0.75)))
    readings = TRUTH.predict(np.array(up), np.full(3, 24.0))
    seen = [mean_of(f"m{k}", up[k], row, NOISE, temperature=24.0) for k, row in enumerate(readings)]
    mounted = Calibration(mount(SCALE.record, seen, jig=JIG))
    found = combine([mounted, calibrated(ZERO_45, session(ZERO_45, 4, 24.0))])

    def shared(one: Calibration) -> Array:
        stated = one.uncertainty.covariance
        turns = [stated.parameters.index(f"mounting.turn.{axis}") for axis in "xyz"]
        own = [stated.parameters.index(f"{what}.{channel}") for what in ("offset", "sensitivity.x") for channel in "xy"]
        return np.array(stated.matrix)[np.ix_([*own, *turns], turns)]

    alone, both = shared(mounted), shared(found)
    assert np.abs(alone[:4]).max() > 1e-4
    np.testing.assert_allclose(both[:4], alone[:4] / 2.0, rtol=0.02, atol=1e-6)
    np.testing.assert_allclose(both[4:], alone[4:], rtol=1e-3)


@pytest.mark.parametrize("mounted_first", [True, False])
def test_a_session_without_a_mounting_takes_that_of_the_other_and_no_two_contradict(mounted_first: bool) -> None:
    mounting = {"roll": 180.0}
    pair = [SCALE.with_mounting(mounting), OF_BASE] if mounted_first else [SCALE, OF_BASE.with_mounting(mounting)]
    assert combine(pair).coefficients.mounting == Mounting(roll=np.pi)
    locked = {pitch: pair[0].with_mounting(f"pitch={pitch}").derived.gimbal_lock for pitch in (90, -90, 89.9)}
    assert locked == {90: True, -90: True, 89.9: False}


def test_a_file_of_two_sessions_is_read_again_and_names_its_sources(tmp_path: Path) -> None:
    SCALE.save(tmp_path / "scale.yaml")
    OF_BASE.save(tmp_path / "drift.yaml")
    found = combine([tmp_path / "scale.yaml", tmp_path / "drift.yaml"], mounting="roll=180")
    found.save(tmp_path / "all.yaml")
    again = tiltcal.read(tmp_path / "all.yaml")
    assert again == found
    assert [one.name for one in again.provenance.sources] == ["scale.yaml", "drift.yaml"]
    assert all(len(one.sha256 or "") == 64 for one in again.provenance.sources)
    assert again.coefficients.mounting.roll == pytest.approx(np.pi)
    assert [one.position for one in again.positions] == [
        *(f"scale/{name}" for name in ("level", "x-45", "y-45")),
        *(f"drift/{name}" for name in ("level-warm", "level-cold")),
    ]
    assert again.limits.temperature == (5.5, 24.0)

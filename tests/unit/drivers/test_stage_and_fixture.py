"""The virtual stage of four accelerometers against its source, and the virtual jig and chamber."""

from dataclasses import replace
from math import cos, hypot, radians, sin
from statistics import fmean, stdev

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from support import accelerometer_disk as disk
from support.command import tiltcal

from tiltcal.drivers import find_model
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.stage import Accelerometer, Disk, disk_sample
from tiltcal.drivers.virtual import Fault, Fixture, Truth, _rotated

QUIET = Disk(noise=0.0)


def taken(made: Disk, count: int, seed: int = 0) -> disk.Record:
    samples = [disk_sample(made, seed, number) for number in range(count)]
    return disk.Record(*(np.array([getattr(one, name) for one in samples]) for name in ("time", "theta", "readings")))


def test_eq_4_by_hand() -> None:
    part = Accelerometer(3.0, misalignment=0.02, offset=0.5)
    made = replace(QUIET, accelerometers=(part,) * 4, inclination=radians(30.0))
    sample = disk_sample(made, 0, 70)  # 1.4 s at 50 Hz: 63° at 0.125 Hz
    assert sample.theta == pytest.approx(63.0)
    along, across = 1.5 * sin(radians(63)), 1.5 * cos(radians(63))
    radial, tangential = along + 0.02 * across, across - 0.02 * along
    felt = [radial, -radial, tangential, -tangential]
    assert sample.readings == pytest.approx([0.5 + one for one in felt])


def test_the_stage_of_the_source_and_parts_that_are_drawn_near_it() -> None:
    named = Disk()
    parts = [(part.scale, part.misalignment, part.offset, part.phase_error) for part in named.accelerometers]
    assert parts == [(3.383, -0.0221, 0, 0), (3.415, -0.0217, 0, 0), (3.402, 0.012, 0, 0), (3.39, 0.0124, 0, 0)]
    assert (named.inclination, named.spin, named.rate, named.gradient) == (1.5e-3, 0.125, 50.0, (0.0, 0.0))
    noise = taken(named, 2000).readings - taken(replace(named, noise=0.0), 2000).readings
    # 1.5e-7 g/√Hz up to 25 Hz, in the sensitivity of each.
    assert np.std(noise, axis=0) == pytest.approx(np.array([part[0] for part in parts]) * 7.5e-7, rel=0.05)
    drawn = [find_model("gradiometer").default_truth(seed).disk for seed in range(60)]
    every = [part for disk in drawn for part in disk.accelerometers]
    for name, centre, limit in (
        ("scale", 3.4, 0.034),
        ("misalignment", 0.0, 0.02),
        ("phase_error", 0.0, radians(0.1)),
        ("offset", 0.0, 0.002),
    ):
        away = [abs(getattr(part, name) - centre) for part in every]
        assert 0.95 * limit <= max(away) <= limit, name
    encoder = taken(drawn[0], 2000).theta - taken(replace(drawn[0], encoder_noise=0.0), 2000).theta
    assert np.std((encoder + 180.0) % 360.0 - 180.0) == pytest.approx(0.002, rel=0.05)


def test_a_gradient_turns_up_twice_a_turn_with_the_signs_of_eq_1() -> None:
    made = taken(replace(QUIET, inclination=0.0, gradient=(2e-6, 5e-7), accelerometers=(Accelerometer(1.0),) * 4), 4000)
    for index, sign in enumerate((1, 1, -1, -1)):
        assert disk.judged(made, made.readings[:, index], harmonic=2) == pytest.approx((sign * 1e-6, sign * 5e-7))


def test_a_slope_is_the_tangent_of_the_angle_and_a_roll_is_about_the_axis_of_the_pitch() -> None:
    truth = Truth(("x",), {"x": 0.0}, {"x": {"x": 1000.0}}, angles="inclination", slope=1000.0)
    assert truth.reading("x", (0.5, 0.0, 0.75**0.5), 25.0) == pytest.approx(577.350269)
    turned = Rotation.from_euler("z", 20.0, degrees=True)
    pitch, roll, up = 0.3, -0.7, Rotation.from_euler("yx", [0.3, 0.7]).apply([0.0, 0.0, 1.0])
    y = dict(zip("xyz", 2.0 * turned.apply([0.0, 1.0, 0.0]), strict=True))
    faults = (Fault("stuck", 2.0, 3.0), Fault("silent", 3.0, 4.0))
    part = Truth(("x", "y"), {"y": 0.5}, {"y": y}, angles="euler", faults=faults)
    assert [part.fault(seconds).kind for seconds in (1.9, 2.0, 2.9, 3.0, 4.0)] == ["", "stuck", "stuck", "silent", ""]
    assert up[0] == pytest.approx(sin(pitch))
    assert part.reading("y", tuple(turned.apply(up)), 25.0) == pytest.approx(0.5 + 2.0 * roll)


def test_a_line_is_the_next_sample_of_the_disk_in_the_columns_of_the_address() -> None:
    assert "nominal" not in tiltcal("devices", "gradiometer").stdout  # a pair is matched whatever 1 g reads
    for options in ("", "&columns=a4,-,theta,time&separator=semicolon"):
        where, clock = parse_address(f"sim:seed=5{options}"), VirtualClock()
        model = find_model("gradiometer").at(where)
        assert model.channels == (("a4", "theta") if options else ("theta", "a1", "a2", "a3", "a4"))
        truth = model.default_truth(5)
        sensor = model.driver(model.twin(truth, None, clock), clock)
        sensor.read()
        for number in range(2, 6):
            sample = disk_sample(truth.disk, 5, number)
            expected = (sample.readings[3], sample.theta) if options else (sample.theta, *sample.readings)
            assert sensor.read().values == pytest.approx(expected, rel=1e-8)
            assert clock.now_ns() / 1e9 == pytest.approx(number / 50, abs=0.01)


@pytest.mark.parametrize(("pace", "constant"), [(2.0, 0.0), (0.0, 200.0), (0.0, 90.0)])
def test_what_follows_the_chamber_obeys_its_differential_equation(pace: float, constant: float) -> None:
    clock = VirtualClock()
    fixture = Fixture(clock, ambient=20.0, time_constant=constant)
    assert fixture.temperature(60.0) == fixture.temperature() == 20.0
    seconds, chamber, element = np.arange(0.0, 2000.0, 20.0), [], []
    for now in seconds:
        clock.seek(round(now * 1e9))
        if now in (100.0, 300.0):
            fixture.move((0.0, 0.0, 1.0), {100.0: 40.0, 300.0: 10.0}[now], pace)
        chamber.append(fixture.temperature())
        element.append(fixture.temperature(90.0))

    def slope(t: float, e: float) -> float:
        return (np.interp(t, seconds, chamber) - e) / 90.0

    solved = solve_ivp(slope, (0.0, 1980.0), [20.0], t_eval=seconds, max_step=5.0, rtol=1e-8).y[0]
    assert element == pytest.approx(solved, abs=0.05)
    assert chamber[10] == pytest.approx(20.0 + 200.0 / 60.0 if pace else 40.0 - 20.0 * np.exp(-100.0 / constant))


def test_a_jig_misses_each_position_by_its_angle_and_keeps_it_while_it_is_held() -> None:
    fixture = Fixture(VirtualClock(), seed=4, jig=0.5)
    misses = []
    for _ in range(2000):
        fixture.move((0.0, 1.0, 0.0))
        fixture.move((0.0, 0.0, 1.0))
        misses.append(fixture.gravity[0])
    assert stdev(misses) == pytest.approx(sin(radians(0.5)), rel=0.08)
    assert abs(fmean(misses)) < 5 * sin(radians(0.5)) / 2000**0.5
    assert hypot(*fixture.gravity) == pytest.approx(1.0, abs=1e-12)
    before = fixture.gravity
    fixture.move((0.0, 0.0, 1.0), temperature=5.5)
    assert fixture.gravity == before
    angles, up = [0.3, -0.2, 0.7], (0.48, -0.6, 0.64)
    assert _rotated(up, angles) == pytest.approx(Rotation.from_euler("xyz", angles).apply(up))

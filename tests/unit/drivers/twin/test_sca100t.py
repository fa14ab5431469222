"""The virtual SCA100T: it answers the part's bytes, keeps its times, and has no memory that a restart could lose."""

from __future__ import annotations

from dataclasses import replace
from math import cos, hypot, radians, sin
from statistics import fmean, stdev

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.sca100t_part import Sca100tPart

from tiltcal.drivers import find_model
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.twin.fixture import Fixture
from tiltcal.drivers.twin.sca100t import Sca100tTwin, recentred
from tiltcal.drivers.twin.truth import Fault, Truth
from tiltcal.errors import BusError, DeviceFault

RDAX, RDAY, RWTR = b"\x10\x00\x00", b"\x11\x00\x00", b"\x08\x00"
D01, D02 = find_model("sca100t-d01"), find_model("sca100t-d02")


def nominal(counts_per_g: float = 819.0, **changes: object) -> Truth:
    truth = Truth(
        channels=("x", "y"),
        offset={"x": 1024.0, "y": 1024.0},
        sensitivity={"x": {"x": counts_per_g}, "y": {"y": counts_per_g}},
        seed=5,
    )
    return replace(truth, **changes)


class Bench:
    """One twin, the clock and the fixture that it lives by, and the driver."""

    def __init__(self, truth: Truth, now_ns: int = 0) -> None:
        self.clock = VirtualClock()
        self.clock.seek(now_ns)
        self.fixture = Fixture(self.clock, ambient=truth.ambient)
        self.twin = Sca100tTwin(truth, self.fixture, self.clock)
        self.sensor = D02.driver(self.twin, self.clock)

    def tilt(self, x: float = 0.0, y: float = 0.0) -> Bench:
        gx, gy = sin(radians(x)), sin(radians(y))
        self.fixture.move((gx, gy, (1.0 - gx * gx - gy * gy) ** 0.5))
        return self

    def frame(self, out: bytes, rest: float = 150e-6) -> bytes:
        self.clock.sleep(rest)
        return self.twin.exchange(out)


def word(answer: bytes) -> int:
    return int(f"{int.from_bytes(answer, 'big'):024b}"[8:19], 2)


@pytest.mark.parametrize(
    ("counts_per_g", "angle", "counts"),
    [
        *((1638.0, angle, counts) for angle, counts in ((-5, 881), (-1, 995), (0, 1024), (1, 1053), (5, 1167))),
        *((819.0, angle, counts) for angle, counts in ((-5, 953), (-1, 1010), (0, 1024), (1, 1038), (5, 1095))),
    ],
)
def test_the_table_of_the_datasheet(counts_per_g: float, angle: float, counts: int) -> None:
    bench = Bench(nominal(counts_per_g))
    assert bench.tilt(x=angle).sensor.read().values == (counts, 1024.0)
    assert bench.tilt(y=angle).sensor.read().values == (1024.0, counts)


def test_the_word_stands_left_aligned_amid_bits_that_mean_nothing() -> None:
    bench = Bench(nominal()).tilt(x=90.0)
    answers = [bench.frame(RDAX) for _ in range(200)]
    assert {word(answer) for answer in answers} == {1843}
    assert len({answer[0] for answer in answers}) > 50
    assert len({answer[2] & 0b11111 for answer in answers}) == 32


def test_the_thermometer_follows_the_datasheets_line() -> None:
    assert Bench(nominal(ambient=0.0)).frame(RWTR)[1] == 197
    assert Bench(nominal(ambient=25.0)).frame(RWTR)[1] == 170
    assert Bench(nominal(ambient=20.0, thermometer_error=5.0)).frame(RWTR)[1] == 170
    assert Bench(nominal(ambient=-200.0)).frame(RWTR)[1] == 255


def test_readings_are_clipped_to_eleven_bits() -> None:
    bench = Bench(nominal(1638.0))
    assert word(bench.tilt(x=90.0).frame(RDAX)) == 2047
    assert word(bench.tilt(x=-90.0).frame(RDAX)) == 0


@pytest.mark.parametrize("command", [0x0A, 0x0B, 0x42, 0xFF])
def test_an_invalid_command_leaves_the_line_floating_until_the_next_frame(command: int) -> None:
    bench = Bench(nominal())
    assert bench.frame(bytes([command, 0, 0])) == b"\xff\xff\xff"
    assert word(bench.frame(RDAX)) == 1024


def test_a_frame_takes_its_bits_at_500_khz() -> None:
    bench = Bench(nominal())
    bench.frame(RDAX, rest=0.0)
    assert bench.clock.now_ns() == 48_000
    bench.frame(RWTR, rest=0.0)
    assert bench.clock.now_ns() == 80_000


def test_a_read_sooner_than_150_us_finds_the_old_words() -> None:
    bench = Bench(nominal(noise={"x": 30.0, "y": 30.0}))
    first = word(bench.frame(RDAX))
    assert word(bench.frame(RDAX, rest=149e-6)) == first
    assert word(bench.frame(RDAX, rest=15e-6)) == first
    assert word(bench.tilt(x=60.0).frame(RDAX, rest=15e-6)) == first
    bench.tilt()
    fresh = [word(bench.frame(RDAX, rest=150e-6)) for _ in range(10)]
    assert len({first, *fresh}) > 5


def test_noise_and_rounding_are_as_large_as_the_truth_says() -> None:
    bench = Bench(nominal(noise={"x": 0.6}, offset={"x": 1024.3, "y": 1024.3}))
    x, y = zip(*(bench.sensor.read().values for _ in range(4000)), strict=True)
    # Rounding adds the variance of an even distribution one count wide; 4000 samples know a deviation to 1.1 %.
    assert stdev(x) == pytest.approx((0.6**2 + 1 / 12) ** 0.5, rel=0.05)
    assert fmean(x) == pytest.approx(1024.3, abs=5 * 0.67 / 4000**0.5)
    assert set(y) == {1024.0}


def test_twins_of_different_seeds_have_different_noise() -> None:
    def noise(seed: int) -> list[int]:
        bench = Bench(nominal(noise={"x": 30.0}, seed=seed))
        return [word(bench.frame(RDAX)) for _ in range(20)]

    assert noise(1) == noise(1)
    assert noise(1) != noise(2)


@settings(max_examples=30, deadline=None)
@given(cut=st.integers(0, 29), step=st.sampled_from([0.0, 1e-3, 10e-3, 0.0123456789]))
def test_a_killed_session_goes_on_with_the_bytes_it_would_have_had(cut: int, step: float) -> None:
    truth = D02.default_truth(3)
    frames = [RDAX, RDAY, RWTR] * 10

    def run(bench: Bench, frames: list[bytes]) -> list[bytes]:
        answers = []
        for frame in frames:
            answers.append(bench.frame(frame))
            bench.clock.sleep(step)
        return answers

    whole = run(Bench(truth), frames)
    before = Bench(truth)
    run(before, frames[:cut])
    assert run(Bench(truth, now_ns=before.clock.now_ns()), frames[cut:]) == whole[cut:]


@settings(max_examples=50, deadline=None)
@given(
    offset=st.floats(900, 1100),
    row=st.tuples(st.floats(500, 1700), st.floats(-60, 60), st.floats(-60, 60)),
    drift=st.floats(-0.5, 0.5),
    temperature=st.floats(-40, 85),
    direction=st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1)).filter(lambda d: hypot(*d) > 0.1),
)
def test_the_twin_agrees_with_the_part_that_was_written_apart_from_it(
    offset: float, row: tuple[float, float, float], drift: float, temperature: float, direction: tuple[float, ...]
) -> None:
    g = [component / hypot(*direction) for component in direction]
    part = Sca100tPart([offset, 1000.0], [list(row), [0, 700, 0]], [drift, 0.0], noise=0.0, jig=0.0, seed=1)
    part.pose(g, temperature)
    truth = nominal(
        offset={"x": offset, "y": 1000.0},
        sensitivity={"x": dict(zip("xyz", row, strict=True)), "y": {"y": 700.0}},
        drift={"x": (drift,)},
        reference=24.0,
        ambient=temperature,
    )
    bench = Bench(truth)
    bench.fixture.move((g[0], g[1], g[2]))
    for frame in (RDAX, RDAY):
        theirs = part.transfer(frame, bench.clock.now_ns(), bench.clock.now_ns())
        # Where a value lies on the edge between two counts, the order of the sum decides.
        assert abs(word(bench.frame(frame)) - word(theirs)) <= (0 if frame == RDAY else 1)
    assert bench.frame(RWTR)[1] == part.transfer(RWTR, 0, 0)[1]


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("model", [D01, D02])
def test_the_self_test_deflects_and_recovers(model, seed: int) -> None:
    bench = Bench(model.default_truth(seed)).tilt()
    for channel in ("x", "y"):
        result = bench.sensor.self_test(channel)
        assert result.passed, result
        assert abs(result.after - result.before) <= 4


def test_the_push_of_one_axis_leaves_the_other_alone() -> None:
    bench = Bench(nominal())
    bench.frame(b"\x0e")
    bench.clock.sleep(25e-3)
    assert word(bench.frame(RDAX)) >= 1945
    assert word(bench.frame(RDAY)) == 1024
    bench.frame(b"\x0f")
    bench.clock.sleep(1.0)
    assert word(bench.frame(RDAX)) == 1024
    assert word(bench.frame(RDAY)) == 2047


def test_below_level_the_push_ends_one_g_above() -> None:
    bench = Bench(nominal()).tilt(x=-30.0)
    bench.frame(b"\x0e")
    bench.clock.sleep(1.0)
    assert word(bench.frame(RDAX)) == round(1024 + 819 * (-0.5 + 1.0))


@pytest.mark.parametrize(("kind", "error"), [("parity", DeviceFault), ("silent", BusError), ("unplugged", BusError)])
def test_a_fault_comes_and_goes(kind: str, error: type[Exception]) -> None:
    bench = Bench(nominal(faults=(Fault(kind, 1.0, 2.0),)))
    bench.sensor.read()
    bench.clock.seek(1_000_000_000)
    with pytest.raises(error):
        bench.sensor.read()
    bench.clock.seek(2_000_000_000)
    assert bench.sensor.read().values == (1024.0, 1024.0)


def test_a_stuck_reading_neither_moves_nor_rushes() -> None:
    bench = Bench(nominal(noise={"x": 30.0, "y": 30.0}, faults=(Fault("stuck", 1.0, 2.0),)))
    bench.clock.seek(1_000_000_000)
    held = {bench.sensor.read().values for _ in range(20)}
    assert len(held) == 1
    assert bench.tilt(x=45.0).sensor.read().values in held


def offcorr(t: float) -> float:
    """Mean offset of the population over temperature, degrees: the datasheet's curve, typed again."""
    return -0.0000006 * t**3 + 0.0001 * t**2 - 0.0039 * t + 0.0522


def scorr(t: float) -> float:
    """Mean change of the sensitivity of the population, %, likewise."""
    return -0.00011 * t**2 + 0.0022 * t + 0.0408


@pytest.mark.parametrize(
    ("model", "offset_limit", "bend_limit", "range_g"), [(D01, 0.11, 0.11, 0.5), (D02, 0.23, 0.57, 1.0)]
)
def test_drawn_parts_keep_the_datasheets_tolerances(model, offset_limit, bend_limit, range_g) -> None:
    parts = [model.default_truth(seed) for seed in range(300)]
    for part in parts:
        for channel in "xy":
            row = part.sensitivity[channel]
            own = row[channel]
            assert abs(part.offset[channel] - 1024.0) <= model.sensitivity * sin(radians(offset_limit))
            assert abs(own / model.sensitivity - 1.0) <= 0.005
            assert hypot(*(k for axis, k in row.items() if axis != channel)) <= 0.04 * own
            quadratic, cubic = part.nonlinearity[channel]
            assert abs(quadratic) * range_g**2 + abs(cubic) * range_g**3 <= sin(radians(bend_limit))
            for t in range(-40, 126, 5):
                own_drift = part.reading(channel, (0, 0, 0), t) - part.offset[channel]
                mean_drift = model.sensitivity * radians(offcorr(t) - offcorr(25.0))
                assert abs(own_drift - mean_drift) <= model.sensitivity * radians(0.86)
    spread = stdev(part.offset["x"] for part in parts) / model.sensitivity
    assert spread == pytest.approx(model.offset_spread, rel=0.1)
    spread = stdev(part.sensitivity["y"]["y"] for part in parts) / model.sensitivity
    assert spread == pytest.approx(model.sensitivity_spread, rel=0.1)


def test_drawn_parts_drift_as_the_population_does() -> None:
    parts = [D01.default_truth(seed) for seed in range(400)]
    for t in (-25.0, 60.0, 85.0):
        drift = fmean(part.reading("x", (0, 0, 0), t) - part.offset["x"] for part in parts)
        # The mean of 400 slopes, even within ±0.008 °/°C, is known to 0.0046 / 20 °/°C.
        expected = 1638.0 * radians(offcorr(t) - offcorr(25.0))
        assert drift == pytest.approx(expected, abs=5 * 1638.0 * radians(0.0046 / 20 * abs(t - 25.0)))
        gain = fmean(sum(k * (t - 25.0) ** (n + 1) for n, k in enumerate(part.gain["x"])) for part in parts)
        expected = (1 + scorr(t) / 100) / (1 + scorr(25.0) / 100) - 1
        assert gain == pytest.approx(expected, abs=5 * 0.01 * 0.0081 / 20 * abs(t - 25.0))


@given(st.lists(st.integers(-9, 9), min_size=1, max_size=5), st.integers(-9, 9), st.integers(-9, 9))
def test_recentred_polynomials_are_the_same_polynomials(coefficients: list[int], centre: int, t: int) -> None:
    moved = recentred(tuple(map(float, coefficients)), centre)
    assert sum(k * (t - centre) ** n for n, k in enumerate(moved)) == sum(k * t**n for n, k in enumerate(coefficients))


def test_a_jig_misses_a_position_by_its_angle() -> None:
    fixture = Fixture(VirtualClock(), seed=4, jig=0.5)
    misses = []
    for _ in range(2000):
        fixture.move((0.0, 1.0, 0.0))
        fixture.move((0.0, 0.0, 1.0))
        misses.append(fixture.gravity[0])
    assert stdev(misses) == pytest.approx(sin(radians(0.5)), rel=0.08)
    assert abs(fmean(misses)) < 5 * sin(radians(0.5)) / 2000**0.5
    assert hypot(*fixture.gravity) == pytest.approx(1.0, abs=1e-12)


def test_a_position_that_is_held_keeps_its_angle_error() -> None:
    fixture = Fixture(VirtualClock(), seed=4, jig=0.5)
    fixture.move((0.0, 0.0, 1.0), temperature=24.0)
    before = fixture.gravity
    fixture.move((0.0, 0.0, 1.0), temperature=5.5)
    assert fixture.gravity == before


def test_the_chamber_approaches_its_set_point() -> None:
    clock = VirtualClock()
    fixture = Fixture(clock, ambient=24.0, time_constant=10.0)
    fixture.move((cos(0.0), 0.0, 0.0), temperature=4.0)
    assert fixture.temperature() == 24.0
    clock.sleep(10.0)
    assert fixture.temperature() == pytest.approx(4.0 + 20.0 * 0.367879, abs=1e-4)

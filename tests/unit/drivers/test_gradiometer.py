"""Four accelerometers on a rotary stage: the model, and the virtual stage that prints their lines."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tiltcal.bench.virtual_bench import truth_of
from tiltcal.drivers import find_model
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.drivers.device import Model, Sensor
from tiltcal.drivers.twin.gradiometer import Disk, Gradiometer, StageTruth
from tiltcal.drivers.twin.truth import Fault, Truth
from tiltcal.errors import BusError, InputError, UsageError
from tiltcal.files.twin import read_twin

TWIN = """\
tiltcal: 1
kind: twin
model: gradiometer
seed: 5
truth:
  disk:
    inclination: 30
    spin: 0.25
    rate: 20
    gradient: {differential: 2e-6, cross: 1e-6}
    accelerometers:
      a1: {scale: 3.0, misalignment: 1.5, offset: 0.5}
      a2: {scale: 3.1}
      a3: {scale: 3.2, phase_error: 0.2}
      a4: {scale: 3.3, drift: 1e-5, second_order: 0.1}
  faults:
    - {kind: stuck, start: 2, end: 3}
"""


def wired(address: str, truth: Truth | None = None) -> tuple[Model, Sensor, VirtualClock]:
    where = parse_address(address)
    model = find_model("gradiometer").at(where)
    clock = VirtualClock()
    held: object = None
    link = model.twin(truth or truth_of(where, model), held, clock)  # type: ignore[arg-type]
    return model, model.driver(link, clock), clock


def test_a_line_is_the_next_sample_of_the_disk() -> None:
    model, sensor, clock = wired("sim:?seed=3")
    assert model.channels == ("theta", "a1", "a2", "a3", "a4")
    assert not model.senses_tilt
    truth = truth_of(parse_address("sim:?seed=3"), model)
    assert isinstance(truth, StageTruth)
    disk = Gradiometer(truth.disk, 3)
    sensor.read()
    for number in range(2, 6):
        expected = disk.sample(number)
        read = sensor.read()
        assert clock.now_ns() / 1e9 == pytest.approx(number / 50, abs=0.01)
        assert read.values == pytest.approx((expected.theta, *expected.readings), rel=1e-8)


def test_the_columns_of_the_address_are_printed_what_it_has_not_reads_0() -> None:
    model, sensor, _ = wired("sim:columns=a4,other,-,theta,time&separator=semicolon")
    assert model.channels == ("a4", "other", "theta")
    sensor.read()
    assert sensor.read().values[1] == 0.0


def test_one_seed_is_one_disk_and_another_is_another() -> None:
    model = find_model("gradiometer")
    first, again, other = (truth_of(parse_address(f"sim:?seed={seed}"), model) for seed in (3, 3, 4))
    assert first == again != other


def test_a_twin_file_says_what_the_disk_is(tmp_path: Path) -> None:
    (tmp_path / "disk.yaml").write_text(TWIN)
    named, truth = read_twin(tmp_path / "disk.yaml")
    assert named == "gradiometer"
    assert isinstance(truth, StageTruth)
    disk = truth.disk
    assert (disk.spin, disk.rate, disk.gradient, disk.noise) == (0.25, 20.0, (2e-6, 1e-6), Disk().noise)
    assert disk.inclination == pytest.approx(0.5235988)
    assert [part.scale for part in disk.accelerometers] == [3.0, 3.1, 3.2, 3.3]
    assert disk.accelerometers[0].misalignment == pytest.approx(0.02617994)
    assert (disk.accelerometers[3].drift, disk.accelerometers[3].second_order) == (1e-5, 0.1)
    assert truth.faults == (Fault("stuck", 2.0, 3.0),)
    _, sensor, _ = wired(f"sim:twin={tmp_path / 'disk.yaml'}")
    angles = [sensor.read().values[0] for _ in range(80)]
    # Stuck from 2 s to 3 s: the same line 20 times over.
    assert max(angles.count(angle) for angle in angles) == 20


def test_it_can_be_unplugged() -> None:
    truth = replace(StageTruth.of(Disk(), 0), faults=(Fault("unplugged", 0.0, 1.0),))
    _, sensor, _ = wired("sim:", truth)
    with pytest.raises(BusError, match="unplugged"):
        sensor.read()


@pytest.mark.parametrize(
    ("old", "new", "line", "key", "about"),
    [
        ("rate: 20", "rate: 500", 9, "truth.disk.rate", "at most 400"),
        ("rate: 20", "rate: 0", 9, "truth.disk.rate", "at least 0.001"),
        ("spin: 0.25", "spins: 0.25", 8, "truth.disk.spins", "did you mean 'spin'"),
        ("a2: {scale: 3.1}", "a2: {}", 13, "truth.disk.accelerometers.a2", "'scale' is missing"),
        ("      a2: {scale: 3.1}\n", "", 11, "truth.disk.accelerometers", "'a2' is missing"),
        ("differential: 2e-6, ", "", 10, "truth.disk.gradient", "'differential' is missing"),
        ("spin: 0.25", "noise: -1", 8, "truth.disk.noise", "at least 0"),
    ],
)
def test_what_is_wrong_in_the_twin_file_is_named(
    old: str, new: str, line: int, key: str, about: str, tmp_path: Path
) -> None:
    path = tmp_path / "disk.yaml"
    assert old in TWIN
    path.write_text(TWIN.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_twin(path)
    assert (caught.value.line, caught.value.key) == (line, key)
    assert about in caught.value.message


def test_a_twin_of_another_kind_is_refused(tmp_path: Path) -> None:
    (tmp_path / "tilt.yaml").write_text("tiltcal: 1\nkind: twin\ntruth: {offset: {x: 0}, sensitivity: {x: {x: 1}}}\n")
    with pytest.raises(UsageError, match="has no theta and no a1"):
        wired(f"sim:twin={tmp_path / 'tilt.yaml'}")
    (tmp_path / "disk.yaml").write_text(TWIN.replace("model: gradiometer\n", ""))
    with pytest.raises(UsageError, match="has no x and no y, which a sca100t-d02 reads"):
        truth_of(parse_address(f"sim:twin={tmp_path / 'disk.yaml'}"), find_model("sca100t-d02"))

"""The twin file says what a virtual sensor really is."""

from pathlib import Path

import pytest
from support.refused import require_refused

from tiltcal.bench.devices import truth_of
from tiltcal.drivers import find_model
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.stage import StageTruth
from tiltcal.drivers.virtual import Fault, Truth
from tiltcal.errors import UsageError
from tiltcal.files.twin import read_twin

FILE = """\
tiltcal: 1
kind: twin
model: sca100t-d02
seed: 7
truth:
  offset: {y: 1021.9, x: 1024.6}
  sensitivity:
    x: {x: 818.2, y: 9.1, z: 2}
    y: {x: -6.4, y: 820.7, z: -1.5}
  temperature: {reference: 24, offset: {x: [0.21, 1e-3]}, sensitivity: {y: [1e-5]}}
  nonlinearity: {x: [0.002, -0.004]}
  noise: {x: 0.6}
  thermometer_error: -0.5
  jig: 0.01
  ambient: 20
  time_constant: 300
  faults:
    - {kind: parity, start: 12, end: 12.5}
"""


def read(tmp_path: Path, text: str, seed: int | None = None) -> tuple[str | None, Truth]:
    path = tmp_path / "twin.yaml"
    path.write_text(text)
    return read_twin(path, seed)


def test_everything_is_read(tmp_path: Path) -> None:
    assert read(tmp_path, FILE) == (
        "sca100t-d02",
        Truth(
            channels=("x", "y"),
            offset={"x": 1024.6, "y": 1021.9},
            sensitivity={"x": {"x": 818.2, "y": 9.1, "z": 2.0}, "y": {"x": -6.4, "y": 820.7, "z": -1.5}},
            reference=24.0,
            drift={"x": (0.21, 0.001)},
            gain={"y": (1e-5,)},
            nonlinearity={"x": (0.002, -0.004)},
            noise={"x": 0.6},
            thermometer_error=-0.5,
            seed=7,
            jig=0.01,
            ambient=20.0,
            time_constant=300.0,
            faults=(Fault("parity", 12.0, 12.5),),
        ),
    )


DISK = """\
tiltcal: 1
kind: twin
model: gradiometer
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
      a4: {scale: 3.3}
"""


@pytest.mark.parametrize(("kind", "text"), [("twin", FILE), ("disk", DISK)])
def test_what_is_wrong_is_told_with_line_and_key(kind: str, text: str, tmp_path: Path) -> None:
    require_refused(kind, text, lambda text: read(tmp_path, text))


def test_a_rotary_stage_is_read(tmp_path: Path) -> None:
    model, truth = read(tmp_path, DISK)
    assert isinstance(truth, StageTruth)
    disk = truth.disk
    assert (model, disk.spin, disk.rate, disk.gradient) == ("gradiometer", 0.25, 20.0, (2e-6, 1e-6))
    assert [part.scale for part in disk.accelerometers] == [3.0, 3.1, 3.2, 3.3]
    angles = disk.inclination, disk.accelerometers[0].misalignment, disk.accelerometers[2].phase_error
    assert angles == pytest.approx((0.5235988, 0.02617994, 0.003490659))


def test_a_twin_of_another_kind_is_refused(tmp_path: Path) -> None:
    for text, model, why in (
        (FILE.replace("model: sca100t-d02\n", ""), "gradiometer", "has no theta and no a1"),
        (DISK.replace("model: gradiometer\n", ""), "sca100t-d02", "has no x and no y, which a sca100t-d02 reads"),
    ):
        (tmp_path / "other.yaml").write_text(text)
        with pytest.raises(UsageError, match=why):
            truth_of(parse_address(f"sim:twin={tmp_path / 'other.yaml'}"), find_model(model))

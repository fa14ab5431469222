"""Channels that are not what they are called; readings are simulated here, by hand."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import tiltcal
from tiltcal.calibration.calibrate import calibrate
from tiltcal.calibration.measurement import BenchUncertainty, MeasuredSensor, Measurement
from tiltcal.core.samples import SampleSummary
from tiltcal.errors import EstimateError, InputError
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity
from tiltcal.files.procedure import find_procedure

SENSOR = SensorIdentity("recorded", "S", "V", ("x", "y"))
PLANE = find_procedure("plane")
NOISE = 1e-4

Wiring = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def calibrated(wiring: Wiring, unit: str = "V") -> CalibrationRecord:
    """A sensor of 2 V/g and 2.5 V at level, whose channels are wired in some way."""
    rng = np.random.default_rng(1)
    measurements = []
    for position in PLANE.positions:
        true = 2.5 + 2.0 * np.array([position.gravity[0], position.gravity[1] + 0.01 * position.gravity[0]])
        mean = wiring(true) + rng.normal(0.0, NOISE, 2)
        summaries = {c: SampleSummary(float(v), 1e-3, 100, NOISE, 0.0, 9.0) for c, v in zip("xy", mean, strict=True)}
        measurements.append(Measurement(position.name, position.gravity, position.tilt, None, summaries))
    return calibrate([MeasuredSensor(SENSOR.replaced(unit=unit), measurements)], PLANE, BenchUncertainty(0.05))[0]


def remarks(wiring: Wiring) -> list[str]:
    about = ("x and y", "channel", "the sign of")
    return [note for note in calibrated(wiring).fit.notes if note.startswith(about)]


def test_a_sensor_wired_as_it_is_called_needs_no_remark() -> None:
    assert remarks(lambda true: true) == []


def test_two_copies_of_one_channel_are_refused() -> None:
    """Each with its own noise, so that the matrix can be inverted: tilt came out 64 degrees wrong with flag 1."""
    with pytest.raises(EstimateError, match=r"x and y answer to gravity alike.*two copies of one channel"):
        calibrated(lambda true: true[[0, 0]])


def test_a_copy_with_its_sign_turned_is_a_copy() -> None:
    with pytest.raises(EstimateError, match="two copies of one channel"):
        calibrated(lambda true: np.array([true[0], 5.0 - true[0]]))


def test_swapped_channels_are_remarked() -> None:
    (note,) = remarks(lambda true: true[::-1])
    assert note.startswith("x and y are swapped")


def test_a_turned_sign_is_remarked() -> None:
    (note,) = remarks(lambda true: np.array([true[0], 5.0 - true[1]]))
    assert note.startswith("the sign of y is turned")


@pytest.mark.parametrize(("unit", "per_g", "said"), [("g", 9.81, 2), ("m/s2", 1.0, 2), ("g", 1.1, 0), ("m/s2", 9.6, 0)])
def test_readings_in_another_unit_of_acceleration_are_remarked(unit: str, per_g: float, said: int) -> None:
    notes = calibrated(lambda true: true * per_g / 2.0, unit).fit.notes
    assert sum(note.endswith(f"are the readings in {unit}?") for note in notes) == said


def test_the_same_readings_twice_are_refused_where_no_sensitivity_is_determined() -> None:
    reversal = find_procedure("reversal")
    summary = SampleSummary(2.5, 1e-3, 100, NOISE, 0.0, 9.0)
    measurements = [
        Measurement(one.name, one.gravity, one.tilt, None, {"x": summary, "y": summary}, heading=one.heading)
        for one in reversal.positions
    ]
    with pytest.raises(EstimateError, match="x and y read the same in every position"):
        calibrate([MeasuredSensor(SENSOR, measurements)], reversal, BenchUncertainty(0.05))


class TestRails:
    """The SCA100T-D02 counts from 0 to 2047; a reading there may stand for any tilt beyond."""

    @pytest.mark.parametrize("reading", [2047.0, 14340.0])
    def test_a_position_at_the_rail_is_refused(self, reading: float) -> None:
        table = {
            "position": ["x-tilt1", "x-tilt2", "y-tilt1", "y-tilt2"],
            "x": [reading, 614.0, 1024.0, 1024.0],
            "y": [1024.0, 1024.0, 1434.0, 614.0],
        }
        with pytest.raises(EstimateError, match=f"x reads {reading:g} count in x-tilt1, at its rail or beyond"):
            tiltcal.fit("plane", table, serial="S-1", sensor="sca100t-d02", jig=0.1)

    def test_the_rails_of_the_base_count_too(self, tmp_path: Path) -> None:
        (tmp_path / "S-1.yaml").write_text(BASE)
        with pytest.raises(InputError, match=r"x reads 2500.1 in 8 of its rows, at its rail or beyond \(0 to 5\)"):
            tiltcal.fit("level", {"x": [2500.1, 2499.9] * 4, "y": [2450.1, 2449.9] * 4}, base=tmp_path / "S-1.yaml")


BASE = """\
tiltcal: 1
kind: tilt
sensor: {model: recorded, serial: S-1, unit: V, channels: [x, y]}
calibration:
  offset: {x: 2.5, y: 2.45}
  sensitivity: {x: {x: 2.0, y: 0.0}, y: {x: 0.0, y: 2.0}}
uncertainty:
  offset: {x: 0.001, y: 0.001}
limits: {reading: [0.0, 5.0]}
"""

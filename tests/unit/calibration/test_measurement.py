"""Channels that are not what they are called, simulated by hand."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from support.measured import mean_of, measured

from tiltcal.calibration.calibrate import calibrate
from tiltcal.calibration.measurement import BenchUncertainty, MeasuredSensor
from tiltcal.core.model import Array
from tiltcal.errors import EstimateError
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity
from tiltcal.files.procedure import find_procedure

SENSOR = SensorIdentity("recorded", "S", "V", ("x", "y"))
PLANE = find_procedure("plane")
NOISE = 1e-4


def calibrated(wiring: Callable[[Array], Array], unit: str = "V") -> CalibrationRecord:
    """A sensor of 2 V/g and 2.5 V at level, whose channels are wired in some way."""
    positions = measured(
        PLANE.positions,
        lambda one: wiring(2.5 + 2.0 * np.array([one.gravity[0], one.gravity[1] + 0.01 * one.gravity[0]])),
        np.random.default_rng(1),
        NOISE,
    )
    return calibrate([MeasuredSensor(SENSOR.replaced(unit=unit), positions)], PLANE, BenchUncertainty(0.05))[0]


def test_exchanged_and_turned_channels_are_remarked_and_two_copies_refused() -> None:
    """Copies have their own noise, so that the matrix can be inverted: tilt came out 64 degrees wrong with flag 1."""
    wirings: dict[str, Callable[[Array], Array]] = {
        "": lambda true: true,
        "x and y are swapped": lambda true: true[::-1],
        "the sign of y is turned": lambda true: np.array([true[0], 5.0 - true[1]]),
    }
    for said, wiring in wirings.items():
        notes = [note for note in calibrated(wiring).fit.notes if note.startswith(("x and y", "channel", "the sign"))]
        assert [note.startswith(said) for note in notes] == ([True] if said else [])
    for copy in (lambda true: true[[0, 0]], lambda true: np.array([true[0], 5.0 - true[0]])):
        with pytest.raises(EstimateError, match=r"x and y answer to gravity alike.*two copies of one channel"):
            calibrated(copy)


def test_readings_in_another_unit_are_remarked() -> None:
    """Beyond a factor of two; degrees are 57.3 a radian, and 0.5 at 30° are 0.955 of them."""
    for unit, per_g, half, said in (
        ("g", 9.8, "4.9 g for 0.5 g, which is 0.5 g", "in g"),
        ("m/s2", 1.0, "0.5 m/s2 for 0.5 g, which is 4.9 m/s2", "in m/s2"),
        ("g", 0.49, "0.245 g for 0.5 g, which is 0.5 g", "in g"),
        ("g", 29.0, "14.5 g for 0.5 g, which is 0.5 g", "degrees"),
        ("m/s2", 114.0, "57 m/s2 for 0.5 g, which is 4.9 m/s2", "degrees"),
        ("m/s2", 115.0, "57.5 m/s2 for 0.5 g, which is 4.9 m/s2", "in m/s2"),
        ("deg", 1.0, "0.477 deg for 0.5 g, which is 28.6 deg", "components of gravity, in g"),
        ("deg", 1000.0, "477 deg for 0.5 g, which is 28.6 deg", "in deg"),
        *(("g", 1.9, "", ""), ("g", 0.51, "", ""), ("m/s2", 9.6, "", ""), ("V", 100.0, "", "")),
    ):
        notes = calibrated(lambda true, per_g=per_g: true * per_g / 2.0, unit).fit.notes  # type: ignore[misc]
        told = [note for note in notes if "are the readings" in note]
        assert told == [f"{c} reads {half}: are the readings {said}?" for c in "xy" if half]


def test_a_channel_that_does_not_react_or_is_too_coarse_is_named_with_its_numbers() -> None:
    """Two positions along y, good to 0.1 mV: an expanded uncertainty of 1.96 √2 0.1 mV; a step of 0.2 V of 2 V/g."""
    dead = r"^y of S does not react to gravity: its sensitivity is 0\.000\d+ ± 0\.0002[89] V/g; see that the channel is"
    with pytest.raises(EstimateError, match=dead):
        calibrated(lambda true: np.array([true[0], 2.5]))
    coarse = measured(PLANE.positions, lambda one: 2.5 + 2.0 * np.array(one.gravity[:2]), np.random.default_rng(1), 0.0)
    coarse = [
        replace(one, summaries={c: replace(s, resolution=0.2) for c, s in one.summaries.items()}) for one in coarse
    ]
    notes = calibrate([MeasuredSensor(SENSOR, coarse)], PLANE, BenchUncertainty(0.05))[0].fit.notes
    said = "have a step of 0.2 V, 5.7° near level: give them with more digits"
    assert [note for note in notes if "digits" in note] == [f"the numbers of {c} {said}" for c in "xy"]


def test_the_same_readings_twice_are_refused_where_no_sensitivity_is_determined() -> None:
    reversal = find_procedure("reversal")
    measurements = [
        mean_of(one.name, one.gravity, (2.5, 2.5), NOISE, heading=one.heading) for one in reversal.positions
    ]
    with pytest.raises(EstimateError, match="x and y read the same in every position"):
        calibrate([MeasuredSensor(SENSOR, measurements)], reversal, BenchUncertainty(0.05))

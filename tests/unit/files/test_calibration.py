"""The calibration file of SPEC 9: what is read, checked and written."""

from math import radians

import numpy as np
import pytest
from support import FIXTURES
from support.refused import require_refused

from tiltcal.core.model import Mounting
from tiltcal.errors import InputError
from tiltcal.files.calibration import CalibrationRecord, SensorIdentity, read_calibration, tilt_record
from tiltcal.files.document import parse_document
from tiltcal.files.results import Provenance, WorstResidual

EXAMPLE = """\
tiltcal: 1
kind: tilt
sensor: {model: sca100t-d02, serial: 0042, unit: count, channels: [x, y]}
calibration:
  offset: {x: 1024.6, y: 1021.9}
  sensitivity:
    x: {x: 818.2, y: 9.1}
    y: {x: -6.4, y: 820.7}
  temperature:
    reference: 24.0
    range: [5.5, 24.0]
    offset: {x: [0.21], y: [-0.05, 1e-4]}
  mounting: {roll: 180, pitch: -2.5, yaw: 0.0}
uncertainty:
  offset: {x: 0.1, y: 0.1}
  covariance: {parameters: [offset.x, offset.y], matrix: [[0.01, 1e-8], [1e-8, 0.01]]}
limits: {tilt: [-60, 60], temperature: [0, 30], reading: {x: [101, 2047]}}
fit: {chi_square: 3.1, notes: [one], worst: {position: level, channel: x, residual: 2}}
positions: [{position: level, mean: {x: 1024.6}}]
"""


def read(text: str) -> CalibrationRecord:
    return tilt_record(parse_document(text, "c.yaml"))


def test_a_single_channel_may_have_other_columns() -> None:
    """What `plane` finds of a sensor with one axis."""
    head = "tiltcal: 1\nkind: tilt\nsensor: {model: m, serial: 7, unit: V, channels: [x]}\n"
    text = head + "calibration: {offset: {x: 3.1}, sensitivity: {x: {x: 6554.0, y: 120.0}}}\n"
    coefficients = read(text).coefficients
    assert (coefficients.axes, coefficients.sensitivity.tolist()) == (("x", "y"), [[6554.0, 120.0]])
    with pytest.raises(InputError, match=r"2 columns \[y, z\] do not go with 1 channels"):
        read(text.replace("{x: 6554.0, y: 120.0}", "{y: 120.0, z: 4.0}"))


def test_angles_are_radians_inside_and_what_is_left_out_is_there() -> None:
    """All else of the example is in :data:`WRITTEN`, which is written from it."""
    calibration = read(EXAMPLE)
    thermal = calibration.coefficients.thermal
    assert thermal is not None
    np.testing.assert_array_equal(thermal.drift, [[0.21, 0.0], [-0.05, 1e-4]])
    assert thermal.gain.shape == (2, 0)
    assert calibration.coefficients.mounting == Mounting(roll=radians(180), pitch=radians(-2.5))
    assert calibration.limits.tilt == {"x": (radians(-60), radians(60)), "y": (radians(-60), radians(60))}
    assert calibration.sensor == SensorIdentity("sca100t-d02", "0042", "count", ("x", "y"))
    assert calibration.fit.worst == WorstResidual(position="level", channel="x", residual=2.0)
    assert calibration.provenance == Provenance()
    bent = read(EXAMPLE.replace("  mounting:", "  nonlinearity: {x: [0.44, 0.01], y: [-0.44]}\n  mounting:"))
    np.testing.assert_array_equal(bent.coefficients.nonlinearity, [[0.44, 0.01], [-0.44, 0.0]])


def test_errors_have_the_turn_of_a_mounting_in_radians() -> None:
    record = read_calibration(FIXTURES / "mounting.yaml")
    stated, errors = record.uncertainty.covariance, record.uncertainty.errors(record.coefficients.mounting)
    assert stated is not None
    unit = np.array([radians(1.0) if name.startswith("mounting.turn") else 1.0 for name in stated.parameters])
    assert (errors.names, sorted(set(unit))) == (stated.parameters, [radians(1.0), 1.0])
    np.testing.assert_allclose(errors.covariance, np.array(stated.matrix) * np.outer(unit, unit), rtol=1e-12)
    np.testing.assert_allclose(errors.wide, np.array(stated.wide) * np.outer(unit, unit), rtol=1e-12)


def test_what_is_wrong_is_told_with_line_and_key() -> None:
    require_refused("tilt", EXAMPLE, read)


WRITTEN = """\
tiltcal: 1
kind: tilt
sensor: {model: sca100t-d02, serial: "0042", unit: count, channels: [x, "y"]}
calibration:
  offset: {x: 1024.6, "y": 1021.9}              # count, at the reference temperature
  sensitivity:                                  # count/g, row = channel, column = axis
    x: {x: 818.2, "y": 9.1}
    "y": {x: -6.4, "y": 820.7}
  temperature:
    reference: 24.0                             # °C
    range: [5.5, 24.0]                          # °C
    offset: {x: [0.21, 0.0], "y": [-0.05, 0.0001]}  # count/°C, count/°C², ...
  mounting: {roll: 180.0, pitch: -2.5, yaw: 0.0}  # degrees
uncertainty:                                    # standard uncertainty, k = 1
  offset: {x: 0.1, "y": 0.1}
  covariance:
    parameters: [offset.x, offset.y]
    matrix:
      - [0.01, 1.0e-08]
      - [1.0e-08, 0.01]
limits:                                         # the ranges that were covered, degrees and °C
  tilt: {x: [-60.0, 60.0], "y": [-60.0, 60.0]}
  temperature: [0.0, 30.0]
  reading: {x: [101.0, 2047.0]}
derived: {}
fit:
  worst: {position: level, channel: x, residual: 2.0}
  chi_square: 3.1
  notes: [one]
procedure: {}
positions:
  - position: level
    mean: {x: 1024.6}
provenance: {}
"""


def test_file_is_written_as_the_specification_shows() -> None:
    assert read(EXAMPLE).text == read(WRITTEN).text == WRITTEN


def test_every_calibration_of_ours_is_written_as_it_was_read() -> None:
    """Of two and three channels, with temperature, mounting, level, free positions and ramps."""
    paths = [path for path in sorted(FIXTURES.glob("*.yaml")) if "kind: tilt" in path.read_text(encoding="utf-8")]
    assert len(paths) > 10
    for path in paths:
        assert read_calibration(path).text == path.read_text(encoding="utf-8"), path

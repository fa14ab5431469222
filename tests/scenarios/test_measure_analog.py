"""Analog sensors through whole procedures on the virtual bench."""

import json
from pathlib import Path

import pytest
from support.command import tiltcal

from tiltcal.drivers import find_model
from tiltcal.files.calibration import read_calibration

CASES = [
    ("sca100t-d01-analog", "plane", "sim:?seed=3"),
    ("sca100t-d02-analog", "mavs", "sim:vdd=5&seed=3"),
    ("adxl202-analog", "mavs", "sim:?seed=3"),
    ("adxl210-analog", "cross-axis", "sim:vdd=5&seed=3"),
]


@pytest.mark.parametrize(("model", "procedure", "address"), CASES)
def test_it_finds_the_twin(model: str, procedure: str, address: str, tmp_path: Path) -> None:
    place = ["--sensor", model, "--address", address, "--serial", "S-7", "-o", "S-7.yaml", "--operator", "sim"]
    quick = [] if procedure == "mavs" else ["--samples", "30", "--settle", "0.2"]
    result = tiltcal("measure", procedure, *place, *quick, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    read = read_calibration(tmp_path / "S-7.yaml")
    truth = find_model(model).default_truth(3)
    for row, channel in enumerate("xy"):
        own = read.coefficients.axes.index(channel)
        # Two parts in a hundred leave room for what a procedure cannot tell: nonlinearity, cross-axis terms.
        assert read.coefficients.sensitivity[row, own] == pytest.approx(truth.sensitivity[channel][channel], rel=0.02)
        if procedure == "mavs":
            # Of a cubic drift the line between two temperatures is found, at either end of it.
            drift = truth.reading(channel, (0, 0, 1), 24.0) - truth.reading(channel, (0, 0, 1), 5.5)
            assert read.coefficients.thermal.drift[row, 0] == pytest.approx(drift / 18.5, abs=3e-5)


def test_probe_of_a_thermistor(tmp_path: Path) -> None:
    result = tiltcal("probe", "--sensor", "thermistor", "--address", "sim:", "--json", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert json.loads(result.stdout)["answers"]["temperature"] == "24.0 °C"

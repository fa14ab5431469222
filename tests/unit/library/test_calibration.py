"""What a program holds of a calibration file."""

import pickle
import re
from collections.abc import Callable
from copy import copy, deepcopy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import FIXTURES

import tiltcal
from tiltcal.drivers import find_model
from tiltcal.errors import InputError
from tiltcal.library.calibration import Calibration, read

FILE = """\
tiltcal: 1
kind: tilt
sensor: {model: sca100t-d02, serial: S-0042, unit: count, channels: [x, y]}
calibration:
  offset: {x: 1024.6, y: 1021.9}
  sensitivity:
    x: {x: 818.2, y: 9.1}
    y: {x: -6.4, y: 820.7}
uncertainty:
  offset: {x: 0.4, y: 0.5}
  sensitivity: {x: {x: 1.2, y: 0.1}, y: {x: 0.2, y: 1.3}}
limits:
  tilt: {x: [-30, 30]}
"""


@pytest.fixture
def calibration(tmp_path: Path) -> Calibration:
    path = tmp_path / "S-0042.yaml"
    path.write_text(FILE, encoding="utf-8")
    return read(path)


def test_coefficients_are_named(calibration: Calibration) -> None:
    assert calibration.offset == {"x": 1024.6, "y": 1021.9}
    assert (calibration.sensitivity["x", "y"], calibration.sensitivity["y", "x"]) == (9.1, -6.4)
    assert (calibration.uncertainty["offset.x"], calibration.uncertainty["sensitivity.y.y"]) == (0.4, 1.3)


@pytest.mark.parametrize("name", ["mavs", "multi-angle"])
def test_arrays_cannot_be_changed(name: str) -> None:
    """A drift and a nonlinearity are among them."""
    coefficients = read(FIXTURES / f"{name}.yaml").coefficients
    thermal = coefficients.thermal
    terms = [] if thermal is None else [thermal.drift, thermal.gain]
    shares = [] if coefficients.nonlinearity is None else [coefficients.nonlinearity]
    assert terms or shares
    for array in (coefficients.offset, coefficients.sensitivity, *terms, *shares):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


@pytest.mark.parametrize("copied", [copy, deepcopy, lambda calibration: pickle.loads(pickle.dumps(calibration))])
def test_a_copy_is_equal_and_cannot_be_changed(copied: Callable[[Calibration], Calibration]) -> None:
    original = read(FIXTURES / "mavs.yaml")
    found = copied(original)
    assert found == original
    assert hash(found) == hash(original)
    assert not found.coefficients.offset.flags.writeable


def test_limits_have_the_rails_of_the_model_where_the_file_names_none(calibration: Calibration) -> None:
    assert calibration.limits.tilt["x"] == pytest.approx((-30.0, 30.0))
    assert calibration.limits.reading == dict.fromkeys(("x", "y"), find_model("sca100t-d02").rails)
    result = calibration.compensation()(np.array([[0.0, 1021.9]]))
    assert (int(result.flag[0]), int(result.reason[0]) & 4) == (4, 4)


def test_a_notebook_shows_calibration_plan_comparison_and_figure() -> None:
    cal = read(FIXTURES / "complete.yaml")
    for shown in (cal, tiltcal.plan("zero-45", sensor="sca100t-d02"), tiltcal.compare(cal, cal)):
        head = re.split(r"\s{2,}", str(shown).splitlines()[1][2:])
        rows = [
            re.findall(r'<td style="text-align:left"(?: colspan="(\d+)")?>', row)
            for row in shown._repr_html_().split("<tr>")[1:]
        ]
        assert {len(row) - 1 + int(row[-1]) for row in rows} == {max(map(len, rows))}
        assert "".join(f">{cell}</td>" for cell in head) in re.sub(r"<td [^>]*", "", shown._repr_html_())
        assert isinstance(shown, tiltcal.Calibration) or repr(shown) == str(shown)
    assert ">chi_square</td>" in cal.fit._repr_html_() or ">degrees_of_freedom</td>" in cal.fit._repr_html_()
    assert ">tilt x</td>" in cal.limits._repr_html_()
    shown = cal.plot()._repr_html_()
    assert "error, data sheet [°]" in shown
    assert "95 % interval, calibrated" in shown
    recorded = Calibration(replace(cal.record, sensor=cal.sensor.replaced(model="recorded")))
    assert "no data sheet of a model recorded is known" in recorded.plot()._repr_html_()


def test_what_is_no_calibration_is_called_what_it_is(calibration: Calibration, tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("x,y\n1,2\n", encoding="utf-8")
    one = FILE.replace("[x, y]", "[x]").replace(", y: 1021.9", "").replace(", y: 9.1}\n    y: {x: -6.4, y: 820.7}", "}")
    (tmp_path / "one.yaml").write_text(one.partition("uncertainty")[0] + "  mounting: {roll: 90}\n", encoding="utf-8")
    for path, why in ((FIXTURES / "mavs.journal.jsonl", "journal of a session: tiltcal replay"),
                      (tmp_path / "log.csv", "a log: tiltcal apply"),
                      (tmp_path / "one.yaml", "one.yaml: a mounting rotation takes a sensor")):  # fmt: skip
        with pytest.raises(InputError, match=why):
            read(path)
    with pytest.raises(KeyError, match="two indices, channel and axis"):
        calibration.sensitivity["x"]  # type: ignore[index]

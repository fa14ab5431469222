"""Logs of one session: what they are together, their signs, and what the length of gravity says of their unit."""

from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
from support import FIXTURES

import tiltcal
from tiltcal.core.model import values
from tiltcal.errors import UsageError
from tiltcal.files.calibration import read_calibration
from tiltcal.files.results import LogRecord
from tiltcal.files.tables import Segment
from tiltcal.library.calibration import Calibration
from tiltcal.logs.recordings import (
    length_remark,
    of_raw_readings,
    open_recordings,
    split_signs,
    unit_of_length,
    upside_down_remark,
)


def test_several_logs_are_one_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A temperature that one of them lacks is left out of all, which is said."""
    monkeypatch.chdir(tmp_path)
    texts = {"a.csv": "x,y,temperature\n1,2,20\n3,4,20\n5,6,21\n", "b.csv": "y,x\n8,7\n10,9\n"}
    for name, text in texts.items():
        Path(name).write_text(text)
    with open_recordings(["up=a.csv", " down =b.csv"], skip_bad_rows=False, progress=None) as logs:
        record, segments = logs.read("xy", "", "V")
        assert [column.tolist() for column in record.of("xy")] == [[1, 3, 5, 7, 9], [2, 4, 6, 8, 10]]
        assert (record.name, [*record.by_role], len(record)) == ("the 2 logs", ["x", "y"], 5)
        assert segments == [Segment("up", 0, 3, None, None), Segment("down", 3, 5, None, None)]
        assert logs.remarks == ["temperature is left out of all logs: there is none in b.csv"]
        sums = {name: sha256(text.encode()).hexdigest() for name, text in texts.items()}
        of_both = tuple(LogRecord(name=n, sha256=sums[n], rows=rows) for n, rows in (("a.csv", 3), ("b.csv", 2)))
        assert logs.provenance(record) == {"logs": of_both}
    with open_recordings("a.csv", skip_bad_rows=False, progress=None) as logs:
        record, segments = logs.read("xy", "", "V")
        assert (logs.name, [*record.by_role], segments, logs.remarks) == ("a.csv", ["x", "y", "temperature"], [], [])
        assert logs.provenance(record, 2) == {"log": of_both[0].replaced(missing=2)}
    for paths, said in (
        ([], "no log is given"),
        (["a.csv", "up=b.csv"], "a.csv has no name of a position, and others have one: write NAME=a.csv, or name none"),
    ):
        with pytest.raises(UsageError) as refused, open_recordings(paths, skip_bad_rows=False, progress=None):
            pass
        assert str(refused.value) == said


def test_signs_of_columns() -> None:
    """A column whose own name begins with a minus is that column."""
    assert split_signs("x=-a,y=-b,z=c,time=t", ["a", "-b", "c"]) == (
        {"x": "a", "y": "-b", "z": "c", "time": "t"}, {"x": -1.0}
    )  # fmt: skip


@pytest.mark.parametrize("name", ["temperature-sweep", "mounting"])
def test_a_calibration_of_turned_readings_is_one_of_the_readings(name: str) -> None:
    """It makes the same of them; its covariance, residuals and means are those of the readings."""
    known = read_calibration(FIXTURES / f"{name}.yaml")
    own = known.sensor.replaced(model="own")  # which has no rails
    turned = replace(known, sensor=own, limits=replace(known.limits, reading={}))
    assert of_raw_readings(turned, {}) is turned
    raw = of_raw_readings(turned, {"y": -1.0})
    frame = {
        "x": np.linspace(900.0, 1200.0, 7),
        "y": np.linspace(1100.0, 950.0, 7),
        "temperature": np.linspace(9, 30, 7),
    }
    found = Calibration(raw).apply(frame | {"y": -frame["y"]}, uncertainty=True)
    for column, expected in Calibration(turned).apply(frame, uncertainty=True).items():
        if column != "y":
            np.testing.assert_allclose(found[column], expected, rtol=1e-12, err_msg=column)
    changed = {name for name, value in values(raw.coefficients).items() if value != values(turned.coefficients)[name]}
    assert changed == {
        one for one in values(turned.coefficients) if one.startswith(CHANGED) and values(raw.coefficients)[one]
    }
    before, after = turned.uncertainty.covariance, raw.uncertainty.covariance
    sign = np.array([-1.0 if one.startswith(CHANGED) else 1.0 for one in before.parameters])
    np.testing.assert_array_equal(np.array(after.matrix), np.array(before.matrix) * np.outer(sign, sign))
    by_channel = {"x": 1.0, "y": -1.0}
    for position, row in turned.fit.residuals.items():
        assert raw.fit.residuals[position] == {channel: value * by_channel[channel] for channel, value in row.items()}
    worst = turned.fit.worst
    assert raw.fit.worst == worst.replaced(residual=worst.residual * by_channel[worst.channel])
    for one, other in zip(raw.positions, turned.positions, strict=True):
        assert one == other.replaced(mean={c: mean * by_channel[c] for c, mean in other.mean.items()})


CHANGED = ("offset.y", "sensitivity.y", "temperature.offset.y")


def test_a_sign_beside_a_known_sensor_is_refused() -> None:
    """Its rails and its nominal coefficients are of the readings as they are: each row was called at its rail."""
    log = {"x": [-1024.0, -1025.0], "y": [1024.0, 1025.0]}
    for procedure, known, named in (
        ("plane", {"sensor": "sca100t-d02"}, "sca100t-d02"),
        ("level", {"base": FIXTURES / "plane.yaml"}, "the base calibration"),
    ):
        with pytest.raises(UsageError) as refused:
            tiltcal.fit(procedure, log, serial="SIM-42", columns="x=-x", **known)
        said = f"columns turns the sign of x, and what {named} says is of its readings as they are: leave the minus out"
        assert str(refused.value) == said


def test_the_length_of_gravity_shows_its_unit() -> None:
    """In two attitudes that are apart, or in one alone; whole numbers are counts, and two axes show nothing."""
    for length, unit in ((1.0, "g"), (9.81, "m/s2"), (1000.0, "mg"), (981.0, "mg"), (64.0, None)):
        means = length * np.array([[1.0, 0, 0], [0, 0.96, 0.28]])
        columns = list(np.repeat(means + 0.013, 5, axis=0).T)
        assert unit_of_length(means, columns) == unit, length
        assert unit_of_length(means[:1], columns, alone=True) == unit
        assert unit_of_length(means[:1], columns) is None
    near = 9.81 * np.array([[1.0, 0, 0], [0.9, 0.435, 0], [0.0, 0.0, 1.06]])  # 26° apart, and 6 % longer
    assert unit_of_length(near[:2], columns) is unit_of_length(near[[0, 2]], columns) is None
    assert unit_of_length(near[[0, 2]] / [[1.0], [1.02]], columns) == "m/s2"
    assert unit_of_length(near, [np.array([9.0, 10.0])] * 3, alone=True) is None
    assert unit_of_length(near[:, :2], columns[:2], alone=True) is None
    assert unit_of_length(np.vstack([near, 30.0 * near]), columns, alone=True) is None  # half of them


def test_what_speaks_against_a_stated_unit() -> None:
    directions = np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, -1.0]])
    for length, unit, said in (
        (1.14, "g", None),
        (0.86, "g", None),
        (9.0, "m/s2", None),
        (9.81, "g", "at rest the readings are 9.81 g long, and gravity is 1 g: the unit is probably m/s2"),
        (1.17, "g", "at rest the readings are 1.17 g long, and gravity is 1 g: is this the unit?"),
        (4.0, "m/s2", "at rest the readings are 4 m/s2 long, and gravity is 9.80665 m/s2: is this the unit?"),
        (
            0.29,
            "g",
            "at rest the readings are 0.29 g long, and gravity is 1 g: without gravity, as linear acceleration is, "
            "nothing can be calibrated",
        ),
        (300.0, "count", None),
    ):
        means = length * directions
        assert length_remark(means, unit, list((means + 0.003).T)) == said
    assert length_remark(means[:, :2], "g", []) is length_remark(None, "g", []) is None


def test_a_longest_hold_upside_down_is_said() -> None:
    known = read_calibration(FIXTURES / "six-face.yaml")
    down = next(name for name, one in known.procedure.set.items() if (one.gravity or (0, 0, 0))[2] == -1.0)
    assert upside_down_remark(known) is None
    longest = tuple(one.replaced(n=1000) if one.position == down else one for one in known.positions)
    assert upside_down_remark(replace(known, positions=longest)) == (
        f"the longest hold, {down}, is upside down: if the device lay face up there, its signs are reversed, as phones "
        "of one maker have them; then fit again with --columns x=-NAME,y=-NAME,z=-NAME"
    )
    assert upside_down_remark(replace(known, positions=())) is None

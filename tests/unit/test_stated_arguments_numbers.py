"""What the command line refuses as an option, the library refuses as an argument, with the same error."""

from __future__ import annotations

from collections.abc import Callable
from math import inf, nan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import FIXTURES
from support.command import tiltcal as command

import tiltcal
from tiltcal.errors import UsageError

FACES = {"position": ["level", "x-45", "y-45"], "x": [2.5, 3.9, 2.5], "y": [2.5, 2.5, 3.9]}
STILL = {"x": np.random.default_rng(1).normal(size=100)}
ROW = {"x": [1024.0], "y": [1024.0], "temperature": [20.0]}


def apply(**options: Any) -> None:
    tiltcal.read(FIXTURES / "mavs.yaml").apply(ROW, **options)


def fit(**options: Any) -> None:
    tiltcal.fit("zero-45", FACES, **{"serial": "S-1", "unit": "V", **options})


def noise(**options: Any) -> None:
    tiltcal.noise(STILL, **{"rate": 100.0, "unit": "m/s2", **options})


def plan(**options: Any) -> None:
    tiltcal.plan("zero-45", sensor="sca100t-d02", **options)


def plan_of_free_angle(**options: Any) -> None:
    tiltcal.plan("plane", sensor="sca100t-d02", **options)


def level(**options: Any) -> None:
    tiltcal.fit("level", ROW, base=FIXTURES / "mavs.yaml", **options)


def free(**options: Any) -> None:
    tiltcal.fit("free", STILL, serial="S-1", unit="V", **options)


def rotation(**options: Any) -> None:
    sensor = {"sensor": "gradiometer", "address": "sim:", "serial": "G-1", "output": "pairs.yaml"}
    tiltcal.measure("rotation", operator="sim", **sensor, **options)


@pytest.mark.parametrize("value", [-1, nan, inf, "a", 10**310])
@pytest.mark.parametrize(
    ("function", "argument"),
    [
        (apply, "reading_noise"),
        (apply, "average"),
        (fit, "jig"),
        (fit, "table_lean"),
        (fit, "gravity"),
        (noise, "rate"),
        (noise, "target"),
        (plan, "jig"),
        (plan, "noise"),
        (plan, "samples"),
        (plan_of_free_angle, "tilt"),
        (level, "alignment"),
        (free, "window"),
        (rotation, "turns"),
    ],
)
def test_no_number_for_it(function: Callable[..., None], argument: str, value: object) -> None:
    named = "an angle of" if argument == "tilt" else f"--{argument.replace('_', '-')}"
    with pytest.raises(UsageError, match=named):
        function(**{argument: value})


@pytest.mark.parametrize("options", [{"samples": 1}, {"samples": 2.5}, {"settle": 0}, {"settle": nan}, {"serial": " "}])
def test_a_session_that_nobody_can_measure(options: dict[str, Any], tmp_path: Path) -> None:
    sensor = {"sensor": "sca100t-d02", "address": "sim:", "serial": "S-1", "output": tmp_path / "S-1.yaml"}
    with pytest.raises(UsageError):
        tiltcal.measure("plane", operator="sim", **sensor | options)
    assert not any(tmp_path.iterdir())


def test_numbers_of_numpy_are_those_of_python(tmp_path: Path) -> None:
    """0.125 is one number in every type; the files and the journals are the same to the byte."""
    sensor = {"sensor": "sca100t-d02", "address": "sim:seed=3", "serial": "S-1", "operator": "sim"}
    kinds = {"python": (int, float), "numpy": (np.int64, np.float32)}
    for name, (whole, number) in kinds.items():
        (tmp_path / name).mkdir()
        tiltcal.measure(
            "plane",
            output=tmp_path / name / "S-1.yaml",
            samples=whole(20),
            jig=number(0.125),
            tilt=number(30),
            **sensor,
        )
    written = [(tmp_path / name / "S-1.yaml").read_bytes() for name in kinds]
    assert written[0] == written[1]
    stated = FACES | {"ux": [0.01] * 3, "uy": [0.01] * 3}
    fits = [tiltcal.fit("zero-45", stated, serial="S-1", unit="V", jig=number(0.125)) for _, number in kinds.values()]
    assert fits[0] == fits[1]


@pytest.mark.parametrize("columns", [["x", "y"], 5])
def test_columns_without_roles(columns: Any) -> None:
    with pytest.raises(UsageError, match="--columns takes the column of each role"):
        apply(columns=columns)


def test_a_mounting_without_names() -> None:
    with pytest.raises(UsageError, match="--mounting takes angles by name"):
        apply(mounting=[180, 0, 0])


def test_results_are_shown_at_a_prompt_as_the_command_prints_them() -> None:
    tilt = tiltcal.read(FIXTURES / "mavs.yaml")
    assert isinstance(tilt, tiltcal.Calibration)
    for found in (tiltcal.plan("zero-45", sensor="sca100t-d02"), tiltcal.compare(tilt, tilt)):
        assert repr(found) == str(found)


def test_sizes_of_averages() -> None:
    with pytest.raises(UsageError, match="--averages takes a number of samples from 1 to"):
        noise(averages=[0])


@pytest.mark.parametrize("pairs", [[("a1", "a2")], ["a1,a2,a4"], "a1,a2,a4", ("a1", "a2", "a4")])
def test_pairs_that_are_none(pairs: Any) -> None:
    with pytest.raises(UsageError, match="a pair is three columns"):
        tiltcal.match({"a1": [1.0]}, pairs, phase="theta")


def test_a_pair_is_no_tilt_calibration() -> None:
    tilt, pair = tiltcal.read(FIXTURES / "mavs.yaml"), tiltcal.read(FIXTURES / "rotation.yaml")
    for function, given in ((tiltcal.compare, (tilt, pair)), (tiltcal.combine, ([tilt, pair],))):
        with pytest.raises(UsageError, match="tilt calibrations"):
            function(*given)


def test_an_empty_serial_number(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("position,x,y\nlevel,2.5,2.5\nx-45,3.9,2.5\ny-45,2.5,3.9\n")
    for words in (
        ["fit", "zero-45", "t.csv", "--table", "--unit", "V"],
        ["measure", "zero-45", "--sensor", "sca100t-d02", "--address", "sim:", "--operator", "sim"],
    ):
        done = command(*words, "--serial", "", "-o", "o.yaml", cwd=tmp_path)
        assert done.returncode == 2
        assert done.stderr.splitlines()[-1] == "tiltcal: the serial number is '': write a text"

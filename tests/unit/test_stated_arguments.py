"""What the command line refuses as an option, the library refuses as an argument, with the same error."""

from collections.abc import Callable
from math import inf, nan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import FIXTURES

import tiltcal
from tiltcal.errors import UsageError

MAVS = FIXTURES / "mavs.yaml"
ROW = {"x": [1024.0], "y": [1024.0], "temperature": [20.0]}
FACES = {"position": ["level", "x-45", "y-45"], "x": [2.5, 3.9, 2.5], "y": [2.5, 2.5, 3.9]}
SENSOR = {"sensor": "sca100t-d02", "address": "sim:seed=3", "serial": "S-1", "operator": "sim", "samples": 20}
DISK = {"sensor": "gradiometer", "address": "sim:", "serial": "G-1", "operator": "sim", "output": "pairs.yaml"}


def measure(output: Any = "S-1.yaml", **options: Any) -> object:
    return tiltcal.measure("plane", **SENSOR | {"output": output} | options)


CALLS: dict[str, Callable[..., object]] = {
    "apply": lambda **more: tiltcal.read(MAVS).apply(ROW, **more),
    "apply_log": lambda log="log.csv", **more: tiltcal.apply_log(MAVS, log, "tilt.csv", **more),
    "folder": lambda **more: tiltcal.open_calibrations(FIXTURES).apply(ROW, **{"serial": "S-1"} | more),
    "compensation": lambda **more: tiltcal.read(MAVS).compensation(**more),
    "fit": lambda **more: tiltcal.fit("zero-45", FACES, **{"serial": "S-1", "unit": "V"} | more),
    "free": lambda **more: tiltcal.fit("free", ROW, **{"serial": "S-1", "unit": "V"} | more),
    "level": lambda **more: tiltcal.fit("level", ROW, base=MAVS, **more),
    "noise": lambda **more: tiltcal.noise(ROW, **{"rate": 1.0, "unit": "g"} | more),
    "match": lambda pairs=(("a1", "a2", "a4"),), **more: tiltcal.match({"a1": [1.0]}, pairs, **more),
    "plan": lambda **more: tiltcal.plan("plane", **{"sensor": "sca100t-d02"} | more),
    "measure": measure,
    "rotation": lambda **more: tiltcal.measure("rotation", **DISK | more),
}

BOOLEANS = (
    "apply uncertainty, apply first_order, apply_log skip_bad_rows, folder uncertainty, compensation first_order, "
    "free table, noise skip_bad_rows, match online, match loops, plan closing, measure typical_temperature, "
    "measure closing, measure plain"
)
NUMBERS = (
    "apply reading_noise, apply average, fit jig, fit table_lean, fit gravity, noise rate, noise target, plan jig, "
    "plan noise, plan samples, plan tilt, level alignment, rotation turns, measure settle, measure samples"
)
OTHERS: list[tuple[str, str, Any, str]] = [
    ("apply", "unit", 5, "unit takes a text, not 5"),
    ("apply", "mounting", [180, 0, 0], "mounting takes angles by name"),
    ("apply", "magnetometer", 3, "magnetometer names three columns, along x, y and z, such as mx,my,mz; not 3"),
    ("apply_log", "log", 5, "the log is named by a text or a Path, not 5"),
    ("fit", "serial", "", "the serial number is '': write a text"),
    ("noise", "calibration", 5, "calibration takes a tilt calibration or its file, not 5"),
    ("match", "pairs", 5, "name a pair"),
    ("match", "pairs", [("a1", 2, "a4")], "a pair is three columns"),
    ("measure", "base", 5.5, "base is named by a text or a Path, not 5.5"),
    ("measure", "output", 5, "output is named by a text or a Path, not 5"),
    ("measure", "heading", "a", "heading takes 0 or a number from"),
]


def refusal(name: str, argument: str, value: object) -> str:
    with pytest.raises(UsageError) as refused:
        CALLS[name](**{argument: value})
    return str(refused.value)


def test_what_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The text "no" counted as true, nan as a number, and the number 5 as an open file."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "log.csv").write_text("x,y\n1024,1024\n")
    for name, argument in (one.split() for one in BOOLEANS.split(", ")):
        for value in ("no", 1, np.array([True])):
            expected = f"{argument} takes True or False, not {value!r}"
            assert refusal(name, argument, value) == expected, (name, argument)
    for name, argument in (one.split() for one in NUMBERS.split(", ")):
        for value in (-1, nan, inf, "a", 10**310):
            named = "an angle of" if argument == "tilt" else argument
            assert named in refusal(name, argument, value), (name, argument, value)
    for name, argument, value, message in OTHERS:
        assert message in refusal(name, argument, value)
    assert [path.name for path in tmp_path.iterdir()] == ["log.csv"]


def test_what_is_no_file_or_calibration() -> None:
    tilt, pair = tiltcal.read(MAVS), tiltcal.read(FIXTURES / "rotation.yaml")
    calls: list[tuple[Callable[..., object], tuple[Any, ...], str]] = [
        (tiltcal.read, (5,), "a file is named by"),
        (tilt.report, (5,), "the output is named by"),
        (tiltcal.apply_log, (5, "a.csv", "b.csv"), "name a calibration or its file, not 5"),
        (tiltcal.open_calibrations(FIXTURES).at, (None, "2026-05-01"), "serial takes a text, not None"),
        (tiltcal.open_sensor("sca100t-d02", None).__enter__, (), "address takes a text, not None"),  # type: ignore[arg-type]
        (tiltcal.combine, ([],), "name two calibrations or more"),
        (tiltcal.compare, (tilt, pair), "tilt calibrations"),
    ]
    for call, arguments, message in calls:
        with pytest.raises(UsageError, match=message):
            call(*arguments)


def test_numbers_and_booleans_of_numpy_are_those_of_python(tmp_path: Path) -> None:
    """0.125 is one number in every type; the files and the journals are the same to the byte."""
    kinds = {"python": (int, float, bool), "numpy": (np.int64, np.float32, np.bool_)}
    for name, (whole, number, boolean) in kinds.items():
        (tmp_path / name).mkdir()
        stated = {"samples": whole(20), "jig": number(0.125), "tilt": number(30), "closing": boolean(True)}
        measure(tmp_path / name / "S-1.yaml", **stated)
    assert len({(tmp_path / name / "S-1.yaml").read_bytes() for name in kinds}) == 1

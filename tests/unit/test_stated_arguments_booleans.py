"""An argument that is true or false takes a boolean; the text "no" counted as true."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import FIXTURES

import tiltcal
from tiltcal.errors import UsageError

ROW = {"x": [1024.0], "y": [1024.0], "temperature": [20.0]}
MAVS = FIXTURES / "mavs.yaml"


def apply(**options: Any) -> Any:
    return tiltcal.read(MAVS).apply(ROW, **options)


def apply_log(**options: Any) -> object:
    Path("log.csv").write_text("x,y\n1024,1024\n")
    return tiltcal.apply_log(MAVS, "log.csv", "tilt.csv", **options)


def apply_folder(**options: Any) -> object:
    return tiltcal.open_calibrations(FIXTURES).apply(ROW, serial="S-1", **options)


def compensation(**options: Any) -> object:
    return tiltcal.read(MAVS).compensation(**options)


def fit(**options: Any) -> object:
    return tiltcal.fit("free", ROW, serial="S-1", unit="V", **options)


def noise(**options: Any) -> object:
    return tiltcal.noise(ROW, rate=1.0, unit="g", **options)


def match(**options: Any) -> object:
    return tiltcal.match({"a1": [1.0]}, [("a1", "a2", "a4")], **options)


def plan(**options: Any) -> object:
    return tiltcal.plan("plane", sensor="sca100t-d02", **options)


def measure(**options: Any) -> object:
    sensor = {"sensor": "sca100t-d02", "address": "sim:seed=1", "serial": "S-1", "output": "S-1.yaml"}
    return tiltcal.measure("plane", operator="sim", samples=3, **sensor | options)


@pytest.mark.parametrize("value", ["no", "", 1, [True], np.array([True])], ids=repr)
@pytest.mark.parametrize(
    ("call", "argument"),
    [
        (apply, "uncertainty"),
        (apply, "first_order"),
        (apply_log, "uncertainty"),
        (apply_log, "first_order"),
        (apply_log, "skip_bad_rows"),
        (apply_folder, "uncertainty"),
        (compensation, "first_order"),
        (fit, "table"),
        (noise, "skip_bad_rows"),
        (match, "skip_bad_rows"),
        (match, "online"),
        (match, "loops"),
        (plan, "closing"),
        (measure, "typical_temperature"),
        (measure, "closing"),
        (measure, "plain"),
    ],
)
def test_what_is_neither_true_nor_false(
    call: Callable[..., object], argument: str, value: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError) as refused:
        call(**{argument: value})
    assert str(refused.value) == f"--{argument.replace('_', '-')} takes True or False, not {value!r}"
    assert {path.name for path in tmp_path.iterdir()} <= {"log.csv"}


@pytest.mark.parametrize("kind", [bool, np.bool_, np.array])
def test_booleans_of_numpy_are_those_of_python(
    kind: Callable[[bool], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same columns, and the same journal and file to the byte."""
    assert "u_tilt_x" in apply(uncertainty=kind(True))
    assert "u_tilt_x" not in apply(uncertainty=kind(False))
    for name, boolean in (("python", bool), ("other", kind)):
        (tmp_path / name).mkdir()
        monkeypatch.chdir(tmp_path / name)
        measure(closing=boolean(True), typical_temperature=boolean(True), plain=boolean(False))
    for name in ("S-1.yaml", "S-1.journal.jsonl"):
        assert (tmp_path / "other" / name).read_bytes() == (tmp_path / "python" / name).read_bytes()

"""What is no text and no name of a file is refused with the name of the option, wherever the library takes one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from support import FIXTURES

import tiltcal
from tiltcal.errors import UsageError

ROW = {"x": [1024.0], "y": [1024.0], "temperature": [20.0]}
NO_FILE = "is named by a text or a Path, not 5"


def apply(**options: Any) -> object:
    return tiltcal.read(FIXTURES / "mavs.yaml").apply(ROW, **options)


def fit(**options: Any) -> object:
    return tiltcal.fit("free", ROW, **{"serial": "S", "unit": "V", **options})


def match(pairs: Any = (("a1", "a2", "a4"),), **options: Any) -> object:
    return tiltcal.match({"a1": [1.0]}, pairs, **options)


def measure(**options: Any) -> object:
    sensor = {"sensor": "sca100t-d02", "address": "sim:", "serial": "S", "output": "S.yaml"}
    return tiltcal.measure("plane", **(sensor | options))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: apply(unit=5), "--unit takes a text, not 5"),
        (
            lambda: apply(magnetometer=3),
            "--magnetometer names three columns, along x, y and z, such as mx,my,mz; not 3",
        ),
        (
            lambda: apply(velocity=[1, 2]),
            r"--velocity names three columns, along x, y and z, such as u,v,w; not \[1, 2\]",
        ),
        (lambda: fit(sensor=5), "--sensor takes a text, not 5"),
        (lambda: tiltcal.fit(5, ROW, serial="S", unit="V"), f"PROCEDURE {NO_FILE}"),  # type: ignore[arg-type]
        (lambda: tiltcal.plan("plane", sensor="sca100t-d02", address=5), "--address takes a text, not 5"),  # type: ignore[arg-type]
        (lambda: tiltcal.plan("plane", base=5), f"a file {NO_FILE}"),  # type: ignore[arg-type]
        (lambda: tiltcal.noise(ROW, rate=1.0, unit=5), "--unit takes a text, not 5"),  # type: ignore[arg-type]
        (lambda: tiltcal.noise(ROW, rate=1.0, averages=5), r"--averages takes several sizes, such as \[5, 50\], not 5"),  # type: ignore[arg-type]
        (lambda: match(5), "name a pair"),
        (lambda: match([5]), "a pair is three columns.*; not 5"),
        (lambda: match([("a1", 2, "a4")]), r"a pair is three columns.*; not \('a1', 2, 'a4'\)"),
        (lambda: match(phase=5), "--phase takes a text, not 5"),
        (lambda: tiltcal.read(5), f"a file {NO_FILE}"),  # type: ignore[arg-type]
        (lambda: tiltcal.read(FIXTURES / "mavs.yaml").save(5), f"the output {NO_FILE}"),
        (lambda: tiltcal.read(FIXTURES / "mavs.yaml").report(5), f"the output {NO_FILE}"),
        (lambda: tiltcal.apply_log(FIXTURES / "mavs.yaml", 5, "a.csv"), f"the log {NO_FILE}"),  # type: ignore[arg-type]
        (lambda: tiltcal.apply_log(5, "a.csv", "b.csv"), "name a calibration or its file, not 5"),  # type: ignore[arg-type]
        (lambda: tiltcal.open_calibrations(5), f"the folder {NO_FILE}"),  # type: ignore[arg-type]
        (lambda: tiltcal.open_calibrations(FIXTURES).at(5, "2026-05-01"), "--serial takes a text, not 5"),  # type: ignore[arg-type]
        (lambda: tiltcal.open_calibrations(FIXTURES).apply(ROW, serial=5), "--serial takes a text, not 5"),  # type: ignore[arg-type]
        (lambda: tiltcal.open_calibrations(FIXTURES).at(None, "2026-05-01"), "--serial takes a text, not None"),  # type: ignore[arg-type]
        (lambda: tiltcal.open_sensor("sca100t-d02", None).__enter__(), "--address takes a text, not None"),  # type: ignore[arg-type]
        (lambda: fit(serial=["S"]), r"the serial number is \['S'\]: write a text"),
        (
            lambda: tiltcal.noise(ROW, rate=1.0, calibration=5),
            "--calibration takes a tilt calibration or its file, not 5",
        ),  # type: ignore[arg-type]
        (lambda: measure(base=5.5), "--base is named by a text or a Path, not 5.5"),
        (lambda: measure(journal=5), f"--journal {NO_FILE}"),
        (lambda: measure(output=5), f"-o {NO_FILE}"),
        (lambda: measure(resume=5), f"--resume {NO_FILE}"),
        (lambda: measure(heading="a"), "--heading-uncertainty takes 0 or a number from .*, not 'a'"),
        (lambda: tiltcal.combine([]), "name two calibrations or more"),
        (lambda: tiltcal.combine(5), "combine takes tilt calibrations or their files, not 5"),  # type: ignore[arg-type]
    ],
)
def test_what_is_no_text(call: Callable[[], object], message: str) -> None:
    """Each was an AttributeError or a TypeError without a name; ``read(5)`` read the open file of that number."""
    with pytest.raises(UsageError, match=message):
        call()

"""The names of the library, and what importing it costs."""

from __future__ import annotations

import inspect
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_type_hints

import pytest
from support import FIXTURES
from support.command import loaded_by
from support.command import tiltcal as command

import tiltcal

NAMES = [
    "BusError",
    "Calibration",
    "CalibrationLibrary",
    "DeviceFault",
    "EstimateError",
    "HardwareError",
    "InputError",
    "JournalError",
    "PairCalibration",
    "SensorError",
    "Stopped",
    "TiltcalError",
    "UsageError",
    "__version__",
    "apply_log",
    "combine",
    "compare",
    "fit",
    "match",
    "measure",
    "noise",
    "open_calibrations",
    "open_sensor",
    "plan",
    "read",
]


def test_names_are_these() -> None:
    assert dir(tiltcal) == sorted(tiltcal.__all__) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_every_name_is_there_and_documented(name: str) -> None:
    found = getattr(tiltcal, name)
    assert name == "__version__" or found.__doc__


@pytest.mark.parametrize("name", [name for name in NAMES if name != "__version__"])
def test_type_hints_of_every_name_can_be_resolved(name: str) -> None:
    found = getattr(tiltcal, name)
    parts = vars(found).values() if inspect.isclass(found) else [found]
    functions = [part.fget if isinstance(part, property) else getattr(part, "func", part) for part in parts]
    for function in filter(inspect.isfunction, functions):
        get_type_hints(function)


def test_another_name_is_no_attribute() -> None:
    with pytest.raises(AttributeError, match="no attribute 'calibrate_all'"):
        tiltcal.calibrate_all  # noqa: B018


def test_import_loads_nothing_heavy() -> None:
    assert not {"numpy", "scipy", "polars", "yaml", "click", "rich"} & loaded_by("import tiltcal; dir(tiltcal)")


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="threads are counted in /proc")
@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="OpenBLAS starts a thread for each further core")
def test_a_command_starts_no_threads_of_openblas() -> None:
    script = (
        "import os\nfrom tiltcal import __main__ as command\n"
        "os._exit = lambda code: print(code, len(os.listdir('/proc/self/task')))\n"
        "command.main(['procedures', 'six-face', '--json'])\nimport numpy"
    )
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "0 1"


@pytest.mark.parametrize(
    ("arguments", "options"),
    [
        (("zero-45",), {"jig": 0.1}),
        (("mounting",), {"jig": 0.1, "noise": 0.5}),
        (("plane",), {"samples": 30, "tilt": 20.0}),
    ],
    ids=["positions", "mounting", "free angle"],
)
def test_plan_prints_what_the_command_prints(arguments: tuple[str, ...], options: dict[str, float]) -> None:
    told = str(tiltcal.plan(*arguments, sensor="sca100t-d02", **options))
    given = [text for name, value in options.items() for text in (f"--{name}", str(value))]
    assert told + "\n" == command("plan", *arguments, "--sensor", "sca100t-d02", *given).stdout


CAL = str(FIXTURES / "mavs.yaml")
ROW = {"x": [1024.0], "y": [1024.0], "temperature": [20.0]}
FIT = ("fit", "free", "log.csv", "--serial", "S", "--unit", "V", "-o", "S.yaml")
MEASURE = ("measure", "plane", "--sensor", "sca100t-d02", "--address", "sim:", "--serial", "S", "-o", "S.yaml")
PLAN = ("plan", "plane", "--sensor", "sca100t-d02")


def _apply(**options: Any) -> Callable[[], object]:
    return lambda: tiltcal.read(CAL).apply(ROW, **options)


def _fit(**options: Any) -> Callable[[], object]:
    return lambda: tiltcal.fit("free", "log.csv", serial="S", unit="V", **options)


def _measure(**options: Any) -> Callable[[], object]:
    sensor = {"sensor": "sca100t-d02", "address": "sim:", "serial": "S", "output": "S.yaml"}
    return lambda: tiltcal.measure("plane", **sensor, **options)


def _plan(**options: Any) -> Callable[[], object]:
    return lambda: tiltcal.plan("plane", sensor="sca100t-d02", **options)


OPTIONS: list[tuple[Callable[[], object], tuple[str, ...]]] = [
    (_apply(reading_noise=1.0), ("apply", CAL, "log.csv", "--reading-noise", "1")),
    (_apply(reading_noise=-1, uncertainty=True), ("apply", CAL, "log.csv", "--uncertainty", "--reading-noise", "-1")),
    (_apply(average=0), ("apply", CAL, "log.csv", "--average", "0")),
    (_apply(average=2.5), ("apply", CAL, "log.csv", "--average", "2.5")),
    (_apply(average="two"), ("apply", CAL, "log.csv", "--average", "two")),
    (_apply(every=-5), ("apply", CAL, "log.csv", "--every", "-5")),
    (_apply(mounting={"roll": 200}), ("apply", CAL, "log.csv", "--mounting", "roll=200")),
    (_fit(window=3), (*FIT, "--window", "3")),
    (_fit(gravity=5), (*FIT, "--gravity", "5")),
    (_fit(table_lean=-0.1), (*FIT, "--table-lean", "-0.1")),
    (_fit(thermometer=float("nan")), (*FIT, "--thermometer", "nan")),
    (_plan(jig="a"), (*PLAN, "--jig", "a")),
    (_plan(noise=float("inf")), (*PLAN, "--noise", "inf")),
    (_plan(samples=1), (*PLAN, "--samples", "1")),
    (_measure(samples=1), (*MEASURE, "--samples", "1")),
    (_measure(settle=0), (*MEASURE, "--settle", "0")),
    (lambda: tiltcal.noise(ROW, rate=0, unit="V"), ("noise", "log.csv", "--unit", "V", "--rate", "0")),
    (
        lambda: tiltcal.noise(ROW, rate=1, averages=[0], unit="V"),
        ("noise", "log.csv", "--unit", "V", "--averages", "0"),
    ),
]


@pytest.mark.parametrize(
    ("call", "arguments"),
    [
        (lambda: tiltcal.plan("six-fase", sensor="sca100t-d02"), ("plan", "six-fase", "--sensor", "sca100t-d02")),
        (lambda: tiltcal.plan("plane", sensor="sca100"), ("plan", "plane", "--sensor", "sca100")),
        (lambda: tiltcal.read("no.yaml"), ("diff", "no.yaml", "no.yaml")),
        (
            lambda: tiltcal.fit("plane", "log.csv", serial="S", unit="V"),
            ("fit", "plane", "log.csv", "--serial", "S", "--unit", "V", "-o", "S.yaml"),
        ),
        *OPTIONS,
    ],
    ids=["procedure", "model", "file", "fit without segments", *(f"{a[0]} {a[-2]} {a[-1]}" for _, a in OPTIONS)],
)
def test_library_refuses_in_the_words_of_the_command(call: object, arguments: tuple[str, ...]) -> None:
    with pytest.raises(tiltcal.TiltcalError) as refusal:
        call()  # type: ignore[operator]
    result = command(*arguments)
    assert result.returncode == refusal.value.exit_code == 2
    assert result.stderr == f"tiltcal: {refusal.value}\n"

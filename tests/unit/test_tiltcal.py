"""The names of the library, and what importing it costs."""

import inspect
import io
import os
import pickle
import re
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import get_overloads, get_type_hints

import pytest
from support import FIXTURES
from support.command import tiltcal as command

import tiltcal

# fmt: off
NAMES = [
    "BusError", "Calibration", "CalibrationLibrary", "DeviceFault", "EstimateError", "HardwareError", "InputError",
    "JournalError", "PairCalibration", "Replay", "SensorError", "Stopped", "TiltcalError", "UsageError", "__version__",
    "apply_log", "combine", "compare", "fit", "match", "measure", "noise", "open_calibrations", "open_sensor", "plan",
    "read", "replay",
]
# fmt: on


def test_names_are_these() -> None:
    assert dir(tiltcal) == sorted(tiltcal.__all__) == NAMES
    with pytest.raises(AttributeError, match="no attribute 'calibrate_all'"):
        tiltcal.calibrate_all  # noqa: B018


def test_every_name_is_documented_and_its_type_hints_can_be_resolved() -> None:
    for name in set(NAMES) - {"__version__"}:
        named = getattr(tiltcal, name)
        assert named.__doc__, name
        parts = vars(named).values() if inspect.isclass(named) else [named]
        functions = [part.fget if isinstance(part, property) else getattr(part, "func", part) for part in parts]
        for function in filter(inspect.isfunction, functions):
            get_type_hints(function)
        assert pickle.loads(pickle.dumps(named)) is named
    for kind in (tiltcal.Calibration, tiltcal.CalibrationLibrary, tiltcal.PairCalibration):
        of_columns, of_frame = map(get_type_hints, get_overloads(kind.apply))
        assert of_columns["return"] != of_frame["return"] == of_frame["frame"]


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


def test_plan_prints_what_the_command_prints() -> None:
    for procedure, options in (
        ("zero-45", {"jig": 0.1}),
        ("mounting", {"jig": 0.1, "noise": 0.5}),
        ("plane", {"samples": 30, "tilt": 20.0}),
    ):
        planned = str(tiltcal.plan(procedure, sensor="sca100t-d02", **options))
        given = [text for name, value in options.items() for text in (f"--{name}", str(value))]
        assert planned + "\n" == command("plan", procedure, "--sensor", "sca100t-d02", *given).stdout, procedure


CAL = str(FIXTURES / "mavs.yaml")
ROW = {"x": [1024.0], "y": [1024.0], "temperature": [20.0]}
FIT = ("fit", "free", "log.csv", "--serial", "S", "--unit", "V", "-o", "S.yaml")
MEASURE = ("measure", "plane", "--sensor", "sca100t-d02", "--address", "sim:", "--serial", "S", "-o", "S.yaml")
PLAN = ("plan", "plane", "--sensor", "sca100t-d02")


def test_library_refuses_in_the_words_of_the_command_with_its_own_names() -> None:
    """Where the command says ``--reading-noise``, the library says ``reading_noise``."""
    apply = partial(tiltcal.read(CAL).apply, ROW)
    fit = partial(tiltcal.fit, "free", "log.csv", serial="S", unit="V")
    sensor = {"sensor": "sca100t-d02", "address": "sim:", "serial": "S", "output": "S.yaml"}
    measure = partial(tiltcal.measure, "plane", **sensor)
    noise, applied = partial(tiltcal.noise, ROW, unit="V"), ("apply", CAL, "log.csv")
    noisy = ("noise", "log.csv", "--unit", "V")
    calls: list[tuple[Callable[[], object], tuple[str, ...]]] = [
        (lambda: tiltcal.plan("six-fase", sensor="sca100t-d02"), ("plan", "six-fase", "--sensor", "sca100t-d02")),
        (lambda: tiltcal.read("no.yaml"), ("diff", "no.yaml", "no.yaml")),
        (lambda: tiltcal.fit("plane", "log.csv", serial="S", unit="V"), ("fit", "plane", *FIT[2:])),
        (lambda: apply(reading_noise=-1, uncertainty=True), (*applied, "--uncertainty", "--reading-noise", "-1")),
        (lambda: apply(average=0), (*applied, "--average", "0")),
        (lambda: apply(mounting={"roll": 200}), (*applied, "--mounting", "roll=200")),
        (lambda: fit(gravity=5), (*FIT, "--gravity", "5")),
        (lambda: fit(thermometer=float("nan")), (*FIT, "--thermometer", "nan")),
        (lambda: measure(samples=1), (*MEASURE, "--samples", "1")),
        (lambda: noise(rate=0), (*noisy, "--rate", "0")),
    ]
    for call, arguments in calls:
        with pytest.raises(tiltcal.TiltcalError) as refusal:
            call()
        done = command(*arguments)
        assert done.returncode == refusal.value.exit_code == 2, arguments
        said, advised, rest = done.stderr.removeprefix("tiltcal: ").partition("`tiltcal")
        named = re.sub("--([a-z-]+)", lambda option: option[1].replace("-", "_"), said)
        assert f"{named}{advised}{rest}" == f"{refusal.value}\n"


def test_what_is_missing_is_named_as_an_argument() -> None:
    with pytest.raises(tiltcal.UsageError) as refusal:
        tiltcal.measure("plane", sensor="sca100t-d02")
    assert str(refusal.value) == "measure needs address, serial and output (or resume JOURNAL)"


def test_measure_asks_in_a_notebook_by_input(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A kernel replaces ``input``, and its standard input is no stream to read."""
    asked = iter(["", "", "q"])
    monkeypatch.setattr("builtins.input", lambda: next(asked))
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    with pytest.raises(tiltcal.Stopped):
        tiltcal.measure("plane", sensor="sca100t-d02", address="sim:", serial="S", output=tmp_path / "S.yaml", jig=0.1)
    assert next(asked, None) is None

"""Every command that reads a long log shows how far it is."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from support import FIXTURES
from support.accelerometer_disk import record
from support.command import tiltcal

from tiltcal.logs.log import Progress

SENSOR = ("--serial", "S-1", "--sensor", "sca100t-d02", "-o", "S-1.yaml")
PAIR = ("--pair", "a1,a2", "--orthogonal", "a4", "-o", "pair.yaml")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A stage that turns, and a sensor at rest whose temperature goes up and down."""
    folder, rng = tmp_path_factory.mktemp("progress"), np.random.default_rng(1)
    record(seconds=100.0).write(folder / "stage.csv")
    minutes = np.arange(0.0, 120.0, 0.05)
    temperature = 20.0 + 15.0 * np.abs(minutes / 30.0 % 2.0 - 1.0)
    readings = 1024.0 + rng.normal(0.0, 0.5, (2, len(minutes))) + (temperature - 24.0)
    rows = zip(60.0 * minutes, *readings, temperature, strict=True)
    lines = "".join(f"{t:.0f},{x:.2f},{y:.2f},{celsius:.2f}\n" for t, x, y, celsius in rows)
    (folder / "rest.csv").write_text("time,x,y,temperature\n" + lines)
    (folder / "segments.csv").write_text("position,start,end,gx,gy,gz\nlevel,0,1000,0,0,1\n")
    tiltcal("match", "stage.csv", *PAIR, "--phase", "theta", cwd=folder, code=0)
    return folder


@pytest.mark.usefixtures("undrawn")
def test_the_bar_ends_at_the_size_of_the_log(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[tuple[int, int | None]] = []

    @contextmanager
    def bar(_what: str) -> Iterator[Progress]:
        yield lambda done, size: shown.append((done, size))

    for command, log in (
        (("fit", "level", "rest.csv", "--base", FIXTURES / "complete.yaml", "-o", "level.yaml"), "rest.csv"),
        (("fit", "ramp", "rest.csv", *SENSOR), "rest.csv"),
        (("noise", "rest.csv", "--columns", "x=x,y=y", "--unit", "V"), "rest.csv"),
        (("match", "stage.csv", *PAIR, "--phase", "theta"), "stage.csv"),
        (("match", "stage.csv", *PAIR), "stage.csv"),
        (("report", FIXTURES / "complete.yaml", "rest.csv", "-o", "page.html"), "rest.csv"),
        (("report", "pair.yaml", "stage.csv", "-o", "page.html"), "stage.csv"),
    ):
        monkeypatch.setattr(f"tiltcal.cli.{command[0]}.progress_bar", bar)
        tiltcal(*command, cwd=folder, code=0)
        size = (folder / log).stat().st_size
        assert shown[-1] == (size, size)

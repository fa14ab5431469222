"""What is given damaged input, by name, and good input of every kind to damage."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from random import Random

from support import FIXTURES

Body = Callable[[Random], object]


@dataclass(frozen=True)
class Target:
    """What is given damaged input: so many for each of a target with a share of 1.

    A library in C or Rust that parses the input (``compiled``) may end the process.
    """

    body: Body
    share: int = 1
    compiled: bool = False


TARGETS: dict[str, Target] = {}


def target(*, share: int = 1, compiled: bool = False) -> Callable[[Body], Body]:
    """Register a function as a target, by its name."""

    def register(body: Body) -> Body:
        TARGETS[body.__name__] = Target(body, share, compiled)
        return body

    return register


@cache
def golden(name: str) -> str:
    """Return the text of a golden file."""
    return (FIXTURES / name).read_text(encoding="utf-8")


@cache
def shipped(folder: str) -> dict[str, str]:
    """Return the texts of the YAML files of a folder of the repository, by name."""
    return {path.name: path.read_text(encoding="utf-8") for path in sorted((FIXTURES.parent / folder).glob("*.yaml"))}


CALIBRATIONS = ("plane", "complete", "six-face", "free", "mounting", "temperature-sweep", "multi-angle", "mavs")
JOURNALS = ("zero-45", "plane", "two-temperature", "verify", "reversal", "six-face")
BENCH = """\
tiltcal: 1
kind: bench
operator: A. Technician
jig: 0.05
sensors:
  - {serial: A, model: sca100t-d02, address: "sim:seed=1", axes: [x, -y]}
  - {serial: B, model: sca3000-d01, address: "sim:seed=2", axes: [y, -x, z]}
thermometer: {model: thermistor, address: "sim:"}
"""
LOG = "time,x,y,z,temperature,theta\n" + "".join(
    f"{k * 0.1:.1f},{x + 0.001 * (k % 7)},{y - 0.001 * (k % 5)},{z + 0.0007 * (k % 3)},20,{27 * k}\n"
    for k, (x, y, z) in enumerate(
        one for face in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)) for one in [face] * 30
    )
)
SEGMENTS = "position,start,end\n" + "".join(
    f"{name},{30 * k},{30 * k + 30}\n" for k, name in enumerate(("x-up", "x-down", "y-up", "y-down", "z-up", "z-down"))
)
VCD_HEADER = """\
$timescale 1 us $end
$scope module m $end
$var wire 1 ! D0 $end
$var wire 1 " D1 $end
$upscope $end
$enddefinitions $end
#0
0!
0"
"""
VCD = VCD_HEADER + "".join(
    f'#{1000 * k + 1}\n1!\n1"\n#{1000 * k + 480}\n0!\n#{1000 * k + 520}\n0"\n' for k in range(30)
)


@cache
def parquet_log() -> bytes:
    import polars as pl

    stream = io.BytesIO()
    pl.read_csv(LOG.encode()).with_columns(note=pl.lit("é")).write_parquet(stream)
    return stream.getvalue()


@cache
def netcdf_log() -> bytes:
    import polars as pl
    import xarray as xr

    data = pl.read_csv(LOG.encode())
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.nc"
        variables = {name: ("time", data[name].to_numpy(), {"units": "count"}) for name in ("x", "y", "temperature")}
        xr.Dataset(variables, {"time": data["time"].to_numpy()}).to_netcdf(path, engine="h5netcdf")
        return path.read_bytes()

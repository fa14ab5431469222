"""``tiltcal apply --magnetometer --velocity``: columns, notes, refusals; the numbers are in the unit tests."""

from pathlib import Path

import pytest
import xarray
from click.testing import CliRunner, Result
from support.applied import PLAIN

from tiltcal.cli.apply import command

CAL = (
    PLAIN
    + """\
uncertainty:
  offset: {x: 0.003, y: 0.003}
  single_reading: {x: 0.004, y: 0.004}
"""
)
LOG = """\
x,y,mx,my,mz,u,v,w,h
2.5,2.5,20,0,-40,0,1,0,5
3.5,2.5,-11.339746,17.320508,-39.641016,1,0,0,65
"""
COMPASS = ("--magnetometer", "mx,my,mz", "--declination", "5", "--velocity", "u,v,w")
BY_HAND = {"heading": [5.0, 65.0], "v_east": [-0.996195, 0.784886], "v_north": [0.087156, 0.365998], "v_up": [0.0, 0.5]}
"""Worked out in docs/how-to/heading.md."""


@pytest.fixture(autouse=True)
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("cal.yaml").write_text(CAL)
    Path("log.csv").write_text(LOG)


def apply(*arguments: str, log: str = "log.csv") -> Result:
    return CliRunner().invoke(command, ["cal.yaml", log, *arguments])


def columns(result: Result) -> dict[str, list[float]]:
    assert result.exit_code == 0, result.exception
    names, *rows = (line.split(",") for line in result.stdout.splitlines())
    return {name: [float(cell) for cell in cells] for name, *cells in zip(names, *rows, strict=True)}


def test_a_magnetometer_gives_the_numbers_worked_out_by_hand() -> None:
    found = apply(*COMPASS)
    assert found.stdout.splitlines()[0].endswith("w,h,g_x,g_y,tilt_x,tilt_y,flag,reason,heading,v_east,v_north,v_up")
    assert {name: columns(found)[name] for name in BY_HAND} == {
        name: pytest.approx(values, abs=2e-6) for name, values in BY_HAND.items()
    }
    assert "magnetic north" not in found.stderr


def test_a_column_of_headings_gives_the_same_velocities_and_is_true() -> None:
    found = columns(apply("--velocity", "u,v,w", "--columns", "heading=h"))
    assert "heading" not in found
    for name in ("v_east", "v_north", "v_up"):
        assert found[name] == pytest.approx(BY_HAND[name], abs=2e-6)


def test_notes_name_the_north_and_what_counts_as_exact() -> None:
    found = apply("--magnetometer", "mx,my,mz", "--uncertainty")
    assert "counts from magnetic north" in found.stderr
    assert "the magnetometer counts as exact" in found.stderr
    # 0.003 and 0.004 V of 2 V/g are 0.1433°; the field dips by atan 2.
    assert columns(found)["u_heading"][0] == pytest.approx(2 * 0.14324, rel=1e-3)


def test_netcdf_states_units_and_meanings() -> None:
    names, *rows = (line.split(",") for line in LOG.splitlines())
    data = {name: ("time", [float(cell) for cell in cells]) for name, *cells in zip(names, *rows, strict=True)}
    dataset = xarray.Dataset(data)
    for name in "uvw":
        dataset[name].attrs["units"] = "cm s-1"
    dataset.to_netcdf("log.nc", engine="h5netcdf")
    assert apply(*COMPASS, "--uncertainty", "-o", "out.nc", log="log.nc").exit_code == 0
    with xarray.open_dataset("out.nc", engine="h5netcdf") as found:
        assert {name: found[name].attrs.get("units") for name in ("heading", "v_east", "U95_v_up", "u_heading")} == {
            "heading": "degree",
            "v_east": "cm s-1",
            "U95_v_up": "cm s-1",
            "u_heading": "degree",
        }
        masks = found["reason"].attrs["flag_masks"].tolist()
        assert found["reason"].attrs["flag_meanings"].split()[masks.index(128)].startswith("no_direction")
        assert found["v_north"].values == pytest.approx(BY_HAND["v_north"], abs=2e-6)

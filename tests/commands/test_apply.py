"""``tiltcal apply`` from the command line to the last byte of its output, with headings and velocities on request."""

import csv
import json
from math import cos, degrees, hypot, nan, radians
from pathlib import Path

import pytest
import xarray
from support.applied import PLAIN, apply, refused
from support.applied import rows as numbers

from tiltcal.errors import InputError, UsageError

WARM = "  temperature: {reference: 20.0, range: [5, 30], offset: {x: [0.01], y: [0]}, sensitivity: {x: [0], y: [0]}}\n"
KNOWN = """\
uncertainty:
  offset: {x: 0.003, y: 0.003}
  sensitivity: {x: {x: 0.002, y: 0.0}, y: {x: 0.0, y: 0.002}}
  single_reading: {x: 0.004, y: 0.004}
"""
LOG = "time,x,y,note\n0.0,3.5,2.5,level\n0.1,2.5,1.5,\n"
CROSS = PLAIN.replace("y: 0.0}, y: {x: 0.0", "y: 0.04}, y: {x: -0.04")


@pytest.fixture(autouse=True)
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a calibration and a log."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cal.yaml").write_text(PLAIN)
    (tmp_path / "log.csv").write_text(LOG)
    return tmp_path


def applied(*arguments: str, text: str = PLAIN, log: str) -> dict[str, list[float]]:
    """Return each column of the result of a log of numbers on standard input."""
    Path("cal.yaml").write_text(text)
    result = apply("cal.yaml", "-", *arguments, stdin=log)
    assert result.exit_code == 0, result.output
    found = numbers(result.stdout)
    return {name: [row[name] for row in found] for name in found[0]}


@pytest.mark.parametrize(
    ("text", "options", "log", "g", "tilt", "flag", "reason"),
    [
        (PLAIN, "", "x,y\n3.5,2.5\n2.5,1.5\n", [(0.5, 0), (0, -0.5)], [(30, 0), (0, -30)], [1, 1], [0, 0]),
        # Upside down by a roll of 180° y changes its sign and x keeps it; the file says what it loses.
        (
            PLAIN + "  mounting: {yaw: 90.0}\n",
            "--mounting roll=180",
            "x,y\n3.5,2.5\n2.5,1.5\n",
            [(0.5, 0), (0, 0.5)],
            [(30, 0), (0, 30)],
            [1, 1],
            [0, 0],
        ),
        (PLAIN + WARM, "--columns x=Vx,y=Vy,temperature=T", "Vx,Vy,T\n3.6,2.5,30\n", [(0.5, 0)], [(30, 0)], [1], [0]),
        # x is beyond 1.02 g, and y outside the calibrated range.
        (PLAIN + "limits: {tilt: {y: [-30, 30]}}\n", "", "x,y\n5,4\n", [(1.25, 0.75)], [(nan, 48.590378)], [4], [9]),
        (CROSS, "", "x,y\n3.016,3.29\n", [(0.25, 0.4)], [(14.477512, 23.578178)], [1], [0]),
        # The first order leaves S_XY S_YX / (S_XX S_YY) of each: 0.0004.
        (CROSS, "--first-order", "x,y\n3.016,3.29\n", [(0.2501, 0.40016)], [(14.483430, 23.588181)], [1], [0]),
    ],
)  # fmt: skip
def test_a_row_has_gravity_tilts_flag_and_reason(
    text: str, options: str, log: str, g: list[tuple[float, ...]], tilt: list[tuple[float, ...]], flag: list[int],
    reason: list[int],
) -> None:  # fmt: skip
    found = applied(*options.split(), text=text, log=log)
    assert list(found) == [*log.splitlines()[0].split(","), "g_x", "g_y", "tilt_x", "tilt_y", "flag", "reason"]
    assert list(zip(found["g_x"], found["g_y"], strict=True)) == [pytest.approx(row, abs=1e-12) for row in g]
    tilts = zip(found["tilt_x"], found["tilt_y"], strict=True)
    assert list(tilts) == [pytest.approx(row, abs=1e-6, nan_ok=True) for row in tilt]
    assert (found["flag"], found["reason"]) == (flag, reason)


def test_uncertainties_are_what_the_gum_gives_and_stand_behind_all_others() -> None:
    """Offset 0.003, sensitivity 0.002, reading 0.004 V of 2 V/g, at level and at 30°."""
    log = "x,y\n2.5,2.5\n3.5,2.5\n"
    plain = applied(text=PLAIN + KNOWN, log=log)
    found = applied("--uncertainty", text=PLAIN + KNOWN, log=log)
    names = ("u_tilt_x", "u_tilt_y", "U95_tilt_x", "U95_tilt_y")
    assert list(found) == [*plain, *names]
    assert {name: found[name] for name in plain} == plain
    level, tilted = degrees(0.005 / 2), degrees(hypot(0.005, 0.5 * 0.002) / 2 / cos(radians(30)))
    for name, expected in zip(names, ([level, tilted], [level] * 2), strict=False):
        assert found[name] == pytest.approx(expected, rel=1e-3)
        assert found[f"U95{name[1:]}"] == pytest.approx([1.96 * one for one in expected], rel=2e-3)
    Path("half.yaml").write_text(PLAIN + "uncertainty: {offset: {x: 0.003, y: 0.003}}\n")
    said = apply("half.yaml", "log.csv", "--uncertainty").stderr
    assert "no uncertainty is stated of sensitivity.x.x, sensitivity.x.y" in said
    assert "--reading-noise" in said
    for silent in (PLAIN, PLAIN + "uncertainty: {}\n"):
        Path("silent.yaml").write_text(silent)
        result = apply("silent.yaml", "log.csv", "--uncertainty", "-o", "out.csv")
        assert "silent.yaml" in refused(result, InputError)
        assert not Path("out.csv").exists()


def test_a_summary_is_in_words_or_json_on_stderr_where_the_rows_go_to_stdout() -> None:
    log = b"x,y\n3.5,2.5\nNaN,2.5\n4.51,2.5\noops,2.5\n"
    assert apply("cal.yaml", "-", "--skip-bad-rows", stdin=log).stderr.splitlines() == [
        "4 rows",
        "  flag 1 pass: 1",
        "  flag 3 suspect: 1",
        "  flag 9 missing: 2",
        "  reason 1 arcsine argument beyond ±1: 1",
        "  reason 32 not a number: 2",
        "  1 row could not be parsed and kept as missing",
    ]
    counts = {"rows": 4, "flags": {"1": 1, "3": 1, "9": 2}, "reasons": {"1": 1, "32": 2}, "bad_rows": 1}
    result = apply("cal.yaml", "-", "--skip-bad-rows", "--json", stdin=log)
    assert json.loads(result.stderr) == counts
    assert len(list(csv.DictReader(result.stdout.splitlines()))) == 4
    beside = apply("cal.yaml", "-", "--skip-bad-rows", "--json", "-o", "out.csv", stdin=log)
    assert (json.loads(beside.stdout), beside.stderr) == (counts, "")


def test_what_is_refused_leaves_no_output(bench: Path) -> None:
    (bench / "out.csv").write_text("the one before")
    content = LOG.encode() + b"0.2,oops,2.5,\n"
    assert refused(apply("cal.yaml", "-", stdin=content), InputError) == (
        "standard input:4: column 'x': 'oops' is no number"
    )
    (bench / "log.csv").write_bytes(content)
    assert "log.csv:4" in refused(apply("cal.yaml", "log.csv", "-o", "out.csv"), InputError)
    assert (bench / "out.csv").read_text() == "the one before"
    assert sorted(path.name for path in bench.iterdir()) == ["cal.yaml", "log.csv", "out.csv"]
    assert refused(apply("cal.yaml", "-", stdin=b"time,Vx,Vy\n1,2,3\n"), InputError) == (
        "standard input:1: there is no column 'x' (did you mean 'Vx'?); the log has time, Vx, Vy. "
        "Name it with --columns x=NAME"
    )
    once = apply("cal.yaml", "-", stdin=LOG).stdout_bytes
    assert "standard input has a column 'g_x' already" in refused(apply("cal.yaml", "-", stdin=once), UsageError)


# Headings and velocities

EARTH = """\
x,y,mx,my,mz,u,v,w,h
2.5,2.5,20,0,-40,0,1,0,5
3.5,2.5,-11.339746,17.320508,-39.641016,1,0,0,65
"""
COMPASS = ("--magnetometer", "mx,my,mz", "--declination", "5", "--velocity", "u,v,w")
BY_HAND = {"heading": [5.0, 65.0], "v_east": [-0.996195, 0.784886], "v_north": [0.087156, 0.365998], "v_up": [0.0, 0.5]}
"""Worked out in docs/how-to/heading.md."""


def test_headings_and_velocities_are_those_worked_out_by_hand() -> None:
    found = applied(*COMPASS, log=EARTH)
    assert list(found)[-6:] == ["flag", "reason", *BY_HAND]
    assert {name: found[name] for name in BY_HAND} == {k: pytest.approx(v, abs=2e-6) for k, v in BY_HAND.items()}
    given = applied("--velocity", "u,v,w", "--columns", "heading=h", log=EARTH)
    assert "heading" not in given
    for name in ("v_east", "v_north", "v_up"):
        assert given[name] == pytest.approx(BY_HAND[name], abs=2e-6)
    # 0.003 and 0.004 V of 2 V/g are 0.1433°; the field dips by atan 2.
    known = PLAIN + KNOWN.replace("  sensitivity: {x: {x: 0.002, y: 0.0}, y: {x: 0.0, y: 0.002}}\n", "")
    uncertain = applied("--magnetometer", "mx,my,mz", "--uncertainty", text=known, log=EARTH)
    assert uncertain["u_heading"][0] == pytest.approx(2 * 0.14324, rel=1e-3)
    Path("log.csv").write_text(EARTH)
    said = apply("cal.yaml", "log.csv", "--magnetometer", "mx,my,mz", "--uncertainty").stderr
    assert "counts from magnetic north" in said
    assert "the magnetometer counts as exact" in said
    assert "magnetic north" not in apply("cal.yaml", "log.csv", *COMPASS).stderr


def test_netcdf_states_units_of_headings() -> None:
    Path("cal.yaml").write_text(PLAIN + KNOWN)
    names, *rows = (line.split(",") for line in EARTH.splitlines())
    data = {name: ("time", [float(cell) for cell in cells]) for name, *cells in zip(names, *rows, strict=True)}
    dataset = xarray.Dataset(data)
    for name in "uvw":
        dataset[name].attrs["units"] = "cm s-1"
    dataset.to_netcdf("log.nc", engine="h5netcdf")
    assert apply("cal.yaml", "log.nc", *COMPASS, "--uncertainty", "-o", "out.nc").exit_code == 0
    with xarray.open_dataset("out.nc", engine="h5netcdf") as found:
        units = {"heading": "degree", "u_heading": "degree", "v_east": "cm s-1", "U95_v_up": "cm s-1"}
        assert {name: found[name].attrs.get("units") for name in units} == units
        assert found["v_north"].values == pytest.approx(BY_HAND["v_north"], abs=2e-6)

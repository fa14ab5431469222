"""``tiltcal history`` and the page of a folder: dates, changes, what is due, and outliers of the fleet."""

import json
import re
from datetime import datetime, timedelta
from math import sqrt
from pathlib import Path

import numpy as np
import pytest
import yaml
from support import FIXTURES
from support.command import tiltcal
from support.html_page import Page

from tiltcal.core.rounding import plus_minus

MAVS = (FIXTURES / "mavs.yaml").read_text(encoding="utf-8")
OFFSET = re.findall(r"^  offset: {(x: [\d.]+)", MAVS, re.MULTILINE)[0]
DRIFT = re.findall(r"^    offset: {(x: \[[-\d.]+\])", MAVS, re.MULTILINE)[0]
ENDED = re.findall(r'^  ended: "2000-01-01(T[\d:]+)', MAVS, re.MULTILINE)[0]
ODD = "U-7"


def moved(text: str, change: float) -> str:
    """Return a file with an offset of x that is so many counts more."""
    return text.replace(OFFSET, f"x: {float(OFFSET[3:]) + change:.2f}")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twenty units with the temperature coefficients of the paper's figure 7 in count/°C, one of them far off."""
    folder = tmp_path_factory.mktemp("calibrations")
    drift = np.random.default_rng(2).normal(1.0, 0.7, 20)
    drift[7] = 9.0
    for unit, of_unit in enumerate(drift):
        text = MAVS.replace("SIM-42", f"U-{unit}").replace(DRIFT, f"x: [{of_unit:.5f}]")
        (folder / f"U-{unit}-a.yaml").write_text(text.replace("2000-01-01", "2020-03-01"))
    later = MAVS.replace("SIM-42", "U-0").replace(DRIFT, f"x: [{drift[0]:.5f}]").replace("2000", "2021")
    later = later.replace("noise alone: no jig is stated, and no position is left over", "the stated jig")
    (folder / "U-0-b.yaml").write_text(moved(later, 12.0))
    (folder / "torn.yaml").write_text(MAVS[:300])
    return folder


def test_dates_changes_and_outliers(folder: Path) -> None:
    """12 counts of 0.7 sqrt(2) standard uncertainty are a change; one file of noise alone leaves it undecided."""
    found = json.loads(tiltcal("history", folder, "--json").stdout)
    sensors = {one["serial"]: one for one in found["sensors"]}
    twice = sensors["U-0"]
    assert [one["date"] for one in twice["calibrations"]] == [f"2020-03-01{ENDED}Z", f"2021-01-01{ENDED}Z"]
    (change,) = twice["changes"]
    diff = json.loads(tiltcal("diff", folder / "U-0-a.yaml", folder / "U-0-b.yaml", "--json").stdout)
    assert {name: change[name] for name in diff} == diff
    assert change["days"] == pytest.approx(306.0)
    due = datetime.fromisoformat(f"2021-01-01{ENDED}Z") + timedelta(days=365)
    assert (twice["due"], twice["is_due"]) == (due.strftime("%Y-%m-%dT%H:%M:%SZ"), True)
    (fleet,) = found["fleets"]
    outliers = {one["name"]: one["outliers"] for one in fleet["coefficients"]}
    assert outliers["temperature.offset.x.1"] == [ODD]
    (problem,) = found["problems"]
    assert "torn.yaml" in problem


def test_text_and_page_name_what_the_json_holds(folder: Path, tmp_path: Path) -> None:
    done = tiltcal("history", folder, "--interval", "9000d", code=0)
    lines = done.stdout.splitlines()
    assert "sca100t-d02 U-0: due 2045-08-23" in lines
    assert "  2021-01-01  U-0-b.yaml  unknown" in lines
    assert any(line.startswith("  temperature.offset.x.1") and line.endswith(f"   {ODD}") for line in lines)
    assert any(line.startswith("problem: ") and "torn.yaml" in line for line in lines)
    tiltcal("report", folder, "-o", tmp_path / "fleet.html", code=0)
    Page(text := (tmp_path / "fleet.html").read_text(encoding="utf-8"))
    assert (text.count("<svg"), "torn.yaml" in text, ODD in text) == (2, True, True)
    assert '<td class="n">U-0-b.yaml</td><td class="n">306</td><td>unknown</td>' in text


def test_a_change_is_told_with_its_uncertainty_and_the_folder_of_its_file(tmp_path: Path) -> None:
    """What the column of z leaves of the offset's variance is each file's own; twice that is the difference's."""
    for name in "abc":
        (tmp_path / name).mkdir()
    later = MAVS.replace("2000", "2021").replace(
        "noise alone: no jig is stated, and no position is left over", "the jig"
    )
    (tmp_path / "b" / "U-0.yaml").write_text(moved(later, 12.0))
    (tmp_path / "a" / "U-0.yaml").write_text(later.replace("2021", "2020"))
    (tmp_path / "c" / "U-0.yaml").write_text(moved(later, 12.0).replace("2021", "2022"))
    (tmp_path / "c" / "copy.yaml").write_text((tmp_path / "b" / "U-0.yaml").read_text())
    data = yaml.safe_load(MAVS)
    variance, *_, of_z = data["uncertainty"]["covariance"]["matrix"][0][:4]
    u = sqrt(2.0 * (variance - (of_z / data["fit"]["priors"]["sensitivity.x.z"]) ** 2))
    assert 0.9 < u < 1.1
    done = tiltcal("history", tmp_path)
    change = plus_minus(12.0, u, signed=True)
    assert done.stdout.splitlines()[1:] == [
        "  2020-01-01  a/U-0.yaml",
        f"  2021-01-01  b/U-0.yaml  changed: offset.x by {change} count",
        "  2022-01-01  c/U-0.yaml  unchanged",
    ]
    page = tmp_path / "fleet.html"
    tiltcal("report", tmp_path, "-o", page, code=0)
    assert f"<td>offset.x by {change} count</td>" in page.read_text(encoding="utf-8")
    for text, said in (
        (
            moved(later, 13.0),
            f"has the same date, 2021-01-01{ENDED}Z, and other coefficients of SIM-42: keep one of them",
        ),
        (later.replace("unit: count", "unit: V"), "its unit is count in one and V in the other, in "),
    ):
        (tmp_path / "c" / "copy.yaml").write_text(text)
        assert said in tiltcal("history", tmp_path, code=0).stdout


def test_a_coefficient_that_some_sensors_lack_is_compared_among_those_that_have_it(tmp_path: Path) -> None:
    level = (FIXTURES / "zero-45.yaml").read_text(encoding="utf-8")
    for unit, text in enumerate([MAVS, MAVS, MAVS, level]):
        (tmp_path / f"U-{unit}.yaml").write_text(text.replace("SIM-42", f"U-{unit}"))
    (fleet,) = json.loads(tiltcal("history", tmp_path, "--json").stdout)["fleets"]
    found = {one["name"]: one["n"] for one in fleet["coefficients"]}
    assert (found["offset.x"], found["temperature.offset.x.1"]) == (4, 3)

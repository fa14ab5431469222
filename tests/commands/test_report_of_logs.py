"""The part of a report about a log: what `apply` says of it, whichever way it comes in, and never too much ink."""

import json
import re
from math import sin
from pathlib import Path
from typing import Any

import pytest
import yaml
from support import FIXTURES
from support.accelerometer_disk import record
from support.html_page import Page

from tiltcal.cli.main import run
from tiltcal.files.calibration import CalibrationRecord, read_calibration
from tiltcal.library.calibration import Calibration

CALIBRATION = str(FIXTURES / "complete.yaml")


@pytest.fixture
def bare(tmp_path: Path) -> str:
    """The same calibration without its records: the only figures of its page are those of logs."""
    known, path = read_calibration(CALIBRATION), tmp_path / "bare.yaml"
    Calibration(CalibrationRecord(known.sensor, known.coefficients)).save(path)
    return str(path)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """An hour with a plug that is loose for a while, a cold spell and a knock to the rail."""
    rows = ["time,x,y,temperature"]
    for k in range(3600):
        x = "" if 1000 <= k < 1100 else f"{1024 + 300 * sin(k / 200):.0f}"
        rows.append(f"{k},{'2047' if k == 2000 else x},{1020 + k % 7},{3.0 if k > 3000 else 20.0}")
    path = tmp_path / "night.csv"
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return path


def report(*files: str | Path, output: Path) -> Page:
    assert run(["report", *map(str, files), "-o", str(output)]) == 0
    return Page(output.read_text(encoding="utf-8"))


def shares(page: Page, heading: str) -> dict[str, tuple[int, float]]:
    return {row[0]: (int(row[2].replace(" ", "")), float(row[3])) for row in page.below(heading)[1:]}


@pytest.mark.usefixtures("undrawn")
def test_flags_are_those_that_apply_counts(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["apply", CALIBRATION, str(log), "-o", str(tmp_path / "tilt.csv"), "--json"]) == 0
    applied = json.loads(capsys.readouterr().out)
    found = shares(report(CALIBRATION, log, output=tmp_path / "r.html"), "Log night.csv")
    expected = {f"Flag {flag}": count for flag, count in applied["flags"].items()}
    expected |= {f"Reason {bit}": count for bit, count in applied["reasons"].items()}
    assert {name: count for name, (count, _) in found.items()} == expected
    assert found["Flag 9"] == (100, pytest.approx(100 * 100 / 3600, abs=6e-4))


@pytest.mark.usefixtures("undrawn")
def test_a_log_that_is_compensated_already_says_the_same(log: Path, tmp_path: Path) -> None:
    tilt = tmp_path / "tilt.csv"
    assert run(["apply", CALIBRATION, str(log), "-o", str(tilt)]) == 0
    page = report(CALIBRATION, log, tilt, output=tmp_path / "r.html")
    assert shares(page, "Log night.csv") == shares(page, "Log tilt.csv")
    angles = [[row[1:] for row in table] for table in tables(page, "Angle / °")]
    assert angles[0] == angles[1]


def tables(page: Page, first: str) -> list[list[list[str]]]:
    found = [[[cell.text for cell in row.find("th", "td")] for row in t.find("tr")] for t in page.root.find("table")]
    return [rows for rows in found if rows and rows[0][:1] == [first]]


def test_other_names_of_columns_moments_and_bad_rows(bare: str, tmp_path: Path) -> None:
    path = tmp_path / "own.csv"
    path.write_text(
        "when,VoutX,VoutY,time\n2026-01-17T22:00:00,1024,1020,a\n2026-01-17T22:00:10,oops,1020,b\n", encoding="utf-8"
    )
    output = tmp_path / "r.html"
    named = ["--columns", "x=VoutX,y=VoutY,time=when", "--skip-bad-rows"]
    assert run(["report", bare, str(path), "-o", str(output), *named]) == 0
    text = output.read_text(encoding="utf-8")
    assert shares(Page(text), "Log own.csv")["Flag 9"] == (1, 50.0)
    assert "time from 2026-01-17 22:00:00 UTC [s]" in text


def test_a_log_without_an_angle_has_no_empty_figure_and_one_without_time_counts_rows(bare: str, tmp_path: Path) -> None:
    (tmp_path / "dead.csv").write_text("x,y,temperature\n,,\n", encoding="utf-8")
    (tmp_path / "rows.csv").write_text("x,y,temperature\n" + "1030,1020,20\n" * 5, encoding="utf-8")
    page = report(bare, tmp_path / "dead.csv", output=tmp_path / "r.html")
    said = [one.text for one in page.root.find("p")]
    assert any(text.startswith("1 row. The calibration") for text in said)
    assert "No row has an angle." in said
    assert not any("dead.csv" in one.text for one in page.root.find("figure"))
    report(bare, tmp_path / "rows.csv", output=tmp_path / "r.html")
    assert re.search(r">row</text>", (tmp_path / "r.html").read_text(encoding="utf-8"))


@pytest.mark.usefixtures("undrawn")
def test_a_name_with_markup_is_text(tmp_path: Path) -> None:
    path = tmp_path / "<img src=x onerror=alert(1)>.csv"
    path.write_text("x,y,temperature\n1030,1020,20\n", encoding="utf-8")
    page = report(CALIBRATION, path, output=tmp_path / "r.html")
    assert not page.root.find("img")
    assert (2, "Log <img src=x onerror=alert(1)>.csv") in page.headings


# Matched pairs have the source's Table 1, and with the log its figure 6.


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A record of two pairs and what matches them."""
    folder = tmp_path_factory.mktemp("pair")
    log = record(seconds=400.0).write(folder / "disk.csv")
    pairs = ["--pair", "a1,a2", "--orthogonal", "a4", "--pair", "a3,a4", "--orthogonal", "a1"]
    assert run(["match", str(log), *pairs, "--phase", "theta", "-o", str(folder / "disk.yaml")]) == 0
    return folder


@pytest.fixture(scope="module")
def page(folder: Path) -> Page:
    assert run(["report", str(folder / "disk.yaml"), str(folder / "disk.csv"), "-o", str(folder / "disk.html")]) == 0
    return Page((folder / "disk.html").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def pairs(folder: Path) -> list[dict[str, Any]]:
    data = yaml.safe_load((folder / "disk.yaml").read_text(encoding="utf-8"))
    return list(data["pairs"])


def value(text: str) -> float:
    return float(text.replace("−", "-").partition("(")[0])


def test_table_1(page: Page, pairs: list[dict[str, Any]]) -> None:
    found = [t for t in page.root.find("table") if t.find("caption")]
    assert len(found) == len(pairs)
    for table, pair in zip(found, pairs, strict=True):
        rows = [[cell.text for cell in row.find("th", "td")] for row in table.find("tr")[2:]]
        names = [*pair["pair"], "sum"]
        assert [row[0] for row in rows] == [*pair["pair"], " + ".join(pair["pair"])]
        for name, row in zip(names, rows, strict=True):
            stages = ("before", "after_p", "after_pq")
            stated = [number for stage in stages for number in pair["components"][stage][name]]
            doubts = [number for stage in stages for number in pair["component_uncertainty"][stage][name]]
            for text, number, u in zip(row[1:], stated, doubts, strict=True):
                assert value(text) == pytest.approx(number, abs=0.06 * u)


def test_p_q_and_suppression(page: Page, pairs: list[dict[str, Any]]) -> None:
    rows = page.below("a1 and a2, orthogonal a4")
    assert value(rows[1][1]) == pytest.approx(pairs[0]["p"], abs=0.06 * pairs[0]["uncertainty"]["p"])
    assert value(rows[2][1]) == pytest.approx(pairs[0]["q"], abs=0.06 * pairs[0]["uncertainty"]["q"])
    said = next(one.text for one in page.root.find("p") if one.text.startswith("Common acceleration"))
    factor = said.split(" times after p, ")[1].split(" times")[0]
    assert re.fullmatch(r"\d{1,3}(\s\d{3})+", factor)
    assert int(re.sub(r"\s", "", factor)) == pytest.approx(pairs[0]["suppression"]["pq"], rel=6e-3)


def test_the_spectra_are_drawn_where_the_log_is_given(folder: Path, page: Page) -> None:
    (figure,) = page.root.find("figure")
    drawn = {one.text for one in figure.find("text")}
    assert {"a1", "sum after p", "sum after p and q", "frequency [Hz]"} <= drawn
    alone = folder / "alone.html"
    assert run(["report", str(folder / "disk.yaml"), "-o", str(alone)]) == 0
    assert not Page(alone.read_text(encoding="utf-8")).root.find("figure")

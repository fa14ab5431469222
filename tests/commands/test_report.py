"""``tiltcal report``: the page that it writes of calibrations and logs, and without what it needs."""

import json
import re
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from math import sin
from pathlib import Path

import numpy as np
import pytest
import yaml
from support import FIXTURES
from support.accelerometer_disk import record
from support.command import TILTCAL, tiltcal
from support.html_page import Page

from tiltcal.files.calibration import CalibrationRecord, read_calibration
from tiltcal.library.calibration import Calibration
from tiltcal.report.numbers import measured

DRAWN = ("complete", "free", "mounting", "multi-angle", "ramp", "reversal", "rotation", "temperature-sweep")
"""Golden files with every section and figure of a page of one calibration; that of pairs has figures with a log."""
CALIBRATION = FIXTURES / "complete.yaml"


def report(*files: str | Path, folder: Path, name: str = "report.html") -> Page:
    done = tiltcal("report", *files, "-o", name, cwd=folder, code=0)
    assert done.stderr == f"wrote {name}\n"
    return Page((folder / name).read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", DRAWN)
def test_a_page_can_be_read_printed_and_kept(name: str, tmp_path: Path) -> None:
    """It has a language, a title and headings in order, tells its figures in words, and fetches and runs nothing."""
    page = report(FIXTURES / f"{name}.yaml", folder=tmp_path)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.facts["Calibration file"] == f"{name}.yaml"
    assert "{" not in page.root.find("main")[0].text
    levels = [level for level, _ in page.headings]
    assert (levels.count(1), levels[0]) == (1, 1)
    assert all(later <= earlier + 1 for earlier, later in pairwise(levels))
    assert page.root.find("html")[0].attributes["lang"] == "en"
    assert page.headings[0][1] in page.root.find("title")[0].text
    figures = [one for figure in page.root.find("figure") for one in figure.find("svg")]
    assert bool(figures) != (name == "rotation")
    for figure in figures:
        assert figure.attributes["role"] == "img"
        named = {one.attributes["id"]: one.text for one in figure.find("title", "desc")}
        assert all(named[name] for name in figure.attributes["aria-labelledby"].split())
    ids = re.findall(r'\sid="([^"]*)"', text)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'(?:url\(#|xlink:href="#)([^")]*)', text)) <= set(ids) or not figures
    assert "://" not in text.replace("sim:", "")
    assert "@import" not in text
    assert not page.root.find("script", "img", "iframe", "object", "embed", "video", "audio")
    assert [one.attributes["href"] for one in page.root.find("link")] == ["data:,"]


def test_the_same_input_gives_the_same_bytes(tmp_path: Path) -> None:
    """In this process, and in one that orders its sets and dictionaries by other hashes."""
    report(CALIBRATION, folder=tmp_path)
    command = [*TILTCAL, "report", CALIBRATION, "-o", tmp_path / "there.html"]
    subprocess.run(command, check=True, env={"PYTHONHASHSEED": "1"}, capture_output=True)
    assert (tmp_path / "report.html").read_bytes() == (tmp_path / "there.html").read_bytes()


@pytest.mark.parametrize(("module", "name"), [("jinja2", "Jinja2"), ("matplotlib", "matplotlib")])
def test_without_the_extra_it_says_what_to_install(
    module: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    said = tiltcal("report", FIXTURES / "plane.yaml", "-o", tmp_path / "report.html", code=2).stderr
    why = f"a report needs {name}, which is not installed: pip install 'tiltcal[report]'"
    assert (said, (tmp_path / "report.html").exists()) == (f"tiltcal: {why}\n", False)
    if module == "jinja2":
        demo = tiltcal("demo", "here/demo", cwd=tmp_path, code=0).stdout
        assert demo.endswith(f"\n5. report\n   no picture and no page: {why}\n")


@pytest.mark.usefixtures("undrawn")
def test_several_calibrations_of_one_sensor(tmp_path: Path) -> None:
    """The page is about the last; the changes are those since each of the others, in counts."""
    known = read_calibration(FIXTURES / "plane.yaml")
    for name, counts in (("winter.yaml", -50.0), ("spring.yaml", 0.0), ("autumn.yml", 30.0)):
        offset = known.coefficients.offset + np.array([0.0, counts])
        changed = replace(known, coefficients=replace(known.coefficients, offset=offset))
        Calibration(changed).save(tmp_path / name)
    page = report("winter.yaml", "spring.yaml", "autumn.yml", folder=tmp_path)
    assert page.facts["Calibration file"] == "autumn.yml"
    for name, change in (("winter.yaml", "80.000("), ("spring.yaml", "30.000(")):
        (heading,) = [text for _, text in page.headings if text.startswith(f"Since {name}")]
        (row,) = [row for row in page.below(heading) if row[0] == "Offset of y"]
        told = json.loads(tiltcal("diff", name, "autumn.yml", "--json", cwd=tmp_path, code=1).stdout)
        (of_y,) = (one for one in told["coefficients"] if one["name"] == "offset.y")
        assert (row[4].startswith(change), row[-1]) == (True, f"{of_y['ratio']:.2f}")
    marked = [row.find("th")[0].text for row in page.root.find("tr") if row.attributes.get("class") == "mark"]
    assert marked == ["Offset of y"] * 2
    assert sum(one.text.startswith("Changed: offset.y by more than") for one in page.root.find("p")) == 2


# The part about a log says what `apply` says of it, whichever way it comes in.


@pytest.fixture
def bare(tmp_path: Path) -> str:
    """The same calibration without its records: the only figures of its page are those of logs."""
    known = read_calibration(CALIBRATION)
    Calibration(CalibrationRecord(known.sensor, known.coefficients)).save(tmp_path / "bare.yaml")
    return "bare.yaml"


def shares(page: Page, heading: str) -> dict[str, tuple[int, float]]:
    return {row[0]: (int(row[2].replace(" ", "")), float(row[3])) for row in page.below(heading)[1:]}


@pytest.mark.usefixtures("undrawn")
def test_flags_are_those_that_apply_counts_and_a_compensated_log_says_the_same(tmp_path: Path) -> None:
    """An hour with a plug that is loose for a while, a cold spell and a knock to the rail; its name has markup."""
    name, rows = "<img src=x onerror=alert(1)>.csv", ["time,x,y,temperature"]
    for k in range(3600):
        x = "" if 1000 <= k < 1100 else f"{1024 + 300 * sin(k / 200):.0f}"
        rows.append(f"{k},{'2047' if k == 2000 else x},{1020 + k % 7},{3.0 if k > 3000 else 20.0}")
    (tmp_path / name).write_text("\n".join(rows) + "\n", encoding="utf-8")
    applied = json.loads(tiltcal("apply", CALIBRATION, name, "-o", "tilt.csv", "--json", cwd=tmp_path, code=0).stdout)
    page = report(CALIBRATION, name, "tilt.csv", folder=tmp_path)
    assert not page.root.find("img")
    found = shares(page, f"Log {name}")
    expected = {f"Flag {flag}": count for flag, count in applied["flags"].items()}
    expected |= {f"Reason {bit}": count for bit, count in applied["reasons"].items()}
    assert {name: count for name, (count, _) in found.items()} == expected
    assert found["Flag 9"] == (100, pytest.approx(100 * 100 / 3600, abs=6e-4))
    assert shares(page, "Log tilt.csv") == found
    tables = [[[cell.text for cell in row.find("th", "td")] for row in t.find("tr")] for t in page.root.find("table")]
    one, other = ([row[1:] for row in rows] for rows in tables if rows and rows[0][:1] == ["Angle / °"])
    assert one == other


def test_other_names_of_columns_moments_bad_rows_and_logs_without_angles_or_times(bare: str, tmp_path: Path) -> None:
    (tmp_path / "own.csv").write_text(
        "when,VoutX,VoutY,time\n2026-01-17T22:00:00,1024,1020,a\n2026-01-17T22:00:10,oops,1020,b\n", encoding="utf-8"
    )
    page = report(bare, "own.csv", "--columns", "x=VoutX,y=VoutY,time=when", "--skip-bad-rows", folder=tmp_path)
    assert shares(page, "Log own.csv")["Flag 9"] == (1, 50.0)
    assert "time from 2026-01-17 22:00:00 UTC [s]" in (tmp_path / "report.html").read_text(encoding="utf-8")
    (tmp_path / "dead.csv").write_text("x,y,temperature\n,,\n", encoding="utf-8")
    (tmp_path / "rows.csv").write_text("x,y,temperature\n" + "1030,1020,20\n" * 5, encoding="utf-8")
    page = report(bare, "dead.csv", folder=tmp_path)
    said = [one.text for one in page.root.find("p")]
    assert any(text.startswith("1 row. The calibration") for text in said)
    assert "No row has an angle." in said
    assert not any("dead.csv" in one.text for one in page.root.find("figure"))
    report(bare, "rows.csv", folder=tmp_path)
    assert re.search(r">row</text>", (tmp_path / "report.html").read_text(encoding="utf-8"))


STAGES = ("before", "after_p", "after_pq")


def test_pairs_have_the_sources_table_1_and_with_the_log_its_figure_6(tmp_path: Path) -> None:
    record(seconds=400.0).write(tmp_path / "disk.csv")
    words = ("--pair", "a1,a2", "--orthogonal", "a4", "--pair", "a3,a4", "--orthogonal", "a1", "--phase", "theta")
    tiltcal("match", "disk.csv", *words, "-o", "disk.yaml", cwd=tmp_path, code=0)
    pairs = yaml.safe_load((tmp_path / "disk.yaml").read_text(encoding="utf-8"))["pairs"]
    page = report("disk.yaml", "disk.csv", folder=tmp_path)
    found = [t for t in page.root.find("table") if t.find("caption")]
    for table, pair in zip(found, pairs, strict=True):
        stages = [(pair["components"][stage], pair["component_uncertainty"][stage]) for stage in STAGES]
        assert [[cell.text for cell in row.find("th", "td")] for row in table.find("tr")[2:]] == [
            [told, *(measured(*one) for values, u in stages for one in zip(values[name], u[name], strict=True))]
            for name, told in zip((*pair["pair"], "sum"), (*pair["pair"], " + ".join(pair["pair"])), strict=True)
        ]
        rows = page.below(f"{' and '.join(pair['pair'])}, orthogonal {pair['orthogonal']}")
        assert [row[1] for row in rows[1:3]] == [measured(pair[name], pair["uncertainty"][name]) for name in "pq"]
    said = next(one.text for one in page.root.find("p") if one.text.startswith("Common acceleration"))
    factor = said.split(" times after p, ")[1].split(" times")[0]
    assert re.fullmatch(r"\d{1,3}(\s\d{3})+", factor)
    assert int(re.sub(r"\s", "", factor)) == pytest.approx(pairs[0]["suppression"]["pq"], rel=6e-3)
    (figure,) = page.root.find("figure")
    assert {"a1", "sum after p", "sum after p and q", "frequency [Hz]"} <= {one.text for one in figure.find("text")}
    assert not report("disk.yaml", folder=tmp_path).root.find("figure")
    (tmp_path / "short.csv").write_text("".join((tmp_path / "disk.csv").read_text().splitlines(keepends=True)[:30]))
    short = tiltcal("report", "disk.yaml", "short.csv", "-o", "short.html", cwd=tmp_path, code=2).stderr
    assert short.startswith("tiltcal: short.csv: ")

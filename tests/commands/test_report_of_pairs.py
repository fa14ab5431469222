"""The page of matched pairs has the source's Table 1, and with the log its figure 6."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from support.accelerometer_disk import record
from support.html_page import Page

from tiltcal.cli.main import run


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
    factor = float(said.split(" times after p, ")[1].split(" times")[0].replace(" ", ""))
    assert factor == pytest.approx(pairs[0]["suppression"]["pq"], rel=6e-3)


def test_the_spectra_are_drawn_where_the_log_is_given(folder: Path, page: Page) -> None:
    (figure,) = page.root.find("figure")
    drawn = {one.text for one in figure.find("text")}
    assert {"a1", "sum after p", "sum after p and q", "frequency [Hz]"} <= drawn
    alone = folder / "alone.html"
    assert run(["report", str(folder / "disk.yaml"), "-o", str(alone)]) == 0
    assert not Page(alone.read_text(encoding="utf-8")).root.find("figure")


def test_two_files_of_pairs_are_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = str(folder / "disk.yaml")
    assert run(["report", file, file, "-o", str(folder / "two.html")]) == 2
    assert "about one file" in capsys.readouterr().err

"""``tiltcal report``: the page that it writes, and what it refuses."""

import re
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from support import FIXTURES
from support.command import TILTCAL
from support.html_page import Page

from tiltcal.cli.main import run
from tiltcal.files.calibration import read_calibration
from tiltcal.library.calibration import Calibration

PAIR = FIXTURES / "rotation.yaml"
"""Its page has figures with a log alone."""


DRAWN = ("complete", "free", "rotation", "sensitivity-drift")
"""Golden files with every section and every figure of a page of one calibration."""


@pytest.fixture(scope="module", params=DRAWN)
def file(request: pytest.FixtureRequest) -> Path:
    return FIXTURES / f"{request.param}.yaml"


@pytest.fixture(scope="module")
def text(file: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    """Its page, with its figures."""
    output = tmp_path_factory.mktemp("page") / "report.html"
    assert run(["report", str(file), "-o", str(output)]) == 0
    return output.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def page(text: str) -> Page:
    return Page(text)


def test_a_page_can_be_read_printed_and_kept(file: Path, text: str, page: Page) -> None:
    """It has a language, a title and headings in order, tells its figures in words, and fetches and runs nothing."""
    assert page.facts["Calibration file"] == file.name
    assert "{" not in page.root.find("main")[0].text
    levels = [level for level, _ in page.headings]
    assert (levels.count(1), levels[0]) == (1, 1)
    assert all(later <= earlier + 1 for earlier, later in pairwise(levels))
    assert page.root.find("html")[0].attributes["lang"] == "en"
    assert page.headings[0][1] in page.root.find("title")[0].text
    figures = [one for figure in page.root.find("figure") for one in figure.find("svg")]
    assert bool(figures) != (file == PAIR)
    for figure in figures:
        assert figure.attributes["role"] == "img"
        named = {one.attributes["id"]: one.text for one in figure.find("title", "desc")}
        assert all(named[name] for name in figure.attributes["aria-labelledby"].split())
    ids = re.findall(r'\sid="([^"]*)"', text)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'(?:url\(#|xlink:href="#)([^")]*)', text)) <= set(ids) or file == PAIR
    assert "://" not in text.replace("sim:", "")
    assert "@import" not in text
    assert not page.root.find("script", "img", "iframe", "object", "embed", "video", "audio")
    assert [one.attributes["href"] for one in page.root.find("link")] == ["data:,"]


def test_the_same_input_gives_the_same_bytes(tmp_path: Path) -> None:
    """In this process, and in one that orders its sets and dictionaries by other hashes."""
    here, there = tmp_path / "here.html", tmp_path / "there.html"
    assert run(["report", str(FIXTURES / "complete.yaml"), "-o", str(here)]) == 0
    command = [*TILTCAL, "report", FIXTURES / "complete.yaml", "-o", there]
    subprocess.run(command, check=True, env={"PYTHONHASHSEED": "1"}, capture_output=True)
    assert here.read_bytes() == there.read_bytes()


def test_without_the_extra_it_says_what_to_install(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    output = tmp_path / "report.html"
    for module, name in (("jinja2", "Jinja2"), ("matplotlib", "matplotlib")):
        with monkeypatch.context() as missing:
            missing.setitem(sys.modules, module, None)
            assert run(["report", str(FIXTURES / "plane.yaml"), "-o", str(output)]) == 2
        said = capsys.readouterr().err
        assert said == f"tiltcal: a report needs {name}, which is not installed: pip install 'tiltcal[report]'\n"
    assert not output.exists()


@pytest.mark.usefixtures("undrawn")
def test_several_calibrations_of_one_sensor(tmp_path: Path) -> None:
    spring, autumn, output = tmp_path / "spring.yaml", tmp_path / "autumn.yml", tmp_path / "report.html"
    known = read_calibration(FIXTURES / "plane.yaml")
    Calibration(known).save(spring)
    offset = known.coefficients.offset + np.array([0.0, 3.0])
    Calibration(replace(known, coefficients=replace(known.coefficients, offset=offset))).save(autumn)
    assert run(["report", str(spring), str(autumn), "-o", str(output)]) == 0
    page = Page(output.read_text(encoding="utf-8"))
    assert page.facts["Calibration file"] == "autumn.yml"
    assert any(text.startswith("Since spring.yaml") for _, text in page.headings)

"""The documentation is true: every command in it runs and says what is printed there, and no link leads nowhere.

In a page, a ``console`` block holds commands behind ``$`` and what they print; ``...`` stands for anything. A block
with a file name behind its language is a file that the commands after it find. A ``pycon`` block is part of the
page's one Python session. A ``text`` block is only read.
"""

import doctest
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from pkgutil import resolve_name

import numpy as np
import polars
import pytest
from support import ROOT
from support.command import Completed
from support.command import tiltcal as run_command
from support.warm_start import WarmStart

import tiltcal
from tiltcal.drivers import models

PAGES = [
    ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md", "benchmarks/README.md")
] + sorted(ROOT.glob("docs/**/*.md"))
WITH_COMMANDS = [page for page in PAGES if "```console" in page.read_text(encoding="utf-8")]
LIBRARY = ROOT / "docs" / "library.md"
SENSORS = ROOT / "docs" / "which-sensor.md"

BLOCK = re.compile(r"^```(\w+)(?: (\S+))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
NAMED_FILE = re.compile(r"`((?:tiltcal|drivers|procedures|tests|docs|fixtures|benchmarks|firmware)/[\w/.-]*)`")
"""A file or folder of ours, in the typewriter face."""
REFERENCE = re.compile(r":(?:mod|func|class|data|meth|attr):`(tiltcal\.[\w.]+)`")
"""A module of ours in a docstring, or a name in it."""
LINK = re.compile(r"\]\(([^)#\s]*)(?:#([^)\s]*))?\)")


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT))


def is_history(page: Path) -> bool:
    """Whether a page names files of the past."""
    return page.name == "CHANGELOG.md" or page.parent.name == "decisions"


@dataclass(frozen=True)
class Command:
    """One command of a page, and what the page says that it prints."""

    line: str
    printed: str

    @property
    def fails(self) -> bool:
        """Whether the page shows an error of ours, or the verdict of `diff` that a sensor has changed."""
        return any(line.startswith(("tiltcal: ", "changed: ")) for line in self.printed.splitlines())


def commands_of(block: str) -> Iterator[Command]:
    for part in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]:
        line, _, printed = part.partition("\n")
        yield Command(line, printed)


def pattern_of(printed: str) -> str:
    """What is printed as a regular expression; a line of ``...`` is any lines, ``...`` in a line is any characters."""
    return "".join(
        "(?:.*\n)*" if line == "..." else re.escape(line).replace(r"\.\.\.", ".*") + "\n"
        for line in printed.splitlines()
    )


@pytest.fixture(scope="module")
def shims(warm: WarmStart, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the ``tiltcal`` and the ``python`` of this test run."""
    folder = tmp_path_factory.mktemp("bin")
    for name, command in (("tiltcal", warm.program), ("python", [sys.executable])):
        shim = folder / name
        shim.write_text(f'#!/bin/sh\nexec {shlex.join(command)} "$@"\n', encoding="utf-8")
        shim.chmod(0o755)
    return folder


SHELL = re.compile(r"[|&;<>$`*~]")
"""What only a shell understands."""


def run(line: str, folder: Path, shims: Path) -> Completed:
    """Run a line of a page: in this process where it is one command of ours, in a shell where it is more."""
    if line.startswith("tiltcal ") and not SHELL.search(line):
        return run_command(*shlex.split(line)[1:], cwd=folder, merged=True)
    return subprocess.run(
        ["bash", "-o", "pipefail", "-c", line],
        cwd=folder,
        env=os.environ | {"PATH": f"{shims}{os.pathsep}{os.environ['PATH']}", "LC_ALL": "C.UTF-8"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )


@pytest.mark.usefixtures("own_modules", "undrawn")  # tests of reports and of figures draw them
@pytest.mark.parametrize("page", WITH_COMMANDS, ids=name_of)
def test_commands_run_and_print_what_the_page_says(page: Path, shims: Path, tmp_path: Path) -> None:
    for language, file, content in BLOCK.findall(page.read_text(encoding="utf-8")):
        if file:
            (tmp_path / file).write_text(content, encoding="utf-8")
        for command in commands_of(content) if language == "console" else ():
            done = run(command.line, tmp_path, shims)
            assert (done.returncode != 0) == command.fails, f"{command.line}\n{done.stdout}"
            if command.printed:
                assert re.fullmatch(pattern_of(command.printed), done.stdout), f"{command.line}\n{done.stdout}"


def test_the_examples_of_the_library_run_and_print_what_the_page_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    page = LIBRARY.read_text(encoding="utf-8")
    source = "\n".join(content for language, _, content in BLOCK.findall(page) if language == "pycon")
    examples = doctest.DocTestParser().get_doctest(source, {}, LIBRARY.name, str(LIBRARY), 0)
    printed: list[str] = []
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    runner.run(examples, out=printed.append)
    assert not runner.failures, "".join(printed)


class AnyOutput(doctest.OutputChecker):
    """The examples of docstrings state no output: they only have to run."""

    def check_output(self, want: str, got: str, optionflags: int) -> bool:
        return not want or super().check_output(want, got, optionflags)


def test_the_examples_of_docstrings_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("S-0042.yaml", "spring.yaml", "autumn.yaml"):
        shutil.copy(ROOT / "fixtures" / "complete.yaml", name)
    shutil.copy(ROOT / "fixtures" / "complete.journal.jsonl", "S-0042.journal.jsonl")
    turn = np.linspace(0.0, 12.0, 1200, endpoint=False)
    disk = {name: np.sin(2.0 * np.pi * (turn + at)) for name, at in (("a1", 0.0), ("a2", 0.5), ("a4", 0.75))}
    polars.DataFrame({"theta": 360.0 * (turn % 1.0), **disk}).write_csv("disk.csv")
    ours = {
        "tiltcal": tiltcal,
        "frame": polars.DataFrame({"VoutX": [1024.0], "y": [1030.0], "temperature": [20.0]}),
        "readings": {"x": np.random.default_rng(1).normal(0.0, 0.01, 2000)},
    }
    printed: list[str] = []
    runner = doctest.DocTestRunner(checker=AnyOutput(), optionflags=doctest.ELLIPSIS)
    for name in tiltcal.__all__:
        for example in doctest.DocTestFinder().find(getattr(tiltcal, name), name, module=False, extraglobs=ours):
            runner.run(example, out=printed.append)
    assert runner.tries > 5
    assert not runner.failures, "".join(printed)


def test_links_lead_somewhere_and_files_that_are_named_exist() -> None:
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for target, heading in LINK.findall(text):
            goal = page.parent / target if target else page
            if not target.startswith(("http:", "https:")):
                assert goal.exists(), f"{page}: {target}"
                assert not heading or heading in headings_of(goal), f"{page}: {target}#{heading}"
        for path in () if is_history(page) else NAMED_FILE.findall(text):
            assert (ROOT / path).exists(), f"{page}: {path}"


def test_every_model_is_on_the_page_that_leads_to_it() -> None:
    page = SENSORS.read_text(encoding="utf-8")
    assert [model.name for model in models() if f"`{model.name}`" not in page] == []


def sensors_with_procedures() -> Iterator[tuple[str, str]]:
    """The models and procedures of each row of the table of markings, which has six columns."""
    for line in SENSORS.read_text(encoding="utf-8").splitlines():
        cells = line.split("|")[1:-1]
        if len(cells) == 6:
            yield from product(re.findall("`([^`]+)`", cells[2]), re.findall("`([^`]+)`", cells[4]))


def test_a_sensor_has_the_range_for_the_procedures_beside_it() -> None:
    for model, procedure in sensors_with_procedures():
        name, _, tilt = procedure.partition(" --tilt ")
        address = "sim:?counts_per_g=1000" if model == "sca3000-i2c" else "sim:"
        planned = tiltcal.plan(name, sensor=model, address=address, tilt=float(tilt) if tilt else None)
        assert str(planned).startswith("predicted standard uncertainty"), (model, procedure)


def test_names_in_docstrings_exist() -> None:
    sources = [source for folder in ("tiltcal", "drivers") for source in (ROOT / folder).rglob("*.py")]
    names = {name for source in sources for name in REFERENCE.findall(source.read_text(encoding="utf-8"))}
    assert names
    for name in sorted(names):
        assert resolve_name(name) is not None


def headings_of(page: Path) -> set[str]:
    """The anchors that a reader's browser makes of headings."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_the_reference_pages_are_current() -> None:
    generator = ROOT / "docs" / "reference" / "generate.py"
    done = subprocess.run([sys.executable, str(generator), "--check"], check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_every_decision_is_listed() -> None:
    listed = (ROOT / "docs" / "decisions" / "README.md").read_text(encoding="utf-8")
    for record in (ROOT / "docs" / "decisions").glob("0*.md"):
        assert f"({record.name})" in listed

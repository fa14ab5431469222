"""Draw changes of the product by chance, and count those that the tests which reach the changed function find.

::

    .venv/bin/python -m pip install cosmic-ray pytest-cov
    .venv/bin/python benchmarks/mutants.py --map reached [tests/unit ...]  # runs the suite once; keep the two files
    .venv/bin/python benchmarks/mutants.py --with reached --seed 1 --count 120 --minutes 60

A place is drawn first and then one of the changes that cosmic-ray has for it, so that no place counts more because more
can be done there. Each change runs in a copy, against the tests that reach its line (outside of functions: its module,
and the tests that hold tables), the quickest first and as many as take 40 seconds, and stops at the first failure. What
fails without the change too is left out, and what survives is printed. A process that a test starts counts
for that test, unless it is killed or has an environment of its own.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from importlib import import_module
from itertools import accumulate
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).resolve().parents[1]
PYTEST = (sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider")

FAILED = "failed.txt"
PHASE = r"(\|| \()(setup|run|call|teardown)\)?$"
"""What coverage and pytest add to the name of a test that runs."""
LONGEST = 300.0
"""Seconds for the tests of one change; with more it is unclear."""
SECONDS = 40.0
"""Of the tests that a change is run against, by their times when the map was recorded."""
LOADED = (
    "click",
    "msgspec",
    "narwhals",
    "numpy",
    "polars",
    "rich",
    "scipy.optimize",
    "scipy.signal",
    "yaml",
)
TABLES = ("tests/project/test_thresholds.py", "tests/scenarios/test_fixtures.py")
TABLES_OF_DRIVERS = ("tests/contract/test_data_sheets.py", "tests/contract/test_every_device.py")
"""What holds constants and tables, which are read once, at an import: coverage shows it of the first test alone."""
LEFT_OUT = ("Variable", "RemoveDecorator")
"""Operators that make another program rather than a slip."""
SLIPS = {"Add": "Sub", "Sub": "Add", "Mul": "Div", "Div": "Mul", "FloorDiv": "Div", "Mod": "FloorDiv"}
SLIPS |= {"BitOr": "BitAnd", "BitAnd": "BitOr", "BitXor": "BitOr", "LShift": "RShift", "RShift": "LShift"}
SLIPS |= {"Lt": "LtE GtE", "LtE": "Lt Gt", "Gt": "GtE LtE", "GtE": "Gt Lt", "Eq": "NotEq", "NotEq": "Eq"}
SLIPS |= {"Is": "NotEq", "IsNot": "Eq", "USub": "UAdd", "Delete": "USub Not"}
"""The other operators that are tried for each: the opposite, and the bound that counts or does not."""
BY_CONSTRUCTION = r"\*,|strict=True|kw_only=True|if TYPE_CHECKING"
"""What is no calculation: how arguments are given, and a zip of what has one length."""

FOLLOWED = {
    "followed.py": """
import os
def pytest_runtest_setup():
    os.environ["COVERAGE_PROCESS_START"] = "{folder}/followed.ini"
""",
    "followed.ini": """
[run]
source = {folder}/tiltcal
    {folder}/drivers
parallel = true
context = ${{PYTEST_CURRENT_TEST}}
disable_warnings = no-data-collected, module-not-imported, module-not-measured, already-imported
""",
    "sitecustomize.py": "import coverage\ncoverage.process_startup()\n",
}
"""Files beside the copied tests, by which a process that a test starts writes its lines under the name of that test."""


class Place(NamedTuple):
    """Where something can be changed: its file, line and column, and the changes as operator and occurrence."""

    file: str
    line: int
    column: int
    changes: tuple[tuple[str, int], ...]


def worth_trying(operator: str) -> bool:
    """Whether an operator of cosmic-ray makes a slip that a person could make."""
    replaced = re.search(r"(?:Binary|Comparison|Unary)Operator_([A-Za-z]+)_([A-Za-z]+)$", operator)
    if replaced:
        return replaced[2] in SLIPS.get(replaced[1], "").split()
    return not any(part in operator for part in LEFT_OUT)


def places(root: Path) -> Iterator[Place]:
    """Return every place of the product where something can be changed."""
    from cosmic_ray.ast import ast_nodes, get_ast
    from cosmic_ray.plugins import get_operator, operator_names

    operators = [(name, get_operator(name)()) for name in operator_names() if worth_trying(name)]
    for path in sorted((*root.glob("tiltcal/**/*.py"), *root.glob("drivers/**/*.py"))):
        if "tiltcal/drivers" in str(path):
            continue
        text = path.read_text(encoding="utf-8")
        said = [*annotated(text), *by_construction(text)]
        found = defaultdict(list)
        nodes = list(ast_nodes(get_ast(text)))
        for name, operator in operators:
            positions = (start for node in nodes for start, _ in operator.mutation_positions(node))
            for occurrence, start in enumerate(positions):
                if not any(first <= start < last for first, last in said):
                    found[start].append((name, occurrence))
        for (line, column), changes in sorted(found.items()):
            yield Place(str(path.relative_to(root)), line, column, tuple(changes))


def by_construction(text: str) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Return where nothing is calculated, as pairs of line and column."""
    lines = enumerate(text.splitlines(), 1)
    return [
        ((number, one.start()), (number, one.end()))
        for number, line in lines
        for one in re.finditer(BY_CONSTRUCTION, line)
    ]


def annotated(text: str) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Return where annotations stand, which nobody runs, as pairs of line and column."""
    marked = (getattr(node, name, None) for node in ast.walk(ast.parse(text)) for name in ("annotation", "returns"))
    expressions = [one for one in marked if isinstance(one, ast.expr)]
    return [((one.lineno, one.col_offset), (one.end_lineno or 0, one.end_col_offset or 0)) for one in expressions]


class Reach:
    """Which tests reach a line, in their process or one that they start, and how long they take."""

    def __init__(self, stems: Sequence[str], present: set[str]) -> None:
        from coverage import CoverageData

        self._present = present
        self._data = CoverageData(no_disk=True)
        self._seconds: dict[str, float] = {}
        for stem in stems:
            one = CoverageData(f"{stem}.coverage")
            one.read()
            self._data.update(one)
            for case in ElementTree.parse(f"{stem}.xml").iter("testcase"):
                self._seconds[f"{case.get('classname')}.{case.get('name')}"] = float(case.get("time") or 0.0)

    def tests(self, root: Path, place: Place) -> list[str]:
        """Return the tests that reach the line of a place, the quickest first, or those of its function."""
        contexts: dict[int, list[str]] = defaultdict(list)
        for measured in self._data.measured_files():  # each map was recorded in a folder of its own
            if measured.endswith(f"/{place.file}"):
                for line, found in self._data.contexts_by_lineno(measured).items():
                    contexts[line] += found
        body = function_of((root / place.file).read_text(encoding="utf-8"), place.line)
        names: set[str] = set()
        for first, last in ((place.line, place.line), body):
            reached = (name for line in range(first, last + 1) for name in contexts.get(line, ()))
            names = names or {re.sub(PHASE, "", name) for name in reached} & self._present
        quickest = sorted(names, key=self._time)
        until = accumulate(map(self._time, quickest))
        chosen = [name for name, so_far in zip(quickest, until, strict=True) if so_far <= SECONDS]
        # A function that makes rows of a table runs at an import alone.
        of_drivers = TABLES_OF_DRIVERS[: None if body[0] == 1 else 1] if place.file.startswith("drivers") else ()
        tables = (*(TABLES if body[0] == 1 else ()), *of_drivers)
        return [*tables, *(chosen or quickest[:1])]

    def _time(self, test: str) -> float:
        path, _, name = test.partition("::")
        return self._seconds.get(f"{path.removesuffix('.py').replace('/', '.')}.{name.replace('::', '.')}", 1.0)


def function_of(text: str, line: int) -> tuple[int, int]:
    """Return the lines of the body of the innermost function around a line, or those of the whole file."""
    spans = [
        (node.body[0].lineno, node.end_lineno or node.lineno, node.lineno)
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    ]
    around = [(begin, end) for begin, end, head in spans if head <= line <= end]
    return min(around, key=lambda span: span[1] - span[0]) if around else (1, text.count("\n") + 1)


def copied(root: Path, folder: str) -> dict[str, str]:
    """Copy what the tests need; return the environment in which they run on the copy."""
    ignored = shutil.ignore_patterns("__pycache__", "build")
    command = ["git", "ls-files"]
    listed = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True).stdout.split("\n")
    for part in {path.partition("/")[0] for path in listed if path}:
        source, goal = root / part, Path(folder, part)
        if source.is_dir():
            shutil.copytree(source, goal, symlinks=True, ignore=ignored)
        else:
            shutil.copy(source, goal)
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return {**kept, "PYTHONPATH": folder}


def record(stem: str, tests: Sequence[str]) -> int:
    """Run the suite once with coverage by test; keep which tests reach what, and their times."""
    stem = str(Path(stem).resolve())
    options = ("-n", "2", "--cov=tiltcal", "--cov=drivers", "--cov-context=test", "--cov-report=")  # drivers by a link
    with tempfile.TemporaryDirectory() as folder:
        environment = copied(ROOT, folder) | {"COVERAGE_FILE": f"{stem}.coverage"}
        for name, text in FOLLOWED.items():
            Path(folder, name).write_text(text.format(folder=folder, stem=stem), encoding="utf-8")
        command = [*PYTEST, *options, "-p", "followed", f"--junitxml={stem}.xml", *tests]
        return subprocess.run(command, cwd=folder, env=environment).returncode


def present() -> set[str]:
    """Return the names of the tests that there are; the map may be older."""
    listed = subprocess.run([*PYTEST, "--collect-only"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return {line for line in listed.splitlines() if "::" in line}


def run(options: argparse.Namespace) -> int:
    """Draw the changes, run each, print those that survive, and return their number."""
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.plugins import get_operator

    for library in LOADED:
        import_module(library)
    chance, reach, began = random.Random(options.seed), Reach(options.reach, present()), time.monotonic()
    among = [place for place in places(ROOT) if place.file.startswith(tuple(options.under))]
    drawn = chance.sample(among, min(2 * options.count, len(among)))
    counted: dict[str, int] = defaultdict(int)
    with tempfile.TemporaryDirectory() as folder:
        environment = copied(ROOT, folder)
        for place in drawn:
            number = sum(counted.values()) + 1
            if number > options.count or time.monotonic() - began > 60.0 * options.minutes:
                break
            operator, occurrence = chance.choice(place.changes)
            path = Path(folder, place.file)
            text = path.read_text(encoding="utf-8")
            changed = mutate_code(text, get_operator(operator)(), occurrence)
            try:
                compile(changed, path, "exec")
            except SyntaxError:  # such as an asterisk before an argument, which is no product
                continue
            path.write_text(changed, encoding="utf-8")
            tests = reach.tests(ROOT, place)
            while (outcome := outcome_of(tests, folder, environment) if tests else "survives") == "found":
                failed = Path(folder, FAILED).read_text(encoding="utf-8") if Path(folder, FAILED).exists() else tests[0]
                shutil.copy2(ROOT / place.file, path)
                if outcome_of([failed], folder, environment) == "survives":
                    break
                print(f"{failed} fails without a change", flush=True)
                tests = [name for name in tests if name != failed and not failed.startswith(f"{name}::")]
                path.write_text(changed, encoding="utf-8")
            shutil.copy2(ROOT / place.file, path)  # with its time, by which Python knows what it has compiled
            counted[outcome] += 1
            lines = zip(text.splitlines(), changed.splitlines(), strict=False)
            old, new = next(((a.strip(), b.strip()) for a, b in lines if a != b), ("", ""))
            said = f"{number} {outcome} ({len(tests)} tests) {place.file}:{place.line}"
            print(f"{said} {failed}" if outcome == "found" else f"{said}\n    {old}\n    {new}", flush=True)
    found, survivors = counted["found"], counted["survives"]
    minutes, spent = (time.monotonic() - began) / 60.0, sum(os.times()[:4]) / 60.0
    print(
        f"seed {options.seed}: {found} of {found + survivors} found, {minutes:.0f} minutes, {spent:.0f} of a processor"
    )
    return survivors


class FirstFailure:
    """A plugin of pytest that writes which test fails."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self._path.write_text(report.nodeid, encoding="utf-8")


def outcome_of(tests: list[str], folder: str, environment: dict[str, str]) -> str:
    """Run tests until one fails, in a fork of this process, which has the libraries loaded; a time-out is a failure."""
    names = Path(folder, "tests.txt")
    Path(folder, FAILED).unlink(missing_ok=True)
    names.write_text("\n".join(tests), encoding="utf-8")
    child = os.fork()
    if child == 0:
        os.setsid()
        os.chdir(folder)
        os.environ.update(environment)
        sys.dont_write_bytecode = False
        sys.path.insert(0, folder)
        for stream in (1, 2):
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
        options = ["-q", "-x", "-p", "no:cacheprovider", "--timeout=40", f"@{names}"]
        os._exit(int(pytest.main(options, plugins=[FirstFailure(Path(folder, FAILED))])))
    until = time.monotonic() + LONGEST
    while time.monotonic() < until:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return "survives" if os.waitstatus_to_exitcode(status) in (0, 5) else "found"
        time.sleep(0.05)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return "unclear"


def main() -> int:
    """Record the map, or draw and run changes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--map", metavar="STEM", help="run the suite once, and write STEM.coverage and STEM.xml")
    parser.add_argument("tests", nargs="*", help="with --map: the tests to run, all without any")
    parser.add_argument("--with", dest="reach", metavar="STEM", action="append", default=[], help="what --map wrote")
    parser.add_argument("--under", metavar="FOLDER", action="append", default=[], help="draw there, and not everywhere")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=120)
    parser.add_argument("--minutes", type=float, default=60.0)
    options = parser.parse_args()
    options.under = options.under or [""]
    return record(options.map, options.tests) if options.map else run(options)


if __name__ == "__main__":
    raise SystemExit(main())

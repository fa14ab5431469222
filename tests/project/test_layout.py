"""A newcomer finds the tests of a module by its name."""

import re
from collections import Counter
from pathlib import Path

from support import ROOT

UNIT = ROOT / "tests" / "unit"


def modules_beside(test: Path) -> set[str]:
    """Return the names of the modules and packages in the folder that a unit test's folder mirrors."""
    folder = test.parent.relative_to(UNIT)
    places = [ROOT / "tiltcal" / folder, ROOT / folder]
    found = {path.stem for place in places for path in place.glob("*.py")}
    return found | {path.parent.name for place in places for path in place.glob("*/__init__.py")} - {"__init__"}


def test_every_unit_test_is_named_for_its_module() -> None:
    """``test_estimate.py``, and beside it ``test_estimate_jointly.py`` where one file would be too long.

    ``test_refused.py`` has what a whole folder refuses, in one table.
    """
    for test in UNIT.glob("**/test_*.py"):
        name = test.stem.removeprefix("test_")
        assert name == "refused" or any(
            name == module or name.startswith(f"{module}_") for module in modules_beside(test)
        ), test


def test_a_class_name_exists_once() -> None:
    sources = [path for folder in ("tiltcal", "drivers") for path in (ROOT / folder).rglob("*.py")]
    found = Counter(
        name
        for source in {path.resolve() for path in sources}
        for name in re.findall(r"^class (\w+)", source.read_text(encoding="utf-8"), flags=re.MULTILINE)
    )
    assert found
    assert not [name for name, count in found.items() if count > 1]

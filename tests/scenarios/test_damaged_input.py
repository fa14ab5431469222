"""A small share of what `benchmarks/fuzz.py` tries: damaged input ends in a result or in one of our errors."""

from __future__ import annotations

import pytest
from support.fuzzing import FAILED, TARGETS, attempt, campaign


@pytest.mark.parametrize("name", [name for name, target in TARGETS.items() if not target.compiled])
def test_in_this_process(name: str) -> None:
    for number in range(15):
        end, detail = attempt(name, 2026, number)
        assert end != FAILED, f"{name} {number}: {detail}"


def test_formats_that_a_library_parses_in_a_process_that_may_end() -> None:
    figures = campaign([name for name, target in TARGETS.items() if target.compiled], 2026, range(15))
    assert not figures.failures
    assert sum(ends.total() for ends in figures.ends.values()) == 30

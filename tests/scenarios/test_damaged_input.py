"""A small share of what `benchmarks/fuzz.py` tries: damaged input ends in a result or in one of our errors."""

from __future__ import annotations

import pytest
from support.fuzz_inputs import TARGETS
from support.fuzzing import FAILED, attempt, attempts


@pytest.mark.parametrize("name", [name for name, target in TARGETS.items() if not target.compiled])
def test_in_this_process(name: str) -> None:
    for number in range(20 if TARGETS[name].share > 1 else 8):
        end, detail = attempt(name, 2026, number)
        assert end != FAILED, f"{name} {number}: {detail}"


def test_formats_that_a_library_parses_in_a_process_that_may_end() -> None:
    for name in [name for name, target in TARGETS.items() if target.compiled]:
        ends = [end for _, end, _ in attempts(name, 2026, range(8))]
        assert len(ends) == 8
        assert FAILED not in ends

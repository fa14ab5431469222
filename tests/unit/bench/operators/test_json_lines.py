"""Answers of a program as JSON Lines."""

from __future__ import annotations

import io

import pytest

from tiltcal.bench.operators.json_lines import JsonLinesRig
from tiltcal.errors import InputError


@pytest.mark.parametrize(
    "line", ['{"answer": "quit", "answer": "ready"}', '{"answer": "ready", "tilt": {"x": 1, "x": 2}}']
)
def test_a_key_that_is_there_twice_is_refused(line: str) -> None:
    """The last of both counted (RFC 8259, section 4: what happens is unpredictable)."""
    rig = JsonLinesRig(io.StringIO(f"{line}\n"), io.StringIO())
    with pytest.raises(InputError, match="is there twice in one answer"):
        rig.position({})

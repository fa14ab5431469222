"""The options of a command reach the library under the library's own names."""

import json
from collections.abc import Callable
from inspect import signature
from math import inf, nan
from typing import Any

import click
import pytest

from tiltcal.cli.main import group
from tiltcal.cli.options import Number, json_text
from tiltcal.errors import UsageError
from tiltcal.library.measure import measure, plan
from tiltcal.library.recorded import apply_log, fit
from tiltcal.stated_arguments import require_from_zero


@pytest.mark.parametrize(
    ("command", "function", "own"),
    [
        ("measure", measure, "operator"),
        ("plan", plan, "as_json"),
        ("fit", fit, "logs topic output"),
        ("apply", apply_log, "files calibrations scheduler as_json topic"),
    ],
)
def test_every_option_but_a_command_s_own_is_a_parameter_of_the_library(
    command: str, function: Callable[..., Any], own: str
) -> None:
    found = group.get_command(click.Context(group), command)
    assert found is not None
    options = {str(one.name) for one in found.params}
    assert set(own.split()) < options
    assert options - set(own.split()) <= set(signature(function).parameters)


@pytest.mark.parametrize("value", ["nan", "inf"])
def test_no_option_takes_what_is_no_finite_number(value: str) -> None:
    """Click takes nan for a number in any range; ``record --rate nan`` ended in a traceback."""
    with pytest.raises(UsageError, match=f"takes 0 or a number from 1e-09 to 1e\\+09, not {value}"):
        Number(require_from_zero).convert(value, None, None)
    every = {name: group.get_command(click.Context(group), name) for name in group.list_commands(click.Context(group))}
    loose = [
        (name, one.name)
        for name, command in every.items()
        if command is not None
        for one in command.params
        if isinstance(one.type, click.FloatRange | click.IntRange) and one.type.max is None
    ]
    assert loose == []


def test_json_has_no_number_that_is_not_finite() -> None:
    text = json_text({"p": nan, "limits": (inf, -inf, 1.5), "rows": [{"n": 3, "°C": None}]})
    assert text.isascii()
    assert json.loads(text) == {"p": None, "limits": [None, None, 1.5], "rows": [{"n": 3, "°C": None}]}

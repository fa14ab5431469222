"""Common options and remarks of the commands that run a session."""

from __future__ import annotations

import click

LEADERS = click.Choice(["terminal", "json", "sim"])


def left_at_default(option: str) -> bool:
    """Return whether an option is not on the command line."""
    context = click.get_current_context()
    return context.get_parameter_source(option) is click.core.ParameterSource.DEFAULT


def remark(line: str) -> None:
    """Print a remark on the session; control characters, which could be escape sequences, become question marks."""
    click.echo("".join(one if one.isprintable() or one == "\n" else "?" for one in line), err=True)

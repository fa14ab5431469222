"""The options that several commands have, and the output of a verdict."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from math import isfinite
from pathlib import Path
from typing import Any, TypeVar, get_args

import click

from tiltcal.cli.completion import complete
from tiltcal.options import flag_of, options_of
from tiltcal.stated_arguments import require_above_zero, require_whole

F = TypeVar("F", bound=Callable[..., Any])

FILE = click.Path(path_type=Path)

HEADINGS = {
    "Sensor": "--sensor --address --bench --calibration --unit",
    "Data": "--columns --pair --orthogonal --phase --skip-bad-rows",
    "Result": "--output --golden --to --name --fixed --allow --figure --interval",
    "Recording": "--samples --rate --rows --for",
    "Averages": "--target",
    "Method": "--online --loops",
}
"""The headings of a long help without declared options, the most used first; all others are under "Other"."""

SHORT = 7  # most options that are listed without headings


class Command(click.Command):
    """A command whose options are listed below headings: those of their declaration, else the most used first."""

    def __init__(self, *names: Any, **how: Any) -> None:
        super().__init__(*names, **how)
        for param in self.params:
            complete(param)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        options = {max(one.opts, key=len): one for one in self.get_params(ctx) if isinstance(one, click.Option)}
        headings = {name: heading for heading, names in HEADINGS.items() for name in names.split()}
        if len(options) <= SHORT or any(isinstance(one, Grouped) for one in options.values()):
            headings = {name: getattr(one, "group", "") or "Options" for name, one in options.items()}
        sections: dict[str, list[tuple[str, str]]] = {}
        for name in dict.fromkeys((*headings, *options)):
            if name in options and (record := options[name].get_help_record(ctx)) is not None:
                sections.setdefault(headings.get(name, "Other"), []).append(record)
        for heading, records in sections.items():
            with formatter.section(heading):
                formatter.write_dl(records)


topic = click.option(
    "--topic", metavar="NAME", help="Of a bag of ROS: the topic of sensor_msgs/Imu, if it has several."
)


def of_topic(log: str, topic: str | None) -> str:
    """Return a log with its topic, as the library takes it."""
    return log if topic is None else f"{log}::{topic}"


command = partial(click.command, cls=Command)  # makes a command of a function


class Number(click.ParamType[Any]):
    """A number; the library refuses what is none with the same check, in the same words."""

    def __init__(self, check: Callable[[str, Any], None] | None, name: str = "float") -> None:
        self._check, self.name = check, name

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        for kind in (int, float):
            with suppress(ValueError):
                value = kind(str(value))
                break
        if self._check is not None:
            self._check("" if param is None else str(param.name), value)
        elif not isinstance(value, int | float):
            self.fail(f"{value!r} is no number", param, ctx)
        return value


def count(least: int, what: str) -> Number:
    """Return the type of a whole number of something."""
    return Number(partial(require_whole, least=least, what=what), "integer")


class Grouped(click.Option):
    """An option below the heading of its group."""

    def __init__(self, *names: Any, group: str, **how: Any) -> None:
        super().__init__(*names, **how)
        self.group = group


def declared(declaration: type, names: str = "") -> Callable[[F], F]:
    """Give a command the options of a declaration, in its order; all or those that are named."""

    def with_options(command: F) -> F:
        for name, (option, kind) in reversed(options_of(declaration).items()):
            if option.metavar is None or (names and name not in names.split()):
                continue
            kinds = get_args(kind) or (kind,)
            how: dict[str, Any] = {"metavar": option.metavar, "default": option.default, "type": click.UNPROCESSED}
            if bool in kinds:
                how = {"is_flag": True, "default": False}
            elif str not in kinds and {int, float} & set(kinds):
                how["type"] = Number(option.check)
            how |= {"cls": Grouped, "group": option.group, "help": option.help}
            click.option(*filter(None, (option.short, flag_of(name, option), name)), **how)(command)
        return command

    return with_options


file_option = partial(click.option, type=FILE)  # an option that takes a path
above_zero = partial(click.option, type=Number(require_above_zero))  # an option that takes a number above 0
as_json = click.option("--json", "as_json", is_flag=True, help="Print JSON.")


def left_at_default(option: str) -> bool:
    """Return whether an option is not on the command line."""
    context = click.get_current_context()
    return context.get_parameter_source(option) is click.core.ParameterSource.DEFAULT


def json_text(data: object, indent: int | None = None) -> str:
    """Return data as JSON in ASCII; a number that is not finite, which JSON does not have, is null."""
    return json.dumps(_finite(data), indent=indent, allow_nan=False)


def _finite(data: object) -> object:
    if isinstance(data, Mapping):
        return {name: _finite(value) for name, value in data.items()}
    if isinstance(data, list | tuple):
        return [_finite(value) for value in data]
    return None if isinstance(data, float) and not isfinite(data) else data


def print_judged(text: str) -> None:
    """Print a result whose verdict is the exit code; a reader that has ended, as with `| head`, changes no verdict."""
    try:
        click.echo(text)
    except BrokenPipeError:
        sys.stdout = None  # what remains in its buffer is not written later

"""Write the reference pages: cli.md, library.md, protocol.md, and the tables of files.md; --check only compares."""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin

import tables
from click.testing import CliRunner
from msgspec import Struct
from msgspec.structs import fields

import tiltcal
from tiltcal.bench import messages
from tiltcal.cli.main import COMMANDS, group
from tiltcal.journal.lines import OperatorAnswer

HERE = Path(__file__).parent

COMMANDS_INTRODUCTION = """\
# Commands

`make reference` writes this page from `--help`; a test checks that it is current.

Results go to standard output, messages to standard error. Exit codes:

| | |
|---|---|
| 0 | done |
| 1 | done, with a negative verdict: `check`, `verify`, `probe --self-test`, `replay --golden` |
| 2 | wrong usage or bad input; the message names file, line and key |
| 3 | hardware or bus error |
| 130 | interrupted; the message states how to resume |
"""

LIBRARY_INTRODUCTION = """\
# Library

`make reference` writes this page from the docstrings; a test checks that it is current. [Use of the
library](../library.md) has examples, the [glossary](../glossary.md) the terms.

`import tiltcal` provides the names below and loads no other package; each name is imported at its first use. What the
command line refuses, the library refuses with the same `tiltcal.TiltcalError` and the same words.
"""

PROTOCOL_INTRODUCTION = """\
# Protocol of programs

`make reference` writes this page from the types of the messages; a test checks that it is current. `--operator json`
writes one object a line to standard output and reads one a line from standard input; a Python object as `operator` has
a method of the name of each question and event. [A table from a program](../how-to/table-or-chamber.md#from-a-program)
has an example.
"""

SECTION = re.compile(r"^(?P<name>[A-Z][a-z]+)\n-{3,}\n", re.MULTILINE)
"""The heading of a numpydoc section."""


def commands_page() -> str:
    """Return the page of the command line."""
    sections = [f"## tiltcal\n\n{_help()}"]
    sections += [f"## tiltcal {command}\n\n{_help(command)}" for command in COMMANDS]
    return "\n".join([COMMANDS_INTRODUCTION, *sections])


def _help(*command: str) -> str:
    """Return what --help prints on a terminal 100 characters wide, as a block of text."""
    result = CliRunner().invoke(group, [*command, "--help"], prog_name="tiltcal", terminal_width=100)
    if result.exit_code != 0:
        raise SystemExit(f"tiltcal {' '.join(command)} --help failed: {result.output}{result.exception!r}")
    return f"```text\n{result.output}```\n"


def library_page() -> str:
    """Return the page of the library, from the public names of :mod:`tiltcal`."""
    objects = {name: getattr(tiltcal, name) for name in tiltcal.__all__ if not name.startswith("_")}
    errors = [one for one in objects.values() if isinstance(one, type) and issubclass(one, Exception)]
    classes = {name: one for name, one in objects.items() if isinstance(one, type) and one not in errors}
    functions = {name: one for name, one in objects.items() if inspect.isfunction(one)}
    parts = [LIBRARY_INTRODUCTION, "## Functions\n"]
    parts += [_callable_section(f"### tiltcal.{name}", one) for name, one in functions.items()]
    parts += ["## Classes\n", *(_class_section(name, one) for name, one in classes.items())]
    parts += [_error_section(errors)]
    return "\n".join(parts)


def _callable_section(heading: str, function: Callable[..., object]) -> str:
    """Return the section of a function or method: signature, summary, parameters, errors."""
    return f"{heading}\n\n{_signature(function)}\n{_documentation(function)}"


def _signature(function: Callable[..., object]) -> str:
    """Return the signature as a block of code, one parameter per line if it is long."""
    signature = inspect.signature(function)
    parameters = [one for one in signature.parameters.values() if one.name != "self"]
    shown = [_parameter(one) for one in parameters]
    keyword = next((place for place, one in enumerate(parameters) if one.kind is one.KEYWORD_ONLY), None)
    if keyword is not None:
        shown.insert(keyword, "*")
    head, tail = f"{function.__name__}(", f") -> {signature.return_annotation}"
    line = head + ", ".join(shown) + tail
    if len(line) > 100:
        line = head + "\n" + "".join(f"    {one},\n" for one in shown) + tail
    return f"```text\n{line}\n```\n"


def _parameter(parameter: inspect.Parameter) -> str:
    """Return a parameter with its annotation and default; a default that is a function is shown as ``...``."""
    text = f"{parameter.name}: {parameter.annotation}"
    if parameter.default is parameter.empty:
        return text
    return f"{text} = {'...' if callable(parameter.default) else repr(parameter.default)}"


def _class_section(name: str, kind: type) -> str:
    """Return the section of a class: its documentation, its properties, its methods."""
    classes = [one for one in kind.__mro__ if one.__module__.startswith("tiltcal.")]
    members = {one: value for base in classes for one, value in vars(base).items() if not one.startswith("_")}
    properties = {
        one: inspect.getdoc(value) or ""
        for one, value in members.items()
        if not inspect.isfunction(value) and inspect.getdoc(value) and hasattr(value, "__get__")
    }
    text = f"### tiltcal.{name}\n\n{_documentation(kind)}"
    if properties:
        rows = "".join(f"| `{one}` | {_cell(doc)} |\n" for one, doc in properties.items())
        text += f"\n| property | |\n|---|---|\n{rows}"
    methods = [value for value in members.values() if inspect.isfunction(value)]
    return "\n".join([text, *(_callable_section(f"#### {name}.{one.__name__}", one) for one in methods)])


def _error_section(errors: list[type]) -> str:
    """Return the tree of the errors, as a table with the base of each."""
    rows = "".join(f"| `{one.__name__}` | `{one.__bases__[0].__name__}` | {_cell(_summary(one))} |\n" for one in errors)
    return f"## Errors\n\n| error | base | |\n|---|---|---|\n{rows}"


def _summary(thing: object) -> str:
    """Return the first paragraph of a docstring."""
    return (inspect.getdoc(thing) or "").partition("\n\n")[0]


def _documentation(thing: object) -> str:
    """Return a docstring as Markdown: the summary, then its sections."""
    text = inspect.getdoc(thing) or ""
    summary, *rest = SECTION.split(text)
    parts = [_prose(summary)]
    for title, body in zip(rest[::2], rest[1::2], strict=True):
        if title == "Examples":
            parts.append(f"```pycon\n{body.strip()}\n```\n")
        elif title in ("Parameters", "Attributes", "Returns", "Yields", "Raises"):
            rows = "".join(f"| {entry} | {_cell(description)} |\n" for entry, description in _entries(body))
            parts.append(f"| {title.lower()} | |\n|---|---|\n{rows}")
        else:
            parts.append(f"**{title}**\n\n{_prose(body)}")
    return "\n".join(parts)


def _entries(body: str) -> Iterator[tuple[str, str]]:
    """Iterate over the entries of a section and their descriptions."""
    for part in re.split(r"^(?=\S)", body.strip("\n"), flags=re.MULTILINE)[1:]:
        head, _, description = part.partition("\n")
        names, colon, kind = head.partition(" : ")
        yield (f"`{names}`: {kind}" if colon else f"`{head}`"), description


def _cell(text: str) -> str:
    """Return a text for a cell of a table."""
    return _inline(" ".join(text.split())).replace("|", "\\|")


def _prose(text: str) -> str:
    """Return paragraphs in Markdown."""
    return _inline(text.strip()) + "\n"


def _inline(text: str) -> str:
    """Return a text with the roles and literals of reStructuredText as Markdown code."""
    text = re.sub(r":\w+:`~?([^`]+)`", lambda match: f"`{match[1].removeprefix('tiltcal.')}`", text)
    return text.replace("``", "`")


NAMES = {str: "text", bool: "true or false", int: "whole number", float: "number", NoneType: "null"}


def protocol_page() -> str:
    """Return the page of what a program says and gets, from the types of the messages."""
    parts = [PROTOCOL_INTRODUCTION, _prose((messages.__doc__ or "").partition("\n\n")[2])]
    for title, base in (("Questions", messages.Question), ("Events", messages.Heard)):
        parts.append(f"## {title}\n")
        for one in (kind for kind in base.__subclasses__() if kind.heard):
            config = one.__struct_config__
            parts.append(f"### `{config.tag}`\n\n{_prose(inspect.getdoc(one) or '')}")
            parts.append(_object(one, f'"{config.tag_field}": "{config.tag}"'))
            if base is messages.Question:
                parts.append(f"Answers: {', '.join(f'`{word}`' for word in one.words)}.\n")
    return "\n".join([*parts, "## Answers\n", _prose(inspect.getdoc(OperatorAnswer) or ""), _object(OperatorAnswer)])


def _object(kind: type[Struct], first: str = "") -> str:
    """Return the keys of a message as a block, and which may be absent."""
    absent = ", ".join(f"`{one.encode_name}`" for one in fields(kind) if not one.required and one.name != "to")
    block = ",\n ".join(filter(None, (first, *_keys(kind))))
    return f"```text\n{{{block}}}\n```\n" + (f"\nMay be absent: {absent}.\n" if absent else "")


def _keys(kind: type[Struct]) -> list[str]:
    return [f'"{one.encode_name}": {_shape(one.type)}' for one in fields(kind) if one.name != "to"]


def _shape(kind: Any) -> str:
    """Return in words what a value is."""
    if hasattr(kind, "__metadata__"):
        return _shape(kind.__origin__)
    if isinstance(kind, type) and issubclass(kind, Struct):
        return f"{{{', '.join(_keys(kind))}}}"
    if get_origin(kind) is None:
        return NAMES[kind]
    inner = [_shape(one) for one in get_args(kind) if one is not Ellipsis]
    if get_origin(kind) in (Union, UnionType):
        return " or ".join(inner)
    return f"{{name: {inner[1]}}}" if get_origin(kind) is Mapping else f"[{', '.join(inner)}]"


PAGES = {"cli.md": commands_page, "library.md": library_page, "protocol.md": protocol_page, "files.md": tables.page}


def main(arguments: list[str]) -> int:
    """Write the pages, or with --check return 1 and name those that are not current."""
    stale = []
    for name, page in PAGES.items():
        path, text = HERE / name, page()
        if path.is_file() and path.read_text(encoding="utf-8") == text:
            continue
        stale.append(name)
        if arguments != ["--check"]:
            path.write_text(text, encoding="utf-8")
    if arguments == ["--check"] and stale:
        print(f"not current: {', '.join(stale)}; run make reference", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

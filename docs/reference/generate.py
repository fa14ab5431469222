"""Write the generated reference pages: cli.md, library.md, and the tables of files.md; --check only compares."""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import tables
from click.testing import CliRunner

import tiltcal
from tiltcal.cli.main import COMMANDS, group

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


PAGES = {"cli.md": commands_page, "library.md": library_page, "files.md": tables.page}


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

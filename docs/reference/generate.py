"""Write docs/reference/cli.md from the --help of every command; --check only compares."""

from __future__ import annotations

import sys
from pathlib import Path

from click.testing import CliRunner

from tiltcal.cli.main import COMMANDS, group

PAGE = Path(__file__).with_name("cli.md")

INTRODUCTION = """\
# Commands

This page is made by `make reference` from what `--help` says; a test holds it up to date.

Results go to standard output, talk to standard error. Exit codes:

| | |
|---|---|
| 0 | done |
| 1 | done, and judged failing: `check`, `verify`, `probe --self-test`, `replay --golden` |
| 2 | wrong usage or bad input; the message names file, line and key |
| 3 | hardware or bus error |
| 130 | interrupted; the message says how to resume |
"""


def reference() -> str:
    """The whole page."""
    sections = [f"## tiltcal\n\n{_help()}"]
    sections += [f"## tiltcal {command}\n\n{_help(command)}" for command in COMMANDS]
    return "\n".join([INTRODUCTION, *sections])


def _help(*command: str) -> str:
    """What --help prints on a terminal 100 characters wide, as a block of text."""
    result = CliRunner().invoke(group, [*command, "--help"], prog_name="tiltcal", terminal_width=100)
    if result.exit_code != 0:
        raise SystemExit(f"tiltcal {' '.join(command)} --help failed: {result.output}{result.exception!r}")
    return f"```text\n{result.output}```\n"


def main(arguments: list[str]) -> int:
    """Write the page, or with --check say whether it is what would be written."""
    page = reference()
    if arguments == ["--check"]:
        return 0 if PAGE.is_file() and PAGE.read_text(encoding="utf-8") == page else 1
    PAGE.write_text(page, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

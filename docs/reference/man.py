"""Write a man page of each command into a folder, from the same help as --help."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from pathlib import Path

import click

import tiltcal
from tiltcal.cli.main import COMMANDS, group


class ManPage(click.HelpFormatter):
    """A formatter of help that writes the macros of man."""

    def write_usage(self, prog: str, args: str = "", prefix: str | None = None) -> None:
        self.write(f".SH SYNOPSIS\n.B {_escaped(prog)}\n{_escaped(args)}\n.SH DESCRIPTION\n")

    def write_heading(self, heading: str) -> None:
        self.write(f".SH {_escaped(heading.upper())}\n")

    def write_paragraph(self) -> None:
        self.write(".PP\n")

    def write_text(self, text: str) -> None:
        for part in re.split(r"\n\s*\n", text.strip()):
            kept = part.removeprefix("\b\n")
            self.write(".SH EXAMPLES\n" if kept.startswith("Example") else ".PP\n")
            self.write(f".nf\n{_escaped(kept)}\n.fi\n" if kept != part else f"{_escaped(part)}\n")

    def write_dl(self, rows: Sequence[tuple[str, str]], col_max: int = 30, col_spacing: int = 2) -> None:
        for term, text in rows:
            self.write(f".TP\n.B {_escaped(term)}\n{_escaped(text)}\n")


def page(name: str, line: str) -> str:
    """Return the page of a command, or of tiltcal itself where the name is empty."""
    title = f"tiltcal-{name}" if name else "tiltcal"
    top = click.Context(group, info_name="tiltcal", **group.context_settings)
    command = group.get_command(top, name) if name else None
    formatter = ManPage()
    if command is None:
        group.format_help(top, formatter)
    else:
        command.format_help(click.Context(command, info_name=name, parent=top), formatter)
    head = (
        f'.TH {title.upper()} 1 "" "tiltcal {tiltcal.__version__}" "tiltcal"\n.SH NAME\n{title} \\- {_escaped(line)}\n'
    )
    return head + formatter.getvalue()


def _escaped(text: str) -> str:
    """Return text as roff prints it: no line of it is a request, and - is that of the keyboard."""
    text = text.replace("\\", "\\e").replace("-", "\\-")
    return re.sub(r"^([.'])", r"\\&\1", text, flags=re.MULTILINE)


def main(folder: Path) -> None:
    """Write the pages."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, line in {"": "calibrate tilt sensors, and remove their errors from logs", **COMMANDS}.items():
        (folder / f"tiltcal{'-' * bool(name)}{name}.1").write_text(page(name, line), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))

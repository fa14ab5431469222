"""``tiltcal config``: show the defaults of ``tiltcal.toml``."""

from __future__ import annotations

import os
from pathlib import Path

import click

from tiltcal.cli import options
from tiltcal.cli.talk import remark
from tiltcal.files.defaults import DEFAULTS, Defaults, in_words, read_defaults


@options.command(epilog="Example: tiltcal config")
def command() -> None:
    """Show the defaults that measure, verify and plan take where nothing is stated, each with its file.

    A file is TOML: operator, references and folder as the reference of files has them, and in that of a project, the
    folder where the command is called, jig. No other command reads it, and the library does not either.
    """
    for whose, path in zip(("user", "project"), _paths(), strict=True):
        click.echo(f"{whose:<10}  {path}" + ("" if os.path.isfile(path) else "  (not there)"))
    for key, (value, file) in defaults_here().values.items():
        click.echo(f"{key:<10}  {in_words(value)}  ({file})")


def defaults_here() -> Defaults:
    """Return the defaults of the user and of the present folder, which say what of them is used."""
    return read_defaults(*_paths(), remark)


def _paths() -> tuple[Path, Path]:
    return Path(click.get_app_dir("tiltcal"), DEFAULTS), Path(DEFAULTS)

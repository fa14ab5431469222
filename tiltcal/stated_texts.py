"""Texts and names of files that a caller states: what is none is refused, as on the command line."""

from __future__ import annotations

from os import PathLike

from tiltcal.errors import UsageError


def require_text(option: str, value: object) -> None:
    """Refuse a value that is no text, with a UsageError."""
    if not isinstance(value, str):
        raise UsageError(f"{option} takes a text, not {value!r}")


def require_text_or_none(option: str, value: object) -> None:
    """Refuse a value that is no text, with a UsageError; None is not stated."""
    if value is not None:
        require_text(option, value)


def require_path(what: str, value: object) -> None:
    """Refuse a value that is no name of a file, with a UsageError; ``what`` says which file, for the message."""
    if not isinstance(value, str | PathLike):
        raise UsageError(f"{what} is named by a text or a Path, not {value!r}")

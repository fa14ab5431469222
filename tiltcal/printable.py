"""Text for a person."""

from __future__ import annotations

from html import escape


def printable(text: str) -> str:
    """Return a text whose control characters, which could be escape sequences, are question marks."""
    return "".join(character if character.isprintable() or character == "\n" else "?" for character in text)


def in_html(result: object) -> str:
    """Return a result as a notebook shows it: the lines that the command prints."""
    return f"<pre>{escape(str(result))}</pre>"


def counted(count: int, noun: str) -> str:
    """Return a count with its noun: ``1 row``, ``2 rows``."""
    return f"{count} {noun}{'s' * (count != 1)}"

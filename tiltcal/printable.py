"""Text that a terminal may be given."""

from __future__ import annotations


def printable(text: str) -> str:
    """Return a text whose control characters, which could be escape sequences, are question marks."""
    return "".join(character if character.isprintable() or character == "\n" else "?" for character in text)

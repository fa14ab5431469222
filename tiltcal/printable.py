"""Text for a person."""

from __future__ import annotations

import re
from html import escape


def printable(text: str) -> str:
    """Return a text whose control characters, which could be escape sequences, are question marks."""
    return "".join(character if character.isprintable() or character == "\n" else "?" for character in text)


def in_html(result: object) -> str:
    """Return a result as a notebook shows it: a table of the lines that the command prints, in their columns."""
    lines = [re.split(r"\s{2,}", escape(line.removeprefix("  ").rstrip())) for line in str(result).splitlines()]
    columns = max(map(len, lines), default=1)
    rows = (
        "".join(f'<td style="text-align:left">{cell}</td>' for cell in cells[:-1])
        + f'<td style="text-align:left" colspan="{columns - len(cells) + 1}">{cells[-1]}</td>'
        for cells in lines
    )
    return f"<table>{''.join(f'<tr>{row}</tr>' for row in rows)}</table>"


def counted(count: int, noun: str) -> str:
    """Return a count with its noun: ``1 row``, ``2 rows``."""
    return f"{count} {noun}{'s' * (count != 1)}"

"""Text for a person."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator
from html import escape
from math import ceil


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


def distinct(names: Iterable[str], form: str) -> Iterator[str]:
    """Return names, by a form with its number from the second of a kind on."""
    seen: Counter[str] = Counter()
    for name in names:
        seen[name] += 1
        yield name if seen[name] == 1 else form.format(name, seen[name])


def did_you_mean(word: str, words: Iterable[str]) -> str:
    """Return a suggestion to stand behind a word that there is not; empty where none of the words is near it."""
    from difflib import get_close_matches

    folded = {one.casefold(): one for one in words}
    near = get_close_matches(word.casefold(), folded, n=1)
    return f" (did you mean {folded[near[0]]!r}?)" if near else ""


def in_minutes(seconds: float) -> str:
    """Return a time in words, such as ``12 min`` or ``3 h 20 min``; one that has begun counts as a minute."""
    hours, minutes = divmod(ceil(seconds / 60.0), 60)
    return f"{f'{hours} h ' if hours else ''}{minutes} min"

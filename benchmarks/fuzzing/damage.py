"""Good input, damaged: by bytes, by words, or in its structure, the same way again for the same draw."""

from __future__ import annotations

import json
from collections.abc import Sequence
from copy import deepcopy
from functools import cache
from pickle import dumps, loads
from random import Random
from typing import Any
from zlib import crc32

import yaml

LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)

WORDS = [
    *("", "9" * 400, "9" * 5000, "\t", " ", "\n", "\r\n", "\x00", "\ufeff", "\x1b[2J", "\u202e"),
    *["0", "-1", "1", "1e400", "-1e-400", "nan", "NaN", "N/A", "-inf", "1.e3", "0x10", "1_000", "0.1.2", "1e8", "3,5"],
    *["null", "true", "~", "[]", "{}", "&a", "*a", "<<", "!!python/object:os.system", "---", "...", "#", "'", '"', "`"],
    *["x", "y", "z", "temperature", "time", "offset", "é", "𝄞", "[/]", "$\\frac{$", "%s", "../..", "/"],
    *["sim:", "sim:seed=x", "?", "&", "=", "==", ",", ",,", ";", ":"],
]

VALUES: list[Any] = [
    *(None, True, False, 0, 1, -1, 2**63, 10**400, 1e308, 5e-324, -0.0, float("inf"), float("nan"), "", "x", "\x1b[2J"),
    *([], [[]], [1], [None], {}, {"x": 1}, {"x": {"x": []}}, {"": 0}, "9" * 400, [0.0] * 50, "../../x.yaml", "[/]"),
]


def damaged_bytes(draw: Random, data: bytes) -> bytes:
    """Change, drop, repeat or add bytes in a few places; now and then keep nothing but a piece."""
    if draw.random() < 0.05:
        return draw.randbytes(draw.randrange(200))
    damaged = bytearray(data)
    for _ in range(draw.choice((1, 1, 1, 1, 2, 3, 8))):
        place = draw.randrange(len(damaged) + 1)
        length = draw.choice((1, 1, 2, 4, 16, 100))
        piece = damaged[place : place + length]
        damaged[place : place + length] = draw.choice(
            (
                b"",
                bytes(byte ^ (1 << draw.randrange(8)) for byte in piece),
                draw.randbytes(length),
                piece + piece,
                draw.choice(WORDS).encode() + piece,
            )
        )
    if draw.random() < 0.1:
        del damaged[draw.randrange(len(damaged) + 1) :]
    return bytes(damaged)


def damaged_table(draw: Random, text: str) -> bytes:
    """Damage rows of cells: their bytes, or their words."""
    if draw.random() < 0.4:
        return damaged_bytes(draw, text.encode())
    return damaged_text(draw, text).encode(errors="replace")


def damaged_text(draw: Random, text: str) -> str:
    """Put words where others were, and lines."""
    for _ in range(draw.choice((1, 1, 1, 2, 4))):
        separator = draw.choice((",", ",", "\n", " ", "&", "=", ":"))
        parts = text.split(separator)
        place = draw.randrange(len(parts))
        match draw.randrange(5):
            case 0:
                parts[place] = draw.choice(WORDS)
            case 1:
                parts.insert(place, draw.choice(WORDS))
            case 2:
                del parts[place]
            case 3:
                parts.insert(place, draw.choice(parts))
            case 4:
                parts[place] += draw.choice(WORDS)
        text = separator.join(parts)
    return text


def damaged_value(draw: Random, value: Any) -> Any:
    """Put another value, key or item into one place of a structure."""
    places = list(_places(value))
    if not places:
        return deepcopy(draw.choice(VALUES))
    for _ in range(draw.choice((1, 1, 1, 1, 2, 3))):
        holder, key = draw.choice(places)
        try:
            match draw.randrange(6):
                case 0 | 1:
                    holder[key] = _near(draw, holder[key], places)
                case 4 | 5:
                    holder[key] = deepcopy(draw.choice(VALUES))
                case 2:
                    del holder[key]
                case 3 if isinstance(holder, dict):
                    holder[draw.choice(WORDS)] = deepcopy(holder[key])
                case _:
                    holder[key] = [holder[key], deepcopy(holder[key])]
        except (KeyError, IndexError):  # the place went with the one before
            continue
    return value


def _near(draw: Random, value: Any, places: Sequence[tuple[Any, Any]]) -> Any:
    """Another value of the same type: what a reader may take, and what works with it may not."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int | float):
        near = value if abs(value) < 1e300 else 1e300  # an integer may be too large for a float
        changed = draw.choice((-value, 0, 1, 2, 1.5 * near, value + 1, 1e-300, 1e300, 1e-9 * near, 1e9 * near))
        return (
            int(changed) if isinstance(value, int) and abs(changed) < float("inf") and draw.random() < 0.7 else changed
        )
    others = [holder[key] for holder, key in places if _holds(holder, key) and type(holder[key]) is type(value)]
    return deepcopy(draw.choice(others or [value]))


def _holds(holder: Any, key: Any) -> bool:
    return key in holder if isinstance(holder, dict) else key < len(holder)


def _places(value: Any) -> Any:
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in items:
        yield value, key
        yield from _places(item)


def damaged_yaml(draw: Random, text: str) -> bytes:
    """Damage a YAML file: its bytes, its words, or what it says."""
    match draw.randrange(4):
        case 0:
            return damaged_bytes(draw, text.encode())
        case 1:
            return damaged_text(draw, text).encode(errors="replace")
    data = damaged_value(draw, loads(_parsed(text)))
    return yaml.dump(data, Dumper=DUMPER, allow_unicode=True, sort_keys=False).encode(errors="replace")


@cache
def _parsed(text: str) -> bytes:
    """Return what a YAML text says, from which each input has a copy of its own."""
    return dumps(yaml.load(text, Loader=LOADER))


def damaged_json(draw: Random, text: str) -> bytes:
    """Damage what a JSON text says."""
    return json.dumps(damaged_value(draw, json.loads(text))).encode()


def damaged_journal(draw: Random, data: bytes) -> bytes:
    """Damage a journal: its bytes, or what a line says, with checks that are right."""
    if draw.randrange(4) == 0:
        return damaged_bytes(draw, data)
    lines = [json.loads(line) for line in data.splitlines()]
    for _ in range(draw.choice((1, 1, 2))):
        place = draw.choice((0, 0, len(lines) - 1, draw.randrange(len(lines)), _rare(draw, lines)))
        lines[place] = damaged_value(draw, lines[place])
    if draw.random() < 0.3:
        del lines[draw.randrange(1, len(lines) + 1) :]
    return _checked(lines)


def _rare(draw: Random, lines: list[Any]) -> int:
    """A line that is no transaction of the bus: an answer, a position, the end."""
    rare = [
        place for place, line in enumerate(lines) if (place and len(line) > 1 and len(str(line[1])) > 1) or place == 0
    ]
    return draw.choice(rare)


def _checked(lines: list[Any]) -> bytes:
    """Write lines of a journal with the checks that they have to have."""
    crc, written = 0, []
    for number, line in enumerate(lines):
        if number == 0 and isinstance(line, dict):
            line.pop("check", None)
            body = _dumps(line)
            crc = crc32(body)
            written.append(body[:-1] + f',"check":"{crc:08x}"}}'.encode())
        else:
            content = line[:-1] if isinstance(line, list) else [line]
            body = _dumps(content)
            crc = crc32(body, crc)
            written.append(body[:-1] + (b"," if content else b"") + f'"{crc:08x}"]'.encode())
    return b"".join(line + b"\n" for line in written)


def _dumps(value: Any) -> bytes:
    return json.dumps(value, ensure_ascii=False, separators=(",", ":")).encode(errors="replace")

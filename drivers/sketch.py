"""Lines of numbers as sketches print them: with labels, units and the monitor's clock, and a guess of what they mean.

``X: 1.55 Y: -0.09 Z: 10.49 m/s^2``, ``ax,ay,az``, ``12:34:56.789 -> 0.1,0.2,9.8``.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from math import hypot
from typing import NamedTuple

_CLOCK = re.compile(rb"^\s*\d{1,2}:\d\d:\d\d(\.\d+)? -> ")
"""What the monitor of the Arduino IDE prints before a line."""
_LABEL = re.compile(rb"([A-Za-z_][\w./ ]*?)[ \t]*[:=][ \t]*(?=[-+.\d])")
_UNIT = re.compile(rb"(?<=[\d.])[ \t]*(m/s\^?2|m/s\xc2\xb2|mg|g|\xc2\xb0C|C)(?![\w/])")
_NUMBER = re.compile(rb"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\w.])")

_UNITS = {b"g": "g", b"mg": "mg", b"m/s2": "m/s2", b"m/s^2": "m/s2", b"m/s\xc2\xb2": "m/s2"}
_AXIS = re.compile(r"(?:a|acc|accel|acceleration|aa|g)?_?([xyz])", re.IGNORECASE)
_TEMPERATURE = re.compile(r"t|temp|temperature|celsius", re.IGNORECASE)
_UNNAMED = {1: "x", 2: "x,y", 3: "x,y,z", 6: "x,y,z,-,-,-", 7: "x,y,z,-,-,-,temperature"}
"""What numbers without a name may be; six are often accelerations and angular rates."""


def bare(line: bytes) -> bytes:
    """Return a line without clock, labels and units: numbers and what separates them."""
    return _UNIT.sub(b" ", _LABEL.sub(b" ", _CLOCK.sub(b"", line)))


class Guess(NamedTuple):
    """What the numbers of a device's lines may be.

    numbers: how many a line has.
    columns: as ``columns=`` of an address; empty where no line has numbers.
    unit: as ``unit=``; empty where no line names it.
    example: the last line that has as many numbers as most.
    """

    numbers: int
    columns: str
    unit: str
    example: str


def guess(lines: Sequence[bytes]) -> Guess:
    """Guess the meaning of the numbers of whole lines: by labels, by a line of names, by their number."""
    counts = [len(_NUMBER.findall(bare(line))) for line in lines]
    usual = max(Counter(filter(None, counts)).items(), key=lambda item: item[1], default=(0, 0))[0]
    if not usual:
        return Guess(0, "", "", "")
    example = next(line for line, count in zip(reversed(lines), reversed(counts), strict=True) if count == usual)
    labels = [label.split()[-1].decode() for label in _LABEL.findall(_CLOCK.sub(b"", example))]
    headings = (re.split(rb"[,;\t ]+", line.strip()) for line, count in zip(lines, counts, strict=True) if not count)
    heading = next((names for names in headings if len(names) == usual), [])
    names = labels if len(labels) == usual else [name.decode("latin-1") for name in heading]
    columns = ",".join(map(_meaning, names)) if names else _UNNAMED.get(usual, "x,y,z" + ",-" * (usual - 3))
    if not set(columns) & set("xyz"):
        columns = _UNNAMED.get(usual, columns)
    unit = next((_UNITS[one] for one in _UNIT.findall(example) if one in _UNITS), "")
    return Guess(usual, columns, unit, example.decode("latin-1").strip())


def unit_of_gravity(guessed: Guess) -> str:
    """Return the unit in which the reading of three axes is about as long as gravity; empty where none is."""
    numbers = [float(number) for number in _NUMBER.findall(bare(guessed.example.encode("latin-1")))]
    columns = guessed.columns.split(",")
    along = [number for number, column in zip(numbers, columns, strict=False) if column in ("x", "y", "z")]
    near = (unit for unit, gravity in (("m/s2", 9.81), ("g", 1.0)) if 0.75 < hypot(*along) / gravity < 1.25)
    return next(near, "") if len(along) == 3 else ""


def _meaning(name: str) -> str:
    """Return what a label or heading means: an axis, the temperature, or - for a number that is skipped."""
    if axis := _AXIS.fullmatch(name):
        return "-" if name[:1] in "gG" and len(name) > 1 else axis[1].lower()
    return "temperature" if _TEMPERATURE.fullmatch(name) else "-"

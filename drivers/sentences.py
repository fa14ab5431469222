"""Sentences of a microcontroller that times the pulses of an ADXL202, framed as in NMEA 0183::

    $PTCDC,seq,t1x,t1y,t2x,t2y[,temperature]*hh

``seq`` counts the sentences, four times are in timer ticks, the temperature is in °C, and ``hh`` is the XOR of all
between ``$`` and ``*`` in two hexadecimal digits.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import reduce
from operator import xor

ROUND_NUMBERS = (100, 128, 256, 1000, 1024, 10_000, 65_536, 100_000, 1_000_000, 1 << 24, 1 << 31, 1 << 32)
"""Values at which a counter may wrap to 0: the widths of counters and of printed digits."""

FEW = 16
"""Largest number of missing sentences at a wrap; more than these count as a restart of the device."""

_TICKS = rb"([0-9]{1,12}(?:\.[0-9]{1,9})?)"
_SENTENCE = re.compile(
    rb"PTCDC,([0-9]{1,12})," + rb",".join([_TICKS] * 4) + rb"(?:,([+-]?[0-9]{1,4}(?:\.[0-9]{0,9})?)?)?"
)


@dataclass(frozen=True, slots=True)
class Sentence:
    """The content of one sentence.

    number: its place in the sequence.
    duty: T1/T2 of x and of y, each with its own period.
    periods: T2 of x and of y, ticks.
    temperature: °C; None if the sentence has none.
    """

    number: int
    duty: tuple[float, float]
    periods: tuple[float, float]
    temperature: float | None


def parse_sentence(line: bytes) -> Sentence | None:
    """Return the sentence of a line without its end.

    None if its frame, checksum or fields are damaged, or a pulse is longer than its period.
    """
    inside = content(line)
    fields = _SENTENCE.fullmatch(inside) if inside is not None else None
    if fields is None:
        return None
    number, *times, temperature = fields.groups()
    t1x, t1y, t2x, t2y = map(float, times)
    if not (0.0 < t2x >= t1x and 0.0 < t2y >= t1y):
        return None
    return Sentence(int(number), (t1x / t2x, t1y / t2y), (t2x, t2y), float(temperature) if temperature else None)


def checksum(content: bytes) -> int:
    """Return the XOR of the bytes between ``$`` and ``*``."""
    return reduce(xor, content, 0)


def content(sentence: bytes) -> bytes | None:
    """Return the content between ``$`` and ``*`` of a sentence; None if the frame or the checksum is wrong."""
    body, star, digits = sentence.rpartition(b"*")
    if not star or not body.startswith(b"$") or len(digits) != 2:
        return None
    try:
        stated = int(digits, 16)
    except ValueError:
        return None
    return body[1:] if stated == checksum(body[1:]) else None


def missing(before: int, now: int) -> int | None:
    """Return how many sentences are missing between two numbers of a sequence.

    The counter may wrap to 0 at any of the :data:`ROUND_NUMBERS`. None if it went back: the device restarted.
    """
    if now > before:
        return now - before - 1
    for modulus in ROUND_NUMBERS:
        if before < modulus and modulus - before - 1 + now < FEW:
            return modulus - before - 1 + now
    return None

"""Sentences framed as in NMEA 0183: ``$`` content ``*`` and two hexadecimal digits, the XOR of the content's bytes."""

from __future__ import annotations

from functools import reduce
from operator import xor

ROUND_NUMBERS = (100, 128, 256, 1000, 1024, 10_000, 65_536, 100_000, 1_000_000, 1 << 24, 1 << 31, 1 << 32)
"""Values at which a counter may wrap to 0: the widths of counters and of printed digits."""

FEW = 16
"""Largest number of missing sentences at a wrap; more than these count as a restart of the device."""


def checksum(content: bytes) -> int:
    """XOR of the bytes between ``$`` and ``*``."""
    return reduce(xor, content, 0)


def content(sentence: bytes) -> bytes | None:
    """Return the content between ``$`` and ``*`` of a sentence.

    Parameters
    ----------
    sentence : bytes
        Without its line end.

    Returns
    -------
    bytes or None
        None if the frame or the checksum is wrong.
    """
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

    The counter may wrap to 0 at any of the :data:`ROUND_NUMBERS`.

    Returns
    -------
    int or None
        None if the counter went back: the device restarted.
    """
    if now > before:
        return now - before - 1
    for modulus in ROUND_NUMBERS:
        if before < modulus and modulus - before - 1 + now < FEW:
            return modulus - before - 1 + now
    return None

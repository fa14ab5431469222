"""Random numbers that have no state: each is a function of a seed, a name and a number.

A twin that draws its noise this way has nothing to lose when a session is killed: sample number n is the same however
often the program was started in between.
"""

from __future__ import annotations

from hashlib import blake2b
from statistics import NormalDist

_STANDARD = NormalDist()


def uniform(seed: int, name: str, number: int) -> float:
    """A number evenly distributed over the open interval (0, 1)."""
    digest = blake2b(f"{seed}/{name}/{number}".encode(), digest_size=8).digest()
    return ((int.from_bytes(digest, "big") >> 11) + 0.5) / 2**53


def normal(seed: int, name: str, number: int) -> float:
    """A standard normal number."""
    return _STANDARD.inv_cdf(uniform(seed, name, number))

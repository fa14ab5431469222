"""Random numbers without state: each is a function of a seed, a name and a number.

So a session that is killed and resumed has the same noise: sample number n does not depend on the samples before it.
"""

from __future__ import annotations

from hashlib import blake2b
from statistics import NormalDist

_STANDARD = NormalDist()


def uniform(seed: int, name: str, number: int) -> float:
    """Return a number that is uniformly distributed over the open interval (0, 1)."""
    digest = blake2b(f"{seed}/{name}/{number}".encode(), digest_size=8).digest()
    return ((int.from_bytes(digest, "big") >> 11) + 0.5) / 2**53


def normal(seed: int, name: str, number: int) -> float:
    """Return a standard normal number."""
    return _STANDARD.inv_cdf(uniform(seed, name, number))

"""What is given damaged input: functions that draw it from random numbers and use it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from random import Random

Body = Callable[[Random], object]


@dataclass(frozen=True)
class Target:
    """What is given damaged input, in a folder of its own.

    Attributes
    ----------
    body : callable
    share : int
        Inputs for each input of a target with a share of 1.
    compiled : bool
        Whether a library in C or Rust parses the input: it may end the process.
    """

    body: Body
    share: int = 1
    compiled: bool = False


TARGETS: dict[str, Target] = {}


def target(*, share: int = 1, compiled: bool = False) -> Callable[[Body], Body]:
    """Register a function as a target, by its name."""

    def register(body: Body) -> Body:
        TARGETS[body.__name__] = Target(body, share, compiled)
        return body

    return register

"""The section ``rotation`` of a procedure: which pairs are matched while a stage turns, and how long it turns.

::

    rotation:
      phase: theta                                # the channel of the stage angle, degrees
      pairs:
        - {pair: [a1, a2], orthogonal: a4}        # the second is trimmed to the first
        - {pair: [a3, a4], orthogonal: a1}
      turns: 100                                  # the most that are made
      converged: 1e-5                             # standard uncertainty of p and q at which it stops earlier
      patience: 60                                # seconds for the stage to begin to turn
      prompt: Let the stage turn steadily.
"""

from __future__ import annotations

from dataclasses import dataclass

from tiltcal.core.pair.encoder import FEWEST_TURNS
from tiltcal.core.pair.model import Pair
from tiltcal.errors import UsageError
from tiltcal.files.node import Node

FEWEST = int(FEWEST_TURNS)
MOST = 1_000_000
"""Turns."""


@dataclass(frozen=True)
class Rotation:
    """What is done while a stage turns.

    Attributes
    ----------
    phase : str
        The channel of the stage angle, degrees.
    pairs : tuple of Pair
        One or two.
    prompt : str
        What the operator is asked to do.
    turns : int
        The most that are made.
    converged : float or None
        Standard uncertainty of p and q, relative to a scale factor, at which it is enough; None where all turns are
        made.
    patience : float
        Seconds in which the stage must begin to turn.
    """

    phase: str
    pairs: tuple[Pair, ...]
    prompt: str = "Let the stage turn steadily, with its axis inclined."
    turns: int = 100
    converged: float | None = None
    patience: float = 60.0

    @property
    def channels(self) -> tuple[str, ...]:
        """The readings of all pairs, each once."""
        return tuple(dict.fromkeys(channel for pair in self.pairs for channel in pair.channels))


def read_rotation(node: Node) -> Rotation:
    """Read and check the section.

    Raises
    ------
    InputError
        Anything in it is wrong; the message names file, line and key.
    """
    section = node.mapping(required=("phase", "pairs"), optional=("turns", "converged", "patience", "prompt"))
    phase = section["phase"].text()
    pairs = tuple(_read_pair(item, phase) for item in section["pairs"].items())
    if not 1 <= len(pairs) <= 2:
        raise section["pairs"].error(f"one or two pairs are matched at once, those of one disk; found {len(pairs)}")
    if len({pair.name for pair in pairs}) < len(pairs):
        raise section["pairs"].error("the same pair is there twice")
    return Rotation(
        phase,
        pairs,
        section["prompt"].text() if "prompt" in section else Rotation.prompt,
        _read_turns(section["turns"]) if "turns" in section else Rotation.turns,
        section["converged"].number(above=0.0) if "converged" in section else None,
        section["patience"].number(above=0.0) if "patience" in section else Rotation.patience,
    )


def require_turns(turns: int) -> int:
    """So many turns, where that many can be asked for.

    Raises
    ------
    UsageError
        Too few, or more than anyone waits for.
    """
    if not FEWEST <= turns <= MOST:
        raise UsageError(f"{turns} turns cannot be: at least {FEWEST} are needed, and at most {MOST} counted")
    return turns


def _read_turns(node: Node) -> int:
    try:
        return require_turns(node.integer())
    except UsageError as refusal:
        raise node.error(str(refusal)) from None


def _read_pair(node: Node, phase: str) -> Pair:
    section = node.mapping(required=("pair", "orthogonal"))
    names = [item.text() for item in section["pair"].items()]
    if len(names) != 2:
        raise section["pair"].error(f"a pair has two channels, found {len(names)}")
    channels = (*names, section["orthogonal"].text())
    if len({*channels, phase}) < len(channels) + 1:
        raise node.error("pair, orthogonal and phase are four different channels")
    return Pair(*channels)

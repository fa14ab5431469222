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

from dataclasses import dataclass, replace

from tiltcal.core.pair.encoder import FEWEST_TURNS
from tiltcal.core.pair.model import Pair
from tiltcal.errors import UsageError
from tiltcal.files.declaration import Context, Converted, ListOf, Section, entry
from tiltcal.files.node import Node
from tiltcal.files.scalars import Integer, Number, Text

FEWEST_WHOLE_TURNS = int(FEWEST_TURNS)
MOST = 1_000_000
"""Turns."""

_FOUR = "pair, orthogonal and phase are four different channels"


@dataclass(frozen=True, kw_only=True)
class PairSelection:
    """One of ``pairs`` as it stands in a file."""

    pair: tuple[str, ...] = entry(
        ListOf(Text(), 2, 2, says="a pair has two channels, found {found}"),
        "`[first, second]`, two channels opposite each other; the second is trimmed to the first",
    )
    orthogonal: str = entry(Text(), "a channel a quarter turn away")


def _pair_of(found: PairSelection, node: Node, context: Context) -> Pair:
    channels = (found.pair[0], found.pair[1], found.orthogonal)
    if len(set(channels)) < len(channels):
        raise node.error(_FOUR)
    return Pair(*channels)


def _distinct(pairs: tuple[Pair, ...], node: Node, context: Context) -> tuple[Pair, ...]:
    if len({pair.name for pair in pairs}) < len(pairs):
        raise node.error("the same pair is there twice")
    return pairs


@dataclass(frozen=True)
class Rotation:
    """The pairs that are matched while a stage turns, and when it ends."""

    phase: str = entry(Text(), "the channel of the stage angle, degrees")
    pairs: tuple[Pair, ...] = entry(
        Converted(
            ListOf(
                Converted(Section(PairSelection), _pair_of),
                1,
                2,
                says="one or two pairs can be matched at once, those of one stage; found {found}",
            ),
            _distinct,
        ),
        "one or two of `{pair: [first, second], orthogonal: third}`; the second is trimmed to the first, the third "
        "stands a quarter turn away",
    )
    prompt: str = entry(
        Text(), "the operator's sentence", default="Let the stage turn steadily, with its axis inclined."
    )
    turns: int = entry(
        Converted(
            Integer(),
            lambda turns, node, _: node.converted(require_turns, turns),
            more={"minimum": FEWEST_WHOLE_TURNS, "maximum": MOST},
        ),
        "the most that are made; `--turns` takes its place",
        default=100,
    )
    converged: float | None = entry(
        Number(above=0.0),
        "the standard uncertainty of p and q, relative to a scale factor, at which it ends earlier; not before the "
        "fifth turn",
        default=None,
    )
    patience: float = entry(Number(above=0.0), "seconds in which the stage must begin to turn", default=60.0)

    @property
    def channels(self) -> tuple[str, ...]:
        """The channels of all pairs, each once."""
        return tuple(dict.fromkeys(channel for pair in self.pairs for channel in pair.channels))

    def with_turns(self, turns: int) -> Rotation:
        """Return the rotation with another limit of turns, which :func:`require_turns` checks."""
        return replace(self, turns=require_turns(turns))


def require_turns(turns: int) -> int:
    """Return a number of turns; a UsageError where it is too small or too large."""
    if not FEWEST_WHOLE_TURNS <= turns <= MOST:
        raise UsageError(
            f"{turns} turns are impossible: at least {FEWEST_WHOLE_TURNS} are needed, and at most {MOST} counted"
        )
    return turns


def _apart(rotation: Rotation, node: Node, context: Context) -> Rotation:
    for pair, item in zip(rotation.pairs, node.entries()["pairs"].items(), strict=True):
        if rotation.phase in pair.channels:
            raise item.error(_FOUR)
    return rotation


ROTATION = Converted(Section(Rotation), _apart)
"""The section ``rotation``."""

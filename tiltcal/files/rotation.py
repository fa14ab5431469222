"""The section ``rotation`` of a procedure: which pairs are matched while a stage turns, and how long it turns."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, field

from tiltcal.core.pair.model import FEWEST_TURNS, Pair
from tiltcal.errors import UsageError
from tiltcal.files.document import Document
from tiltcal.files.record import AboveZero, Identifier, Record, Text, about

FEWEST_WHOLE_TURNS = int(FEWEST_TURNS)
MOST = 1_000_000
"""Turns."""


class PairSelection(Record):
    """One of ``rotation.pairs`` as it stands in a file."""

    pair: Annotated[
        tuple[Text, Text],
        about("`[first, second]`, two channels opposite each other; the second is trimmed to the first"),
    ]
    orthogonal: Annotated[Text, about("a channel a quarter turn away")]


class Rotation(Record):
    """The pairs that are matched while a stage turns, and when it ends."""

    phase: Annotated[Text, about("the channel of the stage angle, degrees")]
    selected: Annotated[
        tuple[PairSelection, ...],
        Meta(min_length=1, max_length=2),
        about(
            "one or two of `{pair: [first, second], orthogonal: third}`; the second is trimmed to the first, the third "
            "stands a quarter turn away"
        ),
    ] = field(name="pairs")
    prompt: Annotated[Text, about("the operator's sentence")] = "Let the stage turn steadily, with its axis inclined."
    turns: Annotated[
        Annotated[int, Meta(ge=FEWEST_WHOLE_TURNS, le=MOST)],
        about("the most that are made; `--turns` takes its place"),
    ] = 100
    converged: Annotated[
        AboveZero | None,
        about(
            "the standard uncertainty of p and q, relative to a scale factor, at which it ends earlier; not before the "
            "fifth turn"
        ),
    ] = None
    patience: Annotated[AboveZero, about("seconds in which the stage must begin to turn")] = 60.0

    @property
    def pairs(self) -> tuple[Pair, ...]:
        """The pairs in order."""
        return tuple(Pair(*one.pair, one.orthogonal) for one in self.selected)

    @property
    def channels(self) -> tuple[str, ...]:
        """The channels of all pairs, each once."""
        return tuple(dict.fromkeys(channel for pair in self.pairs for channel in pair.channels))

    def with_turns(self, turns: int) -> Rotation:
        """Return the rotation with another limit of turns; a UsageError where it is too small or too large."""
        if not FEWEST_WHOLE_TURNS <= turns <= MOST:
            raise UsageError(
                f"{turns} turns are impossible: at least {FEWEST_WHOLE_TURNS} are needed, and at most {MOST} counted"
            )
        return self.replaced(turns=turns)


class RotationFile(Record, kw_only=True):
    """The procedure file of a stage that turns."""

    name: Annotated[Identifier, about("a letter, then letters, digits, `-`, `_`, `.`")]
    title: Annotated[Text, about("what it is for, in one line")]
    source: Annotated[Text, about("the document it comes from")] = ""
    rotation: Annotated[Rotation, about("which pairs are matched while the stage turns")]


def check_rotation(rotation: Rotation, place: Document) -> None:
    """Refuse a rotation whose channels are not different ones, or that has one pair twice, with an InputError."""
    for number, pair in enumerate(rotation.pairs):
        if len({*pair.channels, rotation.phase}) < len(pair.channels) + 1:
            raise place.error("pair, orthogonal and phase are four different channels", "pairs", number)
    if len({pair.name for pair in rotation.pairs}) < len(rotation.pairs):
        raise place.error("the same pair is there twice", "pairs")

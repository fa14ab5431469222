"""The calibration file of accelerometer pairs on a rotary stage, ``kind: pair``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, TypeVar

from msgspec import Meta

from tiltcal.core.pair.matching import STAGES, SUM, Component, Matching
from tiltcal.core.pair.model import Pair
from tiltcal.core.rounding import round_to, significant
from tiltcal.files.document import Document
from tiltcal.files.record import AboveZero, Finite, Record, Size, Text, about, file_data, one_of
from tiltcal.files.results import PairProvenance, Sensors
from tiltcal.files.yaml_text import yaml_text

T = TypeVar("T")
ByStage = Annotated[
    Mapping[Annotated[str, one_of(*STAGES)], Mapping[str, T]], Meta(extra_json_schema={"required": list(STAGES)})
]
"""Two components at the turning for each channel before and after the matching."""

_DIGITS = 4
_SPIN_DIGITS = 9


class SpinRecord(Record):
    """The spin of the stage."""

    turns: Annotated[AboveZero, about("turns of the stage in the record")]
    frequency: Annotated[AboveZero | None, about("Hz; absent where the record has no time")] = None
    phase: Annotated[Text | None, about("column of the stage angle, degrees; absent if estimated")] = None


class CoefficientUncertainty(Record):
    """Standard uncertainties of p and q."""

    p: Annotated[Size, about("of p")]
    q: Annotated[Size, about("of q")]


class Suppression(Record):
    """The suppression of the common acceleration."""

    p: Annotated[Size, about("after p")]
    pq: Annotated[Size, about("after p and q")]


class PairEntry(Record, kw_only=True):
    """One of ``pairs`` as it stands in a file."""

    pair: Annotated[tuple[Text, Text], about("`[first, second]`, two columns")]
    orthogonal: Annotated[Text, about("the accelerometer a quarter turn away, a third column")]
    p: Annotated[Finite, about("a pure number, below 1")]
    q: Annotated[Finite, about("a pure number")]
    uncertainty: Annotated[CoefficientUncertainty, about("`{p, q}`, standard uncertainties (k = 1)")]
    suppression: Annotated[Suppression | None, about("the common acceleration over that in the sum, or noise")] = None
    components: Annotated[
        ByStage[tuple[Finite, Finite]],
        about("`before`, `after_p`, `after_pq`: `[sin, cos]` at the turning per channel and for their `sum`, unit"),
    ]
    component_uncertainty: Annotated[ByStage[tuple[Size, Size]], about("their standard uncertainties")]

    @property
    def matching(self) -> Matching:
        """The matching, which nothing has checked."""
        pair, u = Pair(*self.pair, self.orthogonal), self.component_uncertainty
        names = (*pair.channels, SUM)
        components = {
            stage: {name: Component(*self.components[stage][name], *u[stage][name]) for name in names}
            for stage in STAGES
        }
        return Matching(self.p, self.q, self.uncertainty.p, self.uncertainty.q, pair, components)

    def checked(self, place: Document) -> Matching:
        """Return the matching; an InputError where the keys contradict one another."""
        pair = Pair(*self.pair, self.orthogonal)
        if len(set(pair.channels)) < len(pair.channels):
            raise place.error("pair and orthogonal are three different channels", "orthogonal")
        if self.p >= 1.0:
            raise place.error(f"p is {self.p:g}; it must be below 1: the second accelerometer is divided by 1 - p", "p")
        for key in ("components", "component_uncertainty"):
            stages = getattr(self, key)
            place.require_keys(stages, STAGES, key, complete=True)
            for stage, row in stages.items():
                place.require_keys(row, (*pair.channels, SUM), key, stage, complete=True)
        return self.matching

    @classmethod
    def of(cls, matching: Matching) -> PairEntry:
        """Return the section with the digits of the file, from which its suppression follows."""
        u_p, u_q = significant(matching.u_p, _DIGITS), significant(matching.u_q, _DIGITS)
        stages = matching.components.items()
        entry = cls(
            pair=(matching.pair.first, matching.pair.second),
            orthogonal=matching.pair.orthogonal,
            p=round_to(matching.p, matching.u_p),
            q=round_to(matching.q, matching.u_q),
            uncertainty=CoefficientUncertainty(p=u_p, q=u_q),
            components={
                stage: {name: (round_to(c.sin, c.u_sin), round_to(c.cos, c.u_cos)) for name, c in row.items()}
                for stage, row in stages
            },
            component_uncertainty={
                stage: {name: (significant(c.u_sin, _DIGITS), significant(c.u_cos, _DIGITS)) for name, c in row.items()}
                for stage, row in stages
            },
        )
        suppression = {name: significant(value, _DIGITS) for name, value in entry.matching.suppression.items()}
        return entry.replaced(suppression=Suppression(**suppression))


class PairFile(Record, kw_only=True):
    """The content of a pair file as it stands there."""

    always_written = ("online", "provenance")

    spin: Annotated[SpinRecord, about("how the stage turned")]
    online: Annotated[bool, about("whether p and q are what the online estimator ended with", usual="`false`")] = False
    pairs: Annotated[tuple[PairEntry, ...], Meta(min_length=1, max_length=2), about("one or two pairs")]
    provenance: Annotated[PairProvenance, about("how it was made")] = PairProvenance()


@dataclass(frozen=True, kw_only=True)
class PairRecord:
    """The content of a pair file."""

    spin: SpinRecord
    online: bool = False
    matchings: tuple[Matching, ...]
    provenance: PairProvenance = PairProvenance()

    @property
    def text(self) -> str:
        """The text of its file; numbers have the digits that their uncertainty warrants."""
        comments = {"spin.frequency": "Hz", "pairs": "the sum is first + (second + q orthogonal) / (1 - p)"}
        spin, frequency = self.spin, self.spin.frequency
        file = PairFile(
            spin=spin.replaced(
                turns=significant(spin.turns, _SPIN_DIGITS),
                frequency=None if frequency is None else significant(frequency, _SPIN_DIGITS),
            ),
            online=self.online,
            pairs=tuple(map(PairEntry.of, self.matchings)),
            provenance=self.provenance,
        )
        return yaml_text(file_data("pair", file), comments)

    @property
    def sensors(self) -> Sensors:
        """What it is of, so that its file replaces no other."""
        bench = self.provenance.bench
        return ("pair", *((one.model or "", one.serial or "") for one in (bench.sensors if bench else ())))


def pair_record(document: Document) -> PairRecord:
    """Return the content of a pair file, checked; an InputError names file, line and key."""
    document = document.body("pair")
    file = document.read(PairFile)
    matchings = tuple(entry.checked(document.at("pairs", number)) for number, entry in enumerate(file.pairs))
    if len({matching.pair.name for matching in matchings}) < len(matchings):
        raise document.error("the same pair is there twice", "pairs")
    document.at("provenance").require_moments(file.provenance, "started", "ended")
    return PairRecord(spin=file.spin, online=file.online, matchings=matchings, provenance=file.provenance)

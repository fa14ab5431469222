"""The calibration file of accelerometer pairs on a rotary stage, ``kind: pair``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from tiltcal.core.pair.matching import STAGES, SUM, Component, Matching
from tiltcal.core.pair.model import Pair
from tiltcal.core.rounding import round_to, significant
from tiltcal.files.declaration import ByKey, ByName, Context, Converted, ListOf, Section, entry
from tiltcal.files.emitter import yaml_text
from tiltcal.files.node import Node
from tiltcal.files.provenance_record import PairProvenance
from tiltcal.files.scalars import FROM_ZERO, Flag, Number, Text

_DIGITS = 4


_NINE_DIGITS = Converted(Number(above=0.0), lambda value, node, context: value, lambda value: significant(value, 9))
"""A number above 0, written with nine digits."""


@dataclass(frozen=True, kw_only=True)
class SpinRecord:
    """The spin of the stage."""

    turns: float = entry(_NINE_DIGITS, "turns of the stage in the record")
    frequency: float | None = entry(_NINE_DIGITS, "Hz; absent where the record has no time", default=None)
    phase: str | None = entry(
        Text(),
        "the column of the stage angle, degrees; absent where the spin was estimated. `apply` demodulates the gradient "
        "with it",
        default=None,
    )


@dataclass(frozen=True, kw_only=True)
class CoefficientUncertainty:
    """Standard uncertainties of p and q."""

    p: float = entry(FROM_ZERO, "of p")
    q: float = entry(FROM_ZERO, "of q")


@dataclass(frozen=True, kw_only=True)
class Suppression:
    """The suppression of the common acceleration."""

    p: float = entry(FROM_ZERO, "after p")
    pq: float = entry(FROM_ZERO, "after p and q")


def _by_stage(item: Number) -> ByKey[Mapping[str, tuple[float, ...]]]:
    """Return the declaration of two components at the turning for each channel before and after the matching."""
    components = ListOf(item, 2, 2, says="two numbers [sin, cos] are needed here, found {found}")
    return ByKey(ByName(components), STAGES, complete=True)


@dataclass(frozen=True, kw_only=True)
class PairEntry:
    """One of ``pairs`` as it stands in a file."""

    pair: tuple[str, ...] = entry(
        ListOf(Text(), 2, 2, says="a pair has two channels, found {found}"), "`[first, second]`, two columns"
    )
    orthogonal: str = entry(Text(), "the accelerometer a quarter turn away, a third column")
    p: float = entry(Number(), "a pure number, below 1")
    q: float = entry(Number(), "a pure number")
    uncertainty: CoefficientUncertainty = entry(
        Section(CoefficientUncertainty), "`{p, q}`, standard uncertainties (k = 1)"
    )
    suppression: Suppression | None = entry(
        Section(Suppression),
        "`{p, pq}`: common acceleration in the first channel over what is left in the sum, or over the noise where "
        "that is more",
        default=None,
    )
    components: Mapping[str, Mapping[str, tuple[float, ...]]] = entry(
        _by_stage(Number()),
        "`before`, `after_p`, `after_pq`: per channel and for their `sum` the components `[sin, cos]` at the turning, "
        "unit of the readings",
    )
    component_uncertainty: Mapping[str, Mapping[str, tuple[float, ...]]] = entry(
        _by_stage(FROM_ZERO), "the same for their standard uncertainties"
    )


def _matching_of(section: PairEntry, node: Node, context: Context) -> Matching:
    entries, u = node.entries(), section.uncertainty
    names = (*section.pair, section.orthogonal)
    if len(set(names)) < len(names):
        raise entries["orthogonal"].error("pair and orthogonal are three different channels")
    if section.p >= 1.0:
        raise entries["p"].error(
            f"p is {section.p:g}; it must be below 1: the second accelerometer is divided by 1 - p"
        )
    pair = Pair(section.pair[0], section.pair[1], section.orthogonal)
    for key in ("components", "component_uncertainty"):
        for stage in entries[key].entries().values():
            stage.mapping(required=(*pair.channels, SUM))
    components = {
        stage: {
            name: Component(*section.components[stage][name], *section.component_uncertainty[stage][name])
            for name in (*pair.channels, SUM)
        }
        for stage in STAGES
    }
    return Matching(pair, section.p, section.q, u.p, u.q, components)


def _section_of(matching: Matching) -> PairEntry:
    """Return the section with the digits of the file, so that the file gives the same derived values again."""
    matching = _rounded(matching)
    rows = {stage: matching.components[stage].items() for stage in STAGES}
    return PairEntry(
        pair=(matching.pair.first, matching.pair.second),
        orthogonal=matching.pair.orthogonal,
        p=matching.p,
        q=matching.q,
        uncertainty=CoefficientUncertainty(p=matching.u_p, q=matching.u_q),
        suppression=Suppression(**{name: significant(value, _DIGITS) for name, value in matching.suppression.items()}),
        components={
            stage: {name: (component.sin, component.cos) for name, component in row} for stage, row in rows.items()
        },
        component_uncertainty={
            stage: {name: (component.u_sin, component.u_cos) for name, component in row} for stage, row in rows.items()
        },
    )


def _distinct(found: tuple[Matching, ...], node: Node, context: Context) -> tuple[Matching, ...]:
    if len({matching.pair.name for matching in found}) < len(found):
        raise node.error("the same pair is there twice")
    return found


@dataclass(frozen=True, kw_only=True)
class PairRecord:
    """The content of a pair file."""

    spin: SpinRecord = entry(Section(SpinRecord), "how the stage turned")
    online: bool = entry(
        Flag(), "whether p and q are what the online estimator ended with", default=False, usual="`false`", kept=True
    )
    matchings: tuple[Matching, ...] = entry(
        Converted(
            ListOf(
                Converted(Section(PairEntry), _matching_of, _section_of),
                1,
                2,
                says="one or two pairs are needed here, found {found}",
            ),
            _distinct,
        ),
        "one or two pairs",
        key="pairs",
    )
    provenance: PairProvenance = entry(Section(PairProvenance), "how it was made", default=PairProvenance(), kept=True)


PAIR = Section(PairRecord, kind="pair")
"""The pair file."""


def dump_pair(calibration: PairRecord) -> str:
    """Return the text of a pair file; numbers have the digits that their uncertainty warrants."""
    comments = {"spin.frequency": "Hz", "pairs": "the sum is first + (second + q orthogonal) / (1 - p)"}
    return yaml_text(PAIR.write(calibration), comments)


def _rounded(matching: Matching) -> Matching:
    """Return a matching with the digits of the file."""
    components = {
        stage: {
            name: Component(
                round_to(component.sin, component.u_sin),
                round_to(component.cos, component.u_cos),
                significant(component.u_sin, _DIGITS),
                significant(component.u_cos, _DIGITS),
            )
            for name, component in row.items()
        }
        for stage, row in matching.components.items()
    }
    return Matching(
        matching.pair,
        round_to(matching.p, matching.u_p),
        round_to(matching.q, matching.u_q),
        significant(matching.u_p, _DIGITS),
        significant(matching.u_q, _DIGITS),
        components,
    )

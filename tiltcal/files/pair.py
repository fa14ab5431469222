"""The calibration file of accelerometer pairs on a rotary stage, ``kind: pair``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tiltcal.core.pair.matching import STAGES, SUM, Component, Matching
from tiltcal.core.pair.model import Pair
from tiltcal.core.rounding import round_to, significant
from tiltcal.files.declaration import Section
from tiltcal.files.document import FORMAT_VERSION, read_tiltcal_file
from tiltcal.files.emitter import yaml_text
from tiltcal.files.node import Node
from tiltcal.files.records import PairProvenance
from tiltcal.files.whole import write_whole

_DIGITS = 4
_PROVENANCE = Section(PairProvenance)


@dataclass(frozen=True)
class PairRecord:
    """The content of a pair file.

    Attributes
    ----------
    matchings : tuple of Matching
        One or two pairs.
    phase : str or None
        The column of the stage angle; None where the spin was estimated.
    turns : float
        Of the stage, in the record.
    frequency : float or None
        Of the spin, Hz; None where the record has no time.
    online : bool
        Whether p and q are what the online estimator ended with.
    provenance : PairProvenance
    """

    matchings: tuple[Matching, ...]
    phase: str | None
    turns: float
    frequency: float | None = None
    online: bool = False
    provenance: PairProvenance = field(default_factory=PairProvenance)


def read_pair(path: str | Path) -> PairRecord:
    """Read and check a pair file.

    Parameters
    ----------
    path : str or Path

    Raises
    ------
    InputError
        Anything in it is wrong; the message names file, line and key.
    """
    return pair_of(read_tiltcal_file(path, "pair"))


def write_pair(path: str | Path, calibration: PairRecord) -> None:
    """Write a pair file, whole or not at all.

    Parameters
    ----------
    path : str or Path
    calibration : PairRecord

    Raises
    ------
    UsageError
        The file cannot be written there.
    """
    write_whole(path, dump_pair(calibration))


def dump_pair(calibration: PairRecord) -> str:
    """The text of a pair file; numbers with the digits that their uncertainty warrants."""
    spin: dict[str, Any] = {"turns": significant(calibration.turns, 9)}
    if calibration.frequency is not None:
        spin["frequency"] = significant(calibration.frequency, 9)
    if calibration.phase is not None:
        spin["phase"] = calibration.phase
    data: dict[str, Any] = {
        "tiltcal": FORMAT_VERSION,
        "kind": "pair",
        "spin": spin,
        "online": calibration.online,
        "pairs": [_write_matching(_rounded(matching)) for matching in calibration.matchings],
        "provenance": _PROVENANCE.write(calibration.provenance),
    }
    return yaml_text(data, {"spin.frequency": "Hz", "pairs": "the sum is first + (second + q orthogonal) / (1 - p)"})


def pair_of(document: Node) -> PairRecord:
    """The pairs that a checked document of ``kind: pair`` holds.

    Raises
    ------
    InputError
        Anything in it is wrong; the message names file, line and key.
    """
    top = document.mapping(required=("tiltcal", "kind", "spin", "pairs"), optional=("online", "provenance"))
    spin = top["spin"].mapping(required=("turns",), optional=("frequency", "phase"))
    matchings = tuple(_read_matching(item) for item in top["pairs"].items())
    if not 1 <= len(matchings) <= 2:
        raise top["pairs"].error(f"one or two pairs are needed here, found {len(matchings)}")
    if len({matching.pair.name for matching in matchings}) < len(matchings):
        raise top["pairs"].error("the same pair is there twice")
    return PairRecord(
        matchings,
        spin["phase"].text() if "phase" in spin else None,
        spin["turns"].number(above=0.0),
        spin["frequency"].number(above=0.0) if "frequency" in spin else None,
        top["online"].flag() if "online" in top else False,
        _PROVENANCE.read(top["provenance"]) if "provenance" in top else PairProvenance(),
    )


def _rounded(matching: Matching) -> Matching:
    """With the digits that the file has, so that what is derived from them is derived from the file again."""
    components = {
        stage: {
            name: Component(
                round_to(one.sin, one.u_sin),
                round_to(one.cos, one.u_cos),
                significant(one.u_sin, _DIGITS),
                significant(one.u_cos, _DIGITS),
            )
            for name, one in row.items()
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


def _write_matching(matching: Matching) -> dict[str, Any]:
    return {
        "pair": [matching.pair.first, matching.pair.second],
        "orthogonal": matching.pair.orthogonal,
        "p": matching.p,
        "q": matching.q,
        "uncertainty": {"p": matching.u_p, "q": matching.u_q},
        "suppression": {name: significant(value, _DIGITS) for name, value in matching.suppression.items()},
        "components": {
            stage: {name: [one.sin, one.cos] for name, one in matching.components[stage].items()} for stage in STAGES
        },
        "component_uncertainty": {
            stage: {name: [one.u_sin, one.u_cos] for name, one in matching.components[stage].items()}
            for stage in STAGES
        },
    }


def _read_matching(node: Node) -> Matching:
    section = node.mapping(
        required=("pair", "orthogonal", "p", "q", "uncertainty", "components", "component_uncertainty"),
        optional=("suppression",),
    )
    pair = _read_pair(section["pair"], section["orthogonal"])
    p = section["p"].number()
    if p >= 1.0:
        raise section["p"].error(f"p is {p:g}; it must be below 1: the second accelerometer is divided by 1 - p")
    uncertainty = section["uncertainty"].mapping(required=("p", "q"))
    if "suppression" in section:
        for value in section["suppression"].mapping(required=("p", "pq")).values():
            value.number(minimum=0.0)
    return Matching(
        pair,
        p,
        section["q"].number(),
        uncertainty["p"].number(minimum=0.0),
        uncertainty["q"].number(minimum=0.0),
        _read_components(section["components"], section["component_uncertainty"], pair),
    )


def _read_pair(pair: Node, orthogonal: Node) -> Pair:
    names = [item.text() for item in pair.items()]
    if len(names) != 2:
        raise pair.error(f"a pair has two channels, found {len(names)}")
    channels = (*names, orthogonal.text())
    if len(set(channels)) < len(channels):
        raise orthogonal.error("pair and orthogonal are three different channels")
    return Pair(*channels)


def _read_components(values: Node, uncertainties: Node, pair: Pair) -> dict[str, dict[str, Component]]:
    names = (*pair.channels, SUM)
    tables = []
    for node in (values, uncertainties):
        stages = node.mapping(required=STAGES)
        tables.append({stage: stages[stage].mapping(required=names) for stage in STAGES})
    return {
        stage: {
            name: Component(*_two(tables[0][stage][name]), *_two(tables[1][stage][name], minimum=0.0)) for name in names
        }
        for stage in STAGES
    }


def _two(node: Node, minimum: float | None = None) -> Sequence[float]:
    items = node.items()
    if len(items) != 2:
        raise node.error(f"two numbers [sin, cos] are needed here, found {len(items)}")
    return [item.number(minimum=minimum) for item in items]

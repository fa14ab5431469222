"""The matching of accelerometer pairs in a few lines of text: components, p and q, and what they suppress."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from tiltcal.core.pair.matching import STAGES, SUM, Matching
from tiltcal.core.rounding import bracketed

HEADINGS = {"before": "before matching", "after_p": "after p", "after_pq": "after p and q"}


def _table(matching: Matching) -> Iterator[str]:
    """Yield the components at the turning before matching, after p, and after p and q (the source's Table 1)."""
    pair = matching.pair
    names = {pair.first: pair.first, pair.second: pair.second, SUM: f"{pair.first} + {pair.second}"}
    wide = max(len(text) for text in names.values())
    yield " " * wide + "".join(f"   {HEADINGS[stage]:<28}" for stage in STAGES).rstrip()
    yield " " * wide + "".join(f"   {'sin':<13} {'cos':<14}" for _ in STAGES).rstrip()
    for name, text in names.items():
        cells = []
        for stage in STAGES:
            component = matching.components[stage][name]
            cells += [
                f"   {bracketed(component.sin, component.u_sin):<13}",
                f" {bracketed(component.cos, component.u_cos):<14}",
            ]
        yield f"{text:<{wide}}" + "".join(cells).rstrip()


def pair_summary(matching: Matching) -> str:
    """Return the table, p and q with their uncertainties, and how far the common acceleration is suppressed."""
    return "\n".join(
        [
            f"{matching.pair.first} and {matching.pair.second}, orthogonal {matching.pair.orthogonal}",
            *_table(matching),
            f"p = {bracketed(matching.p, matching.u_p)}   q = {bracketed(matching.q, matching.u_q)}",
            suppressed(matching),
        ]
    )


def suppressed(matching: Matching, write: Callable[[float], str] = "{:.3g}".format) -> str:
    """Return the suppression of the common acceleration in words; ``write`` formats the two factors."""
    suppression = matching.suppression
    left = matching.components["after_pq"][SUM]
    floor = left.amplitude <= left.u_amplitude
    return (
        f"common acceleration suppressed {write(suppression['p'])} times after p, {write(suppression['pq'])} times "
        f"after p and q{' (the noise floor)' if floor else ''}"
    )

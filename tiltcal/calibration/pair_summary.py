"""The matching of accelerometer pairs in a few lines of text: components, p and q, and what they suppress."""

from __future__ import annotations

from collections.abc import Callable

from tiltcal.core.pair.matching import STAGES, SUM, Matching
from tiltcal.core.rounding import bracketed

HEADINGS = {"before": "before matching", "after_p": "after p", "after_pq": "after p and q"}


def pair_summary(matching: Matching) -> str:
    """Return the source's Table 1, p and q with their uncertainties, and how far they suppress what is common."""
    pair = matching.pair
    names = {pair.first: pair.first, pair.second: pair.second, SUM: f"{pair.first} + {pair.second}"}
    wide = max(map(len, names.values()))
    lines = [
        f"{pair.first} and {pair.second}, orthogonal {pair.orthogonal}",
        " " * wide + "".join(f"   {HEADINGS[stage]:<28}" for stage in STAGES),
        " " * wide + "".join(f"   {'sin':<13} {'cos':<14}" for _ in STAGES),
    ]
    for name, text in names.items():
        row = [matching.components[stage][name] for stage in STAGES]
        cells = (f"   {bracketed(one.sin, one.u_sin):<13} {bracketed(one.cos, one.u_cos):<14}" for one in row)
        lines.append(f"{text:<{wide}}" + "".join(cells))
    lines.append(f"p = {bracketed(matching.p, matching.u_p)}   q = {bracketed(matching.q, matching.u_q)}")
    return "\n".join(line.rstrip() for line in [*lines, suppressed(matching)])


def suppressed(matching: Matching, write: Callable[[float], str] = "{:.3g}".format) -> str:
    """Return the suppression of the common acceleration in words; ``write`` formats the two factors."""
    suppression, left = matching.suppression, matching.components["after_pq"][SUM]
    floor = " (the noise floor)" if left.amplitude <= left.u_amplitude else ""
    return (
        f"common acceleration suppressed {write(suppression['p'])} times after p, {write(suppression['pq'])} times "
        f"after p and q{floor}"
    )

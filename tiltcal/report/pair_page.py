"""The page of matched accelerometer pairs: Table 1 of the source, and its figure 6 if there is a log."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tiltcal.calibration.pair_summary import HEADINGS, suppressed
from tiltcal.core.model import Array
from tiltcal.core.pair.matching import STAGES, SUM, Component, Matching
from tiltcal.files.atomic import check_writable, write_whole
from tiltcal.files.pair import PairRecord, dump_pair
from tiltcal.files.results import FileRecord
from tiltcal.report.figure import SvgFigure, picture
from tiltcal.report.number_format import AlignedNumber, column, grouped, measured, plain
from tiltcal.report.page import render, require_extra
from tiltcal.report.pair_figures import PairDrawing, draw_spectra
from tiltcal.report.provenance import Fact, notice, provenance_facts

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BINS = 400
"""Number of intervals of a spectrum on a logarithmic scale."""


def _spectra(name: str, number: int, drawing: PairDrawing) -> SvgFigure:
    """Return the spectra of a log, drawn with few points that keep all peaks and troughs."""
    shown = _outstanding(drawing.frequency, list(drawing.densities.values()))
    densities = {said: density[shown] for said, density in drawing.densities.items()}
    thinned = replace(drawing, frequency=drawing.frequency[shown], densities=densities)

    def plot(figure: Figure) -> None:
        panel = figure.subplots()
        draw_spectra(panel, thinned)
        panel.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, borderaxespad=0.1)
        panel.margins(x=0.01)

    return picture(
        f"spectra{number}",
        3.1,
        plot,
        title=f"Amplitude spectra of {name}",
        description=f"Amplitude densities over frequency of {', '.join(densities)}.",
        caption="Amplitude density of one accelerometer, and of the sum after p and after p and q.",
    )


def _outstanding(frequency: Array, densities: Sequence[Array]) -> NDArray[np.intp]:
    """Return the places where a density is largest or smallest within its interval."""
    if len(frequency) <= 2 * BINS:
        return np.arange(len(frequency))
    edges = np.unique(np.geomspace(1, len(frequency), BINS + 1).astype(np.intp))
    chosen = {0}
    for low, high in pairwise(edges.tolist()):
        for density in densities:
            chosen |= {low + int(np.argmax(density[low:high])), low + int(np.argmin(density[low:high]))}
    return np.array(sorted(chosen), dtype=np.intp)


@dataclass(frozen=True)
class ComponentRow:
    """One row, of a channel or the sum: sine and cosine components before and after."""

    name: str
    cells: Sequence[AlignedNumber]


@dataclass(frozen=True)
class PairSection:
    """One pair on the page."""

    heading: str
    p: AlignedNumber
    q: AlignedNumber
    suppression: str
    rows: Sequence[ComponentRow]


def write_pair_page(path: str | Path, calibration: PairRecord) -> None:
    """Write the page of a calibration in memory.

    Raises
    ------
    UsageError
        The libraries of the extra ``report`` are not installed, or the page cannot be written there.
    """
    require_extra()
    check_writable(path)
    name = "pairs.yaml"
    write_whole(path, pair_page(calibration, FileRecord.of_text(name, dump_pair(calibration))))


def pair_page(calibration: PairRecord, source: FileRecord, spectra: Sequence[tuple[str, PairDrawing]] = ()) -> str:
    """Return one HTML page that needs no other file, with the spectra of logs; the same input gives the same page."""
    return render(
        "pair.html.j2",
        names=[f"{matching.pair.first} and {matching.pair.second}" for matching in calibration.matchings],
        notice=notice(calibration.provenance),
        facts=_facts(calibration, source),
        pairs=[_section(matching) for matching in calibration.matchings],
        stages=[HEADINGS[stage].capitalize() for stage in STAGES],
        logs=[(name, _spectra(name, number, drawing)) for number, (name, drawing) in enumerate(spectra, start=1)],
    )


def _facts(calibration: PairRecord, source: FileRecord) -> list[Fact]:
    spin = calibration.spin
    said = [
        Fact("Turns of the stage", plain(spin.turns, 6)),
        Fact("Frequency of the spin", f"{plain(spin.frequency, 6)} Hz" if spin.frequency else ""),
        Fact("Column of the stage angle", spin.phase or ""),
        Fact("Estimated", "turn by turn" if calibration.online else "from the whole record"),
    ]
    return [
        *(fact for fact in said if fact.value),
        *provenance_facts(calibration.provenance, source),
    ]


def _section(matching: Matching) -> PairSection:
    pair = matching.pair
    names = {pair.first: pair.first, pair.second: pair.second, SUM: f"{pair.first} + {pair.second}"}
    columns = []
    for stage in STAGES:
        row: list[Component] = [matching.components[stage][name] for name in names]
        columns.append(column(measured(component.sin, component.u_sin) for component in row))
        columns.append(column(measured(component.cos, component.u_cos) for component in row))
    p, q = column([measured(matching.p, matching.u_p), measured(matching.q, matching.u_q)])
    return PairSection(
        f"{pair.first} and {pair.second}, orthogonal {pair.orthogonal}",
        p,
        q,
        f"{suppressed(matching, _factor)}.".capitalize(),
        [ComponentRow(said, [cells[k] for cells in columns]) for k, said in enumerate(names.values())],
    )


def _factor(value: float) -> str:
    """Return a factor with three significant digits and separated thousands."""
    return grouped(int(float(f"{value:.3g}"))) if value >= 1000.0 else plain(value, 3)

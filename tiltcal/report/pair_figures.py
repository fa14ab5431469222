"""The figure of a matching: spectra before and after (figure 6 of the source)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from tiltcal.core.model import Array
from tiltcal.report.figure import BLUE, GREY, RED, write_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from tiltcal.core.pair.online import OnlineHistory

COLOURS = (GREY, RED, BLUE)


@dataclass(frozen=True)
class PairDrawing:
    """The data of the figure.

    Attributes
    ----------
    frequency : ndarray, shape (n,)
        Hz, or 1/row where the record has no time.
    densities : mapping of str to ndarray, shape (n,)
        Power spectral density by what it is of: one accelerometer, the sum after p, the sum after p and q; unit²/Hz.
    spin : float
        Where the stage turns, same unit as ``frequency``.
    unit : str
        Of ``frequency``.
    course : sequence of OnlineHistory
        Of the online estimators; empty for none.
    uncertainty : float
        Stated for p and q, the larger of the two; below it no course says anything.
    """

    frequency: Array
    densities: Mapping[str, Array]
    spin: float
    unit: str
    course: Sequence[OnlineHistory] = ()
    uncertainty: float = 0.0


def draw_matching(path: Path, drawing: PairDrawing) -> None:
    """Write amplitude spectral densities as SVG (the source's figure 6), and beside them the course of the estimates.

    UsageError: the file cannot be written there.
    """
    write_figure(path, (8.0, 8.0 if drawing.course else 4.5), partial(_draw, drawing=drawing))


def _draw(figure: Figure, drawing: PairDrawing) -> None:
    panels = figure.subplots(2 if drawing.course else 1, 1, squeeze=False)[:, 0]
    draw_spectra(panels[0], drawing)
    if drawing.course:
        _draw_course(panels[1], drawing)
    for panel in panels:
        panel.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=5, borderaxespad=0.1, columnspacing=1.2)
        panel.margins(x=0.01)


def draw_spectra(panel: Axes, drawing: PairDrawing) -> None:
    """Draw amplitude densities over frequency, with a line at the spin frequency."""
    panel.axvline(drawing.spin, color="black", linewidth=0.8, linestyle=":", label="spin frequency")
    for (name, density), colour in zip(drawing.densities.items(), COLOURS, strict=False):
        panel.loglog(drawing.frequency[1:], density[1:] ** 0.5, color=colour, linewidth=0.9, label=name)
    panel.set_xlabel(f"frequency [{drawing.unit}]")
    panel.set_ylabel(f"amplitude density [reading/√({drawing.unit})]")


def _draw_course(panel: Axes, drawing: PairDrawing) -> None:
    """Draw the distance of p and q of both estimators from the final recursive estimate."""
    course = drawing.course
    turns = [estimate.turns for estimate in course]
    end = course[-1].recursive
    least = max(drawing.uncertainty / 5.0, 1e-9)
    for index, name in enumerate(("p", "q")):
        for kind, colour in (("loops", COLOURS[1]), ("recursive", COLOURS[2])):
            away = [max(abs(getattr(estimate, kind)[index] - end[index]), least) for estimate in course]
            style = "-" if index == 0 else "--"
            panel.semilogy(turns, away, style, color=colour, linewidth=0.9, label=f"{name}, {kind}")
    if drawing.uncertainty:
        panel.axhline(drawing.uncertainty, color="black", linewidth=0.8, linestyle=":", label="stated uncertainty")
        panel.set_ylim(bottom=least)
    panel.set_xlabel("turns")
    panel.set_ylabel("distance from the end")

"""Figures with matplotlib: reproducible SVG, in a file or inside a page."""

from __future__ import annotations

import re
from collections.abc import Callable
from html import escape
from io import BytesIO
from math import log10
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

from tiltcal.errors import UsageError
from tiltcal.extras import how_to_add
from tiltcal.files.atomic import whole_file
from tiltcal.report.numbers import SUPERSCRIPT

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    Plot = Callable[[Figure], None]

WIDTH = 6.85  # width of a figure on the page, inches: A4 with margins of 18 mm
THIN = 0.4  # width of a line that stands behind another one, points
INK, GREY, BLUE, RED = "#000000", "#8a8a8a", "#1f6f8b", "#c0504d"

CHANNELS = {"x": (BLUE, "o", "-"), "y": (RED, "s", "--"), "z": ("#4f6228", "^", ":")}
"""Colour, mark and line of a channel, distinguishable without colour."""

LEGEND: dict[str, Any] = {
    "loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "ncols": 5, "borderaxespad": 0.1, "columnspacing": 1.2
}  # fmt: skip
"""A legend above its panel."""

_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "axes.xmargin": 0.01,
    "lines.linewidth": 0.9,
    "lines.markersize": 3.5,
    "grid.color": "#dddddd",
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "legend.frameon": False,
    "axes.unicode_minus": True,
    "text.parse_math": False,  # a unit or a position may be called $\\frac{$
}


class SvgFigure(NamedTuple):
    """A figure inside a page: one ``svg`` element, whose ids are its own in the page, and what to see in it."""

    svg: str
    caption: str

    def _repr_html_(self) -> str:
        return f"<figure>{self.svg}<figcaption>{self.caption}</figcaption></figure>"


def require_extra() -> None:
    """Check that the libraries of a report are installed, before anything is read; a UsageError names the extra."""
    from importlib.util import find_spec

    for module, name in (("jinja2", "Jinja2"), ("matplotlib", "matplotlib")):
        if find_spec(module) is None:
            raise UsageError(f"a report needs {name}, which is not installed: {how_to_add('tiltcal[report]')}")


def write_figure(path: Path, height: float, plot: Plot) -> None:
    """Draw a figure of this height, inches, into an SVG file; a UsageError where it cannot be written."""
    with whole_file(path) as stream:
        save(plot, stream, 8.0, height)


def picture(name: str, height: float, plot: Plot, *, title: str, description: str, caption: str) -> SvgFigure:
    """Draw a figure of this height, inches, for the page; title and description are for who does not see it."""
    drawn = BytesIO()
    save(plot, drawn, WIDTH, height, f"tiltcal-{name}", 8.0)
    return SvgFigure(_inline(drawn.getvalue().decode(), name, title, description), caption)


def save(plot: Plot, stream: BinaryIO, width: float, height: float, salt: str = "tiltcal", font: float = 10.0) -> None:
    """Write a figure as SVG without a date, with reproducible ids from ``salt`` and a font in points."""
    from matplotlib import rc_context
    from matplotlib.axis import Axis
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine
    from matplotlib.ticker import LogFormatter

    with rc_context(_STYLE), rc_context({"svg.hashsalt": salt, "font.size": font}):
        figure = Figure(figsize=(width, height), layout=ConstrainedLayoutEngine(w_pad=0.08))
        plot(figure)
        for axis in figure.findobj(lambda part: isinstance(part, Axis) and part.get_scale() == "log"):
            axis.set_major_formatter(lambda x, _: f"10{f'{log10(x):.0f}'.translate(SUPERSCRIPT)}")  # type: ignore[attr-defined]
            axis.set_minor_formatter(LogFormatter())  # type: ignore[attr-defined]
        # Figure.savefig draws a figure with a layout twice, the first time for the layout alone.
        FigureCanvasSVG(figure).print_svg(stream, metadata={"Date": None, "Creator": "tiltcal"})  # type: ignore[no-untyped-call]


def _inline(svg: str, name: str, title: str, description: str) -> str:
    """Return an SVG file of matplotlib as an element of a page, without prologue; ``name`` leads its ids."""
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>|<style[^>]*>.*?</style>|<defs>\s*</defs>", "", svg, flags=re.DOTALL)
    svg = re.sub(r"<!--.*?-->\s*", "", svg, flags=re.DOTALL)
    svg = re.sub(r'(\sid="|url\(#|xlink:href="#)', rf"\1{name}-", svg)
    box = re.search(r'viewBox="[^"]*"', svg)
    root = (
        f'<svg {box[0] if box else ""} role="img" aria-labelledby="{name}-title {name}-description">'
        f'<title id="{name}-title">{escape(title)}</title><desc id="{name}-description">{escape(description)}</desc>'
    )
    return root + re.sub(r"\n\s*", "\n", svg[svg.index(">") + 1 :])

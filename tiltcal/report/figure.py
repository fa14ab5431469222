"""Figures with matplotlib: reproducible SVG, in a file or inside a page."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from html import escape
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from tiltcal.errors import UsageError
from tiltcal.files.atomic import whole_file
from tiltcal.report.numbers import SUPERSCRIPT

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH = 6.85
"""Width of a figure on the page, inches: A4 with margins of 18 mm."""

INK, GREY, BLUE, RED = "#000000", "#8a8a8a", "#1f6f8b", "#c0504d"

CHANNELS = {"x": (BLUE, "o", "-"), "y": (RED, "s", "--"), "z": ("#4f6228", "^", ":")}
"""Colour, mark and line of a channel, distinguishable without colour."""

_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "legend.frameon": False,
    "axes.unicode_minus": True,
    "text.parse_math": False,  # a unit or a position may be called $\\frac{$
}


def require_extra() -> None:
    """Check that the libraries of a report are installed, before anything is read.

    UsageError: one is not; the message names the extra.
    """
    from importlib.util import find_spec

    for module, name in (("jinja2", "Jinja2"), ("matplotlib", "matplotlib")):
        if find_spec(module) is None:
            raise UsageError(f"a report needs {name}, which is not installed: pip install 'tiltcal[report]'")


@dataclass(frozen=True)
class SvgFigure:
    """A figure inside a page.

    Attributes
    ----------
    svg : str
        One ``svg`` element, whose ids are its own in the page.
    caption : str
        What to see in it.
    """

    svg: str
    caption: str


@contextmanager
def figure_style(salt: str = "tiltcal", size: float = 10.0) -> Iterator[None]:
    """Draw and save in our style: reproducible ids from ``salt``, and a font of ``size`` points."""
    from matplotlib import rc_context

    with rc_context(_STYLE), rc_context({"svg.hashsalt": salt, "font.size": size}):
        yield


def save(figure: Figure, stream: BinaryIO) -> None:
    """Write a figure as SVG without a date; use it within :func:`figure_style`."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    _label_decades(figure)
    # Figure.savefig draws a figure with a layout twice, the first time for the layout alone; draw does the layout too.
    FigureCanvasSVG(figure).print_svg(stream, metadata={"Date": None, "Creator": "tiltcal"})  # type: ignore[no-untyped-call]


def _label_decades(figure: Figure) -> None:
    """Label logarithmic axes with characters: what is written as mathematics stays as it is (``text.parse_math``)."""
    from matplotlib.axis import Axis
    from matplotlib.ticker import LogFormatterSciNotation

    class Decades(LogFormatterSciNotation):
        def __call__(self, x: float, pos: int | None = None) -> str:
            return in_characters(super().__call__(x, pos))

    for axis in figure.findobj(lambda part: isinstance(part, Axis) and part.get_scale() == "log"):
        axis.set_major_formatter(Decades())  # type: ignore[attr-defined]
        axis.set_minor_formatter(Decades(labelOnlyBase=False))  # type: ignore[attr-defined]


def in_characters(label: str) -> str:
    """Return ``$\\mathdefault{4\\times10^{-3}}$`` as ``4×10⁻³``."""
    plain = re.sub(r"^\$\\mathdefault\{(.*)\}\$$", r"\1", label).replace(r"\times", "×")
    return re.sub(r"\^\{([-0-9]+)\}", lambda power: power[1].translate(SUPERSCRIPT), plain)


def write_figure(path: Path, size: tuple[float, float], plot: Callable[[Figure], None]) -> None:
    """Draw a figure of this size, inches, into an SVG file.

    UsageError: the file cannot be written there.
    """
    from matplotlib.figure import Figure

    with figure_style(), whole_file(path) as stream:
        figure = Figure(figsize=size, layout="constrained")
        plot(figure)
        save(figure, stream)


def picture(
    name: str, height: float, plot: Callable[[Figure], None], *, title: str, description: str, caption: str
) -> SvgFigure:
    """Draw a figure for the page.

    Parameters
    ----------
    name : str
        Its own in the page; leads its ids.
    height : float
        Inches.
    title, description : str
        For who does not see it.
    """
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    drawn = BytesIO()
    with figure_style(f"tiltcal-{name}", 8.0):
        figure = Figure(figsize=(WIDTH, height), layout=ConstrainedLayoutEngine(w_pad=0.08))
        plot(figure)
        save(figure, drawn)
    return SvgFigure(inline(drawn.getvalue().decode(), name, title, description), caption)


def inline(svg: str, name: str, title: str, description: str) -> str:
    """Return an SVG file of matplotlib as an element of a page: without prologue and page-wide style.

    Its name leads every id, so that these are its own, and its text is that of title and description.
    """
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>|<style[^>]*>.*?</style>|<defs>\s*</defs>", "", svg, flags=re.DOTALL)
    svg = re.sub(r"<!--.*?-->\s*", "", svg, flags=re.DOTALL)
    svg = re.sub(r'(\sid=")', rf"\1{name}-", svg)
    svg = re.sub(r'(url\(#|xlink:href="#)', rf"\1{name}-", svg)
    box = re.search(r'viewBox="[^"]*"', svg)
    root = (
        f'<svg {box[0] if box else ""} role="img" aria-labelledby="{name}-title {name}-description">'
        f'<title id="{name}-title">{escape(title)}</title><desc id="{name}-description">{escape(description)}</desc>'
    )
    body = svg[svg.index(">") + 1 :]
    return root + re.sub(r"\n\s*", "\n", body)

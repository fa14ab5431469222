"""The figure of the tilt error before and after compensation, along a log with known true tilt."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from tiltcal.core.model import Array
from tiltcal.files.atomic import whole_file
from tiltcal.report.figure import figure_style, save

BEFORE, AFTER, TEMPERATURE = "#c0504d", "#1f6f8b", "#8a8a8a"


def draw_tilt_error(
    path: Path,
    time: Array,
    temperature: Array,
    before: Mapping[str, Array],
    after: Mapping[str, Array],
    axes: Sequence[str],
    title: str,
) -> None:
    """Write the picture as SVG.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Seconds.
    temperature : ndarray, shape (n,)
        °C.
    before, after : mapping of str to ndarray, shape (n,)
        Tilt error per axis, degrees.
    """
    from matplotlib.figure import Figure

    with figure_style(), whole_file(path) as stream:
        figure = Figure(figsize=(8.0, 2.0 + 1.7 * len(axes)), layout="constrained")
        panels = figure.subplots(len(axes) + 1, 1, sharex=True, height_ratios=[*([2.0] * len(axes)), 1.0])
        for panel, axis in zip(panels, axes, strict=False):
            panel.axhline(0.0, color="black", linewidth=0.6)
            panel.plot(time / 60, before[axis], color=BEFORE, linewidth=0.9, label="data sheet's coefficients")
            panel.plot(time / 60, after[axis], color=AFTER, linewidth=0.9, label="calibrated")
            panel.set_ylabel(f"error of {axis} tilt [°]")
        figure.suptitle(title, x=0.08, ha="left", fontsize=11)
        panels[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.1)
        panels[-1].plot(time / 60, temperature, color=TEMPERATURE, linewidth=1.2)
        panels[-1].set_ylabel("T [°C]")
        panels[-1].set_xlabel("time [min]")
        for panel in panels:
            panel.margins(x=0.01)
        save(figure, stream)

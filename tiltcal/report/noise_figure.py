"""The figure of the noise: the Allan deviation of every channel, and its kinds of noise."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tiltcal.core.noise import ChannelNoise, NoiseScale
from tiltcal.report.figure import BLUE, GREY, RED, write_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_NAMES = {"N": "white noise", "B": "flicker noise", "K": "random walk", "R": "drift"}

_DASHES = {"N": "--", "B": ":", "K": "-.", "R": (0, (8, 3))}


def draw_noise(path: Path, noises: Mapping[str, ChannelNoise], scale: NoiseScale) -> None:
    """Write the Allan deviation of every channel with its kinds of noise, as SVG."""
    write_figure(path, (8.0, 1.0 + 3.6 * len(noises)), partial(_draw, noises=noises, scale=scale))


def _draw(figure: Figure, noises: Mapping[str, ChannelNoise], scale: NoiseScale) -> None:
    panels = figure.subplots(len(noises), 1, squeeze=False)[:, 0]
    for panel, (channel, noise) in zip(panels, noises.items(), strict=True):
        _draw_channel(panel, channel, noise, scale)
    panels[-1].set_xlabel("averaging time [s]")


def _draw_channel(panel: Axes, channel: str, noise: ChannelNoise, scale: NoiseScale) -> None:
    tau, deviation = noise.tau, noise.deviation
    described = np.geomspace(tau[noise.terms.first], tau[-1], 200)
    parts = noise.terms.parts(described)
    for name, part in parts.items() if len(parts) > 1 else ():
        panel.plot(described, part, color=GREY, linewidth=0.9, linestyle=_DASHES[name], label=_NAMES[name])
    label = ("sum, " if len(parts) > 1 else f"{_NAMES[next(iter(parts))]}, ") + (
        "fitted" if noise.terms.follows else "which does not follow it"
    )
    panel.plot(described, np.sqrt(noise.terms.variance(described)), color=RED, linewidth=1.2, label=label)
    within = [deviation - noise.low, noise.high - deviation]
    panel.errorbar(tau, deviation, within, fmt="o", markersize=3.5, elinewidth=0.9, color=BLUE, label="measured, 95 %")
    panel.set_xscale("log")
    panel.set_yscale("log")
    panel.set_ylim(float(noise.low.min()) / 1.6, float(noise.high.max()) * 1.6)
    panel.set_ylabel(f"Allan deviation of {channel} [{scale.unit}]")
    panel.grid(which="major", color="#dddddd", linewidth=0.6)
    panel.set_axisbelow(True)
    if channel in scale.per_g:
        factor = degrees(1.0 / scale.per_g[channel])
        beside = panel.twinx()
        beside.set_yscale("log")
        beside.set_ylim(*(limit * factor for limit in panel.get_ylim()))
        beside.set_ylabel("near level [°]")
        beside.spines["right"].set_visible(True)
    panel.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=5, borderaxespad=0.1, columnspacing=1.2)

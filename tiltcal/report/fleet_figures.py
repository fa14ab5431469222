"""The figures of a fleet: how each coefficient is distributed, and how the offsets have changed."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from tiltcal.calibration.fleet import CoefficientDistribution, ModelFleet
from tiltcal.calibration.labels import unit_of, words
from tiltcal.core.model import Array
from tiltcal.report.figure import CHANNELS, GREY, INK, RED, SvgFigure, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_KINDS = {
    "offset": "offset",
    "sensitivity": "sensitivity",
    "temperature.offset": "temperature coefficient of the offset",
    "temperature.sensitivity": "temperature coefficient of the sensitivity",
}
_BINS = 12


def distribution_figure(fleet: ModelFleet, number: int) -> SvgFigure | None:
    """Return the distribution of each kind of coefficient, a row for each coefficient; None where nothing varies."""
    panels = [(kind, _of_kind(fleet, kind)) for kind in _KINDS]
    panels = [(kind, found) for kind, found in panels if found]
    if not panels:
        return None
    names = ", ".join(_KINDS[kind] for kind, _ in panels)
    return picture(
        f"distribution-{number}",
        sum(0.55 + 0.32 * len(found) for _, found in panels),
        partial(_plot_distributions, fleet=fleet, panels=panels),
        title=f"Distribution of the coefficients of {len(fleet.histories)} {fleet.model}",
        description=f"One dot for each sensor and coefficient: {names}.",
        caption="One dot for each sensor. Grey bar: median ± 2 spreads (from the quartiles). Outliers are named.",
    )


def drift_figure(fleet: ModelFleet, number: int) -> SvgFigure | None:
    """Return the change of the offsets since the first calibration; None where no sensor has two."""
    if not any(len(history.calibrations) > 1 for history in fleet.histories):
        return None
    return picture(
        f"drift-{number}",
        2.3,
        partial(_plot_drift, fleet=fleet),
        title=f"Change of the offsets of {len(fleet.histories)} {fleet.model}",
        description="Offset of each sensor and channel since its first calibration, in mg, over the date.",
        caption="Change of each offset since the sensor’s first calibration, with its standard uncertainty.",
    )


def _of_kind(fleet: ModelFleet, kind: str) -> list[CoefficientDistribution]:
    """Return the distributions of a kind that vary; of sensitivities those to the channel's own axis."""
    found = []
    for distribution in fleet.distributions:
        parts = distribution.name.split(".")
        cross = parts[0] == "sensitivity" and parts[1] != parts[2]
        if distribution.name.startswith(f"{kind}.") and not cross and len(set(distribution.values.values())) > 1:
            found.append(distribution)
    return found


def _plot_distributions(
    figure: Figure, fleet: ModelFleet, panels: Sequence[tuple[str, Sequence[CoefficientDistribution]]]
) -> None:
    heights = [0.55 + 0.32 * len(found) for _, found in panels]
    axes = figure.subplots(len(panels), 1, squeeze=False, gridspec_kw={"height_ratios": heights})[:, 0]
    for panel, (kind, found) in zip(axes, panels, strict=True):
        for row, distribution in enumerate(found):
            _plot_row(panel, row, distribution)
        panel.set_yticks(range(len(found)), [words(distribution.name) for distribution in found])
        panel.set_ylim(len(found) - 0.4, -0.6)
        panel.tick_params(axis="y", length=0)
        panel.spines["left"].set_visible(False)
        unit = unit_of(found[0].name, fleet.unit)
        panel.set_xlabel(f"{_KINDS[kind]} [{unit}]" if len({unit_of(o.name, fleet.unit) for o in found}) == 1 else kind)


def _plot_row(panel: Axes, row: int, distribution: CoefficientDistribution) -> None:
    numbers = np.array(list(distribution.values.values()))
    channel = next((part for part in distribution.name.split(".") if part in CHANNELS), "x")
    colour, mark, _ = CHANNELS[channel]
    reach = 2.0 * distribution.spread
    panel.plot(
        [distribution.median - reach, distribution.median + reach], [row, row], color=GREY, linewidth=4.0, alpha=0.35
    )
    panel.plot([distribution.median, distribution.median], [row - 0.28, row + 0.28], color=INK, linewidth=0.8)
    panel.plot(numbers, row + _apart(numbers), mark, color=colour, markersize=3.0, markeredgewidth=0.0, alpha=0.75)
    for serial in distribution.outliers:
        panel.plot(distribution.values[serial], row, "o", markersize=7.0, markerfacecolor="none", markeredgecolor=RED)
        panel.annotate(
            serial,
            (distribution.values[serial], row),
            (0, -9),
            textcoords="offset points",
            ha="center",
            fontsize=7,
            color=RED,
        )


def _apart(numbers: Array) -> Array:
    """Return how far each dot is moved aside, so that neighbours do not hide one another."""
    width = float(np.ptp(numbers)) / _BINS or 1.0
    bins = np.floor((numbers - numbers.min()) / width).astype(int)
    aside = np.zeros(len(numbers))
    for value in np.unique(bins):
        places = np.flatnonzero(bins == value)
        aside[places] = 0.11 * (np.arange(len(places)) - (len(places) - 1) / 2.0)
    return np.clip(aside, -0.3, 0.3)


def _plot_drift(figure: Figure, fleet: ModelFleet) -> None:
    from datetime import datetime

    channels = fleet.histories[0].sensor.channels
    panels = figure.subplots(1, len(channels), sharey=True, squeeze=False)[0]
    for panel, channel in zip(panels, channels, strict=True):
        colour, mark, _ = CHANNELS[channel]
        panel.axhline(0.0, color=INK, linewidth=0.6)
        for history in fleet.histories:
            series = history.series(f"offset.{channel}")
            coefficients = history.calibrations[-1].record.coefficients
            if series is None or len(series[0]) < 2 or channel not in coefficients.axes:
                continue
            own = coefficients.own_sensitivity(channel)
            values, u = series
            dates: list[datetime] = [calibration.date for calibration in history.calibrations]
            panel.errorbar(
                dates,
                1000.0 * (values - values[0]) / own,
                yerr=1000.0 * u / abs(own),
                color=colour,
                marker=mark,
                markersize=2.5,
                linewidth=0.6,
                elinewidth=0.4,
                alpha=0.7,
            )
        panel.tick_params(axis="x", labelrotation=30)
        panel.set_title(channel, fontsize=8)
    panels[0].set_ylabel("change of the offset [mg]")

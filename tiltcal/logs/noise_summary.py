"""The summary of a sensor's noise at rest: averages, kinds of noise, and the samples that a position needs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from math import sqrt
from typing import Any

import numpy as np

from tiltcal.core.noise.allan_fit import FLICKER
from tiltcal.core.noise.averages import RANGE_OF_100
from tiltcal.core.noise.characterise import ChannelNoise
from tiltcal.core.noise.sample_size import Limit, SampleSize, advise, uncertainty
from tiltcal.core.noise.scale import NoiseScale
from tiltcal.core.rounding import bracketed
from tiltcal.logs.noise_log import NoiseLog
from tiltcal.stated_arguments import require_above_zero

_SHOWS = 0.1
"""Share of the lowest deviation above which what rounding leaves is worth a word."""

_FEWEST_SAMPLES = 2
"""Of a position, for `measure`."""


@dataclass(frozen=True)
class NoiseTarget:
    """How good the mean of a position should be, degrees of an axis near level.

    Attributes
    ----------
    uncertainty : float or None
        Standard uncertainty of the mean.
    range : float or None
        Range of 100 such means, as the source's table I judges them.
    """

    uncertainty: float | None = None
    range: float | None = None

    def __post_init__(self) -> None:
        require_above_zero("--target", self.uncertainty)
        require_above_zero("--target-range", self.range)

    @property
    def degrees(self) -> float | None:
        """The standard uncertainty that meets both; None where neither is stated."""
        stated = [self.uncertainty, None if self.range is None else self.range / RANGE_OF_100]
        return min((seconds for seconds in stated if seconds is not None), default=None)

    def __str__(self) -> str:
        parts = {"": self.uncertainty, "a range of ": self.range}
        return " and ".join(f"{name}{value:g}°" for name, value in parts.items() if value is not None)


_WHY: dict[Limit, str] = {
    "target": "the smallest number that meets the target",
    "record": "the longest that this record supports; more samples still help: record longer",
    "rounding": "more do not help: the noise is too small to average the rounding out",
    "flicker": "twice as many gain less than a tenth: flicker noise stays, however long the average",
    "walk": "twice as many gain less than a tenth: random walk",
    "drift": "twice as many gain less than a tenth: drift",
    "unknown": "twice as many gain less than a tenth, for none of the usual kinds of noise",
}


@dataclass(frozen=True)
class NoisePositions:
    """What the channels' advice comes to for a position that all of them need.

    Attributes
    ----------
    channel : str
        The one that settles it.
    samples : int
        Of a position.
    uncertainty : mapping of str to float
        Of each channel's mean of so many samples, unit.
    met : mapping of str to bool
        Whether it is as good as the target; empty without one.
    """

    advice: Mapping[str, SampleSize]
    channel: str
    samples: int
    uncertainty: Mapping[str, float]
    met: Mapping[str, bool]


@dataclass(frozen=True)
class SensorNoise:
    """The noise of a sensor at rest.

    Attributes
    ----------
    log : NoiseLog
        How the readings follow each other, and what disturbed them.
    scale : NoiseScale
        How much of the readings' unit a g is, where that is known.
    target : NoiseTarget
        How good the mean of a position should be.
    """

    log: NoiseLog
    scale: NoiseScale
    target: NoiseTarget

    @property
    def channels(self) -> Mapping[str, ChannelNoise]:
        """Averages, Allan deviation and kinds of noise of each channel, in its unit."""
        return self.log.channels

    @property
    def remarks(self) -> list[str]:
        """What limits the numbers, in words."""
        return self.log.remarks()

    @cached_property
    def positions(self) -> NoisePositions:
        """How many samples a position needs."""
        interval = self.log.pace.interval
        targets = {channel: self.scale.from_degrees(channel, self.target.degrees) for channel in self.channels}
        advice = {channel: advise(noise, interval, targets[channel]) for channel, noise in self.channels.items()}
        # A channel that misses the target is what settles it, whatever the others need.
        settles = max(advice, key=lambda channel: (advice[channel].met is False, advice[channel].samples))
        samples = max(_FEWEST_SAMPLES, advice[settles].samples)
        tau = np.array([samples * interval])
        u = {channel: float(uncertainty(noise, tau)[0]) for channel, noise in self.channels.items()}
        met = {channel: u[channel] <= wanted for channel, wanted in targets.items() if wanted is not None}
        return NoisePositions(advice, settles, samples, u, met)

    def __str__(self) -> str:
        kinds = (line for channel, noise in self.channels.items() for line in _kinds(channel, noise, self.scale))
        return "\n".join([self.log.as_text(), *_table(self.channels, self.scale), "", *kinds, "", *_advice(self)])

    __repr__ = __str__

    def as_data(self) -> dict[str, Any]:
        """Everything as plain data, with the whole Allan deviation."""
        found, scale, target = self.positions, self.scale, self.target
        return {
            **self.log.as_data(),
            "unit": scale.unit,
            "sensitivity": {"source": scale.source, **scale.per_g} if scale.per_g else None,
            "channels": {channel: _channel_data(channel, noise, scale) for channel, noise in self.channels.items()},
            "recommendation": {
                "samples": found.samples,
                "seconds": found.samples * self.log.pace.interval,
                "channel": found.channel,
                "limit": found.advice[found.channel].limit,
                "target_degrees": target.uncertainty,
                "target_range_degrees": target.range,
                "met": all(found.met.values()) if found.met else None,
                "channels": {
                    channel: {
                        "samples": advice.samples,
                        "limit": advice.limit,
                        **_both("uncertainty", channel, found.uncertainty[channel], scale),
                        **_both("range_of_100", channel, RANGE_OF_100 * found.uncertainty[channel], scale),
                        "met": found.met.get(channel),
                        "useful": advice.useful,
                        "predicted": advice.predicted,
                    }
                    for channel, advice in found.advice.items()
                },
            },
        }


def _channel_data(channel: str, noise: ChannelNoise, scale: NoiseScale) -> dict[str, Any]:
    value, u = noise.terms.value, noise.terms.u
    tau_lowest, lowest = noise.lowest
    named: dict[str, Any] = {
        name: {"value": factor * value[term], "u": factor * u[term]} if term in value else None
        for name, term, factor in (
            ("noise_density", "N", sqrt(2.0)),
            ("velocity_random_walk", "N", 1.0),
            ("flicker", "B", 1.0),
            ("bias_random_walk", "K", 1.0),
            ("drift", "R", 1.0),
        )
    }
    return {
        "mean": noise.mean,
        "samples": noise.count,
        "step": noise.step or None,
        "averages": [
            {
                "samples": average.samples,
                "averages": average.count,
                **_both("std", channel, average.std, scale),
                **_both("range", channel, average.range, scale),
                "white": noise.white(average),
            }
            for average in noise.averages
        ],
        "allan": [
            {"tau": tau, "deviation": deviation, "low": low, "high": high, "dof": dof}
            for tau, deviation, low, high, dof in zip(
                *(column.tolist() for column in (noise.tau, noise.deviation, noise.low, noise.high, noise.terms.dof)),
                strict=True,
            )
        ],
        **named,
        "bias_instability": {
            "reached": noise.settled,
            "tau": tau_lowest,
            **_both("deviation", channel, lowest, scale),
            "coefficient": lowest / FLICKER,
        },
        "rounding": noise.rounding,
        "described": {"from_tau": float(noise.tau[noise.terms.first]), "follows": noise.terms.follows},
    }


def _both(name: str, channel: str, value: float, scale: NoiseScale) -> dict[str, float]:
    angle = scale.degrees(channel, value)
    return {name: value} if angle is None else {name: value, f"{name}_degrees": angle}


def _table(noises: Mapping[str, ChannelNoise], scale: NoiseScale) -> Iterator[str]:
    """Averages of 1, 10, 100 (the source's Table I)."""
    unit = scale.unit
    angles = "" if not scale.per_g else f"  {'std [°]':>10}  {'range [°]':>10}"
    head = f"{'':3} {'samples':>8} {'averages':>9}  {f'std [{unit}]':>14}  {'if white':>10}  {f'range [{unit}]':>14}"
    yield head + angles
    for channel, noise in noises.items():
        for row, average in enumerate(noise.averages):
            cells = [f"{average.std:>14.4g}", f"{noise.white(average):>10.4g}", f"{average.range:>14.4g}"]
            for value in (average.std, average.range):
                angle = scale.degrees(channel, value)
                cells += [] if angle is None else [f"{angle:>10.3g}"]
            yield f"{channel if row == 0 else '':3} {average.samples:>8} {average.count:>9}  " + "  ".join(cells)


def _kinds(channel: str, noise: ChannelNoise, scale: NoiseScale) -> Iterator[str]:
    value, u, unit = noise.terms.value, noise.terms.u, scale.unit
    lines = []
    if "N" in value:
        density, sigma = sqrt(2.0) * value["N"], sqrt(2.0) * u["N"]
        lines.append(
            f"white noise {bracketed(density, sigma)} {unit}/√Hz{_in_g(channel, density, scale, '/√Hz')}, "
            f"which is {bracketed(value['N'], u['N'])} {unit} after 1 s"
        )
    if "B" in value:
        flat = FLICKER * value["B"]
        lines.append(
            f"flicker noise {bracketed(flat, FLICKER * u['B'])} {unit}{_in_g(channel, flat, scale)} at any time"
        )
    if "K" in value:
        lines.append(f"random walk {bracketed(value['K'], u['K'])} {unit}/√s{_in_g(channel, value['K'], scale, '/√s')}")
    if "R" in value:
        lines.append(f"drift {bracketed(value['R'], u['R'])} {unit}/s{_in_g(channel, value['R'], scale, '/s')}")
    first = float(noise.tau[noise.terms.first])
    if not noise.terms.follows:
        lines.append("(the Allan deviation does not follow them: look at the --figure)")
    elif noise.terms.first:
        lines.append(f"(from {first:.3g} s on: samples that follow each other faster are not independent)")
    if noise.settled:
        tau, low = noise.lowest
        lines.append(f"bias instability {low:.3g} {unit}{_in_g(channel, low, scale)} at {tau:.3g} s")
    else:
        high = float(noise.high[-1])
        lines.append(
            f"bias instability not reached: below {high:.3g} {unit}{_in_g(channel, high, scale)} after "
            f"{float(noise.tau[-1]):.3g} s"
        )
    if noise.step:
        shows = noise.rounding > _SHOWS * float(noise.deviation.min())
        left = f"of which averaging leaves {noise.rounding:.2g} {unit}" if shows else "which averaging removes"
        lines.append(f"step {noise.step:.4g} {unit}, {left}")
    for row, line in enumerate(lines):
        yield f"{channel if row == 0 else '':3} {line}"


def _in_g(channel: str, value: float, scale: NoiseScale, per: str = "") -> str:
    if channel not in scale.per_g:
        return ""
    return f" ({1e3 * value / scale.per_g[channel]:.3g} mg{per}, {scale.degrees(channel, value):.3g} °{per})"


def _advice(noise: SensorNoise) -> Iterator[str]:
    found, scale, interval = noise.positions, noise.scale, noise.log.pace.interval
    uncertain, ranging = (
        ", ".join(_in_degrees(channel, factor * u, scale) for channel, u in found.uncertainty.items())
        for factor in (1.0, RANGE_OF_100)
    )
    yield f"measure --samples {found.samples}: a position takes {found.samples * interval:.4g} s at this pace"
    yield f"  its mean is uncertain by {uncertain}"
    if noise.target.range is not None:
        yield f"  100 such means range over {ranging}"
    yield f"  {found.channel}: {_WHY[found.advice[found.channel].limit]}"
    for channel, met in found.met.items():
        if not met:
            yield f"  {channel} does not meet {noise.target}{_foretold(found.advice[channel], interval)}"
    if scale.source:
        yield f"  degrees of an axis near level, by the {scale.source}"


def _foretold(advice: SampleSize, interval: float) -> str:
    if advice.predicted is None:
        return (
            " with any number of samples"
            if advice.met is False
            else " with this number of samples; fewer are sufficient for it"
        )
    return (
        f" with any number of samples within this record; with white noise, {advice.predicted} samples would "
        f"({advice.predicted * interval:.4g} s)"
    )


def _in_degrees(channel: str, value: float, scale: NoiseScale) -> str:
    angle = scale.degrees(channel, value)
    return f"{channel} {value:.3g} {scale.unit}" + (f" ({angle:.2g}°)" if angle is not None else "")

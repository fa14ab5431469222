"""The summary of a sensor's noise at rest: averages, kinds of noise, and the samples that a position needs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import sqrt
from typing import Any

import numpy as np

from tiltcal.core.noise import FLICKER, RANGE_OF_100, ChannelNoise, Limit, NoiseScale, SampleSize, sample_size
from tiltcal.core.rows import Span
from tiltcal.logs.uniform_sampling import SamplingInterval
from tiltcal.printable import counted
from tiltcal.stated_arguments import require_above_zero

_SHOWS = 0.1
"""Share of the lowest deviation above which what rounding leaves is worth a word."""

_FEWEST_SAMPLES = 2
"""Of a position, for `measure`."""


@dataclass(frozen=True)
class NoiseTarget:
    """How good the mean of a position should be, degrees of an axis near level.

    ``uncertainty`` is the standard uncertainty of the mean, ``range`` that of 100 such means, as the source's table I
    judges them; None where it is not stated.
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
        return min((target for target in stated if target is not None), default=None)

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
    """What the channels' advice comes to for a position of so many ``samples``, which ``channel`` settles.

    ``uncertainty`` is that of each channel's mean of them, unit, and ``met`` whether it is as good as the target; empty
    without one.
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
    pace : SamplingInterval
        How the readings follow each other.
    channels : mapping of str to ChannelNoise
        Averages, Allan deviation and kinds of noise of each channel, in its unit.
    missing, faulty : mapping of str to int, int
        Values that are missing in the log's own rows, per channel that lacks some; rows that could not be parsed.
    moved, stuck : sequence of (start, end), (start, end) or None
        Rows at an even pace, missing ones counted: where the sensor was moved, and where no channel changed.
    scale, target : NoiseScale, NoiseTarget
        How much of the readings' unit a g is, where that is stated, and how good the mean of a position should be.
    """

    pace: SamplingInterval
    channels: Mapping[str, ChannelNoise]
    missing: Mapping[str, int]
    faulty: int
    moved: Sequence[Span]
    stuck: Span | None
    scale: NoiseScale
    target: NoiseTarget

    @property
    def remarks(self) -> list[str]:
        """What limits the numbers, in words."""
        remarks = []
        if self.moved:
            begin, end = self._seconds(self.moved[0])
            more = f", and {len(self.moved) - 1} times more" if len(self.moved) > 1 else ""
            remarks.append(
                f"it was not still: moved or knocked from {begin:.4g} to {end:.4g} s{more}; the numbers are of noise "
                "and motion together: take a record at rest, or its rows at rest"
            )
        if self.stuck is not None:
            begin, end = self._seconds(self.stuck)
            remarks.append(f"the readings were stuck from {begin:.4g} to {end:.4g} s: no channel changed")
        if self.pace.gaps:
            remarks.append(f"{counted(self.pace.gaps, 'gap')} in its times, {counted(self.pace.lost, 'row')} long")
        remarks += [f"{channel} is missing in {counted(count, 'row')}" for channel, count in self.missing.items()]
        remarks += [
            f"{channel}: no sum of white noise, flicker noise, random walk and drift follows its Allan deviation; a "
            "vibration may be in it, or a filter"
            for channel, noise in self.channels.items()
            if not noise.terms.follows
        ]
        return remarks

    def _seconds(self, rows: Span) -> list[float]:
        """Return the times at which rows begin and end, seconds from the beginning of the log."""
        return [row * self.pace.interval for row in rows]

    @property
    def _span(self) -> float:
        """The time from the beginning of the first row to the end of the last, seconds."""
        return (self.pace.rows + self.pace.lost) * self.pace.interval

    @cached_property
    def positions(self) -> NoisePositions:
        """How many samples a position needs."""
        interval = self.pace.interval
        targets = {channel: self.scale.from_degrees(channel, self.target.degrees) for channel in self.channels}
        advice = {channel: sample_size(noise, interval, targets[channel]) for channel, noise in self.channels.items()}
        # A channel that misses the target is what settles it, whatever the others need.
        settles = max(advice, key=lambda channel: (advice[channel].met is False, advice[channel].samples))
        samples = max(_FEWEST_SAMPLES, advice[settles].samples)
        tau = np.array([samples * interval])
        u = {channel: float(noise.uncertainty(tau)[0]) for channel, noise in self.channels.items()}
        met = {channel: u[channel] <= wanted for channel, wanted in targets.items() if wanted is not None}
        return NoisePositions(advice, settles, samples, u, met)

    def __str__(self) -> str:
        kinds = (line for channel, noise in self.channels.items() for line in _kinds(channel, noise, self.scale))
        pace = self.pace
        extent = (
            f"{pace.rows} samples of {', '.join(self.channels)}, {pace.interval:.4g} s apart "
            f"({1.0 / pace.interval:.4g} Hz), {self._span:.6g} s"
        )
        return "\n".join([extent, *_table(self.channels, self.scale), "", *kinds, "", *_advice(self)])

    __repr__ = __str__

    def as_data(self) -> dict[str, Any]:
        """Everything as plain data, with the whole Allan deviation."""
        found, scale, target = self.positions, self.scale, self.target
        return {
            "samples": self.pace.rows,
            "interval": self.pace.interval,
            "seconds": self._span,
            "gaps": {"count": self.pace.gaps, "rows": self.pace.lost},
            "missing": dict(self.missing),
            "bad_rows": self.faulty,
            "moved": [self._seconds(rows) for rows in self.moved],
            "hung": None if self.stuck is None else self._seconds(self.stuck),
            "remarks": self.remarks,
            "unit": scale.unit,
            "sensitivity": {"source": scale.source, **scale.per_g} if scale.per_g else None,
            "channels": {channel: _channel_data(channel, noise, scale) for channel, noise in self.channels.items()},
            "recommendation": {
                "samples": found.samples,
                "seconds": found.samples * self.pace.interval,
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
    value = noise.terms.value
    tau_lowest, lowest = noise.lowest
    named: dict[str, Any] = {
        name: {"value": factor * value[term]} if term in value else None
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
    unit, terms, lines = scale.unit, noise.terms, []

    def sized(name: str, value: float, per: str = "") -> str:
        return f"{name} {value:.3g} {unit}{per}{_in_g(channel, value, scale, per)}"

    for term, value in terms.value.items():
        if term == "N":
            density = sized("white noise", sqrt(2.0) * value, "/√Hz")
            lines.append(f"{density}, which is {value:.3g} {unit} after 1 s")
        elif term == "B":
            lines.append(sized("flicker noise", FLICKER * value) + " at any time")
        else:
            lines.append(sized("random walk", value, "/√s") if term == "K" else sized("drift", value, "/s"))
    first, (tau, low) = float(noise.tau[terms.first]), noise.lowest
    if not terms.follows:
        lines.append("(the Allan deviation does not follow them: look at the --figure)")
    elif terms.first:
        lines.append(f"(from {first:.3g} s on: samples that follow each other faster are not independent)")
    if noise.settled:
        lines.append(f"{sized('bias instability', low)} at {tau:.3g} s")
    else:
        below = sized("bias instability not reached: below", float(noise.high[-1]))
        lines.append(f"{below} after {float(noise.tau[-1]):.3g} s")
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
    found, scale, interval = noise.positions, noise.scale, noise.pace.interval
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
    if advice.predicted is not None:
        return (
            f" with any number of samples within this record; with white noise, {advice.predicted} samples would "
            f"({advice.predicted * interval:.4g} s)"
        )
    never = advice.met is False
    return " with any number of samples" if never else " with this number of samples; fewer are sufficient for it"


def _in_degrees(channel: str, value: float, scale: NoiseScale) -> str:
    angle = scale.degrees(channel, value)
    return f"{channel} {value:.3g} {scale.unit}" + (f" ({angle:.2g}°)" if angle is not None else "")

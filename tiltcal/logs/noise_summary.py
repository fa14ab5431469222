"""The noise of a sensor at rest in words and as data: averages, kinds of noise, and the samples of a position."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import sqrt
from typing import Any

import numpy as np

from tiltcal.core.detection import Span
from tiltcal.core.noise import FLICKER, RANGE_OF_100, ChannelNoise, Limit, NoiseScale, SampleSize, sample_size
from tiltcal.printable import counted, in_html
from tiltcal.stated_arguments import require_above_zero

_SHOWS = 0.1  # share of the lowest deviation above which what rounding leaves is worth a word
_FEWEST_SAMPLES = 2  # of a position, for `measure`
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
class Pace:
    """The interval between the rows of a log in seconds, its rows, its gaps, and the rows that are lost in them."""

    interval: float
    rows: int
    gaps: int = 0
    lost: int = 0


@dataclass(frozen=True)
class NoiseTarget:
    """How good the mean of a position should be, degrees of an axis near level; None where it is not stated.

    ``uncertainty`` is the standard uncertainty of the mean, ``range`` that of 100 such means, as the source's table I
    judges them.
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


@dataclass(frozen=True)
class SensorNoise:
    """The noise of a sensor at rest.

    Attributes
    ----------
    pace : Pace
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

    pace: Pace
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

    @cached_property
    def _targets(self) -> dict[str, float | None]:
        return {channel: self.scale.from_degrees(channel, self.target.degrees) for channel in self.channels}

    @cached_property
    def advice(self) -> dict[str, SampleSize]:
        """How many samples each channel needs; one that misses the target comes first, then by their number."""
        sizes = {
            channel: sample_size(noise, self.pace.interval, self._targets[channel])
            for channel, noise in self.channels.items()
        }
        settles = max(sizes, key=lambda channel: (sizes[channel].met is False, sizes[channel].samples))
        return {settles: sizes[settles]} | sizes

    @property
    def samples(self) -> int:
        """How many samples a position needs."""
        return max(_FEWEST_SAMPLES, next(iter(self.advice.values())).samples)

    @cached_property
    def uncertainty(self) -> dict[str, float]:
        """The standard uncertainty of each channel's mean of so many samples, unit."""
        tau = np.array([self.samples * self.pace.interval])
        return {channel: float(noise.uncertainty(tau)[0]) for channel, noise in self.channels.items()}

    @property
    def met(self) -> dict[str, bool]:
        """Whether that is as good as the target, of each channel that has one."""
        return {name: self.uncertainty[name] <= wanted for name, wanted in self._targets.items() if wanted is not None}

    def __str__(self) -> str:
        interval = self.pace.interval
        extent = (
            f"{self.pace.rows} samples of {', '.join(self.channels)}, {interval:.4g} s apart "
            f"({1.0 / interval:.4g} Hz), {(self.pace.rows + self.pace.lost) * interval:.6g} s"
        )
        kinds = (line for channel, noise in self.channels.items() for line in _kinds(channel, noise, self.scale))
        return "\n".join([extent, *self._averages(), "", *kinds, "", *self._recommendation()])

    __repr__ = __str__
    _repr_html_ = in_html

    def _averages(self) -> Iterator[str]:
        """Averages of 1, 10, 100 (the source's Table I)."""
        unit, scale = self.scale.unit, self.scale
        angles = "" if not scale.per_g else f"  {'std [°]':>10}  {'range [°]':>10}"
        yield (
            f"{'':3} {'samples':>8} {'averages':>9}  {f'std [{unit}]':>14}  {'if white':>10}  {f'range [{unit}]':>14}"
            + angles
        )
        for channel, noise in self.channels.items():
            for row, one in enumerate(noise.averages):
                cells = [f"{one.std:>14.4g}", f"{noise.white(one):>10.4g}", f"{one.range:>14.4g}"]
                sizes = (scale.degrees(channel, value) for value in (one.std, one.range))
                cells += [f"{angle:>10.3g}" for angle in sizes if angle is not None]
                yield f"{channel if row == 0 else '':3} {one.samples:>8} {one.count:>9}  " + "  ".join(cells)

    def _recommendation(self) -> Iterator[str]:
        def listed(factor: float) -> str:
            return ", ".join(_in_degrees(channel, factor * u, self.scale) for channel, u in self.uncertainty.items())

        interval, (settles, advice) = self.pace.interval, next(iter(self.advice.items()))
        yield f"measure --samples {self.samples}: a position takes {self.samples * interval:.4g} s at this pace"
        yield f"  its mean is uncertain by {listed(1.0)}"
        if self.target.range is not None:
            yield f"  100 such means range over {listed(RANGE_OF_100)}"
        yield f"  {settles}: {_WHY[advice.limit]}"
        for channel in (channel for channel, met in self.met.items() if not met):
            yield f"  {channel} does not meet {self.target}{_foretold(self.advice[channel], interval)}"
        if self.scale.source:
            yield f"  degrees of an axis near level, by the {self.scale.source}"

    def as_data(self) -> dict[str, Any]:
        """Everything as plain data, with the whole Allan deviation."""
        scale, pace, (settles, advice), met = self.scale, self.pace, next(iter(self.advice.items())), self.met
        return {
            "samples": pace.rows,
            "interval": pace.interval,
            "seconds": (pace.rows + pace.lost) * pace.interval,
            "gaps": {"count": pace.gaps, "rows": pace.lost},
            "missing": dict(self.missing),
            "bad_rows": self.faulty,
            "moved": [self._seconds(rows) for rows in self.moved],
            "hung": None if self.stuck is None else self._seconds(self.stuck),
            "remarks": self.remarks,
            "unit": scale.unit,
            "sensitivity": {"source": scale.source, **scale.per_g} if scale.per_g else None,
            "channels": {channel: _channel_data(channel, noise, scale) for channel, noise in self.channels.items()},
            "recommendation": {
                "samples": self.samples,
                "seconds": self.samples * pace.interval,
                "channel": settles,
                "limit": advice.limit,
                "target_degrees": self.target.uncertainty,
                "target_range_degrees": self.target.range,
                "met": all(met.values()) if met else None,
                "channels": {
                    channel: {
                        "samples": self.advice[channel].samples,
                        "limit": self.advice[channel].limit,
                        **_both("uncertainty", channel, u, scale),
                        **_both("range_of_100", channel, RANGE_OF_100 * u, scale),
                        "met": met.get(channel),
                        "useful": self.advice[channel].useful,
                        "predicted": self.advice[channel].predicted,
                    }
                    for channel, u in self.uncertainty.items()
                },
            },
        }


def _channel_data(channel: str, noise: ChannelNoise, scale: NoiseScale) -> dict[str, Any]:
    def coefficient(term: str, factor: float = 1.0) -> dict[str, float] | None:
        value = noise.terms.value
        return {"value": factor * value[term]} if term in value else None

    tau_lowest, lowest = noise.lowest
    allan = {"tau": noise.tau, "deviation": noise.deviation, "low": noise.low, "high": noise.high}
    allan["dof"] = noise.terms.dof
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
        "allan": [dict(zip(allan, row, strict=True)) for row in np.stack(list(allan.values()), axis=1).tolist()],
        "noise_density": coefficient("N", sqrt(2.0)),
        "velocity_random_walk": coefficient("N"),
        "flicker": coefficient("B"),
        "bias_random_walk": coefficient("K"),
        "drift": coefficient("R"),
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


def _kinds(channel: str, noise: ChannelNoise, scale: NoiseScale) -> Iterator[str]:
    """Yield the kinds of noise of a channel, and where averaging ends."""

    def sized(name: str, value: float, per: str = "") -> str:
        angle = scale.degrees(channel, value)
        in_g = "" if angle is None else f" ({1e3 * value / scale.per_g[channel]:.3g} mg{per}, {angle:.3g} °{per})"
        return f"{name} {value:.3g} {scale.unit}{per}{in_g}"

    terms, lines = noise.terms, []
    for term, value in terms.value.items():
        if term == "N":
            density = sized("white noise", sqrt(2.0) * value, "/√Hz")
            lines.append(f"{density}, which is {value:.3g} {scale.unit} after 1 s")
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
        left = f"of which averaging leaves {noise.rounding:.2g} {scale.unit}" if shows else "which averaging removes"
        lines.append(f"step {noise.step:.4g} {scale.unit}, {left}")
    for row, line in enumerate(lines):
        yield f"{channel if row == 0 else '':3} {line}"


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

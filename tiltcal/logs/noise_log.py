"""The noise of a recorded log of a sensor at rest, characterised block by block."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

from tiltcal.core.noise.characterise import FEWEST_SAMPLES, ChannelNoise, Characteriser
from tiltcal.core.noise.disturbances import RowRange
from tiltcal.errors import EstimateError, InputError
from tiltcal.logs.uniform_sampling import SamplingInterval, UniformLog
from tiltcal.printable import counted


@dataclass(frozen=True)
class NoiseLog:
    """The noise of the sensor of a log.

    Attributes
    ----------
    missing : mapping of str to int
        Values that are missing in the log's own rows, per channel that lacks some.
    moved : sequence of RowRange
        Where the sensor was moved; rows at an even pace, missing ones counted.
    stuck : RowRange or None
        Where no channel changed.
    """

    pace: SamplingInterval
    channels: Mapping[str, ChannelNoise]
    missing: Mapping[str, int]
    moved: Sequence[RowRange]
    stuck: RowRange | None

    def seconds(self, rows: RowRange) -> tuple[float, float]:
        """Return the times at which rows begin and end, seconds from the beginning of the log."""
        return rows.start * self.pace.interval, rows.end * self.pace.interval

    @property
    def span(self) -> float:
        """The time from the beginning of the first row to the end of the last, seconds."""
        return (self.pace.rows + self.pace.lost) * self.pace.interval

    def as_text(self) -> str:
        """Return the extent of the log in words."""
        return (
            f"{self.pace.rows} samples of {', '.join(self.channels)}, {self.pace.interval:.4g} s apart "
            f"({1.0 / self.pace.interval:.4g} Hz), {self.span:.6g} s"
        )

    def as_data(self) -> dict[str, Any]:
        """Return the extent of the log and its faults as plain data."""
        return {
            "samples": self.pace.rows,
            "interval": self.pace.interval,
            "seconds": self.span,
            "gaps": {"count": self.pace.gaps, "rows": self.pace.lost},
            "missing": dict(self.missing),
            "bad_rows": self.pace.faulty,
            "moved": [list(self.seconds(rows)) for rows in self.moved],
            "hung": None if self.stuck is None else list(self.seconds(self.stuck)),
            "remarks": self.remarks(),
        }

    def remarks(self) -> list[str]:
        """Return what limits the numbers, in words."""
        said = []
        if self.moved:
            begin, end = self.seconds(self.moved[0])
            more = f", and {len(self.moved) - 1} times more" if len(self.moved) > 1 else ""
            said.append(
                f"it was not still: moved or knocked from {begin:.4g} to {end:.4g} s{more}; the numbers are of noise "
                "and motion together: take a record at rest, or its rows at rest"
            )
        if self.stuck is not None:
            begin, end = self.seconds(self.stuck)
            said.append(f"the readings were stuck from {begin:.4g} to {end:.4g} s: no channel changed")
        if self.pace.gaps:
            said.append(f"{counted(self.pace.gaps, 'gap')} in its times, {counted(self.pace.lost, 'row')} long")
        said += [f"{channel} is missing in {counted(count, 'row')}" for channel, count in self.missing.items()]
        said += [
            f"{channel}: no sum of white noise, flicker noise, random walk and drift follows its Allan deviation; a "
            "vibration may be in it, or a filter"
            for channel, noise in self.channels.items()
            if not noise.terms.follows
        ]
        return said


def characterise_log(
    log: UniformLog,
    channels: Sequence[str],
    sizes: Sequence[int],
) -> NoiseLog:
    """Characterise the noise of a log, read once from its beginning to its end.

    Parameters
    ----------
    sizes : sequence of int
        Sizes of averages that are asked for beside 1, 10, 100, ...

    Raises
    ------
    InputError
        A row cannot be parsed, or a reading is stuck.
    EstimateError
        There is too little to say anything.
    """
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        found = Characteriser(len(channels), sizes, threads.map)
        for samples in log.samples():
            found.add(samples)
    for place, channel in enumerate(channels):
        _require_noise(found, place, channel, log.name)
    pace = log.pace
    noises = {channel: found.channel(place, pace.interval) for place, channel in enumerate(channels)}
    missing = {channel: pace.rows - count for channel, count in zip(channels, found.counts, strict=True)}
    return NoiseLog(
        pace,
        noises,
        {channel: count for channel, count in missing.items() if count},
        found.moved([noise.step for noise in noises.values()]),
        found.stuck,
    )


def _require_noise(found: Characteriser, place: int, channel: str, file: str) -> None:
    count, value = found.counts[place], found.constant(place)
    if not count:
        raise InputError(f"column {channel!r} has no value in any row: is {channel} connected?", file=file)
    if count < FEWEST_SAMPLES:
        raise EstimateError(
            f"{file}: {channel} has {count} samples; nothing is said of noise from fewer than {FEWEST_SAMPLES}"
        )
    if value is not None:
        raise InputError(
            f"{channel} reads {value:g} in all {count} samples: identical samples are not still, they are stuck (or "
            "the noise is far below the step of the reading, and no averaging helps)",
            file=file,
        )

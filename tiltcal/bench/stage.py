"""The samples of a turning stage: which readings they are, what the turns so far show, and what all of them give.

A channel is called as `tiltcal record` names its column: ``a1`` of a single device, ``S-7_a1`` of several; where only
one device has a channel of the name, the name alone will do. So a pair file fits the logs of the same bench.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil, inf, pi

import numpy as np

from tiltcal.core.flags import Mask
from tiltcal.core.model import Array
from tiltcal.core.pair.demodulate import Demodulation, demodulate
from tiltcal.core.pair.matching import Matching, PairCoefficients, match, solve
from tiltcal.core.pair.model import FEWEST_TURNS, Pair
from tiltcal.core.pair.online import Notice, Recursive, TurnStream
from tiltcal.core.pair.stage import STANDSTILL, stage_record, turning
from tiltcal.drivers.model import Model, Reading
from tiltcal.errors import EstimateError, UsageError
from tiltcal.files.procedure import Rotation

SHOWN_TURN = 2.25
"""Turns after which a whole one must have been among them."""

TOO_FEW = f"at least {FEWEST_TURNS:g} are needed before it can stop"
CONVERGED, ALL_TURNS, STOPPED = "p and q are known as asked", "all turns are made", "the operator stopped"


def column_name(serial: str, channel: str, *, alone: bool) -> str:
    """Return the column of a channel: its name alone, or of several devices behind the serial number."""
    return channel if alone else f"{serial}_{channel}"


@dataclass(frozen=True)
class ChannelRef:
    """One reading of one device.

    Attributes
    ----------
    column : str
        As `tiltcal record` calls it.
    serial : str
        Of the device.
    place : int
        The number of the value in its reading.
    """

    column: str
    serial: str
    place: int

    def value(self, readings: Mapping[str, Reading]) -> float:
        """Return this value of the readings by serial number, in its unit."""
        return readings[self.serial].values[self.place]


@dataclass(frozen=True)
class ChannelMap:
    """The devices and values that give the readings of a rotation.

    Attributes
    ----------
    phase : ChannelRef
        The stage angle, degrees.
    readings : tuple of ChannelRef
        Of all pairs, each once.
    pairs : tuple of Pair
        Those whose channels are there, by their columns.
    left_out : tuple of str
        Why others are not matched.
    """

    phase: ChannelRef
    readings: tuple[ChannelRef, ...]
    pairs: tuple[Pair, ...]
    left_out: tuple[str, ...] = ()


def map_channels(rotation: Rotation, devices: Sequence[tuple[str, Model]]) -> ChannelMap:
    """Find the channels of a rotation among the devices of a bench.

    Parameters
    ----------
    devices : sequence of (str, Model)
        Serial number and model as it is wired, in the order of the bench.

    UsageError: no stage angle, or not one pair has its channels.
    """
    channels = _Channels(devices)
    phase = channels.find(rotation.phase)
    if phase is None:
        raise UsageError(
            f"no device has the stage angle {rotation.phase!r} (there are {channels.names}): where a device prints it, "
            f"name it in the address, such as columns={rotation.phase},...; of a stage without an encoder record the "
            "turning with `tiltcal record`, and match the log with `tiltcal match` without --phase, which estimates "
            "the spin"
        )
    refs: dict[str, ChannelRef] = {}
    pairs, left_out = [], []
    for pair in rotation.pairs:
        found = {name: channels.find(name) for name in pair.channels}
        missing = [name for name, ref in found.items() if ref is None]
        if missing:
            left_out.append(f"{pair.first} and {pair.second} are not matched: there is no {' and no '.join(missing)}")
            continue
        known = {name: ref for name, ref in found.items() if ref is not None}
        refs |= {ref.column: ref for ref in known.values()}
        pairs.append(Pair(*(known[name].column for name in pair.channels)))
    if not pairs:
        raise UsageError(
            f"no pair has its channels: {'; '.join(left_out)} (there are {channels.names}): name them in the address, "
            "or copy the procedure and name your own pairs"
        )
    return ChannelMap(phase, tuple(refs.values()), tuple(pairs), tuple(left_out))


class _Channels:
    """Every reading of a bench, by the names it goes by."""

    def __init__(self, devices: Sequence[tuple[str, Model]]) -> None:
        self._by_column: dict[str, ChannelRef] = {}
        self._by_channel: dict[str, list[ChannelRef]] = {}
        for serial, model in devices:
            for place, channel in enumerate(model.channels):
                ref = ChannelRef(column_name(serial, channel, alone=len(devices) == 1), serial, place)
                self._by_column[ref.column] = ref
                self._by_channel.setdefault(channel, []).append(ref)

    @property
    def names(self) -> str:
        return ", ".join(self._by_column) or "no readings"

    def find(self, name: str) -> ChannelRef | None:
        """Return the reading of a name; None where there is none.

        UsageError: several devices have it.
        """
        if name in self._by_column:
            return self._by_column[name]
        found = self._by_channel.get(name, [])
        if len(found) > 1:
            columns = " or ".join(ref.column for ref in found)
            raise UsageError(f"{len(found)} devices have a channel {name!r}: name one in the procedure: {columns}")
        return found[0] if found else None


@dataclass(frozen=True)
class WholeRotation:
    """All samples in which the stage turns, demodulated; ``left_out`` are the others since it began to turn."""

    demodulation: Demodulation
    turns: float
    seconds: float
    samples: int
    left_out: int
    stuck: tuple[str, ...]

    def matched(self, pairs: Sequence[Pair]) -> tuple[tuple[Matching, ...], tuple[str, ...]]:
        """Return the pairs that can be matched, and why others cannot be.

        EstimateError: not one can be matched.
        """
        matchings, unmatched = [], []
        for pair in pairs:
            try:
                matchings.append(match(self.demodulation, pair))
            except EstimateError as refusal:
                unmatched.append(f"{pair.first} and {pair.second}: {refusal}")
        if not matchings:
            raise EstimateError("; ".join(unmatched))
        return tuple(matchings), tuple(unmatched)


def whole_rotation(channels: Sequence[str], rows: Array) -> WholeRotation:
    """Return what the samples of a stage give: rows of seconds, angle in degrees and readings, shape (n, 2 + channels).

    A row of NaN is a break: the encoder may have lost its zero meanwhile, and the electronics their offsets. So the
    spans between breaks are brought to one phase; those of too few turns to show theirs are left out.

    EstimateError: the stage has not turned enough.
    """
    spans = [_span(channels, part) for part in split_at_breaks(rows)]
    kept = [span for span in spans if span.turns >= FEWEST_TURNS]
    if not kept:
        raise EstimateError(f"the stage has made {int(sum(span.turns for span in spans))} whole turns; {TOO_FEW}")
    lost = sum(len(span.counts) for span in spans if span.turns < FEWEST_TURNS)
    angle, readings, counts = (
        (kept[0].angle, kept[0].readings, kept[0].counts) if len(kept) == 1 else _at_one_phase(channels, kept)
    )
    return WholeRotation(
        demodulate(channels, angle, readings, counts),
        sum(span.turns for span in kept),
        sum(span.seconds for span in kept),
        int(counts.sum()),
        lost + sum(int(np.count_nonzero(~span.counts[np.argmax(span.counts) :])) for span in kept),
        tuple(line for span in kept for line in span.stuck),
    )


def split_at_breaks(rows: Array) -> list[Array]:
    """Return the rows between breaks."""
    broken = np.isnan(rows[:, 0])
    parts = [part[~np.isnan(part[:, 0])] for part in np.split(rows, np.flatnonzero(broken))]
    return [part for part in parts if len(part)]


@dataclass(frozen=True)
class _Span:
    """The samples between two breaks: angles in turns, readings of shape (channels, n), which of them count."""

    angle: Array
    readings: Array
    counts: Mask
    turns: float
    seconds: float
    stuck: tuple[str, ...]


def _span(channels: Sequence[str], rows: Array) -> _Span:
    """Return a span of sample rows, shape (n, 2 + channels)."""
    record = stage_record(channels, rows[:, 1], rows[:, 2:].T)
    counts = record.whole.copy()
    counts[counts] = turning(record.angle[counts])
    follows = counts[1:] & counts[:-1]
    turns, seconds = (float(np.diff(column)[follows].sum()) for column in (record.angle, rows[:, 0]))
    return _Span(record.angle, rows[:, 2:].T, counts, turns, seconds, record.stuck)


def _at_one_phase(channels: Sequence[str], spans: Sequence[_Span]) -> tuple[Array, Array, Mask]:
    """Return angles, readings and what counts of all spans, at the phase of the first, without offsets and drifts.

    An angle that is off for all channels alike multiplies all components by one and the same matrix, so neither p nor q
    of any pair depends on how well that is known.
    """
    signal, end = None, 0.0
    angles, readings = [], []
    for span in spans:
        coefficients = demodulate(channels, span.angle, span.readings, span.counts).coefficients
        components = coefficients[0] + 1j * coefficients[1]
        signal = components if signal is None else signal
        # S sin (θ + φ) + C cos (θ + φ) has the components S + iC times exp iφ.
        off = float(np.angle(np.sum(components * np.conj(signal)))) / (2.0 * pi)
        angles.append(span.angle + off + ceil(end - off - float(np.nanmin(span.angle))))
        end = float(np.nanmax(angles[-1]))
        place = np.arange(len(span.angle)) / len(span.angle) - 0.5
        readings.append(span.readings - coefficients[-2][:, None] - np.outer(coefficients[-1], place))
    return np.concatenate(angles), np.concatenate(readings, axis=1), np.concatenate([span.counts for span in spans])


class StageSamples:
    """The samples of a turning stage so far; ``unknown`` is why estimators cannot go on with pairs, by their names."""

    def __init__(self, pairs: Sequence[Pair], channels: Sequence[str]) -> None:
        self.unknown: dict[str, str] = {}
        self._pairs, self._channels = tuple(pairs), tuple(channels)
        self._blocks: list[Array] = []
        self._turns = self._left_out = self._spans = 0
        self._begin()

    def _begin(self) -> None:
        self._since_break = 0
        self._stream = TurnStream(len(self._channels))
        self._online = {pair: Recursive(pair, self._channels) for pair in self._pairs}

    @property
    def turns(self) -> int:
        """The whole turns that count."""
        return self._turns + self._stream.turns

    @property
    def left_out(self) -> int:
        """Samples that the recursive estimators were not given since the stage began to turn."""
        return self._left_out + self._stream.left_out

    @property
    def holds(self) -> str:
        """The reason why samples are held now; empty where they count, or before the stage turns."""
        return self._stream.why if self._stream.turns else ""

    @property
    def idle(self) -> str:
        """The reason why waiting is of no use; empty where samples count."""
        turned = self._stream.turned
        if self._stream.turns or STANDSTILL <= turned < SHOWN_TURN:
            return ""
        if turned >= SHOWN_TURN:
            return f"the stage turns, but no sample can be used: {self._stream.why}"
        if turned <= -STANDSTILL:
            return "the stage turns backwards: its angle is to count up; swap the tracks of the encoder"
        return "the stage does not turn: start it, and check that the encoder counts"

    def take(self, block: Array) -> list[str]:
        """Take a block of rows; return why samples are held from here on, in order, empty where they go on."""
        if not len(block):
            return []
        self._blocks.append(block)
        self._since_break += len(block)
        remarks = []
        for item in self._stream.push(block[:, 1], block[:, 2:].T):
            if isinstance(item, Notice):
                remarks.append(item.why)
                continue
            for pair, estimator in self._online.items():
                self.unknown.pop(pair.name, None)
                try:
                    estimator.update(item)
                except EstimateError as refusal:
                    self.unknown[pair.name] = str(refusal)
        return remarks

    def interrupt(self) -> int:
        """Note a break, and keep the span before it where its turns show its phase; return the samples not kept."""
        kept = self._stream.turns >= FEWEST_TURNS
        lost = 0 if kept else self._since_break
        self._turns += self._stream.turns if kept else 0
        self._left_out += self._stream.left_out if kept else lost
        self._spans += kept
        self._blocks.append(np.full((1, 2 + len(self._channels)), np.nan))
        self._begin()
        return lost

    def online(self) -> dict[str, PairCoefficients]:
        """Return p and q so far, by the name of the pair; pairs without an estimate are left out."""
        estimates = {pair.name: estimator.coefficients() for pair, estimator in self._online.items()}
        return {name: estimate for name, estimate in estimates.items() if max(estimate.u_p, estimate.u_q) < inf}

    def known_to(self, uncertainty: float) -> bool:
        """Return whether p and q of every pair are known with this standard uncertainty.

        The recursive estimators propose it, unless they had to begin anew; the regression has to agree, by how the
        turns scatter and by the noise within them.
        """
        online = self.online().values()
        proposed = len(online) == len(self._pairs) and all(_within(estimate, uncertainty) for estimate in online)
        if not proposed and not self._spans:
            return False
        try:
            whole = self.whole().demodulation
            # A few turns scatter less than their noise allows by chance, so the noise has to agree as well.
            white = replace(whole, scores=whole.scores[:0], weights=whole.weights[:0])
            return all(
                _within(solve(components, pair), uncertainty) for components in (whole, white) for pair in self._pairs
            )
        except EstimateError:
            return False

    def whole(self) -> WholeRotation:
        """Return what all samples give; EstimateError where the stage has not turned enough."""
        if not self._blocks:
            raise EstimateError(f"the stage has made 0 whole turns; {TOO_FEW}")
        return whole_rotation(self._channels, np.concatenate(self._blocks))


def _within(estimate: PairCoefficients, uncertainty: float) -> bool:
    return max(estimate.u_p, estimate.u_q) <= uncertainty


def unused(link_statistics: Mapping[str, int]) -> int:
    """Return the count of data that were not used: all counts but the first."""
    return sum(list(link_statistics.values())[1:])

"""A turning stage: its accelerometers are sampled until their pairs are matched.

The operator is asked once. Then every sample is taken in blocks of a fraction of a second. What cannot be used is
reported once with the reason, and once more when samples count again; after each turn the operator gets p and q of the
recursive estimators. The rotation ends when both are known as the procedure asks, when its turns are made, or when the
operator stops. The result is that of ``match`` on all samples of the journal; a break of the session is a gap in them.

A channel is called as `tiltcal record` names its column: ``a1`` of a single device, ``S-7_a1`` of several; where only
one device has a channel of the name, the name alone will do. So a pair file fits the logs of the same bench.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil, inf, pi
from typing import TYPE_CHECKING

import numpy as np

from tiltcal.bench.journal import RecordedSession, session_provenance
from tiltcal.bench.record import column_name
from tiltcal.bench.sensors import RECOVERY
from tiltcal.core.flags import Mask
from tiltcal.core.model import Array
from tiltcal.core.pair.demodulate import Demodulation, demodulate
from tiltcal.core.pair.matching import Matching, PairCoefficients, match, solve
from tiltcal.core.pair.model import FEWEST_TURNS, Pair
from tiltcal.core.pair.online import Notice, Recursive, TurnStream
from tiltcal.core.pair.stage import STANDSTILL, follow, stage_record, turning
from tiltcal.drivers.model import Model, Reading
from tiltcal.errors import EstimateError, SensorError, UsageError
from tiltcal.files.journal import POSITION
from tiltcal.files.pair import PairRecord, SpinRecord
from tiltcal.files.results import BenchRecord, BenchSensorRecord, PairProvenance, SamplesRecord
from tiltcal.files.rotation import Rotation

if TYPE_CHECKING:
    from tiltcal.bench.session import Session

BLOCK_NS = 200_000_000
"""Time over which samples are collected before they are judged and the operator is polled, ns."""
LARGEST_BLOCK = 16
"""Samples: fewer than a turn has, so that every turn is reported."""
SOONEST = 5
"""Turns before p and q are called known: fewer do not show how the turns scatter."""
SHOWN_TURN = 2.25
"""Turns after which a whole one must have been among them."""

TOO_FEW = f"at least {FEWEST_TURNS:g} are needed before it can stop"
CONVERGED, ALL_TURNS, STOPPED = "p and q are known as asked", "all turns are made", "the operator stopped"


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


class TurningStage:
    """The rotation of a session.

    Parameters
    ----------
    before : RecordedSession or None
        What there is from before an interruption.
    """

    def __init__(
        self, session: Session, rotation: Rotation, channels: ChannelMap, before: RecordedSession | None
    ) -> None:
        rows = np.empty((0, 2 + len(channels.readings))) if before is None else before.rotation_rows()
        lost = 0
        self._session = session
        self._rotation = rotation
        self._channels = channels
        self._samples = StageSamples(channels.pairs, [channel.column for channel in channels.readings])
        for part in split_at_breaks(rows):
            for first in range(0, len(part), LARGEST_BLOCK):
                self._samples.take(part[first : first + LARGEST_BLOCK])
            lost = self._samples.interrupt()
        self._interval = max(model.interval for model in session.sensors.models)
        self._taken = len(rows)
        self._stale = True
        self._reported = ""
        self._damaged = 0
        self._damage_reported = False
        self._turns = before is not None and before.turning
        if len(rows):
            self._report(f"the session was interrupted here; {_kept(lost)}")

    def turn(self) -> None:
        """Let the stage turn until a pair is matched, and note it in the journal."""
        session, first = self._session, self._session.recorder.line + 1
        while True:
            ended = self._collect()
            try:
                whole = self._samples.whole()
                matchings, unmatched = whole.matched(self._channels.pairs)
                break
            except EstimateError as refusal:
                session.refuse("rotation", str(refusal))
        for why in (*whole.stuck, *unmatched):
            self._report(why)
        session.recorder.record(
            POSITION, {"position": "rotation", "lines": [first, session.recorder.line], "ended": ended}
        )
        session.recorder.secure()
        suppression = {matching.pair.name: matching.suppression for matching in matchings}
        pairs = _coefficients({matching.pair.name: matching for matching in matchings})
        session.tell("accepted", position="rotation", turns=whole.turns, **pairs, suppression=suppression)

    def _collect(self) -> str:
        """Collect samples until they suffice, and return why they do."""
        samples, recorder = self._samples, self._session.recorder
        since_ns, made = self._begin(), samples.turns
        while True:
            why = self._take_block()
            if self._stops():
                return STOPPED
            if samples.turns > made:
                made = samples.turns
                if ended := self._report_turn(made):
                    return ended
            elif why:
                since_ns = recorder.now_ns
            elif not samples.turns and samples.idle and recorder.now_ns - since_ns > self._rotation.patience * 1e9:
                self._session.refuse("rotation", f"{samples.idle} (waited for {self._rotation.patience:g} s)")
                since_ns = self._begin()

    def _begin(self) -> int:
        """Ask the operator to let the stage turn, unless it does; return the time of it, ns since the session began."""
        if self._turns:
            self._turns = False
            return self._session.recorder.now_ns
        pairs = [{"pair": [pair.first, pair.second], "orthogonal": pair.orthogonal} for pair in self._channels.pairs]
        rotation = self._rotation
        self._session.ask({"ask": "rotation", "pairs": pairs, "turns": rotation.turns, "prompt": rotation.prompt})
        self._stale = True
        return self._session.recorder.now_ns

    def _take_block(self) -> str:
        """Collect a block, and report what of it is held; return why it ended early, empty where it did not."""
        block, why = self._sampled()
        for remark in self._samples.take(np.array(block)):
            self._report(remark)
        if why:
            self._report(f"{why}; {_kept(self._samples.interrupt())}")
        elif block:
            self._report(self._samples.holds)
            self._report_damage()
        return why

    def _sampled(self) -> tuple[list[tuple[float, ...]], str]:
        """Return the samples of a fraction of a second, and why they ended early, empty where they did not."""
        session, sensors = self._session, self._session.sensors
        block: list[tuple[float, ...]] = []
        begun_ns = session.recorder.now_ns
        channels = (self._channels.phase, *self._channels.readings)
        while len(block) < LARGEST_BLOCK and session.recorder.now_ns - begun_ns < BLOCK_NS:
            try:
                if self._stale:
                    sensors.discard()
                    self._stale = False
                readings = sensors.by_serial(sensors.read())
            except SensorError as error:
                self._stale = True
                sensors.failed(error, needed=True)
                session.clock.sleep(RECOVERY)
                return block, str(error)
            sensors.succeeded()
            self._taken += 1
            block.append((session.recorder.now_ns / 1e9, *(channel.value(readings) for channel in channels)))
            session.clock.sleep(self._interval)
        return block, ""

    def _stops(self) -> bool:
        """Return whether the operator said stop, and enough turns are made."""
        if self._session.poll(f"turning {self._taken}") is None:
            return False
        if self._samples.turns >= FEWEST_TURNS:
            return True
        self._session.refuse("rotation", f"the stage has made {self._samples.turns} whole turns; {TOO_FEW}")
        return False

    def _report_turn(self, made: int) -> str:
        """Report a completed turn; return why it is the last one, empty where it is not."""
        samples, enough = self._samples, self._rotation.converged
        self._session.recorder.secure()
        remarks = {"unknown": dict(samples.unknown), "left_out": samples.left_out + self._damaged}
        remarks = {name: remark for name, remark in remarks.items() if remark}
        pairs = _coefficients(samples.online())
        self._session.tell("turn", turn=made, of=self._rotation.turns, **pairs, **remarks)
        self._damage_reported = False
        if enough is not None and made >= SOONEST and samples.known_to(enough):
            return CONVERGED
        return ALL_TURNS if made >= self._rotation.turns else ""

    def _report(self, why: str) -> None:
        """Report, once, why samples are held; an empty reason reports that they count again."""
        if why == self._reported:
            return
        self._reported = why
        if why:
            self._session.tell("held", why=why)
        else:
            self._session.tell("resumed")

    def _report_damage(self) -> None:
        """Report, at most once a turn, that samples were damaged or lost on the line."""
        damaged = sum(map(_unused, self._session.sensors.link_statistics().values()))
        if damaged > self._damaged and not self._damage_reported and not self._reported:
            self._damage_reported = True
            self._report(f"{damaged - self._damaged} damaged or lost on the line, and left out")
            self._report("")
        self._damaged = damaged


def _kept(lost: int) -> str:
    """Return what becomes of the samples before a break."""
    return f"{lost} samples of fewer turns than {FEWEST_TURNS:g} are left out" if lost else "the samples before count"


def _coefficients(pairs: Mapping[str, PairCoefficients | Matching]) -> dict[str, dict[str, float]]:
    """Return p, q and their uncertainties, each by the name of the pair."""
    return {key: {name: getattr(pair, key) for name, pair in pairs.items()} for key in ("p", "q", "u_p", "u_q")}


def _unused(link_statistics: Mapping[str, int]) -> int:
    """Return the count of data that were not used: all counts but the first."""
    return sum(list(link_statistics.values())[1:])


def pair_calibration(session: RecordedSession, statistics: Mapping[str, Mapping[str, int]]) -> PairRecord:
    """Return the pairs that a journal gives, with their provenance but for the end of the session."""
    setup = session.setup
    channels = setup.channel_map()
    whole = whole_rotation([channel.column for channel in channels.readings], session.rotation_rows())
    matchings, unmatched = whole.matched(channels.pairs)
    sensors = tuple(
        BenchSensorRecord(serial=sensor.serial, model=sensor.model, address=sensor.address) for sensor in setup.sensors
    )
    provenance = PairProvenance(
        **session_provenance(setup),
        bench=BenchRecord(sensors=sensors),
        link_statistics={serial: dict(counts) for serial, counts in statistics.items()},
        procedure=setup.steps.name,
        samples=SamplesRecord(used=whole.samples, left_out=whole.left_out + sum(map(_unused, statistics.values()))),
        stopped=_ended(session, whole),
        not_matched=(*channels.left_out, *unmatched),
    )
    frequency = whole.turns / whole.seconds if whole.seconds > 0.0 else None
    spin = SpinRecord(turns=whole.turns, frequency=frequency, phase=channels.phase.column)
    return PairRecord(spin=spin, matchings=matchings, provenance=provenance)


def _ended(session: RecordedSession, whole: WholeRotation) -> str:
    """Return why a rotation ended; a journal of format 1 does not say it."""
    if session.turned is not None:
        return session.turned.ended
    theta = session.rotation_rows()[: session.stopped_at, 1]
    angle = follow(theta[np.isfinite(theta)])
    if len(angle) and np.ptp(angle) >= FEWEST_TURNS:  # a stop that came too early was refused
        return STOPPED
    rotation = session.setup.steps.rotation
    return CONVERGED if rotation is not None and whole.turns < rotation.turns - 1 else ALL_TURNS

"""The runner of a rotation: samples the accelerometers of a turning stage until their pairs are matched.

The operator is asked once. Then every sample comes from the tape, in blocks of a fraction of a second, and goes to two
estimators: the recursive one tells after each turn what p and q are by now and when it is enough; the regression over
all that was taken gives the result. What cannot be used (the stage stands or turns back, a gap, missing values, an
interruption) is held from both, told once with the reason, and what was collected before counts: the angle is that of
the encoder, and nothing is counted across a gap.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from math import isfinite

import numpy as np

from tiltcal.bench.desk import Desk
from tiltcal.bench.hookup import Hookup
from tiltcal.bench.operators.operator import Operator
from tiltcal.bench.operators.stage import QUESTION, Turn
from tiltcal.bench.rack import Rack, Sample
from tiltcal.bench.runner import RECOVERY
from tiltcal.bench.tape import Resumed, Tape, TapedClock
from tiltcal.core.model import Array
from tiltcal.core.pair.demodulate import Demodulator
from tiltcal.core.pair.matching import Coefficients, Matching, match, solve
from tiltcal.core.pair.model import Pair
from tiltcal.core.pair.online import Recursive
from tiltcal.core.pair.stage import FEWEST_TURNS, STANDSTILL, Stage
from tiltcal.core.pair.stream import Notice, Rows, Sector, SectorStream
from tiltcal.drivers.device import Talking
from tiltcal.errors import BayError, EstimateError
from tiltcal.files.rotation import Rotation

BLOCK_NS = 200_000_000
"""How long samples are collected before they are looked at, and before the operator is heeded."""
LARGEST_BLOCK = 16
"""Samples: fewer than a turn has, so that no turn goes by untold."""
SOONEST = 5
"""Turns before p and q are called known: from fewer nobody sees how the turns scatter."""

KEPT = "what was collected before counts"
TOO_FEW = f"at least {FEWEST_TURNS:g} are needed before it can stop"

CONVERGED, ALL_TURNS, STOPPED = "p and q are known as asked", "all turns are made", "the operator stopped"


@dataclass(frozen=True)
class Turned:
    """What a rotation gave.

    Attributes
    ----------
    matchings : tuple of Matching
    turns : float
        That were used.
    seconds : float
        They took.
    samples : int
        That were used.
    left_out : int
        Samples that were held, or damaged on the way.
    ended : str
        Why it ended.
    unmatched : tuple of str
        Pairs that could not be matched, and why.
    """

    matchings: tuple[Matching, ...]
    turns: float
    seconds: float
    samples: int
    left_out: int
    ended: str
    unmatched: tuple[str, ...] = ()

    @property
    def frequency(self) -> float | None:
        """Of the spin, Hz; None where no time passed."""
        return self.turns / self.seconds if self.seconds > 0.0 else None


@dataclass
class Block:
    """Samples that came one after the other.

    Attributes
    ----------
    times : list of int
        Nanoseconds since the session began.
    theta : list of float
        Degrees.
    readings : list of list of float
    """

    times: list[int] = field(default_factory=list)
    theta: list[float] = field(default_factory=list)
    readings: list[list[float]] = field(default_factory=list)


class Stretch:
    """What was used of a stage between two interruptions.

    Parameters
    ----------
    channels : sequence of str

    Attributes
    ----------
    samples : int
    turns, seconds : float
        Gaps are not counted.
    """

    def __init__(self, channels: Sequence[str]) -> None:
        self.samples = 0
        self.turns = self.seconds = 0.0
        self.demodulator = Demodulator(channels)
        self._stage = Stage()
        self._last: tuple[float, int] | None = None

    def add(self, theta: Array, readings: Array, times: Rows) -> None:
        """Use some samples, all complete; of none, what follows does not continue what was before."""
        if not len(theta):
            self._last = None
            return
        angle = self._stage.follow(theta)
        # The drift is one of time, in ms: it goes on while samples are held.
        self.demodulator.add(angle, readings, times // 1_000_000)
        first = self._last or (float(angle[0]), int(times[0]))
        self._last = float(angle[-1]), int(times[-1])
        self.samples += len(theta)
        self.turns += self._last[0] - first[0]
        self.seconds += (self._last[1] - first[1]) / 1e9

    def with_more(self, later: Stretch) -> Stretch:
        """This one and a later one as one; both stay as they are.

        Raises
        ------
        EstimateError
            They determine nothing.
        """
        both, more = deepcopy(self), deepcopy(later)
        both.demodulator.join(more.demodulator)
        both.samples += more.samples
        both.turns += more.turns
        both.seconds += more.seconds
        return both


class Collected:
    """What a turning stage has given so far; it takes no more memory the longer it turns.

    Parameters
    ----------
    pairs : sequence of Pair
    channels : sequence of str
        Of the readings, in their order.

    Attributes
    ----------
    left_out : int
        Samples that were held since the stage began to turn.
    """

    def __init__(self, pairs: Sequence[Pair], channels: Sequence[str]) -> None:
        self.left_out = 0
        self._pairs, self._channels = tuple(pairs), tuple(channels)
        self._stream = SectorStream(len(channels))
        self._seen = Stage()
        self._before: Stretch | None = None
        self._kept = 0.0
        self._begin()

    def _begin(self) -> None:
        self._now = Stretch(self._channels)
        self._online = {pair: Recursive(pair, self._channels) for pair in self._pairs}
        self._began = self._stream.turns

    @property
    def turns(self) -> float:
        """Whole ones that count."""
        return self._kept + self._stream.turns - self._began

    @property
    def holds(self) -> str:
        """Why samples are held now; empty where they are not, or where the stage has yet to begin."""
        return self._stream.why if self._stream.turns else ""

    @property
    def standing(self) -> bool:
        """Whether the stage has hardly moved since the first sample."""
        return abs(self._seen.turns) < STANDSTILL

    def take(self, block: Block) -> list[str]:
        """Take a block.

        Returns
        -------
        list of str
            Why samples are held from here on, in order; empty text where they go on.
        """
        if not block.times:
            return []
        theta, readings, times = np.array(block.theta), np.array(block.readings), np.array(block.times, np.int64)
        self._seen.follow(theta[np.isfinite(theta)])
        told = []
        for item in self._stream.push(theta, readings):
            told += [item.why] if isinstance(item, Notice) else self._update(item)
        used = np.isfinite(theta) & np.isfinite(readings).all(axis=1) & (not self._stream.why)
        self._now.add(theta[used], readings[used], times[used])
        self.left_out += int(np.count_nonzero(~used)) if self._stream.turns else 0
        return told

    def interrupt(self) -> int:
        """What comes from here on may have another zero of the angle, and other offsets: the device was out of sight.

        What was collected since the last time is kept where it is turns enough to tell its phase.

        Returns
        -------
        int
            Samples that are not kept.
        """
        whole, lost = self._whole(), 0
        if whole is self._before:
            lost = self._now.samples
        else:
            self._kept += self._stream.turns - self._began
        self.left_out += lost
        self._before = whole
        self._begin()
        return lost

    def online(self) -> dict[str, Coefficients]:
        """p and q by now, by the name of the pair; pairs of which nothing is known are not there."""
        found = {pair.name: Coefficients(one.p, one.q, one.u_p, one.u_q) for pair, one in self._online.items()}
        return {name: one for name, one in found.items() if isfinite(one.u_p) and isfinite(one.u_q)}

    def known_to(self, uncertainty: float) -> bool:
        """Whether p and q of every pair are known so well.

        The recursive estimators propose it, unless they had to begin anew; the regression has to agree, which knows how
        the turns scatter.
        """
        online = self.online()
        proposed = len(online) == len(self._pairs) and all(_within(one, uncertainty) for one in online.values())
        if not proposed and self._before is None:
            return False
        try:
            whole = self.whole().demodulator.result()
            return all(_within(solve(whole, pair), uncertainty) for pair in self._pairs)
        except EstimateError:
            return False

    def whole(self) -> Stretch:
        """All that counts, as one.

        Raises
        ------
        EstimateError
            Too little to determine anything.
        """
        whole = self._whole()
        if whole is None:
            raise EstimateError(f"the stage has made {self.turns:.2f} whole turns; {TOO_FEW}")
        return whole

    def _whole(self) -> Stretch | None:
        if self._stream.turns - self._began < FEWEST_TURNS:
            return self._before
        return self._now if self._before is None else self._before.with_more(self._now)

    def _update(self, sector: Sector) -> list[str]:
        told = []
        for pair, estimator in self._online.items():
            try:
                estimator.update(sector)
            except EstimateError as refusal:
                told.append(f"{pair.first} and {pair.second} cannot be matched yet: {refusal}")
        return told


class RotationRunner:
    """One session at a turning stage.

    Parameters
    ----------
    rotation : Rotation
    hookup : Hookup
    rack : Rack
    operator : Operator
    desk : Desk
    tape : Tape
    clock : TapedClock
    """

    def __init__(
        self,
        rotation: Rotation,
        hookup: Hookup,
        rack: Rack,
        operator: Operator,
        desk: Desk,
        tape: Tape,
        clock: TapedClock,
    ) -> None:
        self._rotation = rotation
        self._hookup = hookup
        self._rack = rack
        self._operator = operator
        self._desk = desk
        self._tape = tape
        self._clock = clock
        self._channels = [tap.column for tap in hookup.readings]
        self._interval = max(model.interval for model in rack.models)
        self._stale = True
        self._held = ""
        self._damaged = 0
        self._told_damage = False

    def run(self, title: str) -> Turned:
        """Let the stage turn until the pairs are matched.

        Parameters
        ----------
        title : str

        Raises
        ------
        Stopped
            The operator quit.
        HardwareError
            A device failed several times in a row.
        JournalError
            The journal does not fit, or a replay ends before the rotation does.
        """
        self._desk.tell(lambda: self._operator.begin(title, 0))
        turned = None
        while turned is None:
            collected = Collected(self._hookup.pairs, self._channels)
            ended = self._turn(collected)
            try:
                turned = self._matched(collected, ended)
            except EstimateError as refusal:
                self._refuse(str(refusal))
        return turned

    def _turn(self, collected: Collected) -> str:
        """Collect until there is enough; why it is."""
        since_ns = self._begin()
        made = 0
        while True:
            why = self._block(collected)
            stopped = self._stops(collected)
            if stopped:
                return STOPPED
            if int(collected.turns) > made:
                made = int(collected.turns)
                ended = self._tell_turn(collected, made)
                if ended:
                    return ended
            elif not collected.turns and collected.standing and self._waited(since_ns):
                self._refuse(
                    why
                    or f"the stage does not turn: its angle {self._hookup.phase.column} has stood for "
                    f"{self._rotation.patience:g} s; start it, and see that the encoder counts"
                )
                since_ns = self._begin()

    def _begin(self) -> int:
        """Ask to let the stage turn; when that was, in nanoseconds since the session began."""
        rotation, pairs = self._rotation, self._hookup.pairs
        self._desk.ask(QUESTION, lambda: self._operator.turning(rotation.prompt, pairs, rotation.turns))
        self._stale = True
        return self._tape.now_ns()

    def _waited(self, since_ns: int) -> bool:
        return self._tape.now_ns() - since_ns > self._rotation.patience * 1e9

    def _block(self, collected: Collected) -> str:
        """Collect for a while, and tell what is held; why no sample came, if none did."""
        block, why = self._sampled()
        for told in collected.take(block):
            self._say(told)
        if why:
            lost = collected.interrupt()
            self._say(f"{why}; {f'{lost} samples of fewer turns than {FEWEST_TURNS:g} are left out' if lost else KEPT}")
        elif block.times:
            self._say(collected.holds)
            self._say_damage(collected)
        return why

    def _sampled(self) -> tuple[Block, str]:
        """Samples of a fraction of a second, and why they ended early."""
        block, begun_ns = Block(), self._tape.now_ns()
        while len(block.times) < LARGEST_BLOCK and self._tape.now_ns() - begun_ns < BLOCK_NS:
            try:
                if self._stale:
                    self._rack.discard()
                    self._stale = False
                sample = self._rack.read()
            except Resumed:
                # What a line held of before the pause does not belong to what comes after it.
                self._stale = True
                return block, "the session was interrupted here"
            except BayError as error:
                self._stale = True
                if not self._rack.failed(error, needed=True):
                    if not self._tape.gone_on_from:
                        raise
                    # It ended the session once; whoever resumes it has put it right.
                    self._rack.succeeded()
                self._clock.sleep(RECOVERY)
                return block, str(error)
            self._rack.succeeded()
            self._enter(block, sample)
            self._clock.sleep(self._interval)
        return block, ""

    def _enter(self, block: Block, sample: Sample) -> None:
        block.times.append(self._tape.now_ns())
        block.theta.append(self._hookup.phase.value(sample))
        block.readings.append([tap.value(sample) for tap in self._hookup.readings])

    def _stops(self, collected: Collected) -> bool:
        """Whether the operator said stop, and there is enough to stop with."""
        if self._desk.heed("turning", self._operator.attend) is None:
            return False
        if collected.turns >= FEWEST_TURNS:
            return True
        self._refuse(f"the stage has made {collected.turns:.2f} whole turns; {TOO_FEW}")
        return False

    def _tell_turn(self, collected: Collected, made: int) -> str:
        """Tell that another turn is made; why it is the last one, if it is."""
        self._tape.secure()
        turn = Turn(made, self._rotation.turns, collected.online(), collected.left_out + self._damaged)
        self._told_damage = False
        self._desk.tell(lambda: self._operator.turned(turn))
        enough = self._rotation.converged
        if enough is not None and made >= SOONEST and collected.known_to(enough):
            return CONVERGED
        return ALL_TURNS if made >= self._rotation.turns else ""

    def _matched(self, collected: Collected, ended: str) -> Turned:
        """The pairs, matched by all that was collected; those that cannot be are left out with the reason.

        Raises
        ------
        EstimateError
            Not one can be matched.
        """
        whole = collected.whole()
        demodulation = whole.demodulator.result()
        matchings, unmatched = [], []
        for pair in self._hookup.pairs:
            try:
                matchings.append(match(demodulation, pair))
            except EstimateError as refusal:
                unmatched.append(f"{pair.first} and {pair.second}: {refusal}")
        if not matchings:
            raise EstimateError("; ".join(unmatched))
        for why in unmatched:
            self._say(why)
        self._desk.tell(lambda: self._operator.matched(whole.turns, matchings))
        return Turned(
            tuple(matchings),
            whole.turns,
            whole.seconds,
            whole.samples,
            collected.left_out + self._damaged,
            ended,
            tuple(unmatched),
        )

    def _refuse(self, why: str) -> None:
        self._desk.tell(lambda: self._operator.turning_refused(why))

    def _say(self, why: str) -> None:
        """Tell, once, why samples are held, or that they go on."""
        if why == self._held:
            return
        self._held = why
        self._desk.tell((lambda: self._operator.held(why)) if why else self._operator.goes_on)

    def _say_damage(self, collected: Collected) -> None:
        """Tell, once a turn, that something was lost on the way."""
        damaged = sum(_unused(bay.sensor.reception()) for bay in self._rack.bays if isinstance(bay.sensor, Talking))
        if damaged > self._damaged and not self._told_damage and not self._held:
            self._told_damage = True
            self._say(f"{damaged - self._damaged} damaged or lost on the line, and left out")
            self._say("")
        self._damaged = damaged


def _unused(reception: Mapping[str, int]) -> int:
    """All but the first, which is what was used."""
    return sum(list(reception.values())[1:])


def _within(found: Coefficients, uncertainty: float) -> bool:
    return max(found.u_p, found.u_q) <= uncertainty

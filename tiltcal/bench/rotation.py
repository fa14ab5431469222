"""A turning stage: its accelerometers are sampled until their pairs are matched.

The operator is asked once. Then every sample is taken in blocks of a fraction of a second. What cannot be used is
reported once with the reason, and once more when samples count again; after each turn the operator gets p and q of all
samples so far. The rotation ends when both are known as the procedure asks, when its turns are made, or when the
operator stops. The result is that of ``match`` on all samples of the journal; a break of the session or of a line is a
gap in them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from tiltcal.bench.devices import RECOVERY
from tiltcal.bench.messages import Held, Matched, Poll, Resumed, RotationQuestion, StagePair, TurnMade
from tiltcal.bench.session import Session
from tiltcal.core.model import Array
from tiltcal.core.pair.matching import (
    TOO_FEW,
    MatchedRotation,
    PairCoefficients,
    rotation_of,
    solve,
    split_at_breaks,
)
from tiltcal.core.pair.model import FEWEST_TURNS
from tiltcal.core.pair.online import TurnStream
from tiltcal.core.pair.stage import STANDSTILL
from tiltcal.drivers.bus.clock import SECOND
from tiltcal.errors import EstimateError, SensorError
from tiltcal.files.procedure import Rotation
from tiltcal.journal.calibrations import unused
from tiltcal.journal.lines import POSITION

BLOCK_NS = 200_000_000  # time over which samples are collected before they are judged and the operator is polled
LARGEST_BLOCK = 16  # samples: fewer than a turn has, so that every turn is reported
SOONEST = 5  # turns before p and q are called known: fewer do not show how the turns scatter
SHOWN_TURN = 2.25  # turns after which a whole one must have been among them
EACH_OF = 100  # p and q are computed anew each turn up to here, then each time the turns grow by 1 %

CONVERGED, ALL_TURNS, STOPPED = "p and q are known as asked", "all turns are made", "the operator stopped"


class TurningStage:
    """The rotation of a session; its samples are rows of seconds, angle in degrees and readings."""

    def __init__(self, session: Session, rotation: Rotation) -> None:
        self._session = session
        self._rotation = rotation
        self._channels = session.setup.stage_channels()
        self._blocks: list[Array] = []
        self._stream = TurnStream(len(self._channels.columns))
        self._turns_before = self._left_out_before = 0
        """Turns, and samples that do not count, of the spans before the last break."""
        self._taken = self._damaged = self._due = 0
        self._stale = True
        self._reported = ""
        self._is_turning = session.recorded.turning
        self._pairs: dict[str, PairCoefficients] = {}
        self._unknown: dict[str, str] = {}
        kept = ""
        for part in split_at_breaks(session.recorded.rotation_rows()):
            self._taken += len(part)
            for first in range(0, len(part), LARGEST_BLOCK):
                self._take(part[first : first + LARGEST_BLOCK])
            kept = self._interrupt()
        if kept:
            self._report(f"the session was interrupted here; {kept}")

    @property
    def _turns(self) -> int:
        """The whole turns so far."""
        return self._turns_before + self._stream.turns

    def _idle(self) -> str:
        """Return why waiting is of no use; nothing where samples count."""
        turned = self._stream.turned
        if self._stream.turns or STANDSTILL <= turned < SHOWN_TURN:
            return ""
        if turned >= SHOWN_TURN:
            return f"the stage turns, but no sample can be used: {self._stream.why}"
        if turned <= -STANDSTILL:
            return "the stage turns backwards: its angle is to count up; swap the tracks of the encoder"
        return "the stage does not turn: start it, and check that the encoder counts"

    def _take(self, block: Array) -> list[str]:
        """Take a block of rows; return why samples are held from here on, in order, empty where they go on."""
        self._blocks.append(block)
        return [notice.why for notice in self._stream.push(block[:, 1], block[:, 2:].T)]

    def _interrupt(self) -> str:
        """Note a break, and keep the span before it where its turns show its phase; return what becomes of it."""
        stream, kept = self._stream, self._stream.turns >= FEWEST_TURNS
        self._turns_before += stream.turns if kept else 0
        self._left_out_before += stream.left_out if kept else stream.rows
        self._blocks.append(np.full((1, 2 + len(self._channels.columns)), np.nan))
        self._stream = TurnStream(len(self._channels.columns))
        if kept or not stream.rows:
            return "the samples before count"
        return f"{stream.rows} samples of fewer turns than {FEWEST_TURNS:g} are left out"

    def _matched(self) -> MatchedRotation:
        """Return what all samples give; EstimateError where the stage has not turned enough."""
        if not self._blocks:
            raise EstimateError(f"the stage has made 0 whole turns; {TOO_FEW}")
        return rotation_of(self._channels.columns, np.concatenate(self._blocks))

    def turn(self) -> None:
        """Let the stage turn until a pair is matched, and note it in the journal."""
        session, first = self._session, self._session.recorder.line + 1
        while True:
            ended = self._collect()
            try:
                rotation = self._matched()
                matchings, unmatched = rotation.matched(self._channels.pairs)
                break
            except EstimateError as refusal:
                session.talk.refuse("rotation", str(refusal))
        for why in (*rotation.stuck, *unmatched):
            self._report(why)
        session.recorder.record(
            POSITION, {"position": "rotation", "lines": [first, session.recorder.line], "ended": ended}
        )
        session.recorder.secure()
        suppression = {matching.pair.name: matching.suppression for matching in matchings}
        pairs = _coefficients({matching.pair.name: matching for matching in matchings})
        session.talk.tell(Matched(position="rotation", turns=rotation.turns, **pairs, suppression=suppression))

    def _collect(self) -> str:
        """Collect samples until they suffice, and return why they do."""
        session, patience = self._session, self._rotation.patience
        since_ns, made = self._begin(), self._turns
        while True:
            why = self._take_block()
            if session.talk.poll(Poll(), f"turning {self._taken}") is not None:
                if self._turns >= FEWEST_TURNS:
                    return STOPPED
                session.talk.refuse("rotation", f"the stage has made {self._turns} whole turns; {TOO_FEW}")
            if self._turns > made:
                made = self._turns
                known = self._report_turn(made)
                if known or made >= self._rotation.turns:
                    return CONVERGED if known else ALL_TURNS
            elif why:
                since_ns = session.recorder.now_ns()
            elif (
                not self._turns and (idle := self._idle()) and session.recorder.now_ns() - since_ns > patience * SECOND
            ):
                session.talk.refuse("rotation", f"{idle} (waited for {patience:g} s)")
                since_ns = self._begin()

    def _begin(self) -> int:
        """Ask the operator to let the stage turn, unless it does; return the time of it, ns since the session began."""
        if not self._is_turning:
            chosen, rotation = self._channels.pairs, self._rotation
            pairs = [StagePair((pair.first, pair.second), pair.orthogonal) for pair in chosen]
            self._session.talk.ask(RotationQuestion(pairs, rotation.turns, rotation.prompt))
            self._stale = True
        self._is_turning = False
        return self._session.recorder.now_ns()

    def _take_block(self) -> str:
        """Collect a block, and report what of it is held; return why it ended early, empty where it did not."""
        block, why = self._sampled()
        for remark in self._take(np.array(block)) if block else ():
            self._report(remark)
        if why:
            self._report(f"{why}; {self._interrupt()}")
        elif block:
            self._report(self._stream.why if self._stream.turns else "")
        return why

    def _sampled(self) -> tuple[list[tuple[float, ...]], str]:
        """Return the samples of a fraction of a second, and why they ended early, empty where they did not."""
        session, sensors = self._session, self._session.sensors
        block: list[tuple[float, ...]] = []
        begun_ns = session.recorder.now_ns()
        while len(block) < LARGEST_BLOCK and session.recorder.now_ns() - begun_ns < BLOCK_NS:
            try:
                readings = sensors.read(fresh=self._stale)
                self._stale = False
            except SensorError as error:
                self._stale = True
                sensors.failed(error, needed=True)
                session.clock.sleep(RECOVERY)
                return block, str(error)
            sensors.succeeded()
            self._taken += 1
            block.append(self._channels.row(session.recorder.now_ns(), readings))
            session.clock.sleep(sensors.interval)
        return block, ""

    def _report_turn(self, made: int) -> bool:
        """Report a completed turn; return whether p and q of every pair are known as the procedure asks."""
        self._session.recorder.secure()
        damaged = sum(map(unused, self._session.sensors.link_statistics().values()))
        if damaged > self._damaged and not self._reported:
            self._report(f"{damaged - self._damaged} damaged or lost on the line, and left out")
            self._report("")
        self._damaged = damaged
        known = made >= self._due and self._match(made)
        self._due = max(self._due, made + made // EACH_OF)
        left_out = self._left_out_before + self._stream.left_out + self._damaged
        coefficients = _coefficients(self._pairs)
        turn = TurnMade(turn=made, of=self._rotation.turns, **coefficients, unknown=self._unknown, left_out=left_out)
        self._session.talk.tell(turn)
        return known

    def _match(self, made: int) -> bool:
        """Take p and q of all samples so far; return whether the scatter of turns and the noise show them as asked."""
        self._pairs, self._unknown = {}, {}
        try:
            whole = self._matched().demodulation
        except EstimateError:
            return False
        # A few turns scatter less than their noise allows by chance, so the noise has to agree as well.
        white = replace(whole, scores=whole.scores[:0], weights=whole.weights[:0])
        largest = 0.0
        for pair in self._channels.pairs:
            try:
                by_turns, by_noise = solve(whole, pair), solve(white, pair)
                self._pairs[pair.name] = by_turns
                largest = max(largest, by_turns.u_p, by_turns.u_q, by_noise.u_p, by_noise.u_q)
            except EstimateError as refusal:
                self._unknown[pair.name] = str(refusal)
        enough = self._rotation.converged
        return enough is not None and made >= SOONEST and not self._unknown and largest <= enough

    def _report(self, why: str) -> None:
        """Report, once, why samples are held; an empty reason reports that they count again."""
        if why == self._reported:
            return
        self._reported = why
        if why:
            self._session.talk.tell(Held(why))
        else:
            self._session.talk.tell(Resumed())


def _coefficients(pairs: Mapping[str, PairCoefficients]) -> dict[str, dict[str, float]]:
    """Return p, q and their uncertainties, each by the name of the pair."""
    return {key: {name: getattr(pair, key) for name, pair in pairs.items()} for key in ("p", "q", "u_p", "u_q")}

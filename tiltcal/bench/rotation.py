"""A turning stage: its accelerometers are sampled until their pairs are matched.

The operator is asked once. Then every sample is taken in blocks of a fraction of a second. What cannot be used is
reported once with the reason, and once more when samples count again; after each turn the operator gets p and q of the
recursive estimators. The rotation ends when both are known as the procedure asks, when its turns are made, or when the
operator stops. The result is that of ``match`` on all samples of the journal; a break of the session or of a line is a
gap in them.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tiltcal.bench.journal import RecordedSession
from tiltcal.bench.sensors import RECOVERY
from tiltcal.bench.session import Session
from tiltcal.bench.stage import (
    ALL_TURNS,
    CONVERGED,
    STOPPED,
    TOO_FEW,
    ChannelMap,
    StageSamples,
    split_at_breaks,
    unused,
)
from tiltcal.core.pair.matching import Matching, PairCoefficients
from tiltcal.core.pair.model import FEWEST_TURNS
from tiltcal.errors import EstimateError, SensorError
from tiltcal.files.journal import POSITION
from tiltcal.files.procedure import Rotation

BLOCK_NS = 200_000_000
"""Time over which samples are collected before they are judged and the operator is polled, ns."""
LARGEST_BLOCK = 16
"""Samples: fewer than a turn has, so that every turn is reported."""
SOONEST = 5
"""Turns before p and q are called known: fewer do not show how the turns scatter."""


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
        damaged = sum(map(unused, self._session.sensors.link_statistics().values()))
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

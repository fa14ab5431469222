"""The runner of a rotation: samples the accelerometers of a turning stage until their pairs are matched.

The operator is asked once. Then every sample comes from the tape, in blocks of a fraction of a second. What cannot be
used is told once with the reason, and so is that it goes on; after each turn the operator is told p and q. It ends when
they are known as the procedure asks, when its turns are made, or when the operator says stop.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from tiltcal.bench.channel_map import ChannelMap
from tiltcal.bench.event_log import EventLog, RecordedClock, Resumed
from tiltcal.bench.operators.operator import Operator
from tiltcal.bench.operators.sim_stage import QUESTION, StageTurn
from tiltcal.bench.position_runner import RECOVERY
from tiltcal.bench.recorded_operator import RecordedOperator
from tiltcal.bench.rotation_samples import TOO_FEW, RotationSamples, SampleBlock
from tiltcal.bench.sensor_set import Sample, SensorSet
from tiltcal.core.pair.encoder import FEWEST_TURNS
from tiltcal.core.pair.matching import Matching, match
from tiltcal.drivers.device import StreamingSensor
from tiltcal.errors import EstimateError, SensorError
from tiltcal.files.rotation import Rotation

BLOCK_NS = 200_000_000
"""How long samples are collected before they are looked at, and before the operator is heeded."""
LARGEST_BLOCK = 16
"""Samples: fewer than a turn has, so that no turn goes by untold."""
SOONEST = 5
"""Turns before p and q are called known: from fewer nobody sees how the turns scatter."""

KEPT = "what was collected before counts"
CONVERGED, ALL_TURNS, STOPPED = "p and q are known as asked", "all turns are made", "the operator stopped"


@dataclass(frozen=True)
class RotationResult:
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


class RotationRunner:
    """One session at a turning stage.

    Parameters
    ----------
    rotation : Rotation
    hookup : ChannelMap
    rack : SensorSet
    operator : Operator
    desk : RecordedOperator
    tape : EventLog
    clock : RecordedClock
    """

    def __init__(
        self,
        rotation: Rotation,
        hookup: ChannelMap,
        rack: SensorSet,
        operator: Operator,
        desk: RecordedOperator,
        tape: EventLog,
        clock: RecordedClock,
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
        self._samples = 0
        self._stale = True
        self._held = ""
        self._damaged = 0
        self._told_damage = False

    def run(self, title: str) -> RotationResult:
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
            collected = RotationSamples(self._hookup.pairs, self._channels)
            ended = self._turn(collected)
            try:
                turned = self._matched(collected, ended)
            except EstimateError as refusal:
                self._refuse(str(refusal))
        return turned

    def _turn(self, collected: RotationSamples) -> str:
        """Collect until there is enough; why it is."""
        since_ns = self._begin()
        made = 0
        while True:
            why = self._block(collected)
            if self._stops(collected):
                return STOPPED
            if int(collected.turns) > made:
                made = int(collected.turns)
                ended = self._tell_turn(collected, made)
                if ended:
                    return ended
            elif why:
                since_ns = self._tape.now_ns()
            elif not collected.turns and collected.idle and self._waited(since_ns):
                self._refuse(f"{collected.idle} (waited for {self._rotation.patience:g} s)")
                since_ns = self._begin()

    def _begin(self) -> int:
        """Ask to let the stage turn; when that was, in nanoseconds since the session began."""
        rotation, pairs = self._rotation, self._hookup.pairs
        self._desk.ask(QUESTION, lambda: self._operator.turning(rotation.prompt, pairs, rotation.turns))
        self._stale = True
        return self._tape.now_ns()

    def _waited(self, since_ns: int) -> bool:
        return self._tape.now_ns() - since_ns > self._rotation.patience * 1e9

    def _block(self, collected: RotationSamples) -> str:
        """Collect for a while, and tell what is held; why no sample came, if none did."""
        block, why = self._sampled()
        for told in collected.take(block):
            self._say(told)
        if why:
            lost = collected.interrupt()
            self._say(f"{why}; {f'{lost} samples of fewer turns than {FEWEST_TURNS:g} are left out' if lost else KEPT}")
        elif block.times:
            self._say(collected.holds)
            self._say_damage()
        return why

    def _sampled(self) -> tuple[SampleBlock, str]:
        """Samples of a fraction of a second, and why they ended early."""
        block, begun_ns = SampleBlock(), self._tape.now_ns()
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
            except SensorError as error:
                self._stale = True
                if not self._rack.failed(error, needed=True):
                    if not self._tape.resumed_before_here:
                        raise
                    # It ended the session once; whoever resumes it has put it right.
                    self._rack.succeeded()
                self._clock.sleep(RECOVERY)
                return block, str(error)
            self._rack.succeeded()
            self._enter(block, sample)
            self._clock.sleep(self._interval)
        return block, ""

    def _enter(self, block: SampleBlock, sample: Sample) -> None:
        self._samples += 1
        block.times.append(self._tape.now_ns())
        block.theta.append(self._hookup.phase.value(sample))
        block.readings.append([tap.value(sample) for tap in self._hookup.readings])

    def _stops(self, collected: RotationSamples) -> bool:
        """Whether the operator said stop, and there is enough to stop with."""
        # One message of a fast line may hold samples for several blocks: the place of a word is a number of samples.
        if self._desk.poll(f"turning {self._samples}", self._operator.poll) is None:
            return False
        if collected.turns >= FEWEST_TURNS:
            return True
        self._refuse(f"the stage has made {collected.turns:.2f} whole turns; {TOO_FEW}")
        return False

    def _tell_turn(self, collected: RotationSamples, made: int) -> str:
        """Tell that another turn is made; why it is the last one, if it is."""
        self._tape.secure()
        left_out = collected.left_out + self._damaged
        turn = StageTurn(made, self._rotation.turns, collected.online(), dict(collected.unknown), left_out)
        self._told_damage = False
        self._desk.tell(lambda: self._operator.turned(turn))
        enough = self._rotation.converged
        if enough is not None and made >= SOONEST and collected.known_to(enough):
            return CONVERGED
        return ALL_TURNS if made >= self._rotation.turns else ""

    def _matched(self, collected: RotationSamples, ended: str) -> RotationResult:
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
        return RotationResult(
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
        self._desk.tell((lambda: self._operator.held(why)) if why else self._operator.resumed)

    def _say_damage(self) -> None:
        """Tell, once a turn, that something was lost on the way."""
        damaged = sum(
            _unused(bay.sensor.link_statistics()) for bay in self._rack.bays if isinstance(bay.sensor, StreamingSensor)
        )
        if damaged > self._damaged and not self._told_damage and not self._held:
            self._told_damage = True
            self._say(f"{damaged - self._damaged} damaged or lost on the line, and left out")
            self._say("")
        self._damaged = damaged


def _unused(link_statistics: Mapping[str, int]) -> int:
    """All but the first, which is what was used."""
    return sum(list(link_statistics.values())[1:])

"""The runner of a rotation: samples the accelerometers of a turning stage until their pairs are matched.

The operator is asked once. Then every sample comes from the event log, in blocks of a fraction of a second. What cannot
be used is reported once with the reason, and once more when samples count again; after each turn the operator gets p
and q. The rotation ends when both are known as the procedure asks, when its turns are made, or when the operator stops.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from tiltcal.bench.channel_map import ChannelMap
from tiltcal.bench.event_log import EventLog, RecordedClock, SessionState
from tiltcal.bench.operators.operator import RotationOperator, StageTurn
from tiltcal.bench.rotation_samples import TOO_FEW, RotationSamples, SampleRow
from tiltcal.bench.sensor_set import RECOVERY, SensorSet
from tiltcal.bench.session_calibration import SessionEnd, session_provenance
from tiltcal.bench.session_plan import SessionPlan
from tiltcal.core.pair.matching import Matching, match
from tiltcal.core.pair.model import FEWEST_TURNS
from tiltcal.drivers.bus.link import Interruption
from tiltcal.drivers.model import StreamingSensor
from tiltcal.errors import EstimateError, SensorError
from tiltcal.files.pair import PairRecord, SpinRecord
from tiltcal.files.results import BenchRecord, BenchSensorRecord, PairProvenance, SamplesRecord
from tiltcal.files.rotation import Rotation

BLOCK_NS = 200_000_000
"""Time over which samples are collected before they are judged and the operator is polled, ns."""
LARGEST_BLOCK = 16
"""Samples: fewer than a turn has, so that every turn is reported."""
SOONEST = 5
"""Turns before p and q are called known: fewer do not show how the turns scatter."""

KEPT = "the samples before count"
CONVERGED, ALL_TURNS, STOPPED = "p and q are known as asked", "all turns are made", "the operator stopped"


@dataclass(frozen=True)
class RotationResult:
    """The result of a rotation.

    Attributes
    ----------
    turns, seconds, samples : float, float, int
        Those that were used.
    left_out : int
        Samples that were held, or damaged on the way.
    ended : str
        The reason of the end.
    unmatched : tuple of str
        The pairs that could not be matched, with the reasons.
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
        """The frequency of the spin, Hz; None where no time passed."""
        return self.turns / self.seconds if self.seconds > 0.0 else None


class RotationRunner:
    """One session at a turning stage."""

    def __init__(
        self,
        rotation: Rotation,
        channels: ChannelMap,
        sensors: SensorSet,
        operator: RotationOperator,
        log: EventLog,
        clock: RecordedClock,
    ) -> None:
        self._rotation = rotation
        self._channels = channels
        self._refs = (channels.phase, *channels.readings)
        self._sensors = sensors
        self._operator = operator
        self._log = log
        self._clock = clock
        self._interval = max(model.interval for model in sensors.models)
        self._samples = 0
        self._stale = True
        self._reported = ""
        self._damaged = 0
        self._damage_reported = False

    def run(self, title: str) -> RotationResult:
        """Let the stage turn until the pairs are matched.

        Raises
        ------
        Stopped
            The operator quit.
        HardwareError
            A device failed several times in a row.
        JournalError
            The journal does not fit, or a replay ends before the rotation does.
        """
        self._operator.begin(title)
        turned = None
        while turned is None:
            collected = RotationSamples(self._channels.pairs, [ref.column for ref in self._channels.readings])
            ended = self._collect(collected)
            try:
                turned = self._matched(collected, ended)
            except EstimateError as refusal:
                self._refuse(str(refusal))
        return turned

    def _collect(self, collected: RotationSamples) -> str:
        """Collect samples until they suffice, and return why they do."""
        since_ns = self._begin()
        made = 0
        while True:
            why = self._take_block(collected)
            if self._stops(collected):
                return STOPPED
            if collected.turns > made:
                made = collected.turns
                ended = self._report_turn(collected, made)
                if ended:
                    return ended
            elif why:
                since_ns = self._log.now_ns()
            elif not collected.turns and collected.idle and self._waited(since_ns):
                self._refuse(f"{collected.idle} (waited for {self._rotation.patience:g} s)")
                since_ns = self._begin()

    def _begin(self) -> int:
        """Ask the operator to let the stage turn, and return the time of the answer, ns since the session began."""
        rotation, pairs = self._rotation, self._channels.pairs
        self._log.ask("rotation", self._operator.turning, rotation.prompt, pairs, rotation.turns)
        self._stale = True
        return self._log.now_ns()

    def _waited(self, since_ns: int) -> bool:
        return self._log.now_ns() - since_ns > self._rotation.patience * 1e9

    def _take_block(self, collected: RotationSamples) -> str:
        """Collect a block, and report what of it is held; return why it ended early, empty where it did not."""
        block, why = self._sampled()
        for remark in collected.take(block):
            self._report_hold(remark)
        if why:
            lost = collected.interrupt()
            kept = f"{lost} samples of fewer turns than {FEWEST_TURNS:g} are left out" if lost else KEPT
            self._report_hold(f"{why}; {kept}")
        elif block:
            self._report_hold(collected.holds)
            self._report_damage()
        return why

    def _sampled(self) -> tuple[list[SampleRow], str]:
        """Return the samples of a fraction of a second, and why they ended early, empty where they did not."""
        block: list[SampleRow] = []
        begun_ns = self._log.now_ns()
        while len(block) < LARGEST_BLOCK and self._log.now_ns() - begun_ns < BLOCK_NS:
            try:
                if self._stale:
                    self._sensors.discard()
                    self._stale = False
                sample = self._sensors.read()
            except Interruption as pause:
                # What a line held of before the pause does not belong to what comes after it.
                self._stale = True
                return block, str(pause)
            except SensorError as error:
                self._stale = True
                self._sensors.failed(error, live=self._log.state is SessionState.LIVE, needed=True)
                self._clock.sleep(RECOVERY)
                return block, str(error)
            self._sensors.succeeded()
            self._samples += 1
            block.append([self._log.now_ns() / 1e9, *(ref.value(sample) for ref in self._refs)])
            self._clock.sleep(self._interval)
        return block, ""

    def _stops(self, collected: RotationSamples) -> bool:
        """Return whether the operator said stop, and enough turns are made."""
        # One message of a fast line may hold samples for several blocks: the place of a word is a number of samples.
        if self._log.poll(f"turning {self._samples}", self._operator.poll) is None:
            return False
        if collected.turns >= FEWEST_TURNS:
            return True
        self._refuse(f"the stage has made {collected.turns} whole turns; {TOO_FEW}")
        return False

    def _report_turn(self, collected: RotationSamples, made: int) -> str:
        """Report a completed turn; return why it is the last one, empty where it is not."""
        self._log.secure()
        left_out = collected.left_out + self._damaged
        turn = StageTurn(made, self._rotation.turns, collected.online(), dict(collected.unknown), left_out)
        self._damage_reported = False
        self._log.report(self._operator.turn_completed, turn)
        enough = self._rotation.converged
        if enough is not None and made >= SOONEST and collected.known_to(enough):
            return CONVERGED
        return ALL_TURNS if made >= self._rotation.turns else ""

    def _matched(self, collected: RotationSamples, ended: str) -> RotationResult:
        """Return the pairs, matched by all that was collected; those that cannot be are left out with the reason.

        Raises
        ------
        EstimateError
            Not one can be matched.
        """
        whole = collected.whole()
        matchings, unmatched = [], []
        for pair in self._channels.pairs:
            try:
                matchings.append(match(whole.demodulation, pair))
            except EstimateError as refusal:
                unmatched.append(f"{pair.first} and {pair.second}: {refusal}")
        if not matchings:
            raise EstimateError("; ".join(unmatched))
        for why in (*whole.stuck, *unmatched):
            self._report_hold(why)
        self._log.report(self._operator.matched, whole.turns, matchings)
        return RotationResult(
            tuple(matchings),
            whole.turns,
            whole.seconds,
            whole.samples,
            whole.left_out + self._damaged,
            ended,
            tuple(unmatched),
        )

    def _refuse(self, why: str) -> None:
        self._log.report(self._operator.refused, why)

    def _report_hold(self, why: str) -> None:
        """Report, once, why samples are held; an empty reason reports that they count again."""
        if why == self._reported:
            return
        self._reported = why
        if why:
            self._log.report(self._operator.paused, why)
        else:
            self._log.report(self._operator.resumed)

    def _report_damage(self) -> None:
        """Report, at most once a turn, that samples were damaged or lost on the line."""
        damaged = sum(
            _unused(sensor.sensor.link_statistics())
            for sensor in self._sensors.sensors
            if isinstance(sensor.sensor, StreamingSensor)
        )
        if damaged > self._damaged and not self._damage_reported and not self._reported:
            self._damage_reported = True
            self._report_hold(f"{damaged - self._damaged} damaged or lost on the line, and left out")
            self._report_hold("")
        self._damaged = damaged


def _unused(link_statistics: Mapping[str, int]) -> int:
    """Return the count of data that were not used: all counts but the first."""
    return sum(list(link_statistics.values())[1:])


def pair_calibration(plan: SessionPlan, channels: ChannelMap, result: RotationResult, ending: SessionEnd) -> PairRecord:
    """Return what a rotation found, with its provenance."""
    sensors = tuple(
        BenchSensorRecord(serial=sensor.serial, model=sensor.model_name, address=sensor.address)
        for sensor in plan.sensors
    )
    provenance = PairProvenance(
        **session_provenance(plan, ending),
        bench=BenchRecord(sensors=sensors),
        link_statistics={serial: dict(statistics) for serial, statistics in ending.link_statistics_by_serial.items()},
        procedure=plan.procedure.name,
        samples=SamplesRecord(used=result.samples, left_out=result.left_out),
        stopped=result.ended,
        not_matched=(*channels.left_out, *result.unmatched),
    )
    spin = SpinRecord(turns=result.turns, frequency=result.frequency, phase=channels.phase.column)
    return PairRecord(spin=spin, matchings=result.matchings, provenance=provenance)

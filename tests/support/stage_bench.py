"""A turning stage for tests: the lines that it prints, played to the runner on a clock that nobody waits for."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from support import accelerometer_disk as disk
from tiltcal.bench.channel_map import map_channels
from tiltcal.bench.event_log import EventLog, RecordedClock, RecordedLink
from tiltcal.bench.operators.operator import OperatorAnswer, StageTurn
from tiltcal.bench.operators.sim import SimRotationOperator
from tiltcal.bench.rotation_runner import RotationResult, RotationRunner
from tiltcal.bench.sensor_set import ConnectedSensor, SensorSet
from tiltcal.core.pair.matching import Matching
from tiltcal.core.pair.model import Pair
from tiltcal.drivers import find_model
from tiltcal.drivers.bus.address import parse_address
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.errors import BusError, Stopped
from tiltcal.files.journal import Journal, JournalWriter, read_journal
from tiltcal.files.rotation import PairSelection, Rotation

A1_A2 = Pair("a1", "a2", "a4")
A3_A4 = Pair("a3", "a4", "a1")

Line = bytes | BusError


def line(theta: float, readings: Sequence[float]) -> bytes:
    return ",".join(f"{value:.9g}" for value in (theta, *readings)).encode() + b"\r\n"


def lines(taken: disk.Record) -> list[Line]:
    """A record as the device prints it: the stage angle and four readings."""
    return [line(theta, row) for theta, row in zip(taken.theta, taken.readings.tolist(), strict=True)]


class Device:
    """A link on which lines come, one each ``interval`` seconds; where they end, the last one is repeated."""

    letter = "r"

    def __init__(self, printed: Iterable[Line], clock: VirtualClock, interval: float) -> None:
        self._printed: Iterator[Line] = iter(printed)
        self._clock = clock
        self._interval = interval
        self._last: bytes = b""

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        if not count:
            return b""
        self._clock.sleep(self._interval)
        said = next(self._printed, self._last)
        if isinstance(said, BusError):
            raise said
        self._last = said
        return said

    def close(self) -> None:
        pass


class Attendant(SimRotationOperator):
    """Says ready, and stop where it is told to; keeps what it hears."""

    def __init__(self, *, stop_after: Sequence[int] = (), readies: int = 1) -> None:
        super().__init__()
        self.turns: list[StageTurn] = []
        self.told: list[str] = []
        self.matchings: Sequence[Matching] = ()
        self._stop_after = list(stop_after)
        self._readies = readies
        self._looks = 0

    def turning(self, prompt: str, pairs: Sequence[Pair], turns: int) -> OperatorAnswer:
        if not self._readies:
            raise Stopped("enough")
        self._readies -= 1
        return OperatorAnswer("ready")

    def poll(self) -> OperatorAnswer | None:
        self._looks += 1
        if self._stop_after and self._looks >= self._stop_after[0]:
            self._stop_after.pop(0)
            return OperatorAnswer("stop")
        return None

    def turn_completed(self, turn: StageTurn) -> None:
        self.turns.append(turn)

    def paused(self, why: str) -> None:
        self.told.append(why)

    def resumed(self) -> None:
        self.told.append("goes on")

    def refused(self, why: str) -> None:
        self.told.append(f"refused: {why}")

    def matched(self, turns: float, matchings: Sequence[Matching]) -> None:
        self.matchings = matchings


def turned(
    printed: Iterable[Line],
    attendant: Attendant,
    *,
    pairs: Sequence[Pair] = (A1_A2,),
    turns: int = 10,
    converged: float | None = None,
    interval: float = 0.02,
    journal: Path | None = None,
    replay: bool = False,
    resume: bool = False,
) -> RotationResult:
    """Let the runner take the lines; with a journal they are captured there, or played from it and gone on with."""
    selected = tuple(PairSelection((pair.first, pair.second), pair.orthogonal) for pair in pairs)
    rotation = Rotation("theta", selected, turns=turns, converged=converged)
    model = find_model("gradiometer").at(parse_address("serial:///dev/null?columns=theta,a1,a2,a3,a4"))
    clock = VirtualClock()
    before: Journal | None = read_journal(journal) if (replay or resume) and journal else None
    writer = JournalWriter.create(journal, {}) if journal and before is None else None
    if resume and before is not None:
        writer = JournalWriter.resume(before)
    log = EventLog(clock, before, writer)
    recorded = RecordedClock(log, clock)
    device = Device(printed, clock, interval)
    driver = model.driver(RecordedLink(log, lambda: device, "r", 0), recorded)
    sensors = SensorSet([ConnectedSensor(model, "G-1", driver)])
    channels = map_channels(rotation, [("G-1", model)])
    runner = RotationRunner(rotation, channels, sensors, attendant, log, recorded)
    try:
        found = runner.run("a rotation")
        log.finish()
        return found
    finally:
        if writer is not None:
            writer.close()


def regressed(taken: disk.Record, pair: tuple[int, int, int]) -> tuple[float, float]:
    """p and q of a record by a regression of its own, that the sum has no component left."""
    vectors = [np.array(disk.judged(taken, taken.readings[:, index])) for index in pair]
    rest, q = np.linalg.solve(np.stack([vectors[0], vectors[2]], axis=1), -vectors[1])
    return 1.0 - float(rest), float(q)

"""A turning stage for tests: the lines that it prints, played to the runner on a clock that nobody waits for."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tiltcal.bench import devices
from tiltcal.bench.measure import run_session
from tiltcal.bench.messages import (
    Held,
    Matched,
    Poll,
    Question,
    Refused,
    Resumed,
    SessionEvent,
    TurnMade,
    WriteQuestion,
)
from tiltcal.bench.operators import Operator
from tiltcal.bench.session import Session
from tiltcal.bench.setup import new_setup, single
from tiltcal.core.pair.model import Pair
from tiltcal.drivers.bus.clock import VirtualClock
from tiltcal.errors import BusError, Stopped
from tiltcal.files.document import document_of
from tiltcal.files.pair import PairRecord
from tiltcal.files.procedure import procedure_in
from tiltcal.journal.calibrations import calibrations_of
from tiltcal.journal.header import Setup
from tiltcal.journal.lines import Journal
from tiltcal.journal.session import RecordedSession

A1_A2 = Pair("a1", "a2", "a4")
A3_A4 = Pair("a3", "a4", "a1")

Line = bytes | BusError


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


class Attendant(Operator):
    """Says ready, and stop where it is told to; keeps what it hears."""

    def __init__(self, *, stop_after: Sequence[int] = (), readies: int = 1) -> None:
        self.turns: list[TurnMade] = []
        self.told: list[str] = []
        self.accepted: Matched | None = None
        self._stop_after = list(stop_after)
        self._readies = readies
        self._looks = 0

    def ask(self, question: Question) -> object:
        if isinstance(question, Poll):
            self._looks += 1
            if self._stop_after and self._looks >= self._stop_after[0]:
                self._stop_after.pop(0)
                return {"answer": "stop"}
            return None
        if isinstance(question, WriteQuestion):
            return {"answer": "yes"}
        if not self._readies:
            raise Stopped("enough")
        self._readies -= 1
        return {"answer": "ready"}

    def tell(self, event: SessionEvent) -> None:
        match event:
            case TurnMade():
                self.turns.append(event)
            case Held():
                self.told.append(event.why)
            case Resumed():
                self.told.append("goes on")
            case Refused():
                self.told.append(f"refused: {event.why}")
            case Matched():
                self.accepted = event


def turned(
    printed: Iterable[Line],
    attendant: Attendant,
    *,
    pairs: Sequence[Pair] = (A1_A2,),
    turns: int = 10,
    converged: float | None = None,
    interval: float = 0.02,
    journal: Path | None = None,
    resume: bool = False,
) -> PairRecord:
    """Let a session take the lines; its journal is captured in a file, gone on with on request, and replayed."""
    with TemporaryDirectory() as folder:
        path = journal or Path(folder) / "stage.journal.jsonl"
        before = RecordedSession(Journal(path)) if resume else None
        setup = _setup(pairs, turns, converged, path) if before is None else before.setup
        session = Session(setup, path, before)
        session.clock = clock = VirtualClock()
        opening, device = devices.open_device, Device(printed, clock, interval)
        devices.open_device = lambda *_: device
        try:
            result = run_session(session, attendant)
        finally:
            devices.open_device = opening
        assert calibrations_of(RecordedSession(Journal(path))) == result
    (record,) = result.values()
    assert isinstance(record, PairRecord)
    return record


def _setup(pairs: Sequence[Pair], turns: int, converged: float | None, journal: Path) -> Setup:
    rotation: dict[str, Any] = {
        "phase": "theta",
        "pairs": [{"pair": [pair.first, pair.second], "orthogonal": pair.orthogonal} for pair in pairs],
        "turns": turns,
    }
    if converged is not None:
        rotation["converged"] = converged
    stated = {"tiltcal": 1, "kind": "procedure", "name": "stage", "title": "a rotation", "rotation": rotation}
    bench = single("gradiometer", "G-1", "serial:///dev/null?columns=theta,a1,a2,a3,a4")
    return new_setup(procedure_in(document_of(stated)), bench, [journal.with_suffix(".yaml")], journal, operator="json")

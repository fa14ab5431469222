"""Whether machines that fail by chance get a wrong position accepted: 200 sessions of a virtual table and chamber.

    python benchmarks/machines.py [SESSIONS]

A fifth of them has a chamber. Each move has a fault in three of ten cases: lost steps, a stall, an end switch, a slip
while it is sampled, a silent line, an open door, an overshoot. Where a session stops, its machines are repaired and it
is resumed. Exit code 1 where a position counts that was not so, or a session does not come to its end.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from tiltcal.bench.setup import new_setup

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support.moving_machines import AMBIENT, CHAMBER, TABLE, VirtualChamber, VirtualTable, by_clock, movers_of

from tiltcal.bench.machines import Machines
from tiltcal.bench.measure import run_session
from tiltcal.bench.operators import VirtualJig
from tiltcal.bench.session import Session
from tiltcal.errors import BusError, Stopped
from tiltcal.files.bench import BenchFile, BenchSensor
from tiltcal.files.procedure import find_procedure
from tiltcal.journal.lines import Journal
from tiltcal.journal.session import RecordedSession

RATE = 0.3


class Faulty:
    """Faults by chance, at a ``rate``, some time after a move began; for the machines of the tests."""

    faults = ""

    def __init__(self, rng: np.random.Generator, rate: float) -> None:
        super().__init__(rng, lambda: 0.0)
        self.rate, self.fault, self.left, self.silent = rate, "", 0.0, 0

    def draw(self, seconds: float) -> None:
        """Draw the fault of a move, and the time until it happens."""
        self.fault = str(self.rng.choice(self.faults.split())) if self.rng.random() < self.rate else ""
        self.silent, self.left = 3 * (self.fault == "silent"), self.rng.uniform(0.0, seconds)

    def happens(self, seconds: float, *faults: str) -> bool:
        """Whether one of these faults is there when so many seconds have gone by."""
        return self.left - seconds < 0.0 and self.fault in faults

    def line(self, text: str) -> str:
        if self.silent:
            self.silent -= 1
            self.advance(self.elapsed())
            raise BusError("silent")
        return super().line(text)

    def repair(self) -> None:
        """Switch it off and on again; it has no further faults."""
        self.fault, self.silent, self.rate = "", 0, 0.0


class FaultyTable(Faulty, VirtualTable):
    """It may lose steps, stall, hit an end switch, slip some seconds later, or be silent."""

    faults = "lost stall switch slip silent"

    def home(self) -> None:
        super().home()
        self.short, self.fault = np.zeros(2), ""

    def repair(self) -> None:
        super().repair()
        self.switch_on()

    def go(self, target: np.ndarray) -> None:
        self.draw(3.0)
        if self.fault == "lost":  # for good: the next moves are short as well, until the table is homed
            self.short = self.short + self.rng.choice([-1, 1]) * self.rng.uniform(0.2, 3.0, 2)
        super().go(target - self.short)

    def advance(self, seconds: float) -> None:
        if self.happens(seconds, "switch"):
            self.state = "Alarm"
        if not self.happens(seconds, "stall", "switch"):
            super().advance(seconds)
        if self.happens(seconds, "slip"):
            self.motor = self.axis = self.target = self.motor - self.rng.uniform(0.2, 5.0, 2)
            self.fault = ""
        self.left -= seconds


class FaultyChamber(Faulty, VirtualChamber):
    """Its door may be opened some time later, it may overshoot, or be silent."""

    faults = "door overshoot silent"

    def repair(self) -> None:
        super().repair()
        self.temperature = self.target = AMBIENT

    def go(self, target: float) -> None:
        self.draw(2400.0)
        super().go(target)

    def advance(self, seconds: float) -> None:
        asked = self.target
        if self.happens(seconds, "door"):
            self.target = AMBIENT
        elif self.fault == "overshoot" and not self.happens(seconds, "overshoot"):
            self.target += 4.0 * np.sign(asked - AMBIENT)
        super().advance(seconds)
        self.target, self.left = asked, self.left - seconds


class FaultySession:
    """A session of one virtual sensor whose machines fail by chance, until it is complete.

    ``wrong`` has what was about to count and was not so, ``stops`` is how often it stopped and was resumed.
    """

    watches, most_attempts = False, 10

    def __init__(self, folder: Path, procedure: str, seed: int, rate: float) -> None:
        rng = np.random.default_rng(seed)
        self.wrong: list[str] = []
        self.refused: list[str] = []
        self.stops = 0
        self._table, self._chamber = FaultyTable(rng, rate), FaultyChamber(rng, rate)
        steps, serial = find_procedure(procedure), f"S-{seed}"
        sensors = (BenchSensor(serial, "sca100t-d02", f"sim:?seed={seed}"),)
        chamber = None if steps.positions[0].temperature is None else CHAMBER
        bench = BenchFile(sensors, jig=0.05, table=TABLE, chamber=chamber)
        self._journal, outputs = folder / f"{serial}.journal.jsonl", [folder / f"{serial}.yaml"]
        setup = new_setup(steps, bench, outputs, self._journal, operator="sim", samples=5, settle=0.1)
        self._session = Session(setup, self._journal)
        self._asked: dict = {}
        self._said: dict = {}

    def run(self) -> None:
        """Carry it out; where it stops, repair the machines and resume it from its journal."""
        while True:
            session, clock = self._session, self._session.clock
            machines = {}
            for name, machine in (("table", self._table), ("chamber", self._chamber)):
                machine.elapsed = by_clock(clock)
                if (stated := session.setup.machines.get(name)) is not None:
                    machines[name] = (stated, machine)
            movers = movers_of(machines, clock)
            self._machines = Machines(
                VirtualJig(lambda line: None), movers, session.setup.steps, clock, thermometer=True
            )
            try:
                self.result = run_session(session, self)
                return
            except Stopped:
                self.stops += 1
                self._table.repair()
                self._chamber.repair()
                before = RecordedSession(Journal(self._journal))
                self._session = Session(before.setup, self._journal, before)

    def ask(self, question: dict) -> object:
        """Pass on; before a position counts, compare what was answered with where the machines really are."""
        said = self._machines.ask(question)
        if question["ask"] == "position":
            self._asked, self._said = question, dict(said)  # type: ignore[call-overload]
        elif question["ask"] == "review" and question["position"] == self._asked["position"]:
            for machine in (self._table, self._chamber):
                machine.advance(machine.elapsed())
            x, y = np.radians(self._table.axis)
            real = np.degrees(np.arcsin([np.sin(x), np.cos(x) * np.sin(y)]))
            off = np.abs(real - [self._said["tilt"]["x"], self._said["tilt"]["y"]]).max()
            asked = self._asked["temperature"]
            warm = 0.0 if asked is None else abs(asked - self._chamber.temperature)
            if off > TABLE.tolerance or warm > CHAMBER.tolerance:
                self.wrong.append(f"{question['position']} is off by {off}° and {warm} °C")
        return said

    def tell(self, event: dict) -> None:
        if event["event"] == "refused":
            self.refused.append(event["why"])
        self._machines.tell(event)


def main(sessions: int) -> int:
    """Run the sessions and print what came of them."""
    wrong: list[str] = []
    refused = stops = 0
    for seed in range(sessions):
        with TemporaryDirectory() as folder:
            session = FaultySession(Path(folder), "mavs" if seed % 5 == 4 else "plane", seed, RATE)
            session.run()
        wrong += session.wrong
        refused, stops = refused + len(session.refused), stops + session.stops
    print(f"{sessions} sessions: {refused} positions refused, {stops} stops resumed, {len(wrong)} wrong accepted")
    print(*wrong, sep="\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else 200))

"""Whether machines that fail by chance get a wrong position accepted: 200 sessions of a virtual table and chamber.

    PYTHONPATH=tests python benchmarks/machines.py [SESSIONS]

A fifth of them has a chamber. Each move has a fault in three of ten cases: lost steps, a stall, an end switch, a slip
while it is sampled, a silent line, an open door, an overshoot. Where a session stops, its machines are repaired and it
is resumed. Exit code 1 where a position counts that was not so, or a session does not come to its end.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from support.moving_machines import FaultySession

RATE = 0.3


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

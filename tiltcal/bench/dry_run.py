"""A dry run: table and chamber go through all positions of a procedure without a sensor."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from functools import partial

from tiltcal.bench.drives import Angles, open_drive
from tiltcal.bench.machines import Mover, carrier_of, in_words, wanted
from tiltcal.drivers.bus.clock import SECOND, session_clock
from tiltcal.errors import HardwareError, UsageError
from tiltcal.journal.header import Setup
from tiltcal.printable import in_minutes


def dry_run(setup: Setup, say: Callable[[str], None]) -> None:
    """Send the machines of a bench to every position, and say what is read back there and how long it took.

    UsageError: nothing of the bench moves by itself in these positions.
    HardwareError: a position is not reached; it is named.
    """
    machines, positions = setup.machines, setup.steps.positions
    if not machines:
        raise UsageError("a dry run moves the table or the chamber of a bench file, and there is none to move")
    clock = session_clock(setup.began, virtual=setup.simulated)
    carrier = carrier_of(machines.values()) or "x"
    used: dict[str, list[float]] = {axis: [] for one in machines.values() for axis in one.limits}
    by_hand = set[str]()
    began_ns = clock.now_ns()
    with ExitStack() as stack:
        movers = [Mover(name, one, clock, partial(open_drive, one, clock)) for name, one in machines.items()]
        for mover in movers:
            stack.callback(mover.close)
            mover.require_there()
        for number, position in enumerate(positions, start=1):
            targets, before_ns = wanted(position, carrier), clock.now_ns()
            by_hand |= {axis for axis, angle in targets.items() if axis not in used and angle}
            reached: dict[str, float] = {}
            try:
                for mover in movers:
                    mine = {axis: targets[axis] for axis in mover.machine.limits if axis in targets}
                    reached |= mover.move(mine, _quietly) if mine else {}
            except HardwareError as error:
                raise HardwareError((f"{position.name}: ", *error.words)) from None
            for axis, angle in reached.items():
                used[axis].append(angle)
            took = (clock.now_ns() - before_ns) / SECOND
            say(f"{number}/{len(positions)}  {position.name:<12} {in_words(reached)}   {took:.0f} s")
    for name, machine in machines.items():
        for axis, (low, high) in machine.limits.items():
            if met := used[axis]:
                says = f"the {name} went from {min(met):.6g} to {max(met):.6g} in {axis}"
                say(f"{says}; its limits are {low:g} and {high:g}")
    length = in_minutes((clock.now_ns() - began_ns) / SECOND)
    say(f"all {len(positions)} positions were reached in {length}, without a sensor")
    if by_hand:
        say(f"no machine sets {', '.join(sorted(by_hand))}: it will be asked for")


def _quietly(why: str, at: Angles) -> None:
    """Say nothing on the way."""

"""The schedule of a session: how long it takes at least, and the order of its positions that moves a table least."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate, groupby, pairwise
from math import acos, degrees

from tiltcal.drivers.model import Model
from tiltcal.files.procedure import Position, Procedure

WORTH_REORDERING = 0.9
"""Another order is proposed where its way is less than this share of the way of the procedure's."""

NOT_BESIDE = 360.0
"""Way between two visits to one setting, degrees: what is not set anew between them shows no error of the jig."""


def least_seconds(procedure: Procedure, model: Model, samples: int, settle: float, soak: float) -> float:
    """Return how long readings must hold still and are sampled; setting and changing temperatures come on top.

    ``settle`` and ``soak`` are the windows in seconds. Of a ramp it is the time at its pace.
    """
    temperatures = [position.temperature for position in procedure.positions]
    if (ramp := procedure.ramp) is not None:
        met = [one for one in (procedure.reference, *temperatures) if one is not None]
        return 60.0 * sum(abs(end - start) for start, end in pairwise(met)) / ramp.pace
    late = (procedure.soak.thermometer or 0.0) * soak / procedure.soak.seconds
    windows = [
        settle if new is None or new == before else max(soak, late) for before, new in pairwise([None, *temperatures])
    ]
    return sum(windows) + len(temperatures) * samples * model.interval


def way(positions: Sequence[Position], beside: float = 0.0) -> float:
    """Return by how many degrees a table turns from the first position to the last: its attitude and its heading.

    ``beside`` counts where a setting follows itself.
    """
    return sum(_turn(start, end) or beside for start, end in pairwise(positions))


def _turn(start: Position, end: Position) -> float:
    along = sum(a * b for a, b in zip(start.gravity, end.gravity, strict=True))
    about = abs((end.heading or 0.0) - (start.heading or 0.0)) % 360.0
    return degrees(acos(max(-1.0, min(along, 1.0)))) + min(about, 360.0 - about)


def shortest(positions: Sequence[Position]) -> list[Position]:
    """Return positions in the order with the shortest way, their temperatures in the order in which they are.

    A stretch of one temperature is turned round as long as that shortens the way; the first stays the first, and the
    last of a procedure that closes the last.
    """
    closes = len(positions) > 1 and _turn(positions[0], positions[-1]) == 0.0
    order, first = list(positions), 1
    stretches = [len(list(stretch)) for _, stretch in groupby(positions, key=lambda position: position.temperature)]
    for end in accumulate(stretches):
        last = end - 1 if closes and end == len(positions) else end
        shorter = True
        while shorter:
            shorter = False
            for start in range(first, last):
                for stop in range(start + 2, last + 1):
                    turned = [*order[:start], *reversed(order[start:stop]), *order[stop:]]
                    if way(turned, NOT_BESIDE) < way(order, NOT_BESIDE) - 1e-6:
                        order, shorter = turned, True
        first = end
    return order


def better_order(positions: Sequence[Position]) -> list[Position] | None:
    """Return a much shorter order of positions; None where theirs is as good."""
    order = shortest(positions)
    return order if way(order) < WORTH_REORDERING * way(positions) else None

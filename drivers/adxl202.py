"""Analog Devices ADXL202, ADXL202E and ADXL210 dual-axis accelerometers at their duty-cycle outputs.

Each axis is a pulse of length T1 in a period T2 that both share; the reading is the duty cycle T1/T2, nominally 0.5 at
0 g and 0.125 more for each g (0.04 for the ADXL210). T2 drifts, so T1 alone is never a reading. The pulses arrive as

- sentences of a microcontroller that times them (:mod:`tiltcal.drivers.sentences`);
- edges of two lines with their times, from a GPIO chip or from a logic analyser's file (:mod:`tiltcal.drivers.pulses`).

Sources: ADXL202/210 data sheet Rev. B, ADXL202E data sheet Rev. A, application notes AN-603 and AN-604.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

from tiltcal.drivers.bus.edges import RECORD, Edge, unpack_edges
from tiltcal.drivers.converter import SCHEMES as CONVERTERS
from tiltcal.drivers.device import Model, Reading, deviation_within, from_twin, in_words
from tiltcal.drivers.lines import UNUSABLE, LineBuffer, shown
from tiltcal.drivers.pulses import Cycle, PulseTrains
from tiltcal.drivers.sentences import Sentence, missing, parse_sentence
from tiltcal.errors import BusError, DeviceFault

if TYPE_CHECKING:
    from tiltcal.drivers.bus.address import Address
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.bus.link import Link

ZERO = 0.5
"""Nominal duty cycle at 0 g."""

EDGES_AT_ONCE = 256
"""The largest number of edges to take in one transaction."""

TROUBLED = 256
"""Transactions with edges, but without a cycle, before the driver raises an error."""


class Adxl202Sentences:
    """The driver of an ADXL202 behind a microcontroller that sends sentences on a serial line."""

    def __init__(self, link: Link, clock: Clock) -> None:
        self._lines = LineBuffer(link, clock)
        self._number: int | None = None
        self._damaged_since = 0
        self._used = self._damaged = self._lost = self._restarts = 0

    def probe(self) -> Mapping[str, str]:
        """Return a new sentence, and the link statistics, as text; the errors are those of :meth:`read`."""
        self.discard()
        sentence = self._next()
        said = _in_words(sentence.duty)
        said["period"] = f"{sentence.periods[0]:g} ticks"
        if sentence.temperature is not None:
            said["temperature"] = f"{sentence.temperature:.1f} °C"
        return said | {"link": in_words(self.link_statistics())}

    def read(self) -> Reading:
        """Return the next undamaged sentence: the duty cycles of x and y, and the temperature where it is sent, °C.

        Raises
        ------
        BusError
            No data, or no valid sentence.
        """
        sentence = self._next()
        return Reading(sentence.duty, sentence.temperature)

    def discard(self) -> None:
        """Discard queued data; they do not count as lost."""
        self._lines.discard()
        self._number = None

    def link_statistics(self) -> Mapping[str, int]:
        """Return the counts of used, damaged and lost sentences (gaps in the sequence), and its restarts."""
        return {"sentences": self._used, "damaged": self._damaged, "lost": self._lost, "restarts": self._restarts}

    def _next(self) -> Sentence:
        for _ in range(UNUSABLE):
            line, whole = self._lines.next()
            # After a lost line end, a second sentence follows; the part before its "$" is damaged.
            garbage, _, _ = line.rpartition(b"$")
            sentence = parse_sentence(line[len(garbage) :])
            if (garbage or sentence is None) and (whole or line.startswith(b"$")):
                self._damaged += 1
                self._damaged_since += 1
            if sentence is not None and self._in_sequence(sentence.number):
                self._used += 1
                return sentence
        raise BusError(
            f"{UNUSABLE} lines arrived and none was a sentence $PTCDC,seq,t1x,t1y,t2x,t2y*hh with its checksum; "
            f"the last was {shown(line)}: is the baud rate right, and does the microcontroller time both axes?"
        )

    def _in_sequence(self, number: int) -> bool:
        """Count the missing sentences before this one, and return whether it is new."""
        before, self._number = self._number, number
        damaged, self._damaged_since = self._damaged_since, 0
        if number == before:
            return False
        if before is not None:
            gap = missing(before, number)
            if gap is None:
                self._restarts += 1
            else:
                # A damaged sentence leaves a gap too, and is already counted.
                self._lost += max(gap - damaged, 0)
        return True


class Adxl202Edges:
    """The driver of an ADXL202 on two lines that are captured edge by edge."""

    def __init__(self, link: Link, clock: Clock) -> None:
        self._link = link
        self._trains = PulseTrains()
        self._ready: deque[Cycle] = deque()
        self._used = 0

    def probe(self) -> Mapping[str, str]:
        """Return a new period, and the link statistics, as text; the errors are those of :meth:`read`."""
        self.discard()
        cycle = self._next()
        said = _in_words(cycle.duty)
        return said | {"period": f"{cycle.period / 1e6:.6g} ms", "link": in_words(self.link_statistics())}

    def read(self) -> Reading:
        """Return the next period: the duty cycles of x and y.

        Raises
        ------
        BusError
            No edges.
        DeviceFault
            One line is dead, or the lines do not belong together.
        """
        return Reading(self._next().duty)

    def discard(self) -> None:
        """Discard queued data; they do not count as lost."""
        self._trains.restart()
        self._ready.clear()
        self._link.exchange(b"", 0)

    def link_statistics(self) -> Mapping[str, int]:
        """Return the counts of used periods, lost edges (gaps in their numbers), and periods with a missing pulse."""
        return {"periods": self._used, "lost edges": self._trains.lost, "torn periods": self._trains.torn}

    def _next(self) -> Cycle:
        for _ in range(TROUBLED):
            if self._ready:
                self._used += 1
                return self._ready.popleft()
            for edge in self._edges():
                cycle = self._trains.take(edge)
                if cycle is not None:
                    self._ready.append(cycle)
        raise DeviceFault("edges arrive, but no complete period of both lines: are the wires of x and y loose?")

    def _edges(self) -> Iterator[Edge]:
        try:
            return unpack_edges(self._link.exchange(b"", EDGES_AT_ONCE * RECORD.size))
        except BusError:
            # After a reconnection the edges are numbered from the start.
            self._trains.restart()
            raise


def _in_words(duty: tuple[float, float]) -> dict[str, str]:
    return {channel: f"{share:.6f} duty" for channel, share in zip("xy", duty, strict=True)}


@dataclass(frozen=True, slots=True)
class Adxl202Variant:
    """The constants of one part.

    Attributes
    ----------
    duty_per_g : float
        Nominal sensitivity.
    noise_density : float
        g/√Hz.
    """

    duty_per_g: float
    noise_density: float


SENSITIVITY_LIMIT = 0.2
"""Largest relative error of the sensitivity between parts: 10 to 15 %/g around 12.5 (AN-603)."""

OFFSET_SPREAD = 0.5
"""Standard deviation of the offset between parts, g; our estimate, because the notes state only that it varies."""


def _configured(model: Model, address: Address) -> Model:
    """Return the model for an address; at a ``sim:`` address ``wiring=edges`` selects edges."""
    if address.scheme in CONVERTERS:
        from tiltcal.drivers import find_model

        return find_model(f"{model.name}-analog").at(address)
    if "wiring" in address.options and not address.simulated:
        address.refuse("option 'wiring' is for sim: addresses; the scheme of a real address states it")
    wiring = address.text("wiring", "sentences")
    if wiring not in ("sentences", "edges"):
        address.refuse(f"option wiring={wiring} is neither sentences nor edges")
    if wiring == "sentences" and address.scheme in ("serial", "sim"):
        return model
    return replace(
        model,
        schemes=("gpio", "vcd", "serial"),
        thermometer=False,
        driver=Adxl202Edges,
        twin=from_twin("adxl202", "EdgesTwin"),
    )


def _model(name: str, title: str, variant: Adxl202Variant) -> Model:
    model = Model(
        name=name,
        title=title,
        channels=("x", "y"),
        unit="duty",
        schemes=("serial", "gpio", "vcd"),
        addresses=(
            "serial:///dev/ttyUSB0?baudrate=115200",
            "gpio:///dev/gpiochip0?x=17&y=27",
            "vcd:capture.vcd?x=D0&y=D1",
            "ads1115+i2c:///dev/i2c-1?address=0x48&x=0&y=1&supply=2",
        ),
        offset=ZERO,
        sensitivity=variant.duty_per_g,
        offset_spread=OFFSET_SPREAD,
        sensitivity_spread=deviation_within(SENSITIVITY_LIMIT),
        rails=(0.0, 1.0),
        resolution=0.0,
        # The sensor streams: a read waits for the next sentence.
        interval=0.0,
        thermometer=True,
        driver=Adxl202Sentences,
        twin=from_twin("adxl202", "sentences_twin"),
        not_modelled=(
            "response time and bandwidth: a new position takes effect at once, the noise of two samples is independent",
            "self-test",
            "supply: ratiometric error, digital noise on the supply",
            "late timestamps, loss and damage on the line",
            "a receive buffer: sentences that are not read at once are missing from the sequence",
            "the period's drift with temperature, on edges (sentences have it)",
            "the memory fault (parity) of other parts: this part has no such memory",
        ),
        default_truth=from_twin("adxl202", "draw_truth", variant),
        options=("wiring",),
    )
    return replace(model, configure=partial(_configured, model))


ADXL202 = _model("adxl202", "Analog Devices ADXL202 accelerometer, ±2 g, duty cycle", Adxl202Variant(0.125, 500e-6))
ADXL202E = _model("adxl202e", "Analog Devices ADXL202E accelerometer, ±2 g, duty cycle", Adxl202Variant(0.125, 200e-6))
ADXL210 = _model("adxl210", "Analog Devices ADXL210 accelerometer, ±10 g, duty cycle", Adxl202Variant(0.04, 500e-6))

"""An ADXL202 behind a microcontroller on a pseudo-terminal, written from the data sheet for the tests alone.

It shares no line with the drivers or their twins. Modelled: duty cycles with offset, a sensitivity matrix, a linear
drift of each offset and Gaussian noise; a period that is off nominal and drifts with temperature; whole timer ticks;
the sentence with its sequence number and checksum; on request, damage to one sentence in so many.
"""

import random
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field

from support.pty_device import printing

SENTENCES_A_SECOND = 250


@dataclass
class Adxl202Part:
    """The part, its pose and its line: duty cycles at 0 g and 24 °C, their change per °C, and per g rows of X and Y.

    ``damage_one_in`` 0 damages none; ``sent`` and ``damaged`` are sentences so far.
    """

    offset: tuple[float, float] = (0.5123, 0.4868)
    sensitivity: tuple[tuple[float, float], tuple[float, float]] = ((0.1312, 0.0021), (-0.0014, 0.1187))
    drift: tuple[float, float] = (2.1e-4, -1.6e-4)
    noise: float = 2.5e-4
    ticks: int = 20_000
    damage_one_in: int = 0
    gravity: Sequence[float] = (0.0, 0.0, 1.0)
    temperature: float = 24.0
    sent: int = 0
    damaged: int = 0
    _random: random.Random = field(default_factory=lambda: random.Random(202))

    def sentence(self) -> bytes:
        """The next sentence, as it goes over the line."""
        warm = self.temperature - 24.0
        period = round(self.ticks * 1.037 * (1 + 8e-4 * warm))
        highs = []
        for offset, row, drift in zip(self.offset, self.sensitivity, self.drift, strict=True):
            duty = offset + drift * warm + row[0] * self.gravity[0] + row[1] * self.gravity[1]
            highs.append(round((duty + self._random.gauss(0.0, self.noise)) * period))
        body = f"PTCDC,{self.sent},{highs[0]},{highs[1]},{period},{period},{self.temperature:.1f}"
        parity = 0
        for character in body:
            parity ^= ord(character)
        whole = f"${body}*{parity:02X}\r\n".encode()
        self.sent += 1
        return self._damage(whole) if self.damage_one_in and self.sent % self.damage_one_in == 0 else whole

    def _damage(self, whole: bytes) -> bytes:
        """One character changed, a piece missing, or noise before it: what a long cable does."""
        self.damaged += 1
        way = self.damaged % 3
        # Behind "$PTCDC,nnn," stand the numbers that a careless reader would believe.
        place = whole.index(b",", 8) + 1
        if way == 0:
            return whole[:place] + bytes([whole[place] ^ 0x04]) + whole[place + 1 :]
        if way == 1:
            return whole[:place] + whole[place + 3 :]
        return whole[: place + 2] + b"\xff\x00\x81\r\n"


def on_a_pty(part: Adxl202Part) -> AbstractContextManager[str]:
    """Let the part print on a pseudo-terminal; its path."""
    return printing(part.sentence, SENTENCES_A_SECOND, waits=False)

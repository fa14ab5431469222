"""Accelerometers of hobby boards on I2C, written from their data sheets for the tests alone: as little as works.

A part has its identity, power and range registers and its data, and nothing else: other registers read 0 and keep
nothing. It shares no line with the drivers, and needs the system's Python alone.
"""

from __future__ import annotations

import struct

from support.held_part import Held

FACTS = {
    # Identity; power register, its bits that decide, what they are while it does not measure; range register and its
    # bits; data, their layout, shift and digits to 1 g; bit that makes a burst count on.
    "mpu6050": (0x75, 0x68, 0x6B, 0x40, 0x40, 0x1C, 0x18, 0x3B, ">4h", 0, 16384, 0x00),
    "adxl345": (0x00, 0xE5, 0x2D, 0x08, 0x00, 0x31, 0x0B, 0x32, "<3h", 0, 256, 0x00),
    "lis3dh": (0x0F, 0x33, 0x20, 0xF0, 0x00, 0x23, 0x38, 0x28, "<3h", 4, 1000, 0x80),
}
FULL = {"mpu6050": 0x00, "adxl345": 0x08, "lis3dh": 0x08}
"""What the range bits have to be for ±2 g at full resolution."""


class AccelerometerPart(Held):
    """The part, and the jig that holds it: offsets in g, a sensitivity matrix in g/g, noise of a word in g."""

    def __init__(
        self, model: str, offset: list[float], sensitivity: list[list[float]], noise: float, jig: float, seed: int
    ) -> None:
        super().__init__(jig, seed)
        self.model, self.offset, self.sensitivity, self.noise = model, offset, sensitivity, noise
        (self.who, identity, self.power, *_, self.range, _, _, _, _, _, _) = FACTS[model]
        self.registers = {self.who: identity, self.power: 0x40 if model == "mpu6050" else 0x00, self.range: 0x00}
        self.pointer = 0

    def message(self, out: bytes, count: int, now_ns: int) -> bytes:
        """Answer one message: a write sets the pointer and may set a register, a read begins at the pointer."""
        if len(out) == 2 and out[0] in (self.power, self.range):
            self.registers[out[0]] = out[1]
        if out:
            self.pointer = out[0]
        burst_bit = FACTS[self.model][11]
        counts_on = not burst_bit or self.pointer & burst_bit
        held = {**self.registers, **self.data()}
        first = self.pointer & ~burst_bit
        return bytes(held.get(first + (place if counts_on else 0), 0) for place in range(count))

    def data(self) -> dict[int, int]:
        """The data registers: 0 while it does not measure, or has another range than ±2 g."""
        _, _, power, deciding, idle, scale, bits, first, layout, shift, digits, _ = FACTS[self.model]
        if self.registers[power] & deciding == idle or self.registers[scale] & bits != FULL[self.model]:
            return {}
        words = []
        for offset, row in zip(self.offset, self.sensitivity):  # noqa: B905
            g = offset + sum(k * one for k, one in zip(row, self.gravity))  # noqa: B905
            words.append(max(-32768, min(32767, round(digits * self.chance.gauss(g, self.noise)) << shift)))
        if layout == ">4h":
            words.append(round((self.temperature - 36.53) * 340))
        return dict(enumerate(struct.pack(layout, *words), first))

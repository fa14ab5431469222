"""WitMotion's serial sensors, such as the WT901, JY901 and BWT61: frames with a checksum, of which we read one kind.

A frame is 0x55, its kind, eight bytes of data and the sum of these ten bytes. Kind 0x51 holds three accelerations,
32768 counts to 16 g, and a temperature; each is 16 bits, low byte first. Other kinds are skipped.

Sources: WT901, Datasheet v20-0702, 5.1.2; BWT61CL, Datasheet v20-0630, 6.1.1. They agree but for the temperature:
hundredths of °C, or T/340 + 36.53 °C, so the address states which.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from struct import Struct

from tiltcal.drivers.bus import Link
from tiltcal.drivers.bus.address import Address
from tiltcal.drivers.bus.clock import Clock
from tiltcal.drivers.model import Model, Reading, Sensor, deviation_within
from tiltcal.drivers.virtual import HeldPose, StreamingPart, Tolerances, Truth
from tiltcal.errors import BusError

HEAD, ACCELERATION = 0x55, 0x51
DATA = Struct("<4h")
LENGTH = 11  # bytes of a frame
COUNT_PER_G = 2048.0
CHANNELS = ("x", "y", "z")
OFFSET, SENSITIVITY = 0.05, 0.02  # largest offset, g, and relative error of a virtual part; no source states them
NOISE = 2.0  # of a sample of a virtual part, count; no source states it
LONGEST = 2048
"""Bytes without an acceleration that are an error: nearly two seconds of ten other kinds, 110 bytes a second each."""

THERMOMETERS: Mapping[str, tuple[float, float] | None] = {
    "no": None,
    "hundredths": (100.0, 0.0),
    "mpu6050": (340.0, 36.53),
}
"""Counts to 1 °C, and °C at 0, by what ``thermometer=`` states."""


def framed(kind: int, data: bytes) -> bytes:
    """Return a frame with its checksum."""
    frame = bytes((HEAD, kind)) + data
    return frame + bytes((sum(frame) % 256,))


class WitMotionSensor(Sensor):
    """The driver; ``thermometer`` is a value of :data:`THERMOMETERS`."""

    def __init__(self, thermometer: tuple[float, float] | None, link: Link, clock: Clock) -> None:
        self._thermometer = thermometer
        self._link = link
        self._arrived = b""
        self._used = self._damaged = 0

    def read(self) -> Reading:
        """Return the next acceleration.

        BusError: silence, or no frame of accelerations with a right checksum.
        """
        taken = 0
        while True:
            while (data := self._next()) is not None:
                if data[0] == ACCELERATION:
                    self._used += 1
                    *values, last = DATA.unpack(data[1:])
                    return Reading(tuple(map(float, values)), self._celsius(last))
            if taken > LONGEST:
                self._arrived = b""
                raise BusError(
                    f"{taken} bytes came without a frame of accelerations: is the baud rate right (9600 as delivered), "
                    "and does the sensor send accelerations (0x51)?"
                )
            arrived = self._listen()
            taken += len(arrived)

    def discard(self) -> None:
        """Discard queued data."""
        self._arrived = b""
        self._link.exchange(b"", 0)

    def link_statistics(self) -> Mapping[str, int]:
        """Return the counts of used frames, and of frames whose checksum is wrong."""
        return {"frames": self._used, "damaged": self._damaged}

    def _listen(self) -> bytes:
        try:
            arrived = self._link.exchange(b"", 4096)
        except BusError:
            self._arrived = b""  # what comes after a reconnection does not continue this frame
            raise
        self._arrived += arrived
        return arrived

    def _next(self) -> bytes | None:
        """Return kind and data of the next sound frame that has arrived whole."""
        while (start := self._arrived.find(HEAD)) >= 0 and len(self._arrived) - start >= LENGTH:
            frame = self._arrived[start : start + LENGTH]
            if sum(frame[:-1]) % 256 == frame[-1]:
                self._arrived = self._arrived[start + LENGTH :]
                return frame[1:-1]
            # 0x55 is a byte of data as well: what follows it may be a frame.
            self._damaged += start == 0
            self._arrived = self._arrived[start + 1 :]
        return None

    def _celsius(self, count: int) -> float | None:
        if self._thermometer is None:
            return None
        scale, zero = self._thermometer
        return count / scale + zero


def _virtual(thermometer: tuple[float, float] | None, truth: Truth, fixture: HeldPose, clock: Clock) -> StreamingPart:
    """Return a sensor that sends accelerations and angular rates ten times a second."""
    scale, zero = thermometer or (100.0, 0.0)

    def message(number: int) -> bytes:
        words = [truth.sample(channel, fixture, clock, number) for channel in CHANNELS]
        celsius = fixture.temperature() + truth.thermometer_error
        counts = [min(max(round(word), -32768), 32767) for word in (*words, (celsius - zero) * scale)]
        return framed(0x52, bytes(8)) + framed(ACCELERATION, DATA.pack(*counts))

    return StreamingPart(truth, fixture, clock, message, period=0.1, baudrate=9600)


def _configured(address: Address) -> Model:
    thermometer = address.choice("thermometer", THERMOMETERS, None)
    return replace(
        WITMOTION,
        driver=partial(WitMotionSensor, thermometer),
        twin=partial(_virtual, thermometer),
        thermometer=thermometer is not None,
        thermometer_step=0.0 if thermometer is None else 1.0 / thermometer[0],
    )


WITMOTION = Model(
    name="witmotion",
    title="WitMotion WT901, JY901, BWT61 and others, serial frames",
    channels=CHANNELS,
    addresses=("serial:///dev/ttyUSB0?baudrate=9600",),
    sensitivity=COUNT_PER_G,
    offset_spread=deviation_within(OFFSET),
    sensitivity_spread=deviation_within(SENSITIVITY),
    rails=(-32768.0, 32767.0),
    resolution=1.0,
    driver=partial(WitMotionSensor, None),
    twin=partial(_virtual, None),
    not_modelled=("offset, noise and tolerances of a real part, which no source states",),
    default_truth=lambda seed: Tolerances(OFFSET, SENSITIVITY).draw(CHANNELS, COUNT_PER_G, NOISE, seed),
    options=("thermometer",),
    configure=_configured,
)

MODELS = {WITMOTION.name: WITMOTION}

"""The virtual DFRobot module: a virtual SCA100T behind a serial line."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tiltcal.drivers.dfrobot import HEADER, REQUEST, checksum
from tiltcal.drivers.sca100t import RDAX, RDAY, RWTR, decode_word
from tiltcal.drivers.twin.sca100t import RELOAD_NS, Sca100tTwin
from tiltcal.drivers.twin.streaming import LineTwin

if TYPE_CHECKING:
    from tiltcal.drivers.bus.clock import Clock
    from tiltcal.drivers.twin.fixture import HeldPose
    from tiltcal.drivers.twin.truth import Truth

BYTE_SECONDS = 10 / 9600


class DfrobotTwin(LineTwin):
    """The module on a serial line of 9600 baud.

    clock: advances by the bytes of request and answer.
    """

    letter = "r"

    def __init__(self, truth: Truth, fixture: HeldPose, clock: Clock) -> None:
        super().__init__(truth, clock)
        self._sensor = Sca100tTwin(truth, fixture, clock)

    def exchange(self, out: bytes, count: int = 0) -> bytes:
        """Answer a request; other bytes get no answer. See :class:`~tiltcal.drivers.bus.link.Link`."""
        self._require_line(silent=count > 0)
        if out != REQUEST:
            return b""
        self._clock.sleep(len(out) * BYTE_SECONDS)
        frames = [self._read(command) for command in ((RDAX, 0, 0), (RDAY, 0, 0), (RWTR, 0))]
        words = b"".join(decode_word(frame).to_bytes(2, "big") for frame in frames[:2])
        payload = words + frames[2][1:2]
        answer = HEADER + payload + bytes([checksum(payload)])
        self._clock.sleep(len(answer) * BYTE_SECONDS)
        return answer[:count]

    def _read(self, frame: tuple[int, ...]) -> bytes:
        self._clock.sleep(RELOAD_NS / 1e9)
        return self._sensor.exchange(bytes(frame))
